"""What the bone and root networks know of the joints: a graph in which every joint sees every other.

RigNet [Xu et al. 2020], Section 4.2, gives both networks a code of the shape, a code of the joint set (PointNet) and the joint or
pair itself. Departure: which joints are connected is a question of how they lie to each other, so here pairs and joints tell each
other what they know, over LAYERS rounds, and the shape speaks through the vertices around each joint and the inside share of
each pair. Nothing depends on the order of joints or on which end of a pair comes first.
"""

import torch
from torch import nn

from ..layers import perceptron

CHANNELS, LAYERS = 96, 3  # at width 1
JOINT_CHANNELS, PAIR_CHANNELS = 15, 11
NOWHERE = 1e3  # longer than any distance in the normalised frame
CELL_SOFTNESS = 0.02  # of the cells of nearest vertices
CELL_MIN = 0.1  # vertices; a joint with fewer around it has no cell
COINCIDENT = 1e-6


def distances(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """(G, N, 3), (G, M, 3) -> (G, N, M)."""
    return ((a.unsqueeze(2) - b.unsqueeze(1)) ** 2).sum(3).sqrt()


def cells(positions: torch.Tensor, joints: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    """Of the vertices that are nearest to each joint (softly): how many, the way to their middle, their mean distance; and the
    distance of the nearest one.

    positions: (G, V, 3), joints: (G, J, 3), valid: (G, J) -> (G, J, 6).
    """
    distance = distances(positions, joints).masked_fill(~valid.unsqueeze(1), NOWHERE)
    share = torch.softmax(-distance / CELL_SOFTNESS, dim=2)
    mass = share.sum(1)
    full = mass.clamp(min=1e-3)
    has_cell = (mass > CELL_MIN).to(mass.dtype)
    middle = (share.unsqueeze(3) * positions.unsqueeze(2)).sum(1) / full.unsqueeze(2) - joints
    spread = (share * distance).sum(1) / full
    nearest = distance.amin(1).clamp(max=1.0)
    part = share.mean(1) * 10
    return torch.cat([
        part.unsqueeze(2), middle * has_cell.unsqueeze(2), (spread * has_cell).unsqueeze(2), nearest.unsqueeze(2)], dim=2)


def betweenness(distance: torch.Tensor) -> torch.Tensor:
    """For each pair, how near a third joint lies to the way between them: the least detour over it, and its squared (Gabriel) and
    greatest (relative neighbourhood) version. (G, J, J) -> (G, J, J, 3)."""
    far = torch.where(distance < COINCIDENT, torch.full_like(distance, NOWHERE), distance)
    to_third, from_third, direct = far.unsqueeze(2), far.unsqueeze(1), distance.clamp(min=COINCIDENT)
    detour = ((to_third + from_third).amin(3) / direct).clamp(max=3.0) - 1
    gabriel = ((to_third**2 + from_third**2).amin(3) / direct**2).clamp(max=2.0)
    neighbourhood = (torch.maximum(to_third, from_third).amin(3) / direct).clamp(max=2.0)
    return torch.stack([detour, gabriel, neighbourhood], dim=3)


def square_of_pairs(values: torch.Tensor, joint_count: int) -> torch.Tensor:
    """Values of all pairs i < j in lexicographic order, as a symmetric matrix with a diagonal of no meaning.
    (G, P) -> (G, J, J)."""
    joint = torch.arange(joint_count)
    low = torch.minimum(joint.unsqueeze(1), joint.unsqueeze(0))
    high = torch.maximum(joint.unsqueeze(1), joint.unsqueeze(0))
    row = low * joint_count - low * (low + 1) // 2 + high - low - 1
    return values[:, row.reshape(-1)].reshape(-1, joint_count, joint_count)


class JointGraph(nn.Module):
    """positions (G, V, 3), joints (G, J, 3), inside_share (G, J, J), valid (G, J) -> joint codes (G, J, C), pair codes
    (G, J, J, C), the same for both orders of a pair, and distances (G, J, J)."""

    def __init__(self, width: float):
        super().__init__()
        self.channels = c = int(width * CHANNELS)
        self.joint_code = perceptron([JOINT_CHANNELS, c], "layer")
        self.pair_code = perceptron([PAIR_CHANNELS, c], "layer")
        self.to_pairs = nn.ModuleList(perceptron([3 * c, c, c], "layer") for _ in range(LAYERS))
        self.gates = nn.ModuleList(nn.Linear(c, 1) for _ in range(LAYERS))
        self.to_joints = nn.ModuleList(perceptron([3 * c, c], "layer") for _ in range(LAYERS))
        self.to_all = nn.ModuleList(perceptron([2 * c, c], "layer") for _ in range(LAYERS))

    def forward(self, positions, joints, inside_share, valid):
        joint_index = torch.arange(joints.shape[1])
        others = valid.unsqueeze(2) & valid.unsqueeze(1) & (joint_index.unsqueeze(1) != joint_index.unsqueeze(0))
        distance = distances(joints, joints)
        to_other = distance.masked_fill(~others, NOWHERE)
        nearer = (to_other.unsqueeze(2) > to_other.unsqueeze(3)).to(joints.dtype).sum(3)  # joints nearer than this one
        between = betweenness(distance.masked_fill(~(valid.unsqueeze(2) & valid.unsqueeze(1)), NOWHERE))
        codes = self.joint_code(self.of_joints(positions, joints, valid, others, to_other, nearer, between))
        pairs = self.pair_code(self.of_pairs(joints, inside_share, distance, nearer, between))
        mask = others.unsqueeze(3)
        for to_pairs, gate, to_joints, to_all in zip(self.to_pairs, self.gates, self.to_joints, self.to_all):
            start, end = codes.unsqueeze(2), codes.unsqueeze(1)
            pairs = pairs + to_pairs(torch.cat([start + end, start * end, pairs], dim=3))
            strongest = torch.where(mask, pairs, torch.full_like(pairs, -NOWHERE)).amax(2).clamp(min=-10.0)
            chosen = (pairs * torch.sigmoid(gate(pairs)) * mask).sum(2)
            codes = codes + to_joints(torch.cat([codes, strongest, chosen], dim=2))
            codes = codes + to_all(torch.cat([codes, pooled(codes, valid)], dim=2))
        return codes, pairs, distance

    def of_joints(self, positions, joints, valid, others, to_other, nearer, between) -> torch.Tensor:
        """(G, J, JOINT_CHANNELS): place, distance from the mirror plane, the three nearest joints, the share of joints below, the
        number of relative neighbours, and the cell."""
        near = [to_other.masked_fill(nearer < rank, NOWHERE).amin(2).clamp(max=1.0) for rank in range(3)]
        below = ((joints[:, :, None, 1] > joints[:, None, :, 1] + 0.005) & others).to(joints.dtype).sum(2)
        neighbours = ((between[..., 2] > 1) & others).to(joints.dtype).sum(2) / 3
        below = below / valid.to(joints.dtype).sum(1, keepdim=True)
        return torch.cat([
            joints, joints[..., :1].abs(), torch.stack([*near, below, neighbours], dim=2), cells(positions, joints, valid)], dim=2)

    def of_pairs(self, joints, inside_share, distance, nearer, between) -> torch.Tensor:
        """(G, J, J, PAIR_CHANNELS): extent, length, inside share, betweenness, how many joints are nearer to the ends, and whether
        the pair crosses the mirror plane."""
        extent = (joints.unsqueeze(2) - joints.unsqueeze(1)).abs()
        rank = torch.log(1 + nearer)
        ranks = torch.stack([torch.minimum(rank, rank.transpose(1, 2)), torch.maximum(rank, rank.transpose(1, 2))], dim=3)
        crosses = (joints[:, :, None, :1] * joints[:, None, :, :1] < -1e-4).to(joints.dtype)
        return torch.cat([extent, distance.unsqueeze(3), inside_share.unsqueeze(3), between, ranks, crosses], dim=3)


def pooled(codes: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    """The greatest code of each character, at each of its joints. (G, J, C), (G, J) -> (G, J, C)."""
    greatest = torch.where(valid.unsqueeze(2), codes, torch.full_like(codes, -NOWHERE)).amax(1, keepdim=True)
    return greatest.expand_as(codes)


def of_one_size(positions, joints, pair_features, graph_count: int):
    """Characters with equally many joints, stacked as everywhere -> the inputs of JointGraph."""
    joints = joints.reshape(graph_count, -1, 3)
    share = square_of_pairs(pair_features[:, 1].reshape(graph_count, -1), joints.shape[1])
    valid = torch.ones_like(joints[..., 0], dtype=torch.bool)
    return positions.reshape(graph_count, -1, 3), joints, share, valid
