"""Parts of bodies: hands, arms, legs, heads, tails, wings, trunks.

Lengths and radii are in units of about the character's height. `side` is +1 for the left and -1 for the right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .shapes import frame_along, unit
from .sketch import FORWARD, SIDEWAYS, UP, Sketch, mirrored


def hand(sketch: Sketch, side: int, joint: int, wrist, direction, radius: float, fingers: int, length: float) -> None:
    """Palm, ball of the thumb and `fingers` fingers (the first is the thumb) along `direction`."""
    upwards = UP if abs(direction[1]) < 0.75 else FORWARD
    sideways = unit(np.cross(direction, upwards)) * side  # towards the thumb
    normal = unit(np.cross(direction, sideways)) * side
    axes = np.stack([sideways, normal, direction], axis=1)
    if fingers == 0:  # a mitten or a fist
        sketch.block(joint, wrist + direction * length * 0.4, [length * 0.32, radius, length * 0.5], axes, roundness=sketch.uniform(2, 3))
        if sketch.chance(0.5):
            start = wrist + direction * length * 0.2 + sideways * length * 0.2
            sketch.limb(joint, start, start + unit(direction + sideways) * length * 0.35, radius * 0.5, radius * 0.38)
        return
    sketch.block(joint, wrist + direction * length * 0.3, [length * 0.34, radius * 0.7, length * 0.36], axes, roundness=2.5)
    thumb_ball = wrist + direction * length * 0.18 + sideways * length * 0.2 - normal * radius * 0.25
    sketch.block(joint, thumb_ball, [length * 0.16, radius * 0.55, length * 0.2], axes)
    bones = sketch.integer(1, 3)
    jointed = sketch.chance(0.75)
    long_fingers = max(fingers - 1, 1)
    for index in range(fingers):
        is_thumb = index == 0 and fingers >= 2
        spread = 0.0 if is_thumb or long_fingers == 1 else (index - 1) / (long_fingers - 1) - 0.5
        if is_thumb:
            start = wrist + direction * length * 0.15 + sideways * length * 0.25
            towards = unit(direction * 0.7 + sideways * 0.8 - normal * 0.2)
        else:
            start = wrist + direction * length * 0.57 - sideways * spread * length * 0.62
            towards = unit(direction - sideways * spread * 0.35)
        finger_length = length * (0.75 - 0.24 * abs(spread)) * (0.75 if is_thumb else 1)
        finger_radius = min(radius * (0.34 if fingers >= 4 else 0.45), length * (0.066 if fingers >= 4 else 0.1))
        if jointed:
            radii = list(np.linspace(finger_radius, finger_radius * 0.75, bones + 1))
            sketch.chain(joint, start, [towards] * bones, [finger_length / bones] * bones, radii)
        else:
            sketch.limb(joint, start, start + towards * finger_length, finger_radius, finger_radius * 0.75)


@dataclass(frozen=True)
class ArmJoints:
    upper: int
    fore: int
    hand: int
    wrist: np.ndarray
    direction: np.ndarray


def arm(sketch: Sketch, side: int, parent: int, shoulder, length: float, radius: float, pose: float, fingers: int, collar_bone: bool) -> ArmJoints:
    """`pose` is the angle below the horizontal: 0 is a T pose, 0.5 to 1 an A pose, above that arms hang down."""
    shoulder = np.asarray(shoulder, float)
    if collar_bone:
        start = np.array([shoulder[0] * sketch.uniform(0.15, 0.4), shoulder[1] - sketch.uniform(-0.01, 0.02) * length, shoulder[2] - 0.02 * length])
        parent = sketch.joint(start, parent)
        sketch.limb(parent, start, shoulder, radius, radius * 1.1)
    direction = unit(mirrored(side, [np.cos(pose), -np.sin(pose), sketch.uniform(-0.08, 0.04)]))
    bend = sketch.uniform(0, 0.25)
    fore_direction = unit(direction + np.array([0, -bend * 0.3 * np.cos(pose), bend]))
    upper_share = sketch.uniform(0.46, 0.54)
    elbow = shoulder + direction * length * upper_share
    upper = sketch.joint(shoulder, parent)
    sketch.limb(upper, shoulder, elbow, radius * 1.05, radius * 0.8, bulge=sketch.uniform(0, 0.14))
    if sketch.chance(0.4):  # deltoid
        sketch.block(upper, shoulder + direction * radius * 0.4, [radius * 1.3, radius * 1.2, radius * 1.5], frame_along(direction))
    if sketch.chance(0.35):  # biceps in front
        middle = shoulder + direction * length * upper_share * 0.5
        sketch.limb(upper, middle - direction * radius * 0.8 + FORWARD * radius * 0.3, middle + direction * radius + FORWARD * radius * 0.3, radius * 0.75, radius * 0.7)
    fore = sketch.joint(elbow - FORWARD * 0.12 * radius, upper)  # elbows sit a little to the back
    wrist = elbow + fore_direction * length * (1 - upper_share)
    sketch.limb(fore, elbow, wrist, radius * 0.82, radius * sketch.uniform(0.5, 0.75), bulge=sketch.uniform(-0.03, 0.12))
    hand_joint = sketch.joint(wrist, fore)
    hand(sketch, side, hand_joint, wrist, fore_direction, radius * 0.7, fingers, length * sketch.uniform(0.24, 0.38))
    return ArmJoints(upper, fore, hand_joint, wrist, fore_direction)


@dataclass(frozen=True)
class LegJoints:
    upper: int
    lower: int
    foot: int


def leg(sketch: Sketch, side: int, parent: int, hip, radius: float, digitigrade: bool, toe: bool) -> LegJoints:
    """From `hip` down to the ground at y = 0. A digitigrade leg is the hind leg of a cat: its heel is in the air."""
    hip = np.asarray(hip, float)
    height = hip[1]
    foot_length = height * sketch.uniform(0.2, 0.34)
    if digitigrade:
        knee = hip + [side * 0.02 * height, -height * 0.36, height * sketch.uniform(0.12, 0.24)]
        ankle = hip + [side * 0.02 * height, -height * 0.70, -height * sketch.uniform(0.10, 0.22)]
        ball = np.array([ankle[0], radius * 0.4, ankle[2] + height * sketch.uniform(0.08, 0.16)])
    else:
        knee = hip + [side * height * sketch.uniform(-0.01, 0.05), -height * sketch.uniform(0.44, 0.50), height * sketch.uniform(0.005, 0.04)]
        ankle = np.array([knee[0] + side * height * sketch.uniform(-0.01, 0.03), height * sketch.uniform(0.07, 0.11), hip[2] - height * sketch.uniform(0, 0.04)])
        ball = np.array([ankle[0] + side * 0.01, radius * 0.35, ankle[2] + foot_length * 0.6])
    upper = sketch.joint(hip, parent)
    sketch.limb(upper, hip, knee, radius * 1.25, radius * 0.85, bulge=sketch.uniform(0, 0.14))
    lower = sketch.joint(knee, upper)
    sketch.limb(lower, knee - FORWARD * 0.1 * radius, ankle, radius * 0.88, radius * sketch.uniform(0.5, 0.7), bulge=sketch.uniform(0, 0.12))
    if sketch.chance(0.45):  # calf at the back
        calf = knee + (ankle - knee) * 0.33 - FORWARD * radius * 0.35
        sketch.block(lower, calf, [radius * 0.62, radius * 0.62, radius * 1.5], frame_along(ankle - knee))
    if sketch.chance(0.25):  # kneecap
        sketch.block(lower, knee + FORWARD * radius * 0.6, [radius * 0.45, radius * 0.5, radius * 0.4])
    foot = sketch.joint(ankle, lower)
    wide = (SIDEWAYS, sketch.uniform(1.0, 1.35))
    sketch.limb(foot, ankle, ball, radius * 0.62, radius * 0.5, squash=wide)
    if not digitigrade and sketch.chance(0.65):  # heel
        sketch.block(foot, [ankle[0], radius * 0.42, ankle[2] - radius * 0.35], [radius * 0.5, radius * 0.42, radius * 0.55])
    tip = ball + FORWARD * foot_length * 0.5
    toe_joint = sketch.joint(ball, foot) if toe else foot
    sketch.limb(toe_joint, ball, tip, radius * 0.5, radius * 0.35, squash=(SIDEWAYS, 1.3))
    if toe and sketch.end_joints:
        sketch.joint(tip, toe_joint)
    if sketch.chance(0.15):  # claws or separate toes
        for offset in (-0.4, 0.0, 0.4):
            start = tip + SIDEWAYS * offset * radius
            sketch.limb(toe_joint, start, start + [offset * radius * 0.3, -radius * 0.1, radius * 0.8], radius * 0.2, radius * 0.08)
    return LegJoints(upper, lower, foot)


def head(sketch: Sketch, neck: int, base, forward, radius: float, *, ears=None, beak=False, jaw=None, snout=None) -> tuple[int, np.ndarray]:
    """Skull, face, ears, perhaps a jaw and hair. Returns the head's joint and the middle of the skull."""
    centre = base + forward * radius * 0.75
    joint = sketch.joint(base, neck)
    width, depth = sketch.uniform(0.85, 1.15), sketch.uniform(0.85, 1.1)
    sketch.block(joint, centre, [radius * 0.85 * width, radius * sketch.uniform(0.85, 1.1), radius * depth], roundness=sketch.uniform(2, 2.8))
    if sketch.end_joints:
        sketch.joint(centre + forward * radius * 0.7, joint)
    has_snout = sketch.chance(0.3) if snout is None else snout
    has_jaw = sketch.chance(0.5 if has_snout else 0.2) if jaw is None else jaw
    if has_snout:
        _snout(sketch, joint, centre, radius, has_jaw)
    else:
        _face(sketch, joint, centre, radius, depth, has_jaw)
    if beak:
        tip = centre + [0, -0.15 * radius, radius * sketch.uniform(1.4, 2.2)]
        sketch.limb(joint, centre + FORWARD * radius * 0.6, tip, radius * 0.35, radius * 0.06)
    kind = sketch.choice(["none", "small", "long", "horn"]) if ears is None else ears
    if kind != "none":
        _ears(sketch, joint, centre, radius, kind)
    if sketch.chance(0.35):
        _eyes(sketch, joint, centre, radius)
    if sketch.chance(0.15):
        _ponytail(sketch, joint, centre, radius)
    return joint, centre


