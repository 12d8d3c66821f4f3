"""Meshes on their way out, and what was made on its way in."""

from __future__ import annotations

import base64
import hashlib
import os
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import IO

import httpx

from .errors import Broken

# A file, or its bytes.
Mesh = str | os.PathLike[str] | bytes
Part = tuple[str, tuple[str, bytes]]

# Which output a file name asks for, as on the command line: ending, word of the option, name of the artifact.
OUTPUTS = [
    (".rig.json", "rig_json", "rig.json"),
    (".glb", "glb", "rigged.glb"),
    (".gltf", "gltf", "rigged.gltf"),
    (".txt", "rignet_txt", "rignet.txt"),
    (".png", "preview_png", "preview.png"),
]


def form(mesh: Mesh, beside: Sequence[str | os.PathLike[str]]) -> list[Part]:
    """The parts of an upload: the mesh, then the files that it refers to."""
    if isinstance(mesh, bytes):
        first = ("mesh", mesh)
    else:
        first = (Path(mesh).name, Path(mesh).read_bytes())
    return [("file", first), *(("with", (Path(path).name, Path(path).read_bytes())) for path in beside)]


def output_of(path: Path) -> tuple[str, str]:
    """The option and the artifact for a file to be written. Raises ValueError for a name that tells neither."""
    for ending, option, artifact in OUTPUTS:
        if path.name.lower().endswith(ending):
            return option, artifact
    raise ValueError(f"{path}: the name must end in .glb, .gltf, .rig.json, .txt or .png")


def save(answer: httpx.Response, to: Path) -> None:
    """Writes the body to `to`, whole or not at all. Raises Broken."""
    with tempfile.NamedTemporaryFile(dir=to.parent, prefix=f".{to.name}.", delete=False) as file:
        try:
            receive(answer, file)
            file.close()
            os.replace(file.name, to)
        except BaseException:
            os.unlink(file.name)
            raise


def receive(answer: httpx.Response, file: IO[bytes]) -> None:
    """Writes the body, and compares it with its `Repr-Digest` (RFC 9530). Raises Broken."""
    digest = hashlib.sha256()
    for chunk in answer.iter_bytes():
        digest.update(chunk)
        file.write(chunk)
    told = answer.headers.get("repr-digest", "")
    if told != f"sha-256=:{base64.b64encode(digest.digest()).decode()}:":
        raise Broken(f"{answer.request.url}: what came does not have the digest that the service told ({told or 'none'})")


def outputs_of(paths: Iterable[Path]) -> list[str]:
    """What is to be made for `paths`, each once."""
    return list(dict.fromkeys(output_of(path)[0] for path in paths))
