"""RigNet [Xu et al. 2020]: five networks, one class = one ONNX graph."""

from .attention import RigNetAttention
from .bone import RigNetBone
from .displacement import RigNetDisplacement
from .root import RigNetRoot
from .skin import RigNetSkin

NETWORKS = {
    "rignet_displacement": RigNetDisplacement,
    "rignet_attention": RigNetAttention,
    "rignet_bone": RigNetBone,
    "rignet_root": RigNetRoot,
    "rignet_skin": RigNetSkin,
}

__all__ = ["NETWORKS", "RigNetAttention", "RigNetBone", "RigNetDisplacement", "RigNetRoot", "RigNetSkin"]
