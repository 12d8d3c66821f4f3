"""Every network by the name of its file. One class = one ONNX graph."""

from .heter_skin_net import HeterSkinNet
from .rignet import NETWORKS as RIGNET

NETWORKS = {**RIGNET, "heter_skin_net": HeterSkinNet}
