"""Skin weights of a generated character: a soft minimum over the distances to each joint's shapes."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse

from .shapes import Shape

FAR = 1e3
LARGEST_HOPS = 2  # a vertex follows joints at most this far in the tree from its nearest one
INFLUENCES = 4
LEAST_WEIGHT = 0.02
SMOOTHING_PASSES = 2


def skin_weights(vertices, faces, shells, shapes: list[Shape], parents: list[int], softness: float) -> np.ndarray:
    """(V, J), rows sum to 1. `shells`: (V,) the shell of each vertex; it follows only that shell's shapes.

    The distance to a shape counts in units of `softness` times its radius; weights fall off exponentially with it.
    """
    distance = np.full((len(vertices), len(parents)), FAR)
    for shape in shapes:
        scaled = shape.distance(vertices) / (softness * max(shape.radius, 1e-3))
        scaled = np.where(shells == shape.shell, scaled, FAR)
        distance[:, shape.joint] = np.minimum(distance[:, shape.joint], scaled)
    nearest = distance.argmin(1)
    allowed = _hops(parents)[nearest] <= LARGEST_HOPS
    weights = np.exp(-(distance - distance.min(1, keepdims=True))) * allowed

    neighbours = _neighbour_mean(len(vertices), faces)
    for _ in range(SMOOTHING_PASSES):
        weights = 0.5 * weights + 0.5 * (neighbours @ weights)
    weights[weights < LEAST_WEIGHT] = 0
    if weights.shape[1] > INFLUENCES:
        dropped = np.argsort(-weights, axis=1, kind="stable")[:, INFLUENCES:]
        np.put_along_axis(weights, dropped, 0, axis=1)
    return weights / weights.sum(1, keepdims=True)


def _hops(parents: list[int]) -> np.ndarray:
    """(J, J) number of bones between two joints."""
    count = len(parents)
    hops = np.full((count, count), count)
    np.fill_diagonal(hops, 0)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            hops[joint, parent] = hops[parent, joint] = 1
    for middle in range(count):
        hops = np.minimum(hops, hops[:, middle : middle + 1] + hops[middle : middle + 1])
    return hops


def _neighbour_mean(vertex_count: int, faces: np.ndarray) -> sparse.csr_matrix:
    """(V, V): the mean over each vertex's neighbours; a vertex without any keeps its own value."""
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    pairs = np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0)
    alone = np.setdiff1d(np.arange(vertex_count), pairs[:, 0])
    pairs = np.concatenate([pairs, np.stack([alone, alone], axis=1)])
    counts = np.bincount(pairs[:, 0], minlength=vertex_count)
    values = 1 / counts[pairs[:, 0]]
    return sparse.csr_matrix((values, (pairs[:, 0], pairs[:, 1])), shape=(vertex_count, vertex_count))