def _snout(sketch: Sketch, joint: int, centre, radius: float, has_jaw: bool) -> None:
    length = radius * sketch.uniform(0.5, 1.3)
    sketch.limb(joint, centre + [0, -0.25 * radius, radius * 0.4], centre + [0, -0.35 * radius, radius * 0.6 + length], radius * 0.5, radius * sketch.uniform(0.2, 0.4))
    if sketch.chance(0.4):  # nose
        sketch.block(joint, centre + [0, -0.22 * radius, radius * 0.75 + length], [radius * 0.16] * 3)
    if has_jaw:
        hinge = sketch.joint(centre + [0, -0.35 * radius, 0.35 * radius], joint)
        sketch.limb(hinge, centre + [0, -0.62 * radius, radius * 0.4], centre + [0, -0.7 * radius, radius * 0.5 + length * 0.8], radius * 0.28, radius * 0.18)


def _face(sketch: Sketch, joint: int, centre, radius: float, depth: float, has_jaw: bool) -> None:
    if sketch.chance(0.6):  # nose
        length = radius * sketch.uniform(0.1, 0.3)
        bridge = centre + [0, radius * 0.05, radius * depth * 0.88]
        sketch.limb(joint, bridge, bridge + [0, -radius * 0.28, length], radius * 0.07, radius * 0.13, squash=(SIDEWAYS, sketch.uniform(0.7, 1.1)))
    if sketch.chance(0.5):  # chin and cheeks narrow the face
        sketch.block(joint, centre + [0, -radius * 0.62, radius * 0.42 * depth], [radius * sketch.uniform(0.35, 0.6), radius * 0.32, radius * 0.45], roundness=2.3)
    if sketch.chance(0.3):  # brow
        sketch.block(joint, centre + [0, radius * 0.3, radius * depth * 0.72], [radius * 0.6, radius * 0.1, radius * 0.2])
    if has_jaw:
        hinge = sketch.joint(centre + [0, -0.3 * radius, 0.3 * radius], joint)
        sketch.block(hinge, centre + [0, -0.62 * radius, 0.35 * radius], [radius * 0.55, radius * 0.25, radius * 0.5])


