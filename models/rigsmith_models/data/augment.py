"""Changes of a character that keep its annotation valid. Every function takes its random generator: nothing is global."""

from dataclasses import replace

import numpy as np

from .character import Character

POSE_PROBABILITY = 0.5
POSED_JOINT_SHARE = 0.3
POSE_DEGREES = 20.0
GROWTH = 0.12  # deviation of the logarithm of how much larger or smaller a body part is made
JOINTS_DROPPED = 0.2
MIRROR = np.array([-1.0, 1.0, 1.0], np.float32)


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues' formula. axis: (3,) of length 1, angle in radians -> (3, 3)."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def mirror_partner(joints: np.ndarray) -> np.ndarray:
    """(J, 3) -> (J,), the joint nearest to each joint's mirror image; a middle joint is its own partner."""
    return np.linalg.norm(joints[:, None] * MIRROR - joints[None], axis=2).argmin(1)


def random_pose(character: Character, rng: np.random.Generator, growth: float = 0.0) -> Character:
    """Linear blend skinning by random rotations; the mirror partner of a joint gets the mirrored rotation.

    With ``growth`` every part also gets its own size, and its joints' distances with it; mirror partners get the same.
    """
    joints, parents = character.joints.astype(float), character.parents
    turns = [np.eye(3) for _ in joints]
    sizes = np.ones(len(joints))
    turned = set()
    for j, partner in enumerate(mirror_partner(joints)):
        if parents[j] < 0 or j in turned or rng.random() > POSED_JOINT_SHARE:
            continue
        axis, angle = rng.normal(size=3), np.deg2rad(POSE_DEGREES) * rng.normal()
        if partner == j:
            axis = np.array([1.0, 0.0, 0.0])  # a middle joint only nods: the pose stays symmetric
        axis /= np.linalg.norm(axis)
        turns[j], turns[partner] = rotation(axis, angle), rotation(axis * MIRROR, -angle)
        if partner == j:
            turns[j] = rotation(axis, angle)
        turned.update((j, int(partner)))

    if growth:
        sizes = np.exp(growth * rng.normal(size=len(joints)).clip(-2, 2))
        sizes = np.sqrt(sizes * sizes[mirror_partner(joints)])

    posed = joints.copy()
    frames = [np.eye(3) for _ in joints]
    for j in parents_first(parents):
        p = parents[j]
        if p >= 0:
            frames[j] = frames[p] @ turns[j]
            posed[j] = posed[p] + sizes[p] * frames[p] @ (joints[j] - joints[p])
    frame = np.stack(frames) * sizes[:, None, None]
    shift = posed - np.einsum("jab,jb->ja", frame, joints)
    weights = character.skin_weights.astype(np.float32)
    blended = (weights @ frame.reshape(-1, 9)).reshape(-1, 3, 3)
    positions = np.einsum("vab,vb->va", blended, character.positions) + weights @ shift
    offsets = np.einsum("vab,vb->va", blended, character.medial_offsets)
    return replace(character, positions=positions.astype(np.float32), medial_offsets=offsets.astype(np.float32),
                   joints=posed.astype(np.float32))


def fewer_joints(joints, parents, weights, rng: np.random.Generator):
    """Drops up to a fifth of the joints (never the root); children and weights go to the parent.

    joints: (J, 3), parents: (J,) with parents[i] < i, weights: (V, J) -> the same of fewer joints.
    """
    parents, weights = parents.astype(int).copy(), weights.copy()
    kept = np.ones(len(joints), bool)
    for victim in rng.permutation(np.arange(1, len(joints)))[: int(rng.uniform(0, JOINTS_DROPPED) * len(joints))]:
        weights[:, parents[victim]] += weights[:, victim]
        parents[parents == victim] = parents[victim]
        kept[victim] = False
    renumber = np.cumsum(kept) - 1
    own = parents[kept]
    return joints[kept], np.where(own < 0, -1, renumber[own]).astype(np.int16), weights[:, kept]


def parents_first(parents: np.ndarray) -> list[int]:
    """Joint indices ordered so that every parent comes before its children."""
    children: dict[int, list[int]] = {}
    for child, parent in enumerate(parents):
        children.setdefault(int(parent), []).append(child)
    order, pending = [], list(children.get(-1, []))
    while pending:
        joint = pending.pop()
        order.append(joint)
        pending += children.get(joint, [])
    return order


def random_scale(character: Character, rng: np.random.Generator) -> tuple[Character, np.ndarray]:
    """Mirror (half the time) and stretch per axis; returns the factors too. The frame is renormalised."""
    limits = (0.67, 1.5) if rng.random() < 0.5 else (0.85, 1.18)
    factors = np.exp(rng.uniform(*np.log(limits), 3)).astype(np.float32)
    if rng.random() < 0.5:
        factors *= MIRROR
    positions, joints = character.positions * factors, character.joints * factors
    low, high = positions.min(0), positions.max(0)
    # x is not re-centred: x = 0 stays the mirror plane.
    origin = np.array([0.0, low[1], 0.5 * (low[2] + high[2])], np.float32)
    scale = 1.0 / (high - low).max()
    return replace(
        character, positions=(positions - origin) * scale, joints=(joints - origin) * scale,
        medial_offsets=character.medial_offsets * factors * scale), factors * scale


def random_mirror(character: Character, rng: np.random.Generator) -> tuple[Character, np.ndarray]:
    """Mirror half the time; returns the factors too. Distances stay what they are."""
    factors = MIRROR if rng.random() < 0.5 else np.ones(3, np.float32)
    return replace(
        character, positions=character.positions * factors, joints=character.joints * factors,
        medial_offsets=character.medial_offsets * factors), factors


def thin(character: Character, vertex_count: int, one_ring_max: int, ball_max: int, rng: np.random.Generator):
    """Keeps ``vertex_count`` random vertices and the neighbours among them, a random ``ball_max`` of the ball.

    -> kept (N,), one_ring (N, 1 + one_ring_max), geodesic_ball (N, 1 + ball_max); rows start with the own index.
    With fewer vertices than asked for, some are repeated: harmless, as every pooling is a maximum or a mean.
    """
    available = len(character.positions)
    if available >= vertex_count:
        kept = np.sort(rng.choice(available, vertex_count, replace=False))
    else:
        kept = np.concatenate([np.arange(available), rng.choice(available, vertex_count - available)])
    index = np.full(available, -1, np.int64)
    index[kept[::-1]] = np.arange(vertex_count)[::-1]
    tables = []
    for table, width in ((character.one_ring, one_ring_max), (character.geodesic_ball, ball_max)):
        neighbours = index[table[kept]]
        absent = (neighbours < 0) | (neighbours == np.arange(vertex_count)[:, None])
        order = (rng.random(neighbours.shape, dtype=np.float32) + absent).argsort(1)[:, :width]
        own = np.broadcast_to(np.arange(vertex_count)[:, None], order.shape)
        rows = np.where(np.take_along_axis(absent, order, 1), own, np.take_along_axis(neighbours, order, 1))
        # A cache with fewer columns than asked for: the own index fills the rest, as everywhere.
        spare = np.repeat(own[:, :1], width - rows.shape[1], axis=1)
        tables.append(np.concatenate([own[:, :1], rows, spare], axis=1))
    return kept, tables[0], tables[1]
