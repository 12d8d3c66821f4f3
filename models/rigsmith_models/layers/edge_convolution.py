"""Edge convolutions over padded neighbour tables. RigNet [Xu et al. 2020], Eqs. 3-5.

A neighbour table is (V, K) int64. Row v holds v itself and neighbours of v; short rows are padded with v, which is
exact because the maximum ignores duplicates. There is no scatter: the graph standard of the service forbids it.
"""

import torch
import torch.nn.functional as F
from torch import nn

from .dense import Dense, normalisation_layer


class EdgeConv(nn.Module):
    """RigNet, Eq. 3: x'_v = max over u in N(v) of MLP(x_v, x_u - x_v).

    x: (V, C_in), neighbours: (V, K) -> (V, C_out). The MLP has two layers of width C_out.

    The first layer is linear in both halves of its input, so it is evaluated once per vertex, not once per edge:
    ``W [x_v; x_u - x_v] = (W_own - W_offset) x_v + W_offset x_u``.

    With ``batch`` normalisation the order is the paper's (normalise each message, then take the maximum). With
    ``layer`` normalisation messages are not normalised, the vertex is, after the maximum: a departure from the
    paper, because the statistics of a small batch did not carry over to single characters (TRAINING.md).
    """

    def __init__(self, channels_in: int, channels_out: int, normalisation: str):
        super().__init__()
        self.channels_in = channels_in
        self.normalise_messages = normalisation == "batch"
        self.first = nn.Linear(2 * channels_in, channels_out)
        self.second = nn.Linear(channels_out, channels_out)
        self.first_norm = normalisation_layer(normalisation, channels_out) if self.normalise_messages else nn.Identity()
        self.second_norm = normalisation_layer(normalisation, channels_out)

    def forward(self, x: torch.Tensor, neighbours: torch.Tensor) -> torch.Tensor:
        vertex_count, degree = neighbours.shape
        own_weight, offset_weight = self.first.weight.split(self.channels_in, dim=1)
        own = F.linear(x, own_weight - offset_weight, self.first.bias)
        other = F.linear(x, offset_weight)
        message = torch.relu(own.unsqueeze(1) + F.embedding(neighbours, other))
        if not self.normalise_messages:
            # The bias and the ReLU are the same for every neighbour and monotone: applied once, after the maximum.
            return self.second_norm(torch.relu(F.linear(message, self.second.weight).amax(1) + self.second.bias))
        message = self.first_norm(message.reshape(vertex_count * degree, -1))
        message = self.second_norm(torch.relu(self.second(message)))
        return message.reshape(vertex_count, degree, -1).amax(1)


class GMEdgeConv(nn.Module):
    """RigNet, Eqs. 3-5: one EdgeConv over mesh edges, one over the geodesic ball, concatenated, then a dense layer.

    x: (V, C_in), one_ring: (V, K1), geodesic_ball: (V, K2) -> (V, C_out).
    """

    def __init__(self, channels_in: int, channels_out: int, normalisation: str):
        super().__init__()
        self.one_ring = EdgeConv(channels_in, channels_out // 2, normalisation)
        self.geodesic_ball = EdgeConv(channels_in, channels_out // 2, normalisation)
        self.join = Dense(channels_out, channels_out, normalisation)

    def forward(self, x: torch.Tensor, one_ring: torch.Tensor, geodesic_ball: torch.Tensor) -> torch.Tensor:
        return self.join(torch.cat([self.one_ring(x, one_ring), self.geodesic_ball(x, geodesic_ball)], dim=1))
