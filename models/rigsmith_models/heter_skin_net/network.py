"""How much each vertex follows the joints that it is linked to. HeterSkinNet [Pan et al. 2021], Sections 3.2 to 3.4, Figure 3.

The mesh and the skeleton are two graphs, joined by links. Convolutions run inside each graph, from vertices to joints and
from joints to vertices; the mesh has a global branch; a head answers per link.
"""

import torch
import torch.nn.functional as F
from torch import nn

from ..layers import Dense, EdgeConv, add_to_graph, maximum_per_graph, normalisation_layer, perceptron

LINKS = 8  # per vertex, as the service sends
LINK_CHANNELS, JOINT_CHANNELS = 13, 8
HOLLOW, VOXEL, STRAIGHT, HEAT, ALONG, LENGTH, LEAF = range(7)  # columns of a link; then offset (3) and direction (3)
DISTANCE_MIN, HEAT_MIN, RADIUS_MIN = 1e-3, 1e-3, 1e-2
DESCRIBED_CHANNELS = 18
VARIANCE_SCALE = 0.1  # beside maximum and mean, in what a joint sees of its vertices
HEAT_HALF = 0.05  # at which heat a link counts half in what its vertex sees
EMPTY = -1e4  # logit of an empty link


class HeterSkinNet(nn.Module):
    """One logit per vertex and link; the softmax over the links is outside.

    positions, medial_offsets (V, 3), one_ring (V, K1): the mesh graph. joint_features (J, 8), joint_neighbours (J, K2): the
    skeleton graph; a row of neighbours holds the joint itself, its parent and its children, padded with itself. links (V, 8):
    joint of each link, link_mask (V, 8), link_features (V, 8, 13); joint_links (J, 32): links that a joint sees, as
    8 vertex + slot, joint_mask (J,): whether it has any. What the columns mean: ``rig::heter_graph`` of the service.
    -> link_logit (V, 8); an empty link has -1e4, so its softmax weight is zero.

    Departures from the paper: links to joints, eight of them, with one head for all links in place of one output per rank (a
    joint is no other joint for being second nearest); what a link carries beside HollowDist; and the logit is added to that of
    the bone heat, which needs no training. What a joint does to weights ends where its heat ends, so that an edit of the skeleton is
    felt near it: the global branch sees the mesh alone, and what a vertex takes from its links is weighed by their heat.
    """

    inputs = ("positions", "medial_offsets", "one_ring", "joint_features", "joint_neighbours", "links", "link_mask", "link_features",
              "joint_links", "joint_mask")
    output = "link_logit"

    def __init__(self, width: float = 1.0, normalisation: str = "batch", dropout: float = 0.3):
        super().__init__()
        c = int(width * 128)
        self.vertex_code = perceptron([7, c, c], normalisation)
        self.mesh_1 = EdgeConv(c, c, normalisation)
        self.joint_code = perceptron([JOINT_CHANNELS, c, c], normalisation)
        self.skeleton_1 = EdgeConv(c, c, normalisation)

        self.link_own = nn.Linear(DESCRIBED_CHANNELS, c)
        self.link_vertex = nn.Linear(c, c, bias=False)
        self.link_joint = nn.Linear(c, c, bias=False)
        self.link_norm = normalisation_layer(normalisation, c)
        self.link_last = Dense(c, c, normalisation)

        self.joint_sees = Dense(4 * c, c, normalisation)
        self.skeleton_2 = EdgeConv(c, c, normalisation)
        self.vertex_sees = Dense(3 * c, c, normalisation)
        self.mesh_2 = EdgeConv(c, c, normalisation)
        self.mesh_global = Dense(c, 2 * c, normalisation)

        self.head_link = nn.Linear(c, 2 * c)
        self.head_vertex = nn.Linear(c, 2 * c, bias=False)
        self.head_joint = nn.Linear(c, 2 * c, bias=False)
        self.head_global = nn.Linear(2 * c, 2 * c, bias=False)
        self.head_norm = normalisation_layer(normalisation, 2 * c)
        self.dropout = nn.Dropout(dropout)
        self.head_last = Dense(2 * c, c, normalisation)
        self.out = nn.Linear(c, 1)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)
        self.prior = nn.Parameter(torch.tensor([1.0, 0.0, 0.0, 0.0]))  # powers of heat and of the three distances

    def forward(self, positions, medial_offsets, one_ring, joint_features, joint_neighbours, links, link_mask, link_features,
                joint_links, joint_mask, graph_count: int = 1) -> torch.Tensor:
        radius = torch.sqrt((medial_offsets**2).sum(1, keepdim=True) + 1e-12)
        described, prior = self.described(link_features, link_mask, radius)
        empty = link_mask.unsqueeze(2) < 0.5

        v1 = self.mesh_1(self.vertex_code(torch.cat([positions, medial_offsets, radius], dim=1)), one_ring)
        j1 = self.skeleton_1(self.joint_code(joint_features), joint_neighbours)
        linked = self.link_own(described) + self.link_vertex(v1).unsqueeze(1) + F.embedding(links, self.link_joint(j1))
        link = self.link_last(per_row(self.link_norm, torch.relu(linked)))
        link = link.reshape(-1, LINKS, v1.shape[1]).masked_fill(empty, 0.0)

        seen = F.embedding(joint_links, link.reshape(-1, v1.shape[1]))
        mean = seen.mean(1)
        variance = VARIANCE_SCALE * ((seen - mean.unsqueeze(1)) ** 2).mean(1)
        seen = torch.cat([seen.amax(1), mean, variance], dim=1) * joint_mask.unsqueeze(1)
        j2 = self.skeleton_2(self.joint_sees(torch.cat([j1, seen], dim=1)), joint_neighbours)
        heat = link_features[:, :, HEAT : HEAT + 1]
        near = heat / (heat + HEAT_HALF) * link_mask.unsqueeze(2)
        mean = (near * link).sum(1) / near.sum(1).clamp(min=1e-3)
        v2 = self.mesh_2(self.vertex_sees(torch.cat([v1, (near * link).amax(1), mean], dim=1)), one_ring)

        globals_ = maximum_per_graph(self.mesh_global(v1), graph_count)
        of_vertex = add_to_graph(self.head_vertex(v2), self.head_global(globals_))
        hidden = self.head_link(link) + of_vertex.unsqueeze(1) + F.embedding(links, self.head_joint(j2))
        hidden = self.head_last(self.dropout(per_row(self.head_norm, torch.relu(hidden))))
        logit = self.out(hidden).reshape(-1, LINKS)
        return torch.where(link_mask > 0.5, logit + prior, torch.full_like(logit, EMPTY))

    def described(self, link_features, link_mask, radius) -> tuple[torch.Tensor, torch.Tensor]:
        """What a link's numbers come to on a logarithmic scale and against the nearest link's (V, 8, 18), and the prior (V, 8)."""
        distance = link_features[:, :, HOLLOW : STRAIGHT + 1].clamp(min=DISTANCE_MIN)
        away = torch.where(link_mask.unsqueeze(2) > 0.5, distance, torch.full_like(distance, 1e3))
        distance = torch.log(distance)
        against = distance - torch.log(away.amin(1, keepdim=True))
        heat = link_features[:, :, HEAT : HEAT + 1]
        warmth = torch.log(heat + HEAT_MIN)
        slender = distance[:, :, STRAIGHT : STRAIGHT + 1] - torch.log(radius + RADIUS_MIN).unsqueeze(1)
        length = torch.log(link_features[:, :, LENGTH : LENGTH + 1] + RADIUS_MIN)
        described = torch.cat(
            [distance, against, heat, warmth, link_features[:, :, ALONG : ALONG + 1], length,
             link_features[:, :, LEAF : LEAF + 1], link_features[:, :, LEAF + 1 :], slender], dim=2)
        prior = self.prior[0] * warmth.squeeze(2) - (self.prior[1:] * against).sum(2)
        return described, prior


def per_row(norm: nn.Module, x: torch.Tensor) -> torch.Tensor:
    """A normalisation over the last axis of (V, K, C) -> (V * K, C)."""
    return norm(x.reshape(-1, x.shape[-1]))
