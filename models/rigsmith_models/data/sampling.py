"""Which characters a training step sees, and the tensors made of them. All random choices derive from (seed, step)."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from . import augment
from .character import Character, read_cache
from .travel import read_travel

LAST_PART = 0.8  # after this share of the steps half of the generated draws go to real characters


@dataclass(frozen=True)
class Sampling:
    """How many vertices of a character a step sees, how many of their neighbours, and how different parts may grow."""

    vertex_counts: tuple[int, ...]
    shares: tuple[float, ...]
    one_ring_max: int
    ball_max: int
    growth: float


SAMPLINGS = {
    "sparse": Sampling((384, 512, 768), (0.3, 0.5, 0.2), one_ring_max=4, ball_max=8, growth=0.0),  # for a CPU
    "dense": Sampling((512, 768, 1024), (0.3, 0.4, 0.3), one_ring_max=5, ball_max=9, growth=augment.GROWTH),  # for a GPU
}


class Pool:
    """All training characters, drawn by their ``draw_weight``, real and synthetic ones at a set share."""

    def __init__(self, files: list[Path]):
        caches = {path.stem: read_travel(path) if path.suffix == ".travel" else read_cache(path) for path in files}
        self.sizes = {name: len(characters) for name, characters in caches.items()}
        self.characters = [c for characters in caches.values() for c in characters]
        self.weight = np.array([c.meta.get("draw_weight", 1.0) for c in self.characters], float)
        self.real = np.array([c.meta.get("style") != "synthetic" for c in self.characters])

    def counts(self) -> dict[str, int]:
        """Characters per cache file."""
        return self.sizes

    def features(self) -> list[str]:
        """Where neighbour tables, inside shares and bone distances came from."""
        return sorted({c.meta.get("features", "stand-in") for c in self.characters})

    def probabilities(self, real_share: float) -> np.ndarray:
        weight = self.weight.copy()
        if self.real.any() and not self.real.all():
            weight[self.real] *= real_share / weight[self.real].sum()
            weight[~self.real] *= (1 - real_share) / weight[~self.real].sum()
        return weight / weight.sum()

    def draw(self, count: int, progress: float, rng: np.random.Generator, real_share: float) -> list[Character]:
        if progress >= LAST_PART:
            real_share = 0.5 * (1 + real_share)
        chosen = rng.choice(len(self.characters), count, replace=False, p=self.probabilities(real_share))
        return [self.characters[k] for k in chosen]


def shape_batch(characters: list[Character], rng: np.random.Generator, device, sampling: Sampling, pose: bool = True, scale: bool = True) -> dict:
    """Augments and thins each character and stacks them.

    -> positions (G*N, 3), medial_offsets (G*N, 3), one_ring (G*N, K1), geodesic_ball (G*N, K2) with indices into the stack, graph_count G, and
    lists per character: ``kept`` vertices, ``joints`` (J, 3) after augmentation, ``scale`` (3,).
    """
    vertex_count = int(rng.choice(sampling.vertex_counts, p=sampling.shares))
    positions, offsets, rings, balls, kept_lists, joints, scales = [], [], [], [], [], [], []
    for graph, character in enumerate(characters):
        if pose and rng.random() < augment.POSE_PROBABILITY:
            character = augment.random_pose(character, rng, sampling.growth)
        character, factors = augment.random_scale(character, rng) if scale else augment.random_mirror(character, rng)
        kept, ring, ball = augment.thin(character, vertex_count, sampling.one_ring_max, sampling.ball_max, rng)
        positions.append(character.positions[kept])
        offsets.append(character.medial_offsets[kept])
        rings.append(ring + graph * vertex_count)
        balls.append(ball + graph * vertex_count)
        kept_lists.append(kept)
        joints.append(character.joints)
        scales.append(factors)
    return {
        "positions": torch.from_numpy(np.concatenate(positions).astype(np.float32)).to(device),
        "medial_offsets": torch.from_numpy(np.concatenate(offsets).astype(np.float32)).to(device),
        "one_ring": torch.from_numpy(np.concatenate(rings)).to(device),
        "geodesic_ball": torch.from_numpy(np.concatenate(balls)).to(device),
        "graph_count": len(characters),
        "kept": kept_lists,
        "joints": joints,
        "scale": scales,
        "mirrored": [factors[0] < 0 for factors in scales],
    }


def padded_joints(joints: list[np.ndarray], device) -> tuple[torch.Tensor, torch.Tensor]:
    """List of (J_g, 3) -> joints (G, J, 3) padded by repeating the first joint, valid (G, J) bool."""
    most = max(len(j) for j in joints)
    stacked = np.stack([np.concatenate([j, np.repeat(j[:1], most - len(j), 0)]) for j in joints]).astype(np.float32)
    valid = np.stack([np.arange(most) < len(j) for j in joints])
    return torch.from_numpy(stacked).to(device), torch.from_numpy(valid).to(device)
