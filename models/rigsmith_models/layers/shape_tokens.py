"""What every vertex may know of the whole shape: learned queries read all vertices, speak to each other, and are read back.

RigNet's global branch is one maximum over the shape. It can say what kind of shape this is, hardly where its parts lie. Queries
that attend to vertices (Lee et al. 2019, "Set Transformer", induced points) can, at a cost that grows linearly in vertices.
"""

import torch
from torch import nn

TOKENS, ROUNDS, HEADS = 64, 2, 8


class Attention(nn.Module):
    """Multi-head attention with layer normalisation before it. asking (G, N, C), asked (G, M, C) -> (G, N, C) to be added to ``asking``."""

    def __init__(self, channels: int):
        super().__init__()
        self.norm_asking, self.norm_asked = nn.LayerNorm(channels), nn.LayerNorm(channels)
        self.query = nn.Linear(channels, channels)
        self.key_value = nn.Linear(channels, 2 * channels)
        self.join = nn.Linear(channels, channels)

    def forward(self, asking: torch.Tensor, asked: torch.Tensor) -> torch.Tensor:
        key, value = self.key_value(self.norm_asked(asked)).chunk(2, dim=2)
        query, key, value = (per_head(x) for x in (self.query(self.norm_asking(asking)), key, value))
        share = torch.softmax(query @ key.transpose(2, 3) * query.shape[3] ** -0.5, dim=3)
        answer = (share @ value).transpose(1, 2)
        return self.join(answer.reshape(answer.shape[0], -1, HEADS * answer.shape[3]))


def per_head(x: torch.Tensor) -> torch.Tensor:
    """(G, N, C) -> (G, HEADS, N, C / HEADS)."""
    return x.reshape(x.shape[0], -1, HEADS, x.shape[2] // HEADS).transpose(1, 2)


def feed_forward(channels: int) -> nn.Sequential:
    return nn.Sequential(nn.LayerNorm(channels), nn.Linear(channels, 2 * channels), nn.ReLU(), nn.Linear(2 * channels, channels))


class ShapeTokens(nn.Module):
    """features (G*V, C_in) -> (G*V, C): each vertex with what the tokens told it."""

    def __init__(self, channels_in: int, channels: int):
        super().__init__()
        self.vertex_code = nn.Linear(channels_in, channels)
        self.tokens = nn.Parameter(torch.randn(1, TOKENS, channels) * 0.5)
        self.reads = nn.ModuleList(Attention(channels) for _ in range(ROUNDS))
        self.speaks = nn.ModuleList(Attention(channels) for _ in range(ROUNDS))
        self.thinks = nn.ModuleList(feed_forward(channels) for _ in range(ROUNDS))
        self.read_back = Attention(channels)

    def forward(self, features: torch.Tensor, graph_count: int) -> torch.Tensor:
        vertices = self.vertex_code(features)
        vertices = vertices.reshape(graph_count, -1, vertices.shape[1])
        tokens = self.tokens.expand(graph_count, -1, -1)
        for read, speak, think in zip(self.reads, self.speaks, self.thinks):
            tokens = tokens + read(tokens, vertices)
            tokens = tokens + speak(tokens, tokens)
            tokens = tokens + think(tokens)
        told = vertices + self.read_back(vertices, tokens)
        return told.reshape(-1, told.shape[2])
