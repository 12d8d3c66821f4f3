"""Where each vertex sends its joint. RigNet [Xu et al. 2020], Section 4.1, Eq. 2."""

import torch
from torch import nn

from .joint_backbone import JointBackbone


class RigNetDisplacement(nn.Module):
    """positions (V, 3), one_ring (V, K1), geodesic_ball (V, K2), medial_offsets (V, 3) -> displacement (V, 3), normalised frame.

    The joint candidate of a vertex is position + displacement. Departure from the paper: the displacement starts from the
    way to the middle of the body part (``medial_offsets``), which geometry knows, so the network learns the way *along* the
    limb and what geometry cannot know. The last layer starts at zero and a tanh bounds what it adds.
    """

    inputs = ("positions", "one_ring", "geodesic_ball", "medial_offsets")
    output = "displacement"

    def __init__(self, width: float = 1.0, normalisation: str = "batch", dropout: float = 0.0):
        super().__init__()
        self.body = JointBackbone(3, width, normalisation, dropout)
        nn.init.zeros_(self.body.out.weight)
        nn.init.zeros_(self.body.out.bias)

    def forward(self, positions, one_ring, geodesic_ball, medial_offsets, graph_count: int = 1) -> torch.Tensor:
        return medial_offsets + torch.tanh(self.body(positions, one_ring, geodesic_ball, medial_offsets, graph_count))
