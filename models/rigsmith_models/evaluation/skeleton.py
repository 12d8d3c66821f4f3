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


def cost_matrix(joint_count: int, pairs: np.ndarray, logit: np.ndarray) -> np.ndarray:
    """cost = -ln(sigmoid(logit)), clamped above zero. pairs: (P, 2), logit: (P,) -> (J, J)."""
    cost = np.full((joint_count, joint_count), np.inf)
    cost[pairs[:, 0], pairs[:, 1]] = np.maximum(np.logaddexp(0, -logit.astype(np.float64)), 1e-12)
    return np.minimum(cost, cost.T)
