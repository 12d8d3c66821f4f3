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


def squared_distances(points: np.ndarray) -> np.ndarray:
    """(N, 3) -> (N, N)."""
    norm = (points**2).sum(1)
    return np.maximum(norm[:, None] + norm[None] - 2 * points @ points.T, 0)


def joints_of(points, displacement_length, attention, settings: Clustering) -> np.ndarray:
    """points: (V, 3) = positions + displacement, displacement_length: (V,), attention: (V,) in (0, 1) -> (J, 3)."""
    spread = attention.max() - attention.min()
    attention = (attention - attention.min()) / spread if spread > 1e-6 else np.ones_like(attention)
    attention = attention**settings.attention_power
    kept = attention > settings.attention_min
    if not kept.any():
        return np.zeros((0, 3), np.float32)
    length = np.concatenate([displacement_length[kept]] * 2)
    weight = np.concatenate([attention[kept]] * 2).astype(np.float32)
    points = points[kept]
    points = np.concatenate([points, points * np.array([-1, 1, 1], np.float32)]).astype(np.float32)
    squared_bandwidth = np.float32(settings.bandwidth**2)
    for _ in range(settings.steps):
        kernel = np.maximum(squared_bandwidth - squared_distances(points), 0) * weight
        mean = kernel @ points / (kernel.sum(1, keepdims=True) + 1e-10)
        points = points + settings.step_length * (mean - points)
    squared = squared_distances(points)
    density = (np.maximum(1 - squared / squared_bandwidth, 0) * weight).sum(1) / weight.sum()
    alive, modes = density > settings.density_min, []
    for i in np.argsort(-density, kind="stable"):
        if not alive[i]:
            continue
        modes.append(i)
        near = squared[i] < squared_bandwidth
        moved = (weight[near] * length[near]).sum() / weight[near].sum()
        alive &= squared[i] > max(settings.bandwidth, settings.suppression * moved) ** 2
    joints = points[modes]
    joints[np.abs(joints[:, 0]) < settings.middle, 0] = 0
    return joints
