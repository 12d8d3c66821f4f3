"""Draws meshes before and after a pose, one row per case, parts in colours of their own and bones as lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

CELL, SCALE, COLOURS = 230, 2, 48
YAW, PITCH = np.radians(35), np.radians(12)
TINTS = [(196, 170, 148), (214, 190, 168), (120, 140, 170), (120, 140, 170), (190, 96, 88), (96, 150, 110), (206, 166, 72), (150, 110, 170)]
LIGHT = np.array([0.35, 0.75, 0.55])


def view() -> np.ndarray:
    """Turns the world to the viewer: x right, y up, z near."""
    c, s = np.cos(YAW), np.sin(YAW)
    d, t = np.cos(PITCH), np.sin(PITCH)
    return np.array([[1, 0, 0], [0, d, -t], [0, t, d]]) @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])


def draw_mesh(cell: int, vertices: np.ndarray, faces: np.ndarray, tint_of: np.ndarray, frame: tuple, bones: list) -> Image.Image:
    picture = Image.new("RGB", (cell, cell), "white")
    pen = ImageDraw.Draw(picture)
    turned, (middle, size) = vertices @ view().T, frame
    places = (turned - middle)[:, :2] * (1, -1) * (0.86 * cell / size) + cell / 2
    corners = turned[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    # Open shells are seen from both sides.
    shade = 0.45 + 0.55 * np.abs(normals @ (LIGHT / np.linalg.norm(LIGHT)))
    for face in np.argsort(corners[:, :, 2].mean(1)):
        colour = tuple(int(value * shade[face]) for value in TINTS[tint_of[face] % len(TINTS)])
        pen.polygon([tuple(places[corner]) for corner in faces[face]], fill=colour, outline=colour)
    for start, end in bones:
        ends = (np.array([start, end]) @ view().T - middle)[:, :2] * (1, -1) * (0.86 * cell / size) + cell / 2
        pen.line([tuple(ends[0]), tuple(ends[1])], fill=(40, 60, 120), width=SCALE)
        pen.ellipse([*(ends[0] - 2 * SCALE), *(ends[0] + 2 * SCALE)], fill=(40, 60, 120))
    return picture


def draw_sheet(path: Path, cases: list[tuple]) -> None:
    """`cases`: name, mesh, ranges of the parts' vertices, joints, vertices after the pose."""
    cell = CELL * SCALE
    sheet = Image.new("RGB", (cell * len(cases), 2 * cell), "white")
    for column, (name, mesh, ranges, joints, after) in enumerate(cases):
        tint = np.zeros(len(mesh.vertices), int)
        for index, part in enumerate(ranges.values()):
            tint[part] = index
        both = np.concatenate([mesh.vertices, after]) @ view().T
        low, high = both.min(0), both.max(0)
        frame = ((low + high) / 2, (high - low)[:2].max())
        bones = [(joints[parent][1], place) for parent, place in joints.values() if parent is not None]
        for row, (vertices, shown) in enumerate(((mesh.vertices, bones), (after, []))):
            picture = draw_mesh(cell, vertices, mesh.faces, tint[mesh.faces[:, 0]], frame, shown)
            sheet.paste(picture, (column * cell, row * cell))
        ImageDraw.Draw(sheet).text((column * cell + 10, 8), name, fill=(60, 64, 72), font_size=14 * SCALE)
    small = sheet.resize((sheet.width // SCALE, sheet.height // SCALE), Image.Resampling.LANCZOS)
    small.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
