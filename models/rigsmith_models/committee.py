"""Several trained networks of one kind that answer together."""

import torch
from torch import nn


class Committee(nn.Module):
    """The mean of the members' logits, as one network of the same inputs and output, so one file.

    Members differ in seed and data. What each learned by heart of its own training rigs averages out: on validation two
    members err less than the better of them (models/TRAINING.md).
    """

    def __init__(self, members: list[nn.Module]):
        super().__init__()
        self.members = nn.ModuleList(members)
        self.inputs, self.output = members[0].inputs, members[0].output

    def forward(self, *inputs) -> torch.Tensor:
        return torch.stack([member(*inputs) for member in self.members]).mean(0)
