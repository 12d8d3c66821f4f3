"""How much each vertex has to say about joints. RigNet [Xu et al. 2020], Section 4.1, Eq. 6."""

import torch
from torch import nn

from .joint_backbone import JointBackbone


class RigNetAttention(nn.Module):
    """positions, one_ring, geodesic_ball, medial_offsets as for the displacement -> attention_logit (V,); the sigmoid is outside."""

    inputs = ("positions", "one_ring", "geodesic_ball", "medial_offsets")
    output = "attention_logit"

    def __init__(self, width: float = 1.0, normalisation: str = "batch", dropout: float = 0.0):
        super().__init__()
        self.body = JointBackbone(1, width, normalisation, dropout)

    def forward(self, positions, one_ring, geodesic_ball, medial_offsets, graph_count: int = 1) -> torch.Tensor:
        return self.body(positions, one_ring, geodesic_ball, medial_offsets, graph_count).squeeze(1)
