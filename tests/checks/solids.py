"""Plain solids as triangle meshes, outside counter-clockwise."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np


@dataclass
class Mesh:
    vertices: np.ndarray  # (V, 3)
    faces: np.ndarray  # (F, 3)


def ring_of(count: int) -> np.ndarray:
    """Directions around the vertical, `(count, 3)`."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([np.sin(angle), np.zeros(count), np.cos(angle)], 1)


def lathe(rings: list[np.ndarray], closed: bool) -> Mesh:
    """The surface over rings of points, its ends closed by fans or open."""
    around, count = len(rings[0]), len(rings)
    at = np.arange(count * around).reshape(count, around)
    beside = np.roll(at, -1, axis=1)
    a, b, c, d = at[:-1], beside[:-1], beside[1:], at[1:]
    faces = [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    vertices = list(rings)
    if closed:
        first, last = count * around, count * around + 1
        vertices += [rings[0].mean(0, keepdims=True), rings[-1].mean(0, keepdims=True)]
        faces.append(np.stack([beside[0], at[0], np.full(around, first)], -1))
        faces.append(np.stack([at[-1], beside[-1], np.full(around, last)], -1))
    return Mesh(np.concatenate(vertices), np.concatenate(faces))


def tube(start, end, start_radius: float, end_radius: float, around: int, along: int, *, closed: bool = True) -> Mesh:
    start, end = np.asarray(start, float), np.asarray(end, float)
    axis = (end - start) / np.linalg.norm(end - start)
    side = np.cross(axis, (0, 0, 1) if abs(axis[2]) < 0.9 else (1, 0, 0))
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    angle = 2 * np.pi * np.arange(around) / around
    circle = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * other
    share = np.linspace(0, 1, along + 1)
    return lathe([start + t * (end - start) + circle * (start_radius + t * (end_radius - start_radius)) for t in share], closed)


def sphere(centre, radius: float, around: int) -> Mesh:
    pitch = np.pi * (np.arange(around // 2) + 0.5) / (around // 2)
    circle = ring_of(around)
    return lathe([np.asarray(centre, float) + radius * (np.sin(p) * circle - (0, np.cos(p), 0)) for p in pitch], closed=True)


def block(centre, half_sizes) -> Mesh:
    """Twelve triangles."""
    signs = np.array([[(index >> bit & 1) * 2 - 1 for bit in range(3)] for index in range(8)])
    quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]]
    faces = [face for a, b, c, d in quads for face in ([a, b, c], [a, c, d])]
    return Mesh(np.asarray(centre, float) + signs * half_sizes, np.array(faces))


def joined(meshes: Iterable[Mesh]) -> Mesh:
    vertices, faces, first = [], [], 0
    for mesh in meshes:
        vertices.append(mesh.vertices)
        faces.append(mesh.faces + first)
        first += len(mesh.vertices)
    return Mesh(np.concatenate(vertices), np.concatenate(faces))
