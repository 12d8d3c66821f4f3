"""A sheet of characters for the eye: reference and predicted skeleton over the mesh, reference and predicted skin as colours."""

import colorsys

import numpy as np
from PIL import Image, ImageDraw

CELL = 240
MARGIN = 14
FACE_PIXELS = 12.0
LIGHT = np.array([0.35, 0.5, 0.8])
TURN_DEGREES = 35  # about the vertical, so that depth shows


class View:
    """Points to pixels of a cell, such that a mesh fills it."""

    def __init__(self, vertices: np.ndarray):
        seen = turned(vertices)
        self.middle = (seen.min(0) + seen.max(0))[:2] / 2
        self.scale = (CELL - 2 * MARGIN) / np.ptp(seen[:, :2], axis=0).max()

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) -> (N, 3): x and y in pixels, and depth (larger is nearer)."""
        seen = turned(points)
        seen[:, :2] = CELL / 2 + (seen[:, :2] - self.middle) * [self.scale, -self.scale]
        return seen


def turned(points: np.ndarray) -> np.ndarray:
    angle = np.radians(TURN_DEGREES)
    x, y, z = points.T
    return np.stack([x * np.cos(angle) - z * np.sin(angle), y, x * np.sin(angle) + z * np.cos(angle)], axis=1)


def joint_colours(count: int) -> np.ndarray:
    """(J, 3) 0 to 255, neighbours in the list far apart on the wheel."""
    return np.array([np.multiply(colorsys.hsv_to_rgb(k * 0.381966 % 1, 0.75, 0.95), 255) for k in range(count)])


def draw_mesh(draw: ImageDraw.ImageDraw, view: View, left: float, top: float, vertices, faces, colours) -> None:
    """Painter's algorithm, far faces first; colours (V, 3) shaded by the facing."""
    vertices, faces, colours = finer(vertices, faces, colours, FACE_PIXELS / view.scale)
    seen = view(vertices)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    shade = 0.55 + 0.45 * np.abs(normal @ (LIGHT / np.linalg.norm(LIGHT)))
    fill = (colours[faces].mean(1) * shade[:, None]).astype(int)
    for face in np.argsort(seen[faces, 2].mean(1)):
        corners = [(left + x, top + y) for x, y in seen[faces[face], :2]]
        draw.polygon(corners, fill=tuple(fill[face]))


def finer(vertices, faces, colours, length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same surface with no edge longer than ``length``: far and near can be told of small faces only."""
    while True:
        corners = vertices[faces]
        is_long = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(1) > length
        if not is_long.any():
            return vertices, faces, colours
        a, b, c = faces[is_long].T
        middles = [0.5 * (values[x] + values[y]) for values in (vertices, colours) for x, y in ((a, b), (b, c), (c, a))]
        count, first = len(a), len(vertices)
        ab, bc, ca = (first + k * count + np.arange(count) for k in range(3))
        vertices, colours = np.concatenate([vertices, *middles[:3]]), np.concatenate([colours, *middles[3:]])
        quarters = [np.stack(corner, axis=1) for corner in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        faces = np.concatenate([faces[~is_long], *quarters])


def draw_skeleton(draw: ImageDraw.ImageDraw, view: View, left: float, top: float, joints, parents, colour: str) -> None:
    seen = view(joints)[:, :2] + [left, top]
    for joint, parent in enumerate(parents):
        if parent >= 0:
            draw.line([tuple(seen[parent]), tuple(seen[joint])], fill=colour, width=2)
    for joint, (x, y) in enumerate(seen):
        radius = 4 if parents[joint] < 0 else 2
        draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill="white", outline=colour)


def row(vertices, faces, reference: tuple, predicted: tuple, weights: np.ndarray, caption: str) -> Image.Image:
    """``reference``: joints, parents, weights; ``predicted``: joints, parents; ``weights`` on the reference skeleton."""
    image = Image.new("RGB", (4 * CELL, CELL + 16), "white")
    draw, view = ImageDraw.Draw(image), View(vertices)
    grey = np.full((len(vertices), 3), 205.0)
    colours = joint_colours(reference[2].shape[1])
    paint = [grey, grey, reference[2] @ colours, weights @ colours]
    for k, colour in enumerate(paint):
        draw_mesh(draw, view, k * CELL, 16, vertices, faces, colour)
    draw_skeleton(draw, view, 0, 16, *reference[:2], "#1a6e2e")
    draw_skeleton(draw, view, CELL, 16, *predicted, "#b3261e")
    draw.text((4, 2), caption, fill="black")
    return image


def sheet(rows: list[Image.Image]) -> Image.Image:
    """Rows below one another."""
    image = Image.new("RGB", (rows[0].width, sum(row.height for row in rows)), "white")
    top = 0
    for row_image in rows:
        image.paste(row_image, (0, top))
        top += row_image.height
    return image
