"""What characters wear and carry: shells of their own over the body, closed or single-sided.

A shell follows only its own shapes, so a coat takes its weights from the joints of the body parts that it copies.
"""

from __future__ import annotations

import numpy as np

from .shapes import BODY
from .sketch import FORWARD, UP, Sketch, mirrored


def cover(sketch: Sketch, joints: list[int], grow: float, material: str, *, single_sided: bool = False) -> int:
    """A shell over the body shapes of `joints`, larger by the share `grow`: sleeves, trousers, boots, gloves."""
    shell = sketch.new_shell()
    worn = [shape for shape in sketch.shapes if shape.joint in joints and shape.shell == BODY]
    for shape in worn:
        sketch.shapes.append(shape.grown(grow, shell=shell, material=material))
    if single_sided and worn:
        sketch.sheets[shell] = np.mean([sketch.joints[joint] for joint in joints], axis=0)
    return shell


def skirt(sketch: Sketch, hips: int, centre, radius: float, length: float, *, jointed: bool, outside: float = 0.0, tips: bool = False) -> None:
    """A ring of panels from `centre` down, each with none, one or two joints; a robe when long. Sometimes one-sided.

    The joints lie so far `outside` the cloth; with `tips` every chain ends with one at the hem.
    """
    shell = sketch.new_shell()
    hem = radius * sketch.uniform(1.15, 1.7)
    bones = sketch.integer(1, 2) if jointed else 0
    if sketch.chance(0.4):
        sketch.sheets[shell] = np.asarray(centre, float)
    panels = 8
    for index in range(panels):
        angle = 2 * np.pi * (index + 0.5) / panels
        outwards = np.array([np.sin(angle), 0, np.cos(angle)])
        start, end = centre + outwards * radius, centre + outwards * hem - UP * length
        worn = {"shell": shell, "material": "cloth", "squash": (outwards, 0.35)}
        beside = outwards * outside
        owner = sketch.joint(start + beside, hips) if bones else hips
        if bones == 2:
            middle = (start + end) / 2
            sketch.limb(owner, start, middle, radius * 0.42, radius * 0.45, **worn)
            owner = sketch.joint(middle + beside, owner)
            sketch.limb(owner, middle, end, radius * 0.45, radius * 0.5, **worn)
        else:
            sketch.limb(owner, start, end, radius * 0.45, radius * 0.55, **worn)
        if bones and tips:
            sketch.joint(end + beside, owner)


def cape(sketch: Sketch, chest: int, neck, width: float, length: float) -> None:
    """A sheet down the back in three strips; with a chain of joints on half of the characters."""
    shell = sketch.new_shell()
    bones = sketch.integer(2, 3) if sketch.chance(0.5) else 0
    segments = max(bones, 2)
    flare = sketch.uniform(1.1, 1.8)
    if sketch.chance(0.5):
        sketch.sheets[shell] = neck + FORWARD * width
    place, owner = np.asarray(neck, float), chest
    for segment in range(segments):
        following = place + [0, -length / segments, -length * sketch.uniform(0.02, 0.12) / segments]
        if bones:
            owner = sketch.joint(place, owner)
        for strip in (-1, 0, 1):
            spread = [1 + (flare - 1) * (segment + end) / segments for end in (0, 1)]
            start = place + [strip * width * 0.6 * spread[0], 0, 0]
            end = following + [strip * width * 0.6 * spread[1], 0, 0]
            half = [width * 0.42 * factor for factor in spread]
            sketch.limb(owner, start, end, half[0], half[1], squash=(FORWARD, 0.16), shell=shell, material="cloth")
        place = following


def belt(sketch: Sketch, hips: int, centre, radius: float) -> None:
    shell = sketch.new_shell()
    sketch.block(hips, centre, [radius, radius * 0.14, radius * 0.8], roundness=2.6, shell=shell, material="leather")
    sketch.block(hips, centre + FORWARD * radius * 0.8, np.array([0.2, 0.2, 0.1]) * radius, roundness=5, shell=shell, material="metal")


def backpack(sketch: Sketch, chest: int, centre, size: float) -> None:
    shell = sketch.new_shell()
    sketch.block(chest, centre, np.array([0.8, 1.0, 0.4]) * size, roundness=sketch.uniform(3, 6), shell=shell, material="leather")


def armour(sketch: Sketch, side: int, joint: int, place, direction, radius: float) -> None:
    """A plate around a shoulder, a forearm or a shin."""
    shell = sketch.new_shell()
    reach = np.asarray(direction, float) * radius * sketch.uniform(0.6, 1.2)
    sketch.limb(joint, place, place + reach, radius * 1.5, radius * sketch.uniform(1.1, 1.6), shell=shell, material="metal")


def hat(sketch: Sketch, head: int, centre, radius: float) -> None:
    """A cone or cylinder, with a brim on some."""
    shell = sketch.new_shell()
    start, top = centre + UP * radius * 0.75, centre + UP * radius * sketch.uniform(1.1, 2.0)
    sketch.limb(head, start, top, radius * 0.8, radius * sketch.uniform(0.1, 0.8), shell=shell, material="cloth")
    if sketch.chance(0.5):
        sketch.block(head, start, np.array([1.5, 0.1, 1.5]) * radius, shell=shell, material="cloth")


def hair(sketch: Sketch, head: int, centre, radius: float) -> None:
    """A cap over the back and top of the skull, with locks on some."""
    shell = sketch.new_shell()
    sketch.block(head, centre + [0, radius * 0.22, -radius * 0.16], np.array([0.98, 0.95, 1.0]) * radius, roundness=2.2, shell=shell, material="hair")
    if sketch.chance(0.5):
        length = radius * sketch.uniform(0.8, 1.8)
        for side in sketch.both_sides():
            start = centre + mirrored(side, [radius * 0.75, radius * 0.2, -radius * 0.2])
            sketch.limb(head, start, start - UP * length, radius * 0.3, radius * 0.2, shell=shell, material="hair")


def held_prop(sketch: Sketch, hand: int, grip, direction, length: float) -> None:
    """A staff, sword or club in one hand: it breaks the symmetry, as in real uploads."""
    shell = sketch.new_shell()
    tilt = np.asarray(direction, float)
    thickness = length * sketch.uniform(0.015, 0.04)
    head = thickness * sketch.choice([0.6, 1.0, 2.2])
    sketch.limb(hand, grip - tilt * length * sketch.uniform(0.1, 0.5), grip + tilt * length * 0.6, thickness, head, shell=shell, material="metal")
