"""The body shared (in shape, not in weights) by the displacement and attention networks. RigNet, Section 4.1, Table 6."""

import torch
from torch import nn

from ..layers import GMEdgeConv, ShapeTokens, normalisation_layer, perceptron

# Hidden widths of Table 6 at width 1; of the tokens, our own.
CONVOLUTIONS = (64, 256, 512)
TOKENS = 192
HEAD = (1024, 256)
POINT_CHANNELS = 6  # position, medial offset


class JointBackbone(nn.Module):
    """positions: (G*V, 3), one_ring: (G*V, K1), geodesic_ball: (G*V, K2), medial_offsets: (G*V, 3) -> (G*V, channels_out).

    Three GMEdgeConvs; shape tokens; then per vertex MLP[tokens' answer | position | x1 | x2 | x3]. Departures from the paper: the
    medial offsets stand beside the positions, in the first convolution and in the head; and shape tokens take the place of the
    global maximum, with which the same time of training finds fewer joints (models/TRAINING.md, the sixth round).
    """

    def __init__(self, channels_out: int, width: float, normalisation: str, dropout: float):
        super().__init__()
        first, second, third = (int(width * c) for c in CONVOLUTIONS)
        token_channels, (hidden, last) = int(width * TOKENS), (int(width * c) for c in HEAD)
        self.convolution_1 = GMEdgeConv(POINT_CHANNELS, first, normalisation)
        self.convolution_2 = GMEdgeConv(first, second, normalisation)
        self.convolution_3 = GMEdgeConv(second, third, normalisation)
        local_channels = POINT_CHANNELS + first + second + third
        self.shape_tokens = ShapeTokens(local_channels, token_channels)
        self.head_local = nn.Linear(local_channels, hidden)
        self.head_global = nn.Linear(token_channels, hidden, bias=False)
        self.head_norm = normalisation_layer(normalisation, hidden)
        self.head_last = perceptron([hidden, last], normalisation)
        self.dropout = nn.Dropout(dropout)
        self.out = nn.Linear(last, channels_out)

    def forward(self, positions, one_ring, geodesic_ball, medial_offsets, graph_count: int = 1) -> torch.Tensor:
        points = torch.cat([positions, medial_offsets], dim=1)
        x1 = self.convolution_1(points, one_ring, geodesic_ball)
        x2 = self.convolution_2(x1, one_ring, geodesic_ball)
        x3 = self.convolution_3(x2, one_ring, geodesic_ball)
        local = torch.cat([points, x1, x2, x3], dim=1)
        told = self.head_global(self.shape_tokens(local, graph_count))
        hidden = self.head_norm(torch.relu(self.head_local(local) + told))
        return self.out(self.dropout(self.head_last(hidden)))