def _ears(sketch: Sketch, joint: int, centre, radius: float, kind: str) -> None:
    length = radius * {"small": 0.6, "long": 1.6, "horn": 0.9}[kind] * sketch.uniform(0.7, 1.3)
    jointed = (kind == "long" and sketch.chance(0.7)) or sketch.chance(0.15)
    outwards = 0.35 if kind == "horn" else sketch.uniform(-0.3, 0.8)
    thickness = radius * (0.18 if kind == "horn" else 0.28)
    squash = None if kind == "horn" else (FORWARD, 0.45)
    bones = 2 if kind == "long" else 1
    for side in sketch.both_sides():
        start = centre + mirrored(side, [radius * 0.55, radius * 0.65, 0])
        direction = unit(mirrored(side, [outwards, 1.0, -0.1]))
        if jointed:
            radii = list(np.linspace(thickness, thickness * 0.4, bones + 1))
            sketch.chain(joint, start, [direction] * bones, [length / bones] * bones, radii, squash=squash)
        else:
            sketch.limb(joint, start, start + direction * length, thickness, thickness * 0.35, squash=squash)


def _eyes(sketch: Sketch, joint: int, centre, radius: float) -> None:
    """Eyeballs are shells of their own, with joints of their own on some characters."""
    jointed = sketch.chance(0.2)
    shell = sketch.new_shell()
    for side in sketch.both_sides():
        place = centre + mirrored(side, [radius * 0.35, radius * 0.1, radius * 0.72])
        owner = sketch.joint(place, joint) if jointed else joint
        sketch.block(owner, place, [radius * 0.2] * 3, shell=shell, material="eyes")


