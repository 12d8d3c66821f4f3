"""Which joint is the root. RigNet [Xu et al. 2020], Section 4.2."""

import torch
from torch import nn

from ..layers import perceptron
from .joint_graph import JointGraph, of_one_size, pooled

DROPOUT = 0.1


class RigNetRoot(nn.Module):
    """positions (V, 3), joints (J, 3), pair_features (P, 2) as of RigNetBone -> root_logit (J,); the root is the argmax.

    Departure from the paper: the joint graph, shared with the bone network in training (train/skeleton_stage.py).
    """

    inputs = ("positions", "joints", "pair_features")
    output = "root_logit"

    def __init__(self, width: float = 1.0, normalisation: str = "layer", graph: JointGraph | None = None):
        super().__init__()
        self.graph = graph or JointGraph(width)
        channels = self.graph.channels
        self.head = nn.Sequential(perceptron([2 * channels, channels], "layer"), nn.Dropout(DROPOUT))
        self.out = nn.Linear(channels, 1)

    def of_codes(self, codes, valid) -> torch.Tensor:
        """(G, J, C), (G, J) -> logits (G, J)."""
        return self.out(self.head(torch.cat([codes, pooled(codes, valid)], dim=2))).squeeze(2)

    def forward(self, positions, joints, pair_features, graph_count: int = 1) -> torch.Tensor:
        inputs = of_one_size(positions, joints, pair_features, graph_count)
        codes, _, _ = self.graph(*inputs)
        return self.of_codes(codes, inputs[-1]).reshape(-1)
