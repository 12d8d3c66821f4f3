"""Which pairs of joints are bones. RigNet [Xu et al. 2020], Section 4.2, Eq. 8."""

import torch
import torch.nn.functional as F
from torch import nn

from ..layers import perceptron
from .encoders import JointSetEncoder, ShapeEncoder, first_layer_by_parts


# The logit starts with -LENGTH_PENALTY x length, so that the tree of an untrained network is the shortest one. Learned.
LENGTH_PENALTY = 10.0


class RigNetBone(nn.Module):
    """One logit per candidate bone; the sigmoid is outside.

    positions (V, 3), one_ring (V, K1), geodesic_ball (V, K2): the character.
    joints (J, 3): normalised frame. pairs (P, 2): joint indices, any order.
    pair_features (P, 2): length, and the share of the bone that lies inside the shape.
    -> bone_logit (P,). Both orders of the two ends are evaluated and averaged, so the result is symmetric: a
    departure from the paper, which swaps the ends at random in training. Another one: a penalty on the length is added to
    the logit (LENGTH_PENALTY).
    """

    inputs = ("positions", "one_ring", "geodesic_ball", "joints", "pairs", "pair_features")
    output = "bone_logit"

    def __init__(self, width: float = 1.0, normalisation: str = "batch"):
        super().__init__()
        self.parts = [int(width * 128), int(width * 128), int(width * 256)]
        self.shape_code = ShapeEncoder([512, 256, 128], width, normalisation)
        self.joint_code = JointSetEncoder(width)
        self.pair_code = perceptron([8, *(int(width * c) for c in (32, 64, 128, 256))], "layer")
        self.head = perceptron([sum(self.parts), int(width * 128), int(width * 32)], "layer")
        self.out = nn.Linear(int(width * 32), 1)
        self.length_penalty = nn.Parameter(torch.tensor(LENGTH_PENALTY))

    def forward(self, positions, one_ring, geodesic_ball, joints, pairs, pair_features, graph_count: int = 1):
        shape_code = self.shape_code(positions, one_ring, geodesic_ball, graph_count)
        joint_code = self.joint_code(joints, graph_count)
        start, end = joints[pairs[:, 0]], joints[pairs[:, 1]]
        both_orders = torch.cat([torch.cat([start, end, pair_features], 1), torch.cat([end, start, pair_features], 1)])
        pair_code = self.pair_code(both_orders)

        first, second = self.head[0], self.head[1]
        of_shape, of_joints, of_pair = first_layer_by_parts(first.linear, self.parts)
        per_graph = F.linear(shape_code, of_shape, first.linear.bias) + F.linear(joint_code, of_joints)
        per_pair = F.linear(pair_code, of_pair).reshape(2, graph_count, -1, of_pair.shape[0])
        hidden = first.norm(torch.relu(per_pair + per_graph.unsqueeze(1)).reshape(-1, of_pair.shape[0]))
        logit = self.out(second(hidden)).reshape(2, -1)
        return 0.5 * (logit[0] + logit[1]) - self.length_penalty * pair_features[:, 0]
