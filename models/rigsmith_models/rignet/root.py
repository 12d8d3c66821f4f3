"""Which joint is the root. RigNet [Xu et al. 2020], Section 4.2."""

import torch
import torch.nn.functional as F
from torch import nn

from ..layers import perceptron
from .encoders import JointSetEncoder, ShapeEncoder, first_layer_by_parts


class RigNetRoot(nn.Module):
    """positions (V, 3), one_ring (V, K1), geodesic_ball (V, K2), joints (J, 3) -> root_logit (J,); the root is the argmax.

    A joint is described by its position and its distance |x| from the symmetry plane.
    """

    inputs = ("positions", "one_ring", "geodesic_ball", "joints")
    output = "root_logit"

    def __init__(self, width: float = 1.0, normalisation: str = "batch"):
        super().__init__()
        self.parts = [int(width * 128), int(width * 128), int(width * 256)]
        self.shape_code = ShapeEncoder([128], width, normalisation)
        self.joint_code = JointSetEncoder(width)
        self.own_code = perceptron([4, *(int(width * c) for c in (32, 64, 128, 256))], "layer")
        self.head = perceptron([sum(self.parts), int(width * 128), int(width * 32)], "layer")
        self.out = nn.Linear(int(width * 32), 1)

    def forward(self, positions, one_ring, geodesic_ball, joints, graph_count: int = 1) -> torch.Tensor:
        shape_code = self.shape_code(positions, one_ring, geodesic_ball, graph_count)
        joint_code = self.joint_code(joints, graph_count)
        own_code = self.own_code(torch.cat([joints, joints[:, :1].abs()], dim=1))

        first, second = self.head[0], self.head[1]
        of_shape, of_joints, of_own = first_layer_by_parts(first.linear, self.parts)
        per_graph = F.linear(shape_code, of_shape, first.linear.bias) + F.linear(joint_code, of_joints)
        per_joint = F.linear(own_code, of_own).reshape(graph_count, -1, of_own.shape[0])
        hidden = first.norm(torch.relu(per_joint + per_graph.unsqueeze(1)).reshape(-1, of_own.shape[0]))
        return self.out(second(hidden)).squeeze(1)
