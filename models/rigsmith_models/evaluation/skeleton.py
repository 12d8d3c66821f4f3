"""Joints, bone costs and root -> tree. RigNet [Xu et al. 2020], Section 4.2: minimum spanning tree."""

import numpy as np


def minimum_spanning_tree(cost: np.ndarray, root: int) -> np.ndarray:
    """Prim's algorithm. cost: (J, J) symmetric -> parents (J,), -1 for the root."""
    count = len(cost)
    parents = np.full(count, -1)
    best, source = cost[root].copy(), np.full(count, root)
    inside = np.arange(count) == root
    for _ in range(count - 1):
        joint = int(np.where(inside, np.inf, best).argmin())
        parents[joint], inside[joint] = source[joint], True
        closer = cost[joint] < best
        best, source = np.where(closer, cost[joint], best), np.where(closer, joint, source)
    return parents


def cost_matrix(joint_count: int, pairs: np.ndarray, logit: np.ndarray, outside: np.ndarray | None = None) -> np.ndarray:
    """cost = -ln(sigmoid(logit)), clamped above zero, plus 2 for each sample outside the body if more than one is.

    pairs: (P, 2), logit: (P,), outside: (P,) counts -> (J, J). The service halves the cost between two middle joints of a
    symmetric character too; that needs its symmetry plane and is left out here.
    """
    weight = np.maximum(np.logaddexp(0, -logit.astype(np.float64)), 1e-12)
    if outside is not None:
        weight = weight + OUTSIDE_COST * np.where(outside > OUTSIDE_FREE, outside, 0)
    cost = np.full((joint_count, joint_count), np.inf)
    cost[pairs[:, 0], pairs[:, 1]] = weight
    return np.minimum(cost, cost.T)


OUTSIDE_COST, OUTSIDE_FREE, SAMPLE_STEP = 2.0, 1, 0.01  # as in the service


def outside_samples(length: np.ndarray, inside_share: np.ndarray) -> np.ndarray:
    """How many of a segment's samples (one every 0.01) lie outside the body. (P,), (P,) -> (P,)"""
    count = np.rint(length / SAMPLE_STEP)
    return count - np.rint(inside_share * count)
