"""How far apart two skins move a mesh: RigNet [Xu et al. 2020], Section 6, "average distance over poses".

Ten fixed random poses per skeleton: 30 % of the joints (at least one) turned about a random axis by N(0, 25 degrees).
"""

import numpy as np

POSES = 10
TURNED_SHARE = 0.3
TURN_DEGREES = 25.0


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues' formula: the rotation about a unit axis -> (3, 3)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def random_pose(joint_count: int, seed: int) -> np.ndarray:
    """-> (J, 3, 3) joint-local rotations."""
    rng = np.random.default_rng([17, seed])
    rotations = np.repeat(np.eye(3)[None], joint_count, 0)
    for joint in rng.permutation(joint_count)[: max(round(TURNED_SHARE * joint_count), 1)]:
        axis = rng.normal(size=3)
        rotations[joint] = rotation(axis / np.linalg.norm(axis), np.radians(rng.normal(0, TURN_DEGREES)))
    return rotations


def posed(vertices, joints, parents, weights, rotations) -> np.ndarray:
    """Linear blend skinning; parents come before their children. weights: (V, J) -> (V, 3)"""
    turned, placed = np.zeros((len(joints), 3, 3)), np.zeros((len(joints), 3))
    for joint, parent in enumerate(parents):
        if parent < 0:
            turned[joint], placed[joint] = rotations[joint], joints[joint]
        else:
            turned[joint] = turned[parent] @ rotations[joint]
            placed[joint] = placed[parent] + turned[parent] @ (joints[joint] - joints[parent])
    moved = np.einsum("jab,vjb->vja", turned, vertices[:, None] - joints) + placed
    return np.einsum("vj,vja->va", weights, moved)


def posed_distances(vertices, joints, parents, weights, reference) -> tuple[float, float]:
    """Mean and greatest distance of a vertex between the two skins, each averaged over the poses."""
    means, greatest = [], []
    for seed in range(POSES):
        pose = random_pose(len(joints), seed)
        apart = np.linalg.norm(
            posed(vertices, joints, parents, weights - reference, pose), axis=1)  # the blend is linear in the weights
        means.append(apart.mean())
        greatest.append(apart.max())
    return float(np.mean(means)), float(np.mean(greatest))
