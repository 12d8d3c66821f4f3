"""Where each vertex sends its joint. RigNet [Xu et al. 2020], Section 4.1, Eq. 2."""

import torch
from torch import nn

from .joint_backbone import JointBackbone


class RigNetDisplacement(nn.Module):
    """positions (V, 3), one_ring (V, K1), geodesic_ball (V, K2) -> displacement (V, 3), normalised frame, each in (-1, 1).

    The joint candidate of a vertex is position + displacement. The last layer starts at zero (no displacement) and a
    tanh bounds the result; the paper leaves both open.
    """

    inputs = ("positions", "one_ring", "geodesic_ball")
    output = "displacement"

    def __init__(self, width: float = 1.0, normalisation: str = "batch", dropout: float = 0.0):
        super().__init__()
        self.body = JointBackbone(3, width, normalisation, dropout)
        nn.init.zeros_(self.body.out.weight)
        nn.init.zeros_(self.body.out.bias)

    def forward(self, positions, one_ring, geodesic_ball, graph_count: int = 1) -> torch.Tensor:
        return torch.tanh(self.body(positions, one_ring, geodesic_ball, graph_count))
