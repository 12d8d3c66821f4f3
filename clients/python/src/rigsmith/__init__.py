"""A client of a Rigsmith service: a mesh in, the same file with a skeleton and skin weights out.

    import rigsmith

    rigsmith.rig("knight.glb", out="knight-rigged.glb", detail=0.7)

`rig` is the whole way in one call, `Client` each step of it, `rigsmith.api` every operation as it is generated from the OpenAPI
document.
"""

try:
    from . import api
except ImportError as error:
    raise ImportError("the generated part of rigsmith is not there: `make python-client` writes it") from error

from .api.models import Artifact, Asset, Batch, BatchResult, Check, Finding, Rig
from .client import Client, rig
from .errors import (
    Broken,
    Busy,
    Conflict,
    Expired,
    FieldError,
    Forbidden,
    InvalidRequest,
    NotFinished,
    NotFound,
    NotUnderstood,
    Refused,
    RigFailed,
    RigsmithError,
    ServiceFault,
    TooLarge,
    Unreachable,
)
from .events import Event
from .files import Mesh
from .options import Options

__all__ = [
    "Artifact", "Asset", "Batch", "BatchResult", "Broken", "Busy", "Check", "Client", "Conflict", "Event", "Expired", "FieldError",
    "Finding", "Forbidden", "InvalidRequest", "Mesh", "NotFinished", "NotFound", "NotUnderstood", "Options", "Refused", "Rig",
    "RigFailed", "RigsmithError", "ServiceFault", "TooLarge", "Unreachable", "api", "rig",
]  # fmt: skip
