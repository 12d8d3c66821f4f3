"""Displacement and attention fine-tuned together, through the mean shift that will read them. RigNet, Section 4.1."""

import torch
from torch import nn

from ..rignet import RigNetAttention, RigNetDisplacement

BANDWIDTH_START, BANDWIDTH_LIMITS = 0.05, (0.02, 0.1)
SHIFT_STEPS = 8
SHIFT_STEP_LENGTH = 0.3


class JointStage(nn.Module):
    """The two networks and the learned bandwidth. Exported as the two networks; the bandwidth only trains."""

    parts = {"displacement": "rignet_displacement", "attention": "rignet_attention"}

    def __init__(self, width: float, normalisation: str):
        super().__init__()
        self.displacement = RigNetDisplacement(width, normalisation)
        self.attention = RigNetAttention(width, normalisation)
        self.bandwidth = nn.Parameter(torch.tensor(BANDWIDTH_START))

    def forward(self, positions, one_ring, geodesic_ball, medial_offsets, graph_count: int = 1):
        """-> displacement (G*V, 3), attention_logit (G*V,)."""
        shape = (positions, one_ring, geodesic_ball, medial_offsets, graph_count)
        return self.displacement(*shape), self.attention(*shape)


def mean_shift_states(points, attention, bandwidth) -> list[torch.Tensor]:
    """Eq. 6, all points moving together. points: (G, N, 3), attention: (G, N) -> the points after each step.

    ``m_v = sum_u a_u K(q_u - q_v) q_u / sum_u a_u K(q_u - q_v) - q_v`` with ``K(x) = max(h^2 - |x|^2, 0)``.
    """
    states = []
    for _ in range(SHIFT_STEPS):
        norm = (points**2).sum(2)
        squared = norm.unsqueeze(2) + norm.unsqueeze(1) - 2 * points @ points.transpose(1, 2)
        kernel = torch.relu(bandwidth**2 - squared.clamp(min=0)) * attention.unsqueeze(1)
        mean = (kernel @ points) / (kernel.sum(2, keepdim=True) + 1e-8)
        points = points + SHIFT_STEP_LENGTH * (mean - points)
        states.append(points)
    return states
