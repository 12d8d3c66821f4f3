"""Displaced vertices -> joints: mean shift, modes, symmetry. RigNet [Xu et al. 2020], Section 4.1, Eq. 6.

The service has its own implementation; this one calibrates its constants and judges the networks.
"""

from dataclasses import dataclass

import numpy as np


@dataclass
class Clustering:
    bandwidth: float = 0.05
    steps: int = 10
    step_length: float = 0.9
    attention_power: float = 1.0
    attention_min: float = 1e-3  # of attention scaled to [0, 1] per mesh
    density_min: float = 0.01  # of the total attention, for a mode to count
    suppression: float = 0.5  # suppression radius = max(bandwidth, this x mean displacement around the mode)
    middle: float = 0.02  # |x| below which a joint is snapped to the mirror plane


MIRROR = np.array([-1, 1, 1], np.float32)


def squared_distances(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(N, 3), (M, 3) -> (N, M)."""
    return np.maximum((points**2).sum(1)[:, None] + (others**2).sum(1) - 2 * points @ others.T, 0)


@dataclass
class Shifted:
    """Points after the mean shift, each followed in the second half by its mirror image."""

    points: np.ndarray  # (2M, 3)
    weight: np.ndarray  # (2M,) attention
    moved: np.ndarray  # (2M,) length of the displacement
    density: np.ndarray  # (2M,) as a part of the total attention


def shifted(points, displacement_length, attention, settings: Clustering) -> Shifted:
    """Eq. 6. points: (V, 3) = positions + displacement, displacement_length: (V,), attention: (V,) in (0, 1).

    Every point has a mirror image with the same attention. The images stay images through the mean shift, so only the
    points themselves are moved.
    """
    spread = attention.max() - attention.min()
    attention = (attention - attention.min()) / spread if spread > 1e-6 else np.ones_like(attention)
    attention = attention**settings.attention_power
    kept = attention > settings.attention_min
    points = points[kept].astype(np.float32)
    weight = np.tile(attention[kept], 2).astype(np.float32)
    squared_bandwidth = np.float32(settings.bandwidth**2)
    for _ in range(settings.steps):
        both = np.concatenate([points, points * MIRROR])
        kernel = np.maximum(squared_bandwidth - squared_distances(points, both), 0) * weight
        mean = kernel @ both / (kernel.sum(1, keepdims=True) + 1e-10)
        points = points + np.float32(settings.step_length) * (mean - points)
    both = np.concatenate([points, points * MIRROR])
    density = (np.maximum(1 - squared_distances(points, both) / squared_bandwidth, 0) * weight).sum(1) / weight.sum()
    return Shifted(both, weight, np.tile(displacement_length[kept], 2), np.tile(density, 2))


def modes_of(cloud: Shifted, settings: Clustering) -> np.ndarray:
    """Densest first; a mode suppresses its neighbourhood -> joints (J, 3), those near the mirror plane snapped to it."""
    alive, modes = cloud.density > settings.density_min, []
    for i in np.argsort(-cloud.density, kind="stable"):
        if not alive[i]:
            continue
        modes.append(i)
        squared = squared_distances(cloud.points[i : i + 1], cloud.points)[0]
        near = squared < settings.bandwidth**2
        moved = (cloud.weight[near] * cloud.moved[near]).sum() / max(cloud.weight[near].sum(), 1e-12)
        alive &= squared > max(settings.bandwidth, settings.suppression * moved) ** 2
        alive[i] = False
    joints = cloud.points[modes]
    joints[np.abs(joints[:, 0]) < settings.middle, 0] = 0
    return joints


def joints_of(points, displacement_length, attention, settings: Clustering) -> np.ndarray:
    """Displaced points with their attention -> (J, 3)."""
    return modes_of(shifted(points, displacement_length, attention, settings), settings)
