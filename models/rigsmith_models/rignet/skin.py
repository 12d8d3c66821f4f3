"""How much each vertex follows its nearest bones. RigNet [Xu et al. 2020], Section 4.3, Eq. 10."""

import torch
import torch.nn.functional as F
from torch import nn

from ..layers import Dense, GMEdgeConv, add_to_graph, maximum_per_graph, normalisation_layer, perceptron

BONES_PER_VERTEX = 5
FEATURES_PER_BONE = 8
INVERSE_DISTANCE = 6  # column of 1/(D + 1e-10) among the 8 numbers of a bone

# The reference feature reaches 1e10 for a vertex on a bone. Below a hundredth of the character all distances are
# "on the bone"; the scale brings the rest to about 1.
INVERSE_DISTANCE_MAX = 100.0
INVERSE_DISTANCE_SCALE = 0.05

# The logit starts as PRIOR_POWER x ln(1/D), that is weights by the inverse fourth power of the distance: the geometric
# baseline. The network learns what to add, so that little training cannot make it worse than that.
PRIOR_POWER = 4.0
PRIOR_INVERSE_LIMITS = (1e-2, 300.0)


class RigNetSkin(nn.Module):
    """One logit per vertex and near bone; the softmax over the bones is outside.

    positions (V, 3), one_ring (V, K1), geodesic_ball (V, K2): the character.
    bone_features (V, 40): the 5 bones nearest by volumetric geodesic distance D, ascending; per bone start (3), end (3),
    1/(D + 1e-10), leaf flag. bone_mask (V, 5): 1 for a bone, 0 for padding (fewer than 5 bones).
    -> skin_logit (V, 5); a padded slot gets -1e4, so its softmax weight is zero.

    The inverse distance is clamped and scaled here, so that the caller always sends the reference's feature. Padded
    slots are zeroed before use. Departure from the paper: the logit is added to a geometric prior (PRIOR_POWER), whose
    power is learned.
    """

    inputs = ("positions", "one_ring", "geodesic_ball", "bone_features", "bone_mask")
    output = "skin_logit"

    def __init__(self, width: float = 1.0, normalisation: str = "batch"):
        super().__init__()
        def wide(*channels):
            return [int(width * c) for c in channels]
        self.embed = perceptron([3 + BONES_PER_VERTEX * FEATURES_PER_BONE, *wide(128, 64)], normalisation)
        self.convolution_1 = GMEdgeConv(*wide(64, 512), normalisation)
        self.shape_code = perceptron(wide(512, 512, 1024), normalisation)
        self.convolution_2 = GMEdgeConv(*wide(512, 256), normalisation)
        self.convolution_3 = GMEdgeConv(*wide(256, 256), normalisation)
        self.head_local = nn.Linear(*wide(256, 1024))
        self.head_global = nn.Linear(*wide(1024, 1024), bias=False)
        self.head_norm = normalisation_layer(normalisation, *wide(1024))
        self.head_last = Dense(*wide(1024, 512), normalisation)
        self.out = nn.Linear(int(width * 512), BONES_PER_VERTEX)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)
        self.prior_power = nn.Parameter(torch.tensor(PRIOR_POWER))

    def scaled(self, bone_features: torch.Tensor, bone_mask: torch.Tensor) -> torch.Tensor:
        """(V, 40), (V, 5) -> (V, 40) with the inverse distance clamped and scaled and the padding zeroed."""
        by_bone = bone_features.reshape(-1, BONES_PER_VERTEX, FEATURES_PER_BONE)
        ends, inverse, leaf = by_bone.split([INVERSE_DISTANCE, 1, 1], dim=2)
        inverse = inverse.clamp(max=INVERSE_DISTANCE_MAX) * INVERSE_DISTANCE_SCALE
        by_bone = torch.cat([ends, inverse, leaf], dim=2) * bone_mask.unsqueeze(2)
        return by_bone.reshape(-1, BONES_PER_VERTEX * FEATURES_PER_BONE)

    def forward(self, positions, one_ring, geodesic_ball, bone_features, bone_mask, graph_count: int = 1):
        features = self.scaled(bone_features, bone_mask)
        inverse = bone_features.reshape(-1, BONES_PER_VERTEX, FEATURES_PER_BONE)[:, :, INVERSE_DISTANCE]
        prior = self.prior_power * torch.log(inverse.clamp(*PRIOR_INVERSE_LIMITS))
        x1 = self.convolution_1(self.embed(torch.cat([positions, features], dim=1)), one_ring, geodesic_ball)
        shape_code = maximum_per_graph(self.shape_code(x1), graph_count)
        x3 = self.convolution_3(self.convolution_2(x1, one_ring, geodesic_ball), one_ring, geodesic_ball)
        hidden = add_to_graph(self.head_local(x3), self.head_global(shape_code))
        logit = self.out(self.head_last(self.head_norm(torch.relu(hidden))))
        return torch.where(bone_mask > 0.5, logit + prior, torch.full_like(logit, -1e4))