def _ponytail(sketch: Sketch, joint: int, centre, radius: float) -> None:
    bones, length = sketch.integer(1, 4), radius * sketch.uniform(0.6, 2.0)
    directions = [[0, -0.2 if index == 0 else -1.0, -0.5] for index in range(bones)]
    radii = list(np.linspace(radius * 0.3, radius * 0.12, bones + 1))
    sketch.chain(joint, centre + [0, radius * 0.3, -radius * 0.8], directions, [length / bones] * bones, radii)


def tail(sketch: Sketch, parent: int, start, length: float, radius: float, *, bones=None, rise=None) -> list[int]:
    bones = bones or sketch.integer(2, 6)
    rise = sketch.uniform(-0.5, 0.7) if rise is None else rise
    curl = sketch.uniform(-0.25, 0.25)
    directions = [[0, rise + curl * index, -1.0] for index in range(bones)]
    radii = list(np.linspace(radius, radius * sketch.uniform(0.15, 0.6), bones + 1))
    joints, end = sketch.chain(parent, start, directions, [length / bones] * bones, radii)
    if sketch.chance(0.25):  # tuft
        sketch.block(joints[-1], end, [radius * sketch.uniform(0.8, 1.6)] * 3)
    return joints


def wing(sketch: Sketch, side: int, parent: int, shoulder, span: float, radius: float) -> None:
    bones = sketch.integer(2, 4)
    lift, back = sketch.uniform(-0.1, 0.7), sketch.uniform(-0.4, 0.1)
    shares = np.array([0.28, 0.36, 0.36, 0.3][:bones])
    lengths = span * shares / shares.sum()
    chord = span * sketch.uniform(0.22, 0.42)
    place = np.asarray(shoulder, float)
    for index, length in enumerate(lengths):
        direction = unit(mirrored(side, [1, lift * (1 - 0.8 * index / bones), back * (index + 0.3)]))
        parent = sketch.joint(place, parent)
        following = place + direction * length
        width = chord * (1 - 0.55 * index / bones)
        flat = unit(np.cross(FORWARD, direction))
        axes = np.stack([direction, flat, np.cross(direction, flat)], axis=1)
        middle = (place + following) / 2 + [0, -0.05 * width, -width * 0.45]
        sketch.block(parent, middle, [length * 0.62, radius * 0.35, width * 0.62], axes, roundness=2.6, blend=radius * 0.12)
        sketch.limb(parent, place, following, radius * 0.6, radius * 0.45)
        place = following
    if sketch.end_joints:
        sketch.joint(place, parent)


