"""The kinds of characters, and how often each is drawn."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from . import clothing
from .parts import arm, head, leg, tail, trunk, wing
from .shapes import unit
from .sketch import FORWARD, SIDEWAYS, UP, Sketch, mirrored


def biped(sketch: Sketch, kind: str) -> None:
    """Humans, chibis, brutes, beasts, winged and many-armed ones, and those in a skirt whose joints lie outside it."""
    chibi = kind == "chibi"
    leg_height = sketch.uniform(0.22, 0.36) if chibi else sketch.uniform(0.42, 0.54)
    head_radius = sketch.uniform(0.15, 0.24) if chibi else sketch.uniform(0.062, 0.10)
    shoulder_height = sketch.uniform(0.55, 0.66) if chibi else sketch.uniform(0.78, 0.84)
    hip_width = sketch.uniform(0.045, 0.085)
    shoulder_width = hip_width * sketch.uniform(1.2, 2.1) * (1.3 if kind == "brute" else 1)
    radius = sketch.uniform(0.025, 0.05) * {"chibi": 1.2, "brute": 1.35}.get(kind, 1)
    hip_radius = hip_width * sketch.uniform(1.2, 1.7)

    root = _root(sketch, leg_height)
    spine, top = trunk(
        sketch, [0, leg_height + 0.03, 0], [0, shoulder_height, -0.01], hip_radius,
        shoulder_width * sketch.uniform(0.7, 0.95), sketch.integer(2, 4), root,
    )  # fmt: skip
    hips, chest = spine[0], spine[-1]
    neck = sketch.joint(top, chest)
    skull_base = top + [0, sketch.uniform(0.03, 0.07), 0.01]
    sketch.limb(neck, top - UP * 0.02, skull_base, radius * 1.1, radius)
    skull, skull_centre = head(sketch, neck, skull_base, np.array([0, 1.0, 0.05]), head_radius)

    pose = sketch.choice([sketch.uniform(0, 0.12), sketch.uniform(0.5, 1.0), sketch.uniform(1.0, 1.35)], [0.5, 0.35, 0.15])
    fingers = sketch.choice([0, 1, 2, 3, 4, 5], [0.35, 0.05, 0.1, 0.15, 0.15, 0.2])
    arm_length = sketch.uniform(0.24, 0.42) * (shoulder_height / 0.8)
    collar_bone = sketch.chance(0.6)
    arms = []
    for pair in range(2 if kind == "multi_arm" else 1):
        height = top[1] - sketch.uniform(0.02, 0.05) - pair * (shoulder_height - leg_height) * 0.3
        parent = spine[-2] if pair > 0 and len(spine) > 2 else chest
        for side in sketch.both_sides():
            shoulder = [side * (shoulder_width + 0.01), height, -0.01]
            arms.append(arm(sketch, side, parent, shoulder, arm_length, radius, pose + pair * 0.3, fingers, collar_bone))

    digitigrade = kind == "beast" and sketch.chance(0.6)
    toe = sketch.chance(0.65)
    legs = []
    for side in sketch.both_sides():
        hip = [side * hip_width, leg_height, 0]
        legs.append(leg(sketch, side, hips, hip, radius * sketch.uniform(1.1, 1.5), digitigrade, toe))

    if kind == "beast" or sketch.chance(0.12):
        tail(sketch, hips, [0, leg_height + 0.02, -hip_radius * 0.6], sketch.uniform(0.2, 0.5), radius * sketch.uniform(0.6, 1.1))
    if kind == "winged" or sketch.chance(0.06):
        span = sketch.uniform(0.3, 0.6)
        for side in sketch.both_sides():
            wing(sketch, side, chest, [side * 0.03, shoulder_height - 0.04, -hip_radius * 0.7], span, radius)
    if sketch.squareness == 2.0:
        _dress(sketch, hips, spine, arms, legs, skull, skull_centre, top, hip_radius, head_radius, radius)
    if kind == "skirted":
        centre = sketch.joints[hips] + UP * 0.01
        clothing.skirt(sketch, hips, centre, hip_radius * sketch.uniform(1.0, 1.25), sketch.uniform(0.12, centre[1] * 0.85), jointed=True,
                       outside=sketch.uniform(0, 0.06), tips=sketch.chance(0.6))


def _dress(sketch, hips, spine, arms, legs, skull, skull_centre, top, hip_radius, head_radius, radius) -> None:
    """Clothes, by chance and in layers from the skin outwards."""
    if sketch.chance(0.25):  # coat or shirt
        sleeves = [a.upper for a in arms] if sketch.chance(0.7) else []
        clothing.cover(sketch, [*spine, *sleeves], sketch.uniform(0.06, 0.2), "cloth", single_sided=sketch.chance(0.3))
    if sketch.chance(0.2):
        clothing.cover(sketch, [joint for l in legs for joint in (l.upper, l.lower)], sketch.uniform(0.06, 0.22), "cloth")
    if sketch.chance(0.25):  # boots
        clothing.cover(sketch, [l.foot for l in legs], sketch.uniform(0.1, 0.3), "leather")
    if sketch.chance(0.12):  # gloves
        clothing.cover(sketch, [a.hand for a in arms], sketch.uniform(0.08, 0.2), "leather")
    if sketch.chance(0.15):
        centre = sketch.joints[hips] + UP * 0.01
        clothing.skirt(sketch, hips, centre, hip_radius * 1.05, sketch.uniform(0.12, centre[1] * 0.8), jointed=sketch.chance(0.6))
    if sketch.chance(0.15):
        clothing.belt(sketch, hips, sketch.joints[hips] + UP * 0.02, hip_radius * 1.15)
    if sketch.chance(0.12):
        for side, worn in zip(sketch.both_sides(), arms[:2]):
            clothing.armour(sketch, side, worn.upper, sketch.joints[worn.upper], worn.direction, radius)
            if sketch.chance(0.5):
                clothing.armour(sketch, side, worn.fore, sketch.joints[worn.fore] + worn.direction * radius, worn.direction, radius * 0.75)
    if sketch.chance(0.1):
        clothing.cape(sketch, spine[-1], top - [0, 0.02, hip_radius * 0.9], hip_radius, sketch.uniform(0.25, top[1] * 0.85))
    if sketch.chance(0.1):
        clothing.backpack(sketch, spine[-1], top - [0, hip_radius * 1.2, hip_radius * 1.05], hip_radius)
    if sketch.chance(0.3):
        clothing.hair(sketch, skull, skull_centre, head_radius)
    elif sketch.chance(0.15):
        clothing.hat(sketch, skull, skull_centre, head_radius)
    if sketch.chance(0.08):
        carrying = arms[0] if sketch.chance(0.5) else arms[1]
        direction = unit(FORWARD * sketch.uniform(0.3, 1) + UP * sketch.uniform(-0.3, 1))
        clothing.held_prop(sketch, carrying.hand, carrying.wrist + carrying.direction * 0.05, direction, sketch.uniform(0.2, 0.7))


def _root(sketch: Sketch, hip_height: float) -> int:
    """Some artists put a joint on the ground or at the pelvis above the spine; most start with the spine."""
    if sketch.chance(0.08):
        return sketch.joint([0, 0, 0], -1)
    if sketch.chance(0.12):
        return sketch.joint([0, hip_height + 0.01, 0], -1)
    return -1


def robot(sketch: Sketch) -> None:
    sketch.squareness = sketch.uniform(4, 8)
    sketch.segmented = sketch.chance(0.35)
    biped(sketch, sketch.choice(["human", "chibi", "brute"]))


def quadruped(sketch: Sketch, kind: str) -> None:
    """Four-legged animals, and what is built on them: centaurs, dragons, many heads, many tails."""
    length, height, girth = sketch.uniform(0.45, 0.7), sketch.uniform(0.25, 0.5), sketch.uniform(0.07, 0.14)
    bones = sketch.integer(2, 4)
    back, front = np.array([0, height, -length / 2]), np.array([0, height + sketch.uniform(-0.03, 0.08), length / 2])
    arch = sketch.uniform(0, 0.05)
    places = [back + (front - back) * t + UP * (arch * np.sin(np.pi * t) + girth * 0.35) for t in np.linspace(0, 1, bones + 1)]
    squash = (SIDEWAYS, sketch.uniform(0.7, 1))
    roundness = sketch.choice([2.0, 2.6])
    spine, joint = [], -1
    below = UP * girth * 0.35
    for index in range(bones):
        joint = sketch.joint(places[index], joint)
        spine.append(joint)
        radii = girth * sketch.uniform(0.85, 1.1), girth * sketch.uniform(0.85, 1.1)
        sketch.limb(joint, places[index] - below, places[index + 1] - below, *radii, squash=squash, roundness=roundness)
    hips, chest = spine[0], spine[-1]

    radius = girth * sketch.uniform(0.28, 0.45)
    for hind in (True, False):
        toe = sketch.chance(0.6)
        digitigrade = hind and sketch.chance(0.75)
        shoulder_blade = not hind and sketch.chance(0.4)
        apart = girth * sketch.uniform(0.5, 0.75)
        for side in sketch.both_sides():
            hip = np.array([side * apart, height - girth * 0.15, (-1 if hind else 1) * length * 0.44])
            parent = hips if hind else chest
            if shoulder_blade:
                blade = hip + [-side * girth * 0.3, girth * 0.6, -girth * 0.2]
                parent = sketch.joint(blade, chest)
                sketch.limb(parent, blade, hip, radius, radius)
            if sketch.chance(0.5):  # haunch
                sketch.block(parent, hip, np.array([0.9, 1.5, 1.2]) * radius)
            leg(sketch, side, parent, hip, radius, digitigrade, toe)

    if kind == "centaur":
        _centaur_front(sketch, chest, places[-1], girth, radius)
    else:
        _animal_heads(sketch, kind, chest, places[-1], girth)
    tails = sketch.integer(2, 3) if kind == "multi_tail" else int(sketch.chance(0.85))
    for index in range(tails):
        offset = (index - (tails - 1) / 2) * girth * 0.5
        tail(sketch, hips, back + [offset, girth * 0.3, -girth * 0.6], sketch.uniform(0.15, 0.6), girth * sketch.uniform(0.2, 0.5))
    if kind == "dragon":
        span = sketch.uniform(0.4, 0.8)
        for side in sketch.both_sides():
            wing(sketch, side, chest, [side * girth * 0.5, height + girth * 0.8, length * 0.3], span, girth * 0.3)
    if sketch.chance(0.15):  # spikes along the back
        for joint, place in zip(spine, places):
            sketch.limb(joint, place, place + UP * girth * sketch.uniform(0.8, 1.5), girth * 0.25, girth * 0.05, squash=(SIDEWAYS, 0.4))
    if sketch.chance(0.08):  # saddle
        clothing.backpack(sketch, spine[len(spine) // 2], places[len(places) // 2] + UP * girth * 0.6, girth * 0.7)


def _centaur_front(sketch: Sketch, chest: int, start, girth: float, radius: float) -> None:
    spine, top = trunk(
        sketch, start + [0, 0.03, 0.02], start + [0, sketch.uniform(0.25, 0.38), 0.03], girth * 0.8, girth * 0.95, sketch.integer(1, 3), chest
    )  # fmt: skip
    neck = sketch.joint(top, spine[-1])
    skull_base = top + [0, 0.04, 0.01]
    sketch.limb(neck, top, skull_base, radius, radius)
    head(sketch, neck, skull_base, UP, sketch.uniform(0.06, 0.09))
    pose, fingers, length = sketch.uniform(0, 1.2), sketch.integer(0, 4), sketch.uniform(0.25, 0.38)
    for side in sketch.both_sides():
        arm(sketch, side, spine[-1], top + [side * girth * 1.05, -0.04, 0], length, radius * 0.8, pose, fingers, sketch.chance(0.5))


def _animal_heads(sketch: Sketch, kind: str, chest: int, start, girth: float) -> None:
    heads = sketch.integer(2, 3) if kind == "multi_head" else 1
    bones = sketch.integer(2, 5) if kind == "dragon" else sketch.integer(1, 3)
    length = sketch.uniform(0.25, 0.5) if kind == "dragon" else sketch.uniform(0.08, 0.3)
    rise = sketch.uniform(0.2, 1.6)
    for index in range(heads):
        spread = 0.0 if heads == 1 else (index / (heads - 1) - 0.5) * 1.2
        directions = [[spread, rise - 0.25 * k * rise / max(bones - 1, 1), 1.0] for k in range(bones)]
        radii = list(np.linspace(girth * 0.62, girth * 0.42, bones + 1))
        neck, end = sketch.chain(chest, start + [spread * girth, 0, 0], directions, [length / bones] * bones, radii, end_joint=False)
        snout = True if sketch.chance(0.75) else None
        head(sketch, neck[-1], end, unit([spread * 0.3, 0.35, 1.0]), girth * sketch.uniform(0.55, 0.85), snout=snout)


def bird(sketch: Sketch) -> None:
    girth, height, tilt = sketch.uniform(0.10, 0.18), sketch.uniform(0.15, 0.4), sketch.uniform(0.1, 1.2)
    axis = unit([0, tilt, 1.0])
    above = unit(np.cross(axis, SIDEWAYS))
    centre = np.array([0, height + girth * 0.6, 0])
    hips = sketch.joint([0, height + girth * 0.5, -girth * 0.2], -1)
    axes = np.stack([SIDEWAYS, above, axis], axis=1)
    sketch.block(hips, centre, [girth * 0.8, girth * 0.85, girth * sketch.uniform(1.0, 1.5)], axes)
    chest = sketch.joint(centre + axis * girth * 0.5, hips)
    sketch.block(chest, centre + axis * girth * 0.55, [girth * 0.65, girth * 0.65, girth * 0.7])
    bones, length = sketch.integer(1, 4), sketch.uniform(0.04, 0.35)
    radii = list(np.linspace(girth * 0.45, girth * 0.3, bones + 1))
    neck, end = sketch.chain(chest, centre + axis * girth * 0.9, [[0, 1.0, 0.35]] * bones, [length / bones] * bones, radii, end_joint=False)
    head(sketch, neck[-1], end, unit([0, 1.0, 0.4]), girth * sketch.uniform(0.4, 0.7), ears="none", beak=True, snout=False)
    span = sketch.uniform(0.3, 0.7)
    for side in sketch.both_sides():
        wing(sketch, side, chest, centre + mirrored(side, [girth * 0.6, girth * 0.3, girth * 0.2]), span, girth * 0.3)
    toe, radius, digitigrade = sketch.chance(0.5), girth * sketch.uniform(0.16, 0.28), sketch.chance(0.5)
    for side in sketch.both_sides():
        leg(sketch, side, hips, [side * girth * 0.45, height + girth * 0.1, 0], radius, digitigrade, toe)
    bones = sketch.integer(1, 2)
    radii = list(np.linspace(girth * 0.35, girth * 0.25, bones + 1))
    lengths = [girth * sketch.uniform(0.5, 1.2)] * bones
    sketch.chain(hips, centre - axis * girth * 0.9, [-axis] * bones, lengths, radii, squash=(above, 0.4))


def fish(sketch: Sketch) -> None:
    bones, girth = sketch.integer(3, 7), sketch.uniform(0.09, 0.2)
    fullness = sketch.uniform(0.6, 1.2)

    def profile(t: float) -> float:
        return girth * (np.sin(np.pi * np.clip(t * 0.85 + 0.15, 0, 1)) ** fullness + 0.12)

    places = [np.array([0, girth * 1.3, z]) for z in np.linspace(0.5, -0.35, bones + 1)]
    squash = (SIDEWAYS, sketch.uniform(0.4, 0.8))
    root = sketch.integer(0, bones // 2)
    joints: dict[int, int] = {}
    for index in [*range(root, bones), *range(root - 1, -1, -1)]:
        parent = -1 if index == root else joints[index - 1 if index > root else index + 1]
        joints[index] = sketch.joint(places[index], parent)
        sketch.limb(joints[index], places[index], places[index + 1], profile(index / bones), profile((index + 1) / bones), squash=squash)
    fin = sketch.joint(places[-1], joints[bones - 1])
    sketch.block(fin, places[-1] - FORWARD * 0.1, [girth * 0.12, girth * sketch.uniform(0.7, 1.5), 0.1], roundness=2.5, blend=0.004)
    if sketch.chance(0.7):  # dorsal fin
        middle = bones // 2
        reach = profile(middle / bones)
        owner = sketch.joint(places[middle] + UP * reach * 0.9, joints[middle]) if sketch.chance(0.5) else joints[middle]
        sketch.block(owner, places[middle] + [0, reach * 1.3, -0.03], [girth * 0.1, girth * 0.6, 0.09], roundness=2.5, blend=0.004)
    front = min(1, bones - 1)
    length, fin_bones = sketch.uniform(0.08, 0.25), sketch.integer(1, 2)
    for side in sketch.both_sides():
        start = places[front] + mirrored(side, [girth * 0.5, -girth * 0.3, -0.05])
        directions = [mirrored(side, [1, -0.35, -0.5])] * fin_bones
        radii = [girth * 0.3, girth * 0.22, girth * 0.1][: fin_bones + 1]
        sketch.chain(joints[front], start, directions, [length] * fin_bones, radii, squash=(unit(mirrored(side, [0.2, 1, 0])), 0.35))
    if sketch.chance(0.3):  # jaw
        jaw = sketch.joint(places[0] + [0, -girth * 0.2, -0.02], joints[0])
        sketch.limb(jaw, places[0] + [0, -girth * 0.3, -0.05], places[0] + [0, -girth * 0.3, 0.06], girth * 0.3, girth * 0.15)


def bug(sketch: Sketch) -> None:
    """Insects, spiders, crabs, centipedes: 4 to 14 legs."""
    pairs = sketch.integer(2, 4) if sketch.chance(0.8) else sketch.integer(5, 7)
    girth, height = sketch.uniform(0.09, 0.16), sketch.uniform(0.14, 0.3)
    length = girth * sketch.uniform(1.0, 2.2)
    root = sketch.joint([0, height, 0], -1)
    sketch.block(root, [0, height, 0], [girth, girth * 0.7, length])
    if sketch.chance(0.7):
        rear = sketch.joint([0, height, -length * 0.8], root)
        place = [0, height + girth * 0.2, -length - girth * sketch.uniform(0.6, 1.0)]
        sketch.block(rear, place, np.array([sketch.uniform(0.8, 1.3), sketch.uniform(0.7, 1.2), sketch.uniform(1.0, 1.6)]) * girth)
        if sketch.chance(0.25):
            tail(sketch, rear, [0, height + girth * 0.4, -length - girth * 1.8], sketch.uniform(0.2, 0.5), girth * 0.35, rise=1.2)
    head(sketch, root, np.array([0, height, length * 0.85]), unit([0, 0.15, 1.0]), girth * sketch.uniform(0.45, 0.7), ears=sketch.choice(["none", "horn"]), snout=False)
    radius, bones = girth * sketch.uniform(0.14, 0.26), sketch.integer(2, 3)
    spread, knee_height = sketch.uniform(0.25, 0.5), sketch.uniform(0.3, 1.1)
    for pair in range(pairs):
        along = pair / max(pairs - 1, 1) - 0.5
        for side in sketch.both_sides():
            start = np.array([side * girth * 0.75, height - girth * 0.1, -along * length * 1.5])
            outwards = unit([side, 0, -along * 1.4])
            knee = start + outwards * spread * 0.45 + UP * height * knee_height * 0.6
            foot = start + outwards * spread
            foot[1] = 0.01
            joint = sketch.joint(start, root)
            sketch.limb(joint, start, knee, radius, radius * 0.8)
            joint = sketch.joint(knee, joint)
            if bones == 3:
                shin = knee * 0.45 + foot * 0.55 + outwards * 0.04
                sketch.limb(joint, knee, shin, radius * 0.8, radius * 0.6)
                joint = sketch.joint(shin, joint)
                sketch.limb(joint, shin, foot, radius * 0.6, radius * 0.3)
            else:
                sketch.limb(joint, knee, foot, radius * 0.8, radius * 0.3)
            if sketch.end_joints:
                sketch.joint(foot, joint)
    if sketch.chance(0.2):
        span = sketch.uniform(0.3, 0.6)
        for side in sketch.both_sides():
            wing(sketch, side, root, [side * girth * 0.4, height + girth * 0.6, 0], span, girth * 0.2)


def snake(sketch: Sketch) -> None:
    bones, girth = sketch.integer(4, 14), sketch.uniform(0.035, 0.09)
    sway = sketch.uniform(0, 0.14) if sketch.chance(0.5) else 0.0
    raised = sketch.uniform(0, 0.35) if sketch.chance(0.5) else 0.0
    shares = np.linspace(0, 1, bones + 1)
    lift = raised * np.clip((shares - 0.7) / 0.3, 0, 1) ** 1.5
    places = np.stack([sway * np.sin(shares * sketch.uniform(4, 9)), girth + lift, shares - 0.5], axis=1)
    joint = -1
    for index in range(bones):
        joint = sketch.joint(places[index], joint)
        radii = [girth * np.clip(0.25 + 3 * t, 0, 1) for t in shares[index : index + 2]]
        sketch.limb(joint, places[index], places[index + 1], *radii)
    head(sketch, joint, places[-1], unit([0, 0.1, 1.0]), girth * sketch.uniform(1.0, 1.5), ears=sketch.choice(["none", "horn"]), snout=sketch.chance(0.5))


def octopus(sketch: Sketch) -> None:
    arms, bones = sketch.integer(4, 8), sketch.integer(2, 5)
    girth, length, height = sketch.uniform(0.12, 0.22), sketch.uniform(0.25, 0.5), sketch.uniform(0.12, 0.3)
    root = sketch.joint([0, height, 0], -1)
    sketch.block(root, [0, height + girth * 0.6, 0], [girth, girth * sketch.uniform(0.9, 1.5), girth])
    if sketch.chance(0.5):
        sketch.joint([0, height + girth, 0], root)
    down = sketch.uniform(0.1, 1.2)
    for index in range(arms):
        angle = 2 * np.pi * (index + 0.5) / arms
        outwards = np.array([np.sin(angle), 0, np.cos(angle)])
        directions = [outwards - UP * down * (1 - 1.2 * k / bones) for k in range(bones)]
        radii = list(np.linspace(girth * 0.34, girth * 0.1, bones + 1))
        sketch.chain(root, UP * height + outwards * girth * 0.6, directions, [length / bones] * bones, radii)


def blob(sketch: Sketch) -> None:
    """Toys: slimes, mushrooms, plants, snails; few joints."""
    segments, girth = sketch.integer(1, 3), sketch.uniform(0.18, 0.32)
    joint, place = -1, np.array([0, 0.03, 0])
    for _ in range(segments):
        joint = sketch.joint(place, joint)
        height = girth * sketch.uniform(0.7, 1.1)
        sketch.block(joint, place + UP * height * 0.6, [girth * sketch.uniform(0.75, 1.1), height * 0.8, girth * sketch.uniform(0.75, 1.1)])
        place = place + UP * height
    if sketch.chance(0.5):
        head(sketch, joint, place, UP, girth * sketch.uniform(0.5, 0.9))
    elif segments == 1:  # a blob of one joint has nothing to predict
        sketch.joint(place, joint)
    with_arms, with_feet = sketch.chance(0.6), sketch.chance(0.5)
    for side in sketch.both_sides():
        if with_arms:
            bones = sketch.integer(1, 2)
            start = mirrored(side, [girth * 0.8, girth * 0.72, 0])
            directions = [mirrored(side, [1, sketch.uniform(-0.8, 0.5), 0])] * bones
            radii = list(np.linspace(girth * 0.25, girth * 0.2, bones + 1))
            sketch.chain(min(1, joint), start, directions, [girth * sketch.uniform(0.3, 0.8)] * bones, radii)
        if with_feet:
            ankle = mirrored(side, [girth * 0.45, 0.02, 0.05])
            foot = sketch.joint(ankle, 0)
            sketch.block(foot, ankle + [0, -0.06, 0.05], np.array([0.3, 0.2, 0.45]) * girth)


# name: (share, how it is drawn)
FAMILIES: dict[str, tuple[float, Callable[[Sketch], None]]] = {
    "human": (0.24, lambda sketch: biped(sketch, "human")),
    "chibi": (0.10, lambda sketch: biped(sketch, "chibi")),
    "brute": (0.04, lambda sketch: biped(sketch, "brute")),
    "beast": (0.06, lambda sketch: biped(sketch, "beast")),
    "winged": (0.03, lambda sketch: biped(sketch, "winged")),
    "multi_arm": (0.03, lambda sketch: biped(sketch, "multi_arm")),
    "robot": (0.06, robot),
    "quadruped": (0.13, lambda sketch: quadruped(sketch, "quadruped")),
    "centaur": (0.03, lambda sketch: quadruped(sketch, "centaur")),
    "multi_tail": (0.02, lambda sketch: quadruped(sketch, "multi_tail")),
    "multi_head": (0.02, lambda sketch: quadruped(sketch, "multi_head")),
    "dragon": (0.05, lambda sketch: quadruped(sketch, "dragon")),
    "bird": (0.06, bird),
    "fish": (0.05, fish),
    "bug": (0.04, bug),
    "snake": (0.02, snake),
    "octopus": (0.01, octopus),
    "blob": (0.04, blob),
    "skirted": (0.0, lambda sketch: biped(sketch, "skirted")),  # only where it is asked for: more of what the draw has too little of
}
