"""Networks in training form -> the form that is exported: split weights, batch normalisation folded out of the messages."""

import copy

import torch
import torch.nn.functional as F
from torch import nn

from .layers import EdgeConv

DEAD_VARIANCE = 1e-9


class FoldedEdgeConv(nn.Module):
    """EdgeConv in evaluation mode, with nothing per edge but one sum, one ReLU and one matrix product. Exact.

    BatchNorm 1 follows the ReLU, so it folds into the second layer: ``W2' = W2 diag(s1)``, ``b2' = b2 + W2 t1``.
    BatchNorm 2 moves behind the maximum. Where its scale is negative the maximum of the normalised message is the
    minimum of the message: those rows of W2 are negated before the maximum and turned back after it.
    """

    def __init__(self, convolution: EdgeConv):
        super().__init__()
        own, offset = convolution.first.weight.double().split(convolution.channels_in, dim=1)
        weight, bias = convolution.second.weight.double(), convolution.second.bias.double()
        sign = torch.ones_like(bias)
        self.normalise_messages = convolution.normalise_messages
        if self.normalise_messages:
            scale_1, shift_1 = affine_of(convolution.first_norm)
            scale_2, shift_2 = affine_of(convolution.second_norm)
            bias = bias + weight @ shift_1
            sign = torch.where(scale_2 < 0, -sign, sign)
            weight = sign.unsqueeze(1) * weight * scale_1
            self.register_buffer("scale", scale_2.float())
            self.register_buffer("shift", shift_2.float())
        else:
            self.norm = convolution.second_norm
        for name, value in {
            "own_weight": own - offset, "own_bias": convolution.first.bias, "offset_weight": offset,
            "second_weight": weight, "second_bias": bias, "sign": sign,
        }.items():
            self.register_buffer(name, value.detach().float())

    def forward(self, x: torch.Tensor, neighbours: torch.Tensor) -> torch.Tensor:
        own = F.linear(x, self.own_weight, self.own_bias)
        other = F.embedding(neighbours, F.linear(x, self.offset_weight))
        extreme = F.linear(torch.relu(own.unsqueeze(1) + other), self.second_weight).amax(1)
        if self.normalise_messages:
            return torch.relu(extreme * self.sign + self.second_bias) * self.scale + self.shift
        return self.norm(torch.relu(extreme + self.second_bias))


def affine_of(norm: nn.BatchNorm1d) -> tuple[torch.Tensor, torch.Tensor]:
    """Evaluation-mode BatchNorm as ``scale * x + shift``, in float64."""
    scale = norm.weight.double() / torch.sqrt(norm.running_var.double() + norm.eps)
    return scale.detach(), (norm.bias.double() - norm.running_mean.double() * scale).detach()


class FoldedNorm(nn.Module):
    """Evaluation-mode BatchNorm on rows, as one product and one sum."""

    def __init__(self, norm: nn.BatchNorm1d):
        super().__init__()
        scale, shift = affine_of(norm)
        self.register_buffer("scale", scale.float())
        self.register_buffer("shift", shift.float())

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x * self.scale + self.shift


def folded(network: nn.Module) -> nn.Module:
    """A copy of the network with every EdgeConv and BatchNorm replaced by its folded form."""
    network = copy.deepcopy(network).eval()
    for name, module in list(network.named_modules()):
        if isinstance(module, EdgeConv):
            replace_module(network, name, FoldedEdgeConv(module))
    for name, module in list(network.named_modules()):
        if isinstance(module, nn.BatchNorm1d):
            replace_module(network, name, FoldedNorm(module))
    return network


def silence_dead_channels(network: nn.Module) -> nn.Module:
    """Channels whose values never varied in training say their constant, whatever comes; in place.

    Normalisation divides by their deviation, nearly zero: on a shape unlike all training ones such a channel would fire hundreds of times too loud.
    """
    for module in network.modules():
        if isinstance(module, nn.BatchNorm1d):
            with torch.no_grad():
                module.weight[module.running_var < DEAD_VARIANCE] = 0
    return network


def replace_module(network: nn.Module, name: str, module: nn.Module) -> None:
    parent, _, last = name.rpartition(".")
    setattr(network.get_submodule(parent), last, module)
