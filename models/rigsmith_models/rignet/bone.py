"""Which pairs of joints are bones. RigNet [Xu et al. 2020], Section 4.2, Eq. 8."""

import torch
from torch import nn

from ..layers import perceptron
from .joint_graph import JointGraph, of_one_size

# The logit starts with -LENGTH_PENALTY x length, so that the tree of an untrained network is the shortest one. Learned.
LENGTH_PENALTY = 10.0
DROPOUT = 0.1


class RigNetBone(nn.Module):
    """One logit per candidate bone; the sigmoid is outside.

    positions (V, 3): the character. joints (J, 3): normalised frame. pairs (P, 2): all pairs i < j in lexicographic order, either
    end first. pair_features (P, 2): length, and the share of the bone that lies inside the shape. -> bone_logit (P,).
    Departures from the paper: the joint graph, and a penalty on the length that is added to the logit (LENGTH_PENALTY).
    """

    inputs = ("positions", "joints", "pairs", "pair_features")
    output = "bone_logit"

    def __init__(self, width: float = 1.0, normalisation: str = "layer", graph: JointGraph | None = None):
        super().__init__()
        self.graph = graph or JointGraph(width)
        channels = self.graph.channels
        self.head = nn.Sequential(perceptron([3 * channels, channels], "layer"), nn.Dropout(DROPOUT))
        self.out = nn.Linear(channels, 1)
        self.length_penalty = nn.Parameter(torch.tensor(LENGTH_PENALTY))

    def of_codes(self, codes, pairs, distance) -> torch.Tensor:
        """Logits of all pairs, (G, J, J), from the codes of the joint graph."""
        start, end = codes.unsqueeze(2), codes.unsqueeze(1)
        hidden = self.head(torch.cat([start + end, (start - end).abs(), pairs], dim=3))
        return self.out(hidden).squeeze(3) - self.length_penalty * distance

    def forward(self, positions, joints, pairs, pair_features, graph_count: int = 1):
        logit = self.of_codes(*self.graph(*of_one_size(positions, joints, pair_features, graph_count)))
        joint_count = logit.shape[1]
        return logit.reshape(-1)[pairs[:, 0] * joint_count + pairs[:, 1] % joint_count]
