"""Metrics of a rig against a reference rig, as RigNet [Xu et al. 2020], Section 6, defines them.

All inputs in the normalised frame (longest side 1). NumPy and SciPy only.
"""

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

BONE_SAMPLE_STEP = 0.01
INFLUENCE_MIN = 1e-4


def joint_to_joint(predicted: np.ndarray, reference: np.ndarray) -> float:
    """CD-J2J = 1/2 (mean over p of min over r of |p - r| + mean over r of min over p of |r - p|). (P, 3), (R, 3)."""
    distance = cdist(predicted, reference)
    return float(0.5 * (distance.min(1).mean() + distance.min(0).mean()))


def distance_to_bones(points: np.ndarray, joints: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """(N, 3) -> (N,), distance to the nearest segment from a joint to its parent."""
    child = np.flatnonzero(parents >= 0)
    if not len(child):
        return cdist(points, joints).min(1)
    start, along = joints[parents[child]], joints[child] - joints[parents[child]]
    squared = np.maximum((along**2).sum(1), 1e-12)
    t = np.clip(((points[:, None] - start) * along).sum(2) / squared, 0, 1)
    return np.linalg.norm(points[:, None] - start - t[..., None] * along, axis=2).min(1)


def bone_samples(joints: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """Joints, and the midpoints of equal pieces of at most 0.01 of every bone -> (S, 3)."""
    samples = [joints]
    for child, parent in enumerate(parents):
        if parent >= 0:
            along = joints[child] - joints[parent]
            pieces = max(int(np.ceil(np.linalg.norm(along) / BONE_SAMPLE_STEP)), 1)
            samples.append(joints[parent] + along * ((np.arange(pieces) + 0.5) / pieces)[:, None])
    return np.concatenate(samples)


def joint_to_bone(joints_a, parents_a, joints_b, parents_b) -> float:
    """CD-J2B: joints of one to the bones of the other, both ways, averaged."""
    return float(0.5 * (distance_to_bones(joints_a, joints_b, parents_b).mean()
                        + distance_to_bones(joints_b, joints_a, parents_a).mean()))


def bone_to_bone(joints_a, parents_a, joints_b, parents_b) -> float:
    """CD-B2B: points along the bones of one to the bones of the other, both ways, averaged."""
    return float(0.5 * (distance_to_bones(bone_samples(joints_a, parents_a), joints_b, parents_b).mean()
                        + distance_to_bones(bone_samples(joints_b, parents_b), joints_a, parents_a).mean()))


def matched_joints(predicted, reference, tolerance, multiplier: float = 1.0) -> tuple[float, float, float]:
    """Hungarian pairs within the reference joint's tolerance -> (IoU, precision, recall).

    IoU = 2 x matched / (predicted + reference). tolerance: (R,), see ``data.targets.tolerance``.
    """
    matched = int(found_joints(predicted, reference, tolerance, multiplier).sum())
    return 2 * matched / (len(predicted) + len(reference)), matched / len(predicted), matched / len(reference)


def found_joints(predicted, reference, tolerance, multiplier: float = 1.0) -> np.ndarray:
    """(R,) bool: which reference joints have a Hungarian partner within their tolerance."""
    distance = cdist(predicted, reference)
    row, column = linear_sum_assignment(distance)
    found = np.zeros(len(reference), bool)
    found[column] = distance[row, column] <= tolerance[column] * multiplier
    return found


def tree_edit_distance(joints_a, parents_a, joints_b, parents_b) -> float:
    """Zhang-Shasha distance of rooted trees, unit costs, unlabelled joints, children ordered by (x, y, z)."""
    left_a, roots_a = _postorder(joints_a, parents_a)
    left_b, roots_b = _postorder(joints_b, parents_b)
    tree = np.zeros((len(left_a), len(left_b)))
    for a in roots_a:
        for b in roots_b:
            _forest_distance(tree, left_a, left_b, a, b)
    return float(tree[-1, -1])


def _forest_distance(tree, left_a, left_b, a, b) -> None:
    """Fills ``tree`` for the pairs of subtrees on the leftmost paths of the key roots a and b."""
    rows, columns = a - left_a[a] + 2, b - left_b[b] + 2
    forest = np.zeros((rows, columns))
    forest[:, 0], forest[0] = np.arange(rows), np.arange(columns)
    for i in range(1, rows):
        for k in range(1, columns):
            x, y = left_a[a] + i - 1, left_b[b] + k - 1
            remove, insert = forest[i - 1, k] + 1, forest[i, k - 1] + 1
            if left_a[x] == left_a[a] and left_b[y] == left_b[b]:
                forest[i, k] = tree[x, y] = min(remove, insert, forest[i - 1, k - 1])
            else:
                forest[i, k] = min(remove, insert, forest[left_a[x] - left_a[a], left_b[y] - left_b[b]] + tree[x, y])


def _postorder(joints, parents) -> tuple[list[int], list[int]]:
    """-> leftmost leaf (postorder number) of every joint in postorder, and the key roots."""
    children: dict[int, list[int]] = {}
    for child, parent in enumerate(parents):
        children.setdefault(int(parent), []).append(child)
    for siblings in children.values():
        siblings.sort(key=lambda joint: tuple(np.round(joints[joint], 3)))
    leftmost: list[int] = []
    first_leaf: dict[int, int] = {}
    pending = [(children[-1][0], False)]
    while pending:
        joint, seen = pending.pop()
        own = children.get(joint, [])
        if own and not seen:
            pending.append((joint, True))
            pending += [(child, False) for child in reversed(own)]
            continue
        first_leaf[joint] = first_leaf[own[0]] if own else len(leftmost)
        leftmost.append(first_leaf[joint])
    last_of = {leaf: number for number, leaf in enumerate(leftmost)}
    return leftmost, sorted(last_of.values())


def skin_agreement(predicted: np.ndarray, reference: np.ndarray) -> tuple[float, float, float]:
    """(V, J) weights on one skeleton -> (precision, recall) of influences above 1e-4, mean over vertices of the L1 norm."""
    ours, theirs = predicted > INFLUENCE_MIN, reference > INFLUENCE_MIN
    both = (ours & theirs).sum()
    l1 = np.abs(predicted - reference).sum(1).mean()
    return float(both / max(ours.sum(), 1)), float(both / max(theirs.sum(), 1)), float(l1)


def mirror_error(joints: np.ndarray, normal: np.ndarray, point: np.ndarray) -> float:
    """Mean distance from each joint's image in the plane (unit normal, one point of it) to the nearest joint. (J, 3)"""
    images = joints - 2 * ((joints - point) @ normal)[:, None] * normal
    return float(cdist(images, joints).min(1).mean())


def bootstrap_interval(values: np.ndarray, seed: int = 0, draws: int = 2000) -> tuple[float, float]:
    """95% interval of the mean over characters, by resampling them. (N,) -> (low, high).

    Of paired differences it is the interval of the mean difference.
    """
    return resampled_interval(values, np.mean, seed, draws)


def bootstrap_interval_of_median(values: np.ndarray, seed: int = 0, draws: int = 2000) -> tuple[float, float]:
    return resampled_interval(values, np.median, seed, draws)


def resampled_interval(values: np.ndarray, statistic, seed: int, draws: int) -> tuple[float, float]:
    rng = np.random.default_rng(seed)
    drawn = statistic(values[rng.integers(0, len(values), (draws, len(values)))], axis=1)
    return float(np.percentile(drawn, 2.5)), float(np.percentile(drawn, 97.5))
