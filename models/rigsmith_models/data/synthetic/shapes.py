"""The two primitives that bodies are made of, as approximate signed distances.

Positions are in the frame of the character under construction: y up, facing +z, about one unit high.
Negative inside. Distances are exact near the surface of a round limb and approximate elsewhere, which is enough for
blending and for weights.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

BODY = 0  # the shell that most shapes belong to; other shells are meshed apart


def unit(vector) -> np.ndarray:
    vector = np.asarray(vector, float)
    return vector / (np.linalg.norm(vector) + 1e-9)


def frame_along(axis) -> np.ndarray:
    """A rotation whose third column is `axis`; the first two are picked so that mirrored axes get mirrored frames."""
    z = unit(axis)
    helper = np.array([0.0, 1.0, 0.0]) if abs(z[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    x = unit(np.cross(helper, z))
    return np.stack([x, np.cross(z, x), z], axis=1)


@dataclass(frozen=True)
class Limb:
    """A tapered capsule from `start` to `end` that may bulge and whose cross-section may be squashed and squared."""

    joint: int  # whose motion it follows
    start: np.ndarray
    end: np.ndarray
    start_radius: float
    end_radius: float
    bulge: float = 0.0  # extra radius in the middle, as a share of the larger radius
    squash: tuple[np.ndarray, float] | None = None  # (unit direction, factor) of the cross-section
    roundness: float = 2.0  # exponent of the cross-section: 2 an ellipse, larger nearer to a rectangle
    blend: float = 0.01  # length over which it melts into its neighbours
    shell: int = BODY
    material: str = "skin"

    @property
    def radius(self) -> float:
        return max(self.start_radius, self.end_radius) * (1 + abs(self.bulge))

    def distance(self, points: np.ndarray) -> np.ndarray:
        """(..., 3) -> (...)"""
        offset = points - self.start
        axis = self.end - self.start
        share = np.clip(offset @ axis / max(float(axis @ axis), 1e-12), 0, 1)
        largest = max(self.start_radius, self.end_radius)
        radius = self.start_radius + (self.end_radius - self.start_radius) * share
        radius = radius + self.bulge * largest * np.sin(np.pi * share)
        rest = offset - share[..., None] * axis
        if self.squash is None:
            return np.sqrt((rest**2).sum(-1)) - radius
        direction, factor = self.squash
        across = np.abs(rest @ direction)
        other = np.sqrt(np.maximum((rest**2).sum(-1) - across**2, 0))
        power = self.roundness
        size = ((across / factor) ** power + other**power) ** (1 / power)
        return (size - radius) * min(factor, 1.0)

    def bounds(self, margin: float) -> tuple[np.ndarray, np.ndarray]:
        reach = self.radius * (max(1.0, self.squash[1]) if self.squash else 1.0) + margin
        return np.minimum(self.start, self.end) - reach, np.maximum(self.start, self.end) + reach

    def scaled(self, factors: np.ndarray) -> Limb:
        return replace(self, start=self.start * factors, end=self.end * factors)

    def grown(self, share: float, **changes) -> Limb:
        """The same with all radii larger by `share`: clothing over it."""
        return replace(
            self, start_radius=self.start_radius * (1 + share), end_radius=self.end_radius * (1 + share), **changes
        )


@dataclass(frozen=True)
class Block:
    """A superquadric: an ellipsoid at exponent 2, nearly a box at 8."""

    joint: int
    centre: np.ndarray
    half_sizes: np.ndarray  # (3,)
    rotation: np.ndarray  # (3, 3), columns are the block's axes
    roundness: float = 2.0
    blend: float = 0.01
    shell: int = BODY
    material: str = "skin"

    @property
    def radius(self) -> float:
        return float(self.half_sizes.min())

    def distance(self, points: np.ndarray) -> np.ndarray:
        local = np.abs((points - self.centre) @ self.rotation) / self.half_sizes
        size = (local**self.roundness).sum(-1) ** (1 / self.roundness)
        return (size - 1) * float(np.exp(np.log(self.half_sizes).mean()))

    def bounds(self, margin: float) -> tuple[np.ndarray, np.ndarray]:
        extent = np.abs(self.rotation) @ self.half_sizes
        # The distance is a share of the mean size, so a margin is wider along the longer axes.
        extent = extent * (1 + 0.5 * margin / self.half_sizes.min()) + margin
        return self.centre - extent, self.centre + extent

    def scaled(self, factors: np.ndarray) -> Block:
        along = np.abs(self.rotation.T) @ factors  # scaling a turned block exactly would shear it
        return replace(self, centre=self.centre * factors, half_sizes=self.half_sizes * along)

    def grown(self, share: float, **changes) -> Block:
        return replace(self, half_sizes=self.half_sizes * (1 + share), **changes)


Shape = Limb | Block
