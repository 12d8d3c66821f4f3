"""Shapes to a triangle mesh: one implicit surface per shell, then decimation or subdivision to a vertex count.

The surface of a shell is where ``sum_i exp(-d_i / s_i) = 1`` over its shapes i with distance d_i and blend length s_i:
a smooth union whose fillets have about the width s_i.
"""

from __future__ import annotations

import fast_simplification
import numpy as np
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from .shapes import Shape

# A shape adds less than this many e-folds below the surface's level beyond its box, so its box can end there.
REACH = 5.0
LARGEST_REDUCTION = 0.97  # of one decimation; more degenerates thin parts
FEWEST_VERTICES = 16  # of one shell


def mesh_shells(shapes: list[Shape], spacing: float) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """(shell, vertices (V, 3), faces (F, 3)) for each shell that has a surface; grid cells of size `spacing`."""
    meshes = []
    for shell in sorted({shape.shell for shape in shapes}):
        field, origin = _field([shape for shape in shapes if shape.shell == shell], spacing)
        if field.max() <= 0:  # all its shapes are thinner than the grid
            continue
        vertices, faces, _, _ = marching_cubes(field, 0.0, gradient_direction="ascent")
        meshes.append((shell, vertices * spacing + origin, faces.astype(np.int64)))
    return meshes


def _field(shapes: list[Shape], spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """log sum exp(-d / s) on a grid around the shapes, and the grid's origin. Symmetric shapes get a symmetric grid."""
    boxes = [shape.bounds(shape.blend * REACH + 2 * spacing) for shape in shapes]
    low = np.floor(np.min([box[0] for box in boxes], axis=0) / spacing - 1) * spacing
    high = np.max([box[1] for box in boxes], axis=0) + spacing
    counts = np.ceil((high - low) / spacing).astype(int) + 1
    total = np.zeros(counts, np.float32)
    for shape, (box_low, box_high) in zip(shapes, boxes):
        first = np.maximum(((box_low - low) / spacing).astype(int), 0)
        last = np.minimum(((box_high - low) / spacing).astype(int) + 2, counts)
        axes = [(low[k] + spacing * np.arange(first[k], last[k])).astype(np.float32) for k in range(3)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        inside = tuple(slice(first[k], last[k]) for k in range(3))
        total[inside] += np.exp(np.clip(-shape.distance(points) / shape.blend, -30, 12)).astype(np.float32)
    return np.log(total + 1e-6), low


def outward_half(vertices: np.ndarray, faces: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """The faces that look away from the vertical axis through `inner`: a closed cloth becomes a single-sided sheet."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    away = (a + b + c) / 3 - inner
    away[:, 1] = 0
    return faces[(normals * away).sum(1) > 0]


def decimate(vertices: np.ndarray, faces: np.ndarray, target: int, aggression: float) -> tuple[np.ndarray, np.ndarray]:
    target = max(target, FEWEST_VERTICES)
    if len(vertices) <= target:
        return vertices, faces
    reduction = min(1 - target / len(vertices), LARGEST_REDUCTION)
    fewer_vertices, fewer_faces = fast_simplification.simplify(
        vertices.astype(np.float32), faces.astype(np.int32), target_reduction=float(reduction), agg=aggression
    )
    return fewer_vertices.astype(float), fewer_faces.astype(np.int64)


def with_holes(vertices: np.ndarray, faces: np.ndarray, centres: np.ndarray, radius: float) -> np.ndarray:
    """The faces without those around some points: an open boundary, as at a neck that a collar hides."""
    middles = vertices[faces].mean(1)
    return faces[cKDTree(centres).query(middles)[0] > radius]


def without_unused(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    used, inverse = np.unique(faces, return_inverse=True)
    return vertices[used], inverse.reshape(faces.shape)


def split_long_edges(
    vertices: np.ndarray, faces: np.ndarray, fewest: int, near: tuple[np.ndarray, float] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Halves the longest edges, keeping neighbours conformal, until there are `fewest` vertices.

    Each round halves the edges longer than three quarters of the median over the faces of their longest edge. With
    `near`, points (N, 3) and a radius, only edges that close to a point: artists put their vertices where it bends.
    Ends after at most 12 rounds, or when no edge is left to halve.
    """
    for _ in range(12):
        if len(vertices) >= fewest:
            break
        sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1)  # (F, 3, 2): edge k goes from corner k to k + 1
        keys = np.sort(sides, axis=-1).reshape(-1, 2)
        edges, edge_of = np.unique(keys, axis=0, return_inverse=True)
        edge_of = edge_of.reshape(len(faces), 3)
        length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        long = length > 0.75 * np.median(length[edge_of].max(1))
        if near is not None:
            points, radius = near
            long &= cKDTree(points).query(vertices[edges].mean(1))[0] < radius
        candidates = np.flatnonzero(long)
        if len(candidates) == 0:
            break
        halved = candidates[np.argsort(-length[candidates], kind="stable")[: fewest - len(vertices)]]
        middle = np.full(len(edges), -1)
        middle[halved] = len(vertices) + np.arange(len(halved))
        vertices = np.concatenate([vertices, vertices[edges[halved]].mean(1)])
        faces = _split_faces(faces, middle[edge_of])
    return vertices, faces


def _split_faces(faces: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Each face with 0 to 3 halved edges as 1 to 4 faces. `middle`: (F, 3), the new vertex of each edge or -1."""
    pieces = []
    halved = middle >= 0
    count = halved.sum(1)
    pieces.append(faces[count == 0])
    for marked in (1, 2, 3):
        chosen = count == marked
        corners, middles, flags = faces[chosen], middle[chosen], halved[chosen]
        # Turn each face so that the same pattern of edges is halved: the first edge, and the second if there are two.
        if marked == 1:
            turn = flags.argmax(1)
        elif marked == 2:
            turn = (np.argmin(flags, axis=1) + 1) % 3
        else:
            turn = np.zeros(len(corners), int)
        order = (np.arange(3) + turn[:, None]) % 3
        (a, b, c), (ab, bc, ca) = (np.take_along_axis(table, order, 1).T for table in (corners, middles))
        triangles = {
            1: [(a, ab, c), (ab, b, c)],
            2: [(a, ab, c), (ab, b, bc), (ab, bc, c)],
            3: [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)],
        }[marked]
        pieces.extend(np.stack(triangle, axis=1) for triangle in triangles)
    return np.concatenate(pieces)
