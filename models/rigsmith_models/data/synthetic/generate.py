"""A seed to a rigged character."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .families import FAMILIES
from .shapes import BODY
from .sketch import Sketch
from .skin import skin_weights
from .surface import decimate, mesh_shells, outward_half, split_long_edges, with_holes, without_unused

# Raise this with any change that makes another character from the same seed.
GENERATOR_VERSION = 3

FEWEST_VERTICES = 1000  # as in the working meshes that the networks see


@dataclass
class Character:
    """All positions in the normalised frame: y up, facing +z, longest side 1, centred in x and z, lowest y 0."""

    vertices: np.ndarray  # (V, 3) f32
    faces: np.ndarray  # (F, 3) i32, counter-clockwise from outside
    joints: np.ndarray  # (J, 3) f32
    parents: np.ndarray  # (J,) i16, -1 for joint 0 alone, else below the own index
    weights: np.ndarray  # (V, J) f32, rows sum to 1, at most 4 joints each
    family: str


def generate(seed: int, target_vertices: int | None = None, family: str | None = None) -> Character:
    """The character of `seed`: the same on every run of one GENERATOR_VERSION (and versions of numpy and scikit-image).

    `target_vertices` is met within a few percent where the shape allows; None draws 1,000 to 3,500, or a low-polygon
    mesh of 300 to 800 split up to 1,000. `family` picks one of FAMILIES in place of a draw.
    """
    random = np.random.default_rng(seed)
    names = list(FAMILIES)
    shares = np.array([FAMILIES[name][0] for name in names])
    drawn = names[random.choice(len(names), p=shares / shares.sum())]
    family = family or drawn
    sketch = Sketch(random)
    FAMILIES[family][1](sketch)
    _vary_proportions(sketch)
    if family != "fish" and sketch.chance(0.03):  # some artists start at the chest
        _reroot(sketch, sketch.integer(0, min(2, len(sketch.joints) - 1)))

    vertices, faces, shells = _mesh(sketch, target_vertices)
    weights = skin_weights(vertices, faces, shells, sketch.shapes, sketch.parents, sketch.uniform(0.12, 0.35))
    joints = np.array(sketch.joints)
    if sketch.chance(0.12):  # nobody models perfectly symmetrically
        lean = np.array([0, sketch.uniform(-0.03, 0.03), sketch.uniform(-0.03, 0.03)])
        vertices = vertices + vertices[:, :1] * lean
        joints = joints + joints[:, :1] * lean
    vertices, joints = _normalised(vertices, joints)
    return Character(
        vertices.astype(np.float32), faces.astype(np.int32), joints.astype(np.float32),
        np.array(sketch.parents, np.int16), weights.astype(np.float32), family,
    )  # fmt: skip


def _vary_proportions(sketch: Sketch) -> None:
    """Scales the axes apart; mildly, since training adds more."""
    factors = sketch.random.uniform(0.85, 1.18, 3)
    sketch.joints = [joint * factors for joint in sketch.joints]
    sketch.shapes = [shape.scaled(factors) for shape in sketch.shapes]
    sketch.sheets = {shell: inner * factors for shell, inner in sketch.sheets.items()}


def _reroot(sketch: Sketch, root: int) -> None:
    """Makes joint `root` the root and renumbers so that parents precede children."""
    neighbours: list[list[int]] = [[] for _ in sketch.joints]
    for joint, parent in enumerate(sketch.parents):
        if parent >= 0:
            neighbours[joint].append(parent)
            neighbours[parent].append(joint)
    order, parent_of = [root], {root: -1}
    for joint in order:  # grows while it is walked: breadth first
        for neighbour in sorted(neighbours[joint]):
            if neighbour not in parent_of:
                parent_of[neighbour] = joint
                order.append(neighbour)
    number = {joint: index for index, joint in enumerate(order)}
    sketch.joints = [sketch.joints[joint] for joint in order]
    sketch.parents = [number.get(parent_of[joint], -1) for joint in order]
    sketch.shapes = [replace(shape, joint=number[shape.joint]) for shape in sketch.shapes]


def _mesh(sketch: Sketch, target_vertices: int | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces and the shell of each vertex, in the sketch's own frame."""
    boxes = [shape.bounds(0) for shape in sketch.shapes]
    size = (np.max([box[1] for box in boxes], axis=0) - np.min([box[0] for box in boxes], axis=0)).max()
    thin = np.percentile([shape.radius for shape in sketch.shapes], 10)
    spacing = max(min(size * sketch.uniform(0.009, 0.012), thin * 1.1), size * 0.006)

    low_polygon = sketch.chance(0.2)
    target = sketch.integer(300, 800) if low_polygon else sketch.integer(FEWEST_VERTICES, 3500)
    target = target_vertices or target
    # Denser at the joints: fewer vertices everywhere, then more where it bends.
    dense_at_joints = sketch.chance(0.25)
    first_target = round(target * sketch.uniform(0.55, 0.8)) if dense_at_joints else target
    aggression = sketch.uniform(4, 7)
    shells = mesh_shells(sketch.shapes, spacing)
    total = sum(len(vertices) for _, vertices, _ in shells)

    all_vertices, all_faces, all_shells, count = [], [], [], 0
    for shell, vertices, faces in shells:
        if shell in sketch.sheets and shell != BODY:
            faces = outward_half(vertices, faces, sketch.sheets[shell])
        vertices, faces = decimate(vertices, faces, round(first_target * len(vertices) / total), aggression)
        vertices, faces = without_unused(vertices, faces)
        all_vertices.append(vertices)
        all_faces.append(faces + count)
        all_shells.append(np.full(len(vertices), shell))
        count += len(vertices)
    vertices, faces, shell_of = np.concatenate(all_vertices), np.concatenate(all_faces), np.concatenate(all_shells)
    before = len(vertices)
    if dense_at_joints:
        vertices, faces = split_long_edges(vertices, faces, target, (np.array(sketch.joints), 0.09 * size))
    if target_vertices is None:
        vertices, faces = split_long_edges(vertices, faces, FEWEST_VERTICES)
    shell_of = _shells_after_split(faces, shell_of, before, len(vertices))
    if sketch.chance(0.08):
        holes = vertices[sketch.random.integers(0, len(vertices), sketch.integer(1, 3))]
        faces = with_holes(vertices, faces, holes, sketch.uniform(0.01, 0.03) * size)
        used = np.unique(faces)
        vertices, faces = without_unused(vertices, faces)
        shell_of = shell_of[used]
    return vertices, faces, shell_of


def _shells_after_split(faces: np.ndarray, shell_of: np.ndarray, before: int, after: int) -> np.ndarray:
    """New vertices belong to the shell of the faces they are in; shells share no face. Ends when nothing is unknown."""
    shells = np.full(after, -1)
    shells[:before] = shell_of
    for _ in range(64):
        if (shells >= 0).all():
            break
        known = shells[faces].max(1)
        for corner in range(3):
            target = faces[:, corner]
            unknown = shells[target] < 0
            shells[target[unknown]] = known[unknown]
    return shells


def _normalised(vertices: np.ndarray, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    low, high = vertices.min(0), vertices.max(0)
    origin = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
    scale = 1 / (high - low).max()
    return (vertices - origin) * scale, (joints - origin) * scale