def trunk(sketch: Sketch, base, top, hip_radius: float, chest_radius: float, bones: int, parent: int) -> tuple[list[int], np.ndarray]:
    """A spine of `bones` joints nearer to the back, and the flesh around it. Returns the joints and the top."""
    base, top = np.asarray(base, float), np.asarray(top, float)
    setback = -sketch.uniform(0.05, 0.4) * hip_radius
    shares = np.linspace(0, 1, bones + 1)
    places = [base + (top - base) * t + [0, 0, setback * np.sin(np.pi * min(t + 0.15, 1))] for t in shares]
    waist = sketch.uniform(0.72, 1.05)
    roundness = sketch.choice([2.0, 2.5, 3.2], [0.4, 0.35, 0.25])

    def girth(t: float) -> float:
        return (hip_radius + (chest_radius - hip_radius) * t) * (1 - (1 - waist) * np.sin(np.pi * t))

    joints = []
    for index in range(bones):
        parent = sketch.joint(places[index], parent)
        joints.append(parent)
        offset = np.array([0, 0, -setback * 0.8])
        end = places[index + 1] + offset
        if index == bones - 1:  # the rounded end stays under the neck
            end = end - unit(top - base) * girth(1) * 0.62
        low, high = girth(shares[index]), girth(shares[index + 1])
        squash = (FORWARD, sketch.uniform(0.6, 0.85))
        sketch.limb(parent, places[index] + offset, end, low, high, squash=squash, roundness=roundness, blend=0.72 * high * sketch.softness)
    _muscles_of_the_trunk(sketch, joints, places, hip_radius, chest_radius)
    return joints, places[-1]


def _muscles_of_the_trunk(sketch: Sketch, joints, places, hip_radius: float, chest_radius: float) -> None:
    if sketch.chance(0.4):  # chest
        sketch.block(joints[-1], places[-1] + [0, -chest_radius * 0.9, hip_radius * 0.25], [chest_radius * 1.05, chest_radius * 0.7, hip_radius * 0.55], blend=chest_radius * 0.2)
    if sketch.chance(0.4):  # pelvis
        sketch.block(joints[0], places[0] - UP * 0.01, [hip_radius * 1.1, hip_radius * 0.7, hip_radius * 0.8], blend=hip_radius * 0.2)
    if sketch.chance(0.3):  # breast or breast plates
        for side in sketch.both_sides():
            place = places[-1] + mirrored(side, [chest_radius * 0.42, -chest_radius * 0.85, hip_radius * 0.6])
            sketch.block(joints[-1], place, np.array([0.42, 0.36, 0.3]) * chest_radius * sketch.uniform(0.8, 1.2))
    if sketch.chance(0.3):  # buttocks
        for side in sketch.both_sides():
            place = places[0] + mirrored(side, [hip_radius * 0.42, -hip_radius * 0.2, -hip_radius * 0.45])
            sketch.block(joints[0], place, np.array([0.5, 0.5, 0.42]) * hip_radius)
    if sketch.chance(0.2):  # belly
        middle = (places[0] + places[1]) / 2
        sketch.block(joints[0], middle + [0, 0, hip_radius * 0.4], np.array([0.85, 0.8, 0.6]) * hip_radius * sketch.uniform(0.8, 1.3))
