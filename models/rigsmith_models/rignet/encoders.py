"""Encoders shared (in shape, not in weights) by BoneNet and RootNet. RigNet, Section 4.2, Table 6."""

import torch
from torch import nn

from ..layers import GMEdgeConv, maximum_per_graph, perceptron


class ShapeEncoder(nn.Module):
    """positions: (G*V, 3), one_ring: (G*V, K1), geodesic_ball: (G*V, K2) -> (G, C), one code per character."""

    def __init__(self, channels: list[int], width: float, normalisation: str):
        super().__init__()
        first, second, third = (int(width * c) for c in (64, 128, 256))
        self.convolution_1 = GMEdgeConv(3, first, normalisation)
        self.convolution_2 = GMEdgeConv(first, second, normalisation)
        self.convolution_3 = GMEdgeConv(second, third, normalisation)
        self.mix = perceptron([first + second + third, *(int(width * c) for c in channels)], normalisation)

    def forward(self, positions, one_ring, geodesic_ball, graph_count: int) -> torch.Tensor:
        x1 = self.convolution_1(positions, one_ring, geodesic_ball)
        x2 = self.convolution_2(x1, one_ring, geodesic_ball)
        x3 = self.convolution_3(x2, one_ring, geodesic_ball)
        return maximum_per_graph(self.mix(torch.cat([x1, x2, x3], dim=1)), graph_count)


class JointSetEncoder(nn.Module):
    """joints: (G*J, 3) -> (G, 128*width), the paper's plain PointNet: per joint MLP, maximum, MLP.

    In a batch every character has the same number of rows; padding repeats a joint, which the maximum ignores. Layer
    normalisation, always: a batch has few characters and many padded rows, so its statistics would mean little.
    """

    def __init__(self, width: float):
        super().__init__()
        self.per_joint = perceptron([3, *(int(width * c) for c in (64, 128, 1024))], "layer")
        self.pooled = perceptron([int(width * c) for c in (1024, 256, 128)], "layer")

    def forward(self, joints, graph_count: int) -> torch.Tensor:
        return self.pooled(maximum_per_graph(self.per_joint(joints), graph_count))


def first_layer_by_parts(layer: nn.Linear, parts: list[int]) -> list[torch.Tensor]:
    """Splits the weight of a linear layer over a concatenation, so that parts shared by many rows are multiplied once."""
    return list(layer.weight.split(parts, dim=1))
