"""A character under construction: joints and the shapes that follow them.

Every random choice comes from the sketch's own generator, so a seed is a character. Left and right are drawn inside
``for side in sketch.both_sides()``, which rewinds the generator: the two sides are exact mirror images.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .shapes import BODY, Block, Limb, Shape, frame_along, unit

SIDEWAYS = np.array([1.0, 0.0, 0.0])
UP = np.array([0.0, 1.0, 0.0])
FORWARD = np.array([0.0, 0.0, 1.0])


def mirrored(side: int, vector) -> np.ndarray:
    """`vector` as given for the left side (+1), mirrored for the right (-1)."""
    return np.array([vector[0] * side, vector[1], vector[2]], float)


class Sketch:
    def __init__(self, random: np.random.Generator):
        self.random = random
        self.joints: list[np.ndarray] = []
        self.parents: list[int] = []
        self.shapes: list[Shape] = []
        self.sheets: dict[int, np.ndarray] = {}  # shell -> only faces that look away from this axis point are kept
        self.squareness = 2.0  # above 2, limbs become boxes of this roundness: robots
        self.segmented = False  # every joint's shapes are a shell of their own: robots and toys
        self.softness = self.uniform(0.08, 0.18)  # how wide neighbouring shapes blend, in radii
        self.end_joints = self.chance(0.30)  # some artists end every chain with a joint
        self.shell = BODY
        self.shell_count = 1

    # ---- random choices

    def uniform(self, low: float, high: float) -> float:
        return float(self.random.uniform(low, high))

    def chance(self, probability: float) -> bool:
        return bool(self.random.random() < probability)

    def integer(self, low: int, high: int) -> int:
        """Both ends included."""
        return int(self.random.integers(low, high + 1))

    def choice(self, options, shares=None):
        return options[int(self.random.choice(len(options), p=shares))]

    def both_sides(self) -> Iterator[int]:
        """+1 (left), then -1 with the same random choices."""
        state = self.random.bit_generator.state
        for side in (1, -1):
            self.random.bit_generator.state = state
            yield side

    # ---- building

    def new_shell(self) -> int:
        """A number for shapes that are meshed apart from the body."""
        self.shell_count += 1
        return self.shell_count - 1

    def joint(self, position, parent: int) -> int:
        self.joints.append(np.asarray(position, float))
        self.parents.append(parent)
        return len(self.joints) - 1

    def limb(self, joint, start, end, start_radius, end_radius, *, bulge=0.0, squash=None, roundness=2.0, **rest) -> None:
        start, end = np.asarray(start, float), np.asarray(end, float)
        radius = max(start_radius, end_radius)
        shell = rest.pop("shell", self._shell_of(joint))
        if self.squareness > 2 and "material" not in rest and shell_is_flesh(self, shell):
            half = np.linalg.norm(end - start) / 2 + radius * 0.25
            flat = squash[1] if squash else 1.0
            self.block(joint, (start + end) / 2, [radius, radius * flat, half], frame_along(end - start))
            return
        blend = rest.pop("blend", radius * self.softness)
        self.shapes.append(
            Limb(joint, start, end, start_radius, end_radius, bulge, squash, roundness, blend, shell, **rest)
        )

    def block(self, joint, centre, half_sizes, rotation=None, *, roundness=None, **rest) -> None:
        half_sizes = np.asarray(half_sizes, float)
        rotation = np.eye(3) if rotation is None else rotation
        roundness = max(roundness or 2.0, self.squareness)
        shell = rest.pop("shell", self._shell_of(joint))
        blend = rest.pop("blend", float(half_sizes.min()) * self.softness)
        self.shapes.append(Block(joint, np.asarray(centre, float), half_sizes, rotation, roundness, blend, shell, **rest))

    def _shell_of(self, joint: int) -> int:
        if not self.segmented:
            return self.shell
        while self.shell_count <= joint + 1:
            self.new_shell()
        return joint + 1

    def chain(self, parent, start, directions, lengths, radii, *, squash=None, bulge=0.0, end_joint=None) -> tuple[list[int], np.ndarray]:
        """Joints along a path, a limb from each to the next. Returns the joints and where the path ends."""
        place, joints = np.asarray(start, float), []
        for index, length in enumerate(lengths):
            parent = self.joint(place, parent)
            joints.append(parent)
            following = place + unit(directions[index]) * length
            self.limb(parent, place, following, radii[index], radii[index + 1], bulge=bulge, squash=squash)
            place = following
        if self.end_joints if end_joint is None else end_joint:
            joints.append(self.joint(place, parent))
        return joints, place


def shell_is_flesh(sketch: Sketch, shell: int) -> bool:
    return shell == BODY or sketch.segmented
