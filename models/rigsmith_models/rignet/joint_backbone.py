"""The body shared (in shape, not in weights) by the displacement and attention networks. RigNet, Section 4.1, Table 6."""

import torch
from torch import nn

from ..layers import GMEdgeConv, add_to_graph, maximum_per_graph, normalisation_layer, perceptron

# Hidden widths of Table 6 at width 1.
CONVOLUTIONS = (64, 256, 512)
GLOBAL = 1024
HEAD = (1024, 256)
POINT_CHANNELS = 6  # position, medial offset


class JointBackbone(nn.Module):
    """positions: (G*V, 3), one_ring: (G*V, K1), geodesic_ball: (G*V, K2), medial_offsets: (G*V, 3) -> (G*V, channels_out).

    Three GMEdgeConvs; a global maximum; then per vertex MLP[global | position | x1 | x2 | x3]. The first layer of that
    MLP is split so that the part which reads the global feature runs once per graph. Departure from the paper: the medial
    offsets stand beside the positions, in the first convolution and in the head.
    """

    def __init__(self, channels_out: int, width: float, normalisation: str, dropout: float):
        super().__init__()
        first, second, third = (int(width * c) for c in CONVOLUTIONS)
        global_channels, (hidden, last) = int(width * GLOBAL), (int(width * c) for c in HEAD)
        self.convolution_1 = GMEdgeConv(POINT_CHANNELS, first, normalisation)
        self.convolution_2 = GMEdgeConv(first, second, normalisation)
        self.convolution_3 = GMEdgeConv(second, third, normalisation)
        self.shape_code = perceptron([first + second + third, global_channels], normalisation)
        self.head_local = nn.Linear(POINT_CHANNELS + first + second + third, hidden)
        self.head_global = nn.Linear(global_channels, hidden, bias=False)
        self.head_norm = normalisation_layer(normalisation, hidden)
        self.head_last = perceptron([hidden, last], normalisation)
        self.dropout = nn.Dropout(dropout)
        self.out = nn.Linear(last, channels_out)

    def forward(self, positions, one_ring, geodesic_ball, medial_offsets, graph_count: int = 1) -> torch.Tensor:
        points = torch.cat([positions, medial_offsets], dim=1)
        x1 = self.convolution_1(points, one_ring, geodesic_ball)
        x2 = self.convolution_2(x1, one_ring, geodesic_ball)
        x3 = self.convolution_3(x2, one_ring, geodesic_ball)
        shape_code = maximum_per_graph(self.shape_code(torch.cat([x1, x2, x3], dim=1)), graph_count)
        local = self.head_local(torch.cat([points, x1, x2, x3], dim=1))
        hidden = self.head_norm(torch.relu(add_to_graph(local, self.head_global(shape_code))))
        return self.out(self.dropout(self.head_last(hidden)))
