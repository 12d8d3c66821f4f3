"""Dense layers: Linear -> ReLU -> normalisation, in the order of RigNet's supplement."""

import torch
from torch import nn

NORMALISATIONS = ("layer", "batch")


def normalisation_layer(kind: str, channels: int) -> nn.Module:
    """``layer``: statistics of one row, the same in training and service. ``batch``: the paper's BatchNorm."""
    if kind == "layer":
        return nn.LayerNorm(channels)
    if kind == "batch":
        return nn.BatchNorm1d(channels)
    raise ValueError(f"unknown normalisation {kind!r}; use one of {NORMALISATIONS}")


class Dense(nn.Module):
    """x: (N, C_in) -> norm(ReLU(W x + b)): (N, C_out)."""

    def __init__(self, channels_in: int, channels_out: int, normalisation: str):
        super().__init__()
        self.linear = nn.Linear(channels_in, channels_out)
        self.norm = normalisation_layer(normalisation, channels_out)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.norm(torch.relu(self.linear(x)))


def perceptron(channels: list[int], normalisation: str) -> nn.Sequential:
    """MLP[c0, c1, ...] of the paper's Table 6; the last layer has ReLU and normalisation too."""
    return nn.Sequential(*(Dense(a, b, normalisation) for a, b in zip(channels[:-1], channels[1:])))
