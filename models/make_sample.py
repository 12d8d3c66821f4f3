"""Writes tests/fixtures/sample-character.glb: a small adventurer of our own making, as a user would upload it.

    python models/make_sample.py [OUT.glb]

Three mesh nodes (body, hair, gear) with normals, texture coordinates and one painted texture; no skeleton and no skin.
It is built from the shapes of ``rigsmith_models.data.synthetic`` and is the same on every run. Needs
``models/requirements.txt``.
"""

from __future__ import annotations

import argparse
import io
import json
import struct
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from rigsmith_models.data.synthetic.shapes import Block, Limb, Shape, frame_along, unit
from rigsmith_models.data.synthetic.surface import decimate, mesh_shells, without_unused

OUT = Path(__file__).resolve().parent.parent / "tests/fixtures/sample-character.glb"
HEIGHT_METRES = 1.3
SPACING = 0.0065  # of the grid that the surface is taken from
TEXTURE_SIZE = 1024
PADDING = 3  # texels around each chart
BODY, HAIR, GEAR = 0, 1, 2
NODES = {BODY: ("Body", 2600), HAIR: ("Hair", 500), GEAR: ("Gear", 900)}  # shell: (node name, vertices)

# sRGB
COLOURS = {
    "skin": (232, 183, 148), "hair": (92, 54, 38), "shirt": (214, 120, 62), "vest": (54, 92, 110),
    "trousers": (92, 84, 72), "boots": (86, 52, 36), "sole": (46, 36, 34), "belt": (66, 42, 30),
    "metal": (200, 170, 92), "pack": (124, 92, 56), "roll": (140, 60, 58), "scarf": (168, 48, 52), "eye": (250, 250, 246),
}  # fmt: skip


def shapes() -> list[Shape]:
    """The adventurer in an A pose: y up, facing +z, one unit high."""
    parts: list[Shape] = []

    def limb(material, start, end, start_radius, end_radius, *, shell=BODY, blend=0.008, **rest):
        parts.append(Limb(0, np.array(start, float), np.array(end, float), start_radius, end_radius, blend=blend, shell=shell, material=material, **rest))

    def block(material, centre, half_sizes, *, rotation=None, shell=BODY, blend=0.008, **rest):
        rotation = np.eye(3) if rotation is None else rotation
        parts.append(Block(0, np.array(centre, float), np.array(half_sizes, float), rotation, blend=blend, shell=shell, material=material, **rest))

    forward = np.array([0, 0, 1.0])
    # Head
    block("skin", [0, 0.845, 0.005], [0.118, 0.128, 0.118], roundness=2.2, blend=0.012)
    block("skin", [0, 0.775, 0.035], [0.082, 0.058, 0.075], roundness=2.2, blend=0.02)  # jaw
    limb("skin", [0, 0.825, 0.118], [0, 0.812, 0.132], 0.008, 0.013, blend=0.010)  # nose
    limb("skin", [0, 0.66, -0.008], [0, 0.76, 0.0], 0.038, 0.036, blend=0.012)  # neck
    # Trunk: a vest over a shirt
    limb("vest", [0, 0.485, 0], [0, 0.585, 0.002], 0.088, 0.098, squash=(forward, 0.72), roundness=2.4, blend=0.012)
    block("vest", [0, 0.60, 0.012], [0.104, 0.058, 0.068], roundness=2.4, blend=0.02)
    block("trousers", [0, 0.425, -0.002], [0.090, 0.060, 0.072], roundness=2.3, blend=0.014)
    for side in (1, -1):
        _arm(limb, block, side)
        _leg(limb, block, side)
        block("skin", [side * 0.116, 0.83, -0.005], [0.018, 0.032, 0.022], blend=0.008)  # ear
        block("eye", [side * 0.046, 0.842, 0.107], [0.023, 0.030, 0.018], blend=0.003, shell=GEAR)
    # Hair: a cap, a fringe of locks, and locks at the nape
    block("hair", [0, 0.875, -0.014], [0.130, 0.118, 0.126], roundness=2.2, shell=HAIR, blend=0.012)
    locks = [(-0.085, 0.91, 0.085, -0.1), (-0.03, 0.93, 0.112, -0.5), (0.03, 0.93, 0.112, 0.3), (0.085, 0.91, 0.085, 0.5)]
    for x, y, z, lean in locks:
        limb("hair", [x * 0.8, y + 0.02, z * 0.7], [x + lean * 0.05, y - 0.035, z + 0.022], 0.034, 0.010, shell=HAIR, blend=0.010)
    for x in (-0.09, -0.03, 0.03, 0.09):
        limb("hair", [x, 0.83, -0.105], [x * 1.15, 0.755, -0.112 - 0.2 * abs(0.05 - abs(x))], 0.034, 0.014, shell=HAIR, blend=0.010)
    limb("hair", [0.01, 0.98, -0.02], [0.035, 1.02, 0.0], 0.03, 0.008, shell=HAIR, blend=0.010)  # a tuft that will not lie down
    # Gear: belt, scarf, pack with a rolled blanket
    block("belt", [0, 0.468, 0.0], [0.101, 0.016, 0.080], roundness=2.5, shell=GEAR, blend=0.004)
    block("metal", [0, 0.468, 0.079], [0.022, 0.020, 0.009], roundness=5, shell=GEAR, blend=0.003)
    block("pack", [0, 0.575, -0.108], [0.078, 0.085, 0.040], roundness=3.4, shell=GEAR, blend=0.005)
    block("pack", [0, 0.545, -0.148], [0.050, 0.040, 0.016], roundness=3.6, shell=GEAR, blend=0.004)
    limb("roll", [-0.085, 0.682, -0.105], [0.085, 0.682, -0.105], 0.030, 0.030, shell=GEAR, blend=0.004)
    for side in (1, -1):
        limb("belt", [side * 0.052, 0.682, -0.105], [side * 0.058, 0.682, -0.104], 0.033, 0.033, shell=GEAR, blend=0.003)
    for index in range(12):  # the scarf, a ring of beads that melt together
        angles = 2 * np.pi * (np.array([index, index + 1]) / 12)
        ring = [[0.062 * np.sin(angle), 0.684 - 0.012 * np.cos(angle), -0.004 + 0.058 * np.cos(angle)] for angle in angles]
        limb("scarf", ring[0], ring[1], 0.021, 0.021, shell=GEAR, blend=0.007)
    limb("scarf", [0.030, 0.672, 0.058], [0.052, 0.575, 0.090], 0.017, 0.024, squash=(unit([0.1, 0.3, 1]), 0.4), shell=GEAR, blend=0.005)
    return parts


def _arm(limb, block, side: int) -> None:
    def mirrored(x, y, z):
        return np.array([side * x, y, z])

    shoulder, elbow, wrist = mirrored(0.100, 0.628, -0.004), mirrored(0.212, 0.566, -0.010), mirrored(0.318, 0.508, 0.004)
    along = unit(wrist - elbow)
    limb("shirt", mirrored(0.05, 0.635, 0), shoulder, 0.050, 0.047, blend=0.014)
    limb("shirt", shoulder, elbow, 0.046, 0.039, bulge=0.05, blend=0.010)
    limb("shirt", elbow, elbow + along * 0.030, 0.042, 0.043, blend=0.004)  # rolled-up sleeve
    limb("skin", elbow, wrist, 0.031, 0.023, bulge=0.08, blend=0.006)
    up = unit(np.cross(np.cross(along, [0, 1.0, 0]), along))
    across = unit(np.cross(along, up)) * side  # towards the thumb
    axes = np.stack([across, up, along], axis=1)
    palm = wrist + along * 0.034
    block("skin", palm, [0.030, 0.017, 0.036], rotation=axes, roundness=2.5, blend=0.006)
    for finger in range(4):
        spread = finger / 3 - 0.5
        start = wrist + along * 0.062 + across * spread * 0.044
        towards = unit(along + across * spread * 0.25 - up * 0.12)
        limb("skin", start, start + towards * (0.042 - 0.012 * abs(spread - 0.15)), 0.0102, 0.0088, blend=0.003)
    thumb = wrist + along * 0.022 + across * 0.026
    limb("skin", thumb, thumb + unit(along * 0.75 + across * 0.7) * 0.040, 0.0125, 0.0100, blend=0.005)


def _leg(limb, block, side: int) -> None:
    def mirrored(x, y, z):
        return np.array([side * x, y, z])

    hip, knee, ankle = mirrored(0.050, 0.41, 0.0), mirrored(0.062, 0.235, 0.006), mirrored(0.068, 0.065, -0.012)
    limb("trousers", hip, knee, 0.058, 0.046, bulge=0.04, blend=0.012)
    limb("trousers", knee, knee + (ankle - knee) * 0.45, 0.045, 0.046, blend=0.008)
    limb("boots", knee + (ankle - knee) * 0.42, knee + (ankle - knee) * 0.55, 0.050, 0.047, blend=0.003)  # cuff
    limb("boots", knee + (ankle - knee) * 0.5, ankle, 0.043, 0.038, blend=0.006)
    limb("boots", ankle - [0, 0.018, 0.004], mirrored(0.074, 0.036, 0.070), 0.040, 0.036, squash=(np.array([0, 1.0, 0]), 0.9), blend=0.010)
    block("sole", mirrored(0.072, 0.009, 0.026), [0.044, 0.012, 0.090], roundness=3.0, blend=0.003)


# ---------------------------------------------------------------- texture coordinates


def charts(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cuts the surface into charts that look along one axis. Returns the chart (F,) and the axis 0 to 5 (F,) of faces."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    scores = np.concatenate([normals, -normals], axis=1)
    neighbours = _face_neighbours(faces)
    for _ in range(6):  # a face agrees with its neighbours where it nearly does: fewer, larger charts
        scores = 0.6 * scores + 0.4 * (neighbours @ scores)
    axis = scores.argmax(1)
    same = neighbours.tocoo()
    kept = axis[same.row] == axis[same.col]
    graph = coo_matrix((np.ones(kept.sum()), (same.row[kept], same.col[kept])), shape=same.shape)
    return connected_components(graph, directed=False)[1], axis


def _face_neighbours(faces: np.ndarray):
    """(F, F): the mean over the faces across each face's edges."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    _, edge = np.unique(edges, axis=0, return_inverse=True)
    incidence = coo_matrix((np.ones(len(owner)), (owner, edge.ravel())), shape=(len(faces), edge.max() + 1)).tocsr()
    shared = (incidence @ incidence.T).tolil()
    shared.setdiag(0)
    shared = shared.tocsr()
    counts = np.maximum(np.asarray(shared.sum(1)).ravel(), 1)
    return coo_matrix((1 / counts, (np.arange(len(faces)),) * 2)).tocsr() @ shared


def unwrap(vertices, faces) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Splits vertices at chart borders and lays each chart flat, in units of length.

    Returns the source vertex of each split vertex, the new faces, and per chart the flat coordinates with their vertices.
    """
    chart, axis = charts(vertices, faces)
    sources, new_faces, flat, count = [], np.empty_like(faces), [], 0
    for index in range(chart.max() + 1):
        members = np.flatnonzero(chart == index)
        used, local = np.unique(faces[members], return_inverse=True)
        new_faces[members] = local.reshape(-1, 3) + count
        direction = axis[members[0]]
        plane = {0: (2, 1), 1: (0, 2), 2: (0, 1)}[direction % 3]
        flat.append(vertices[used][:, plane])
        sources.append(used)
        count += len(used)
    return np.concatenate(sources), new_faces, flat


def pack(flat: list[np.ndarray]) -> np.ndarray:
    """Places the charts' boxes on shelves of the texture, as large as fits. Returns texture coordinates in texels."""
    sizes = [chart.max(0) - chart.min(0) for chart in flat]
    order = sorted(range(len(flat)), key=lambda index: -sizes[index][1])
    low, high = 10.0, 1e4
    placed = None
    for _ in range(40):  # bisection of the scale
        scale = (low * high) ** 0.5
        attempt = _shelves(sizes, order, scale)
        if attempt is None:
            high = scale
        else:
            low, placed = scale, attempt
    return np.concatenate(
        [(chart - chart.min(0)) * low + corner for chart, corner in zip(flat, placed)]
    )


def _shelves(sizes, order, scale):
    corners = [None] * len(sizes)
    x = y = shelf = 0.0
    for index in order:
        width, height = sizes[index] * scale + 2 * PADDING
        if x + width > TEXTURE_SIZE:
            x, y, shelf = 0.0, y + shelf, 0.0
        if width > TEXTURE_SIZE or y + height > TEXTURE_SIZE:
            return None
        corners[index] = np.array([x + PADDING, y + PADDING])
        x, shelf = x + width, max(shelf, height)
    return corners


# ---------------------------------------------------------------- texture


def places_of_texels(positions, normals, faces, texels) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which texels a triangle covers, and the point (N, 3) and normal (N, 3) of the surface in the middle of each."""
    index, points, directions = [], [], []
    for face in faces:
        corners = texels[face]
        first = np.maximum(np.floor(corners.min(0) - 1).astype(int), 0)
        last = np.minimum(np.ceil(corners.max(0) + 1).astype(int), TEXTURE_SIZE - 1)
        grid = np.stack(np.meshgrid(np.arange(first[0], last[0] + 1), np.arange(first[1], last[1] + 1)), -1).reshape(-1, 2)
        edges = np.stack([corners[1] - corners[0], corners[2] - corners[0]], axis=1)
        if abs(np.linalg.det(edges)) < 1e-9:
            continue
        weights = np.linalg.solve(edges, (grid + 0.5 - corners[0]).T).T
        weights = np.concatenate([1 - weights.sum(1, keepdims=True), weights], axis=1)
        inside = weights.min(1) > -0.02
        index.append(grid[inside])
        points.append(weights[inside] @ positions[face])
        directions.append(weights[inside] @ normals[face])
    return np.concatenate(index), np.concatenate(points), np.concatenate(directions)


def paint(points: np.ndarray, normals: np.ndarray, parts: list[Shape]) -> np.ndarray:
    """The colour (N, 3) at points of the surface of one shell: its nearest shape's, with a face and soft shading."""
    distances = np.stack([shape.distance(points) for shape in parts])
    nearest = distances.argmin(0)
    materials = np.array([shape.material for shape in parts])[nearest]
    colours = np.array([COLOURS[material] for material in materials], float)
    x, y, z = points.T

    skin = materials == "skin"
    face = skin & (z > 0.06)
    cheeks = np.exp(-(((np.abs(x) - 0.066) / 0.024) ** 2 + ((y - 0.805) / 0.017) ** 2))
    colours[face] += (cheeks[:, None] * [18, -22, -20])[face]
    mouth = face & (np.abs(y - (0.777 + 2.4 * x**2)) < 0.0035) & (np.abs(x) < 0.034)
    colours[mouth] = (150, 74, 66)
    brows = face & (np.abs(y - (0.893 - 3.0 * (np.abs(x) - 0.046) ** 2)) < 0.006) & (np.abs(np.abs(x) - 0.048) < 0.027)
    colours[brows] = COLOURS["hair"]

    eye = materials == "eye"
    iris = np.hypot((np.abs(x) - 0.045) / 0.0135, (y - 0.841) / 0.0185)
    colours[eye & (iris < 1)] = (74, 112, 70)
    colours[eye & (iris < 0.55)] = (24, 22, 22)
    glint = np.hypot(x - np.sign(x) * 0.044 - 0.005, y - 0.848)
    colours[eye & (glint < 0.0042)] = (255, 255, 255)

    vest = materials == "vest"
    opening = vest & (z > 0) & (np.abs(x) < 0.018 + 0.14 * np.maximum(y - 0.50, 0))
    colours[opening] = (238, 226, 196)
    hem = vest & (z > 0) & ~opening & (np.abs(x) < 0.026 + 0.14 * np.maximum(y - 0.50, 0))
    colours[hem] = (36, 62, 76)
    stripes = (materials == "roll") & (np.sin(x * 150) > 0.55)
    colours[stripes] = (222, 196, 140)
    strands = materials == "hair"
    colours[strands] *= (1 + 0.10 * np.sin(38 * np.arctan2(x, z - 0.02) + 9 * y))[strands, None]

    light = 0.92 + 0.10 * normals[:, 1]  # a little sky
    crease = np.clip(np.sort(distances, axis=0)[min(1, len(parts) - 1)] / 0.012, 0, 1)
    light *= 0.90 + 0.10 * crease
    return np.clip(colours * light[:, None], 0, 255)


def dilate(image: np.ndarray, filled: np.ndarray) -> None:
    """Spreads colours into the empty texels around charts, so that filtering does not pick up the background."""
    for _ in range(PADDING + 1):
        for shift, axis in ((1, 0), (-1, 0), (1, 1), (-1, 1)):
            source = np.roll(filled, shift, axis)
            new = source & ~filled
            image[new] = np.roll(image, shift, axis)[new]
            filled |= new


# ---------------------------------------------------------------- file


def smooth_normals(vertices, faces) -> np.ndarray:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], np.cross(b - a, c - a))
    return normals / (np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12)


def write_glb(path: Path, meshes, texture: bytes) -> None:
    """`meshes`: (name, positions, normals, texture coordinates, faces) in metres."""
    binary, views, accessors, nodes, gltf_meshes = bytearray(), [], [], [], []

    def view(data: bytes, **rest) -> int:
        binary.extend(b"\0" * (-len(binary) % 4))
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data), **rest})
        binary.extend(data)
        return len(views) - 1

    def accessor(array, kind, component, target, **rest) -> int:
        accessors.append({"bufferView": view(array.tobytes(), target=target), "componentType": component, "count": len(array.reshape(-1, {"VEC3": 3, "VEC2": 2, "SCALAR": 1}[kind])), "type": kind, **rest})
        return len(accessors) - 1

    for name, positions, normals, coordinates, faces in meshes:
        positions = positions.astype(np.float32)
        attributes = {
            "POSITION": accessor(positions, "VEC3", 5126, 34962, min=positions.min(0).tolist(), max=positions.max(0).tolist()),
            "NORMAL": accessor(normals.astype(np.float32), "VEC3", 5126, 34962),
            "TEXCOORD_0": accessor(coordinates.astype(np.float32), "VEC2", 5126, 34962),
        }
        indices = accessor(faces.astype(np.uint16), "SCALAR", 5123, 34963)
        nodes.append({"name": name, "mesh": len(gltf_meshes)})
        gltf_meshes.append({"name": name, "primitives": [{"attributes": attributes, "indices": indices, "material": 0}]})
    image = view(texture)
    binary.extend(b"\0" * (-len(binary) % 4))
    document = {
        "asset": {"version": "2.0", "generator": "rigsmith models/make_sample.py", "copyright": "Rigsmith authors, MIT OR Apache-2.0"},
        "scene": 0, "scenes": [{"name": "Scene", "nodes": list(range(len(nodes)))}], "nodes": nodes, "meshes": gltf_meshes,
        "materials": [{"name": "Painted", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0, "roughnessFactor": 0.85}}],
        "textures": [{"source": 0, "sampler": 0}], "samplers": [{"magFilter": 9729, "minFilter": 9987}],
        "images": [{"name": "painted", "mimeType": "image/png", "bufferView": image}],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(binary)}],
    }  # fmt: skip
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(binary)
    header = struct.pack("<4sII", b"glTF", 2, length)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + bytes(binary)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(header + chunks)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, nargs="?", default=OUT)
    out = parser.parse_args().out

    parts = shapes()
    surfaces = []
    for shell, vertices, faces in mesh_shells(parts, SPACING):
        vertices, faces = without_unused(*decimate(vertices, faces, NODES[shell][1], 5.0))
        sources, split_faces, flat = unwrap(vertices, faces)
        surfaces.append((shell, vertices[sources], smooth_normals(vertices, faces)[sources], split_faces, flat))

    texels = pack([chart for surface in surfaces for chart in surface[4]])
    image = np.zeros((TEXTURE_SIZE, TEXTURE_SIZE, 3))
    filled = np.zeros((TEXTURE_SIZE, TEXTURE_SIZE), bool)
    meshes, first = [], 0
    floor = min(positions[:, 1].min() for _, positions, *_ in surfaces)
    for shell, positions, normals, faces, _ in surfaces:
        own = texels[first : first + len(positions)]
        first += len(positions)
        index, points, directions = places_of_texels(positions, normals, faces, own)
        image[index[:, 1], index[:, 0]] = paint(points, directions, [shape for shape in parts if shape.shell == shell])
        filled[index[:, 1], index[:, 0]] = True
        metres = (positions - [0, floor, 0]) * HEIGHT_METRES
        meshes.append((NODES[shell][0], metres, normals, own / TEXTURE_SIZE, faces))
    dilate(image, filled)
    png = io.BytesIO()
    Image.fromarray(image.round().astype(np.uint8)).quantize(128, dither=Image.Dither.NONE).save(png, "PNG", optimize=True)
    write_glb(out, meshes, png.getvalue())
    print(f"{out}: {out.stat().st_size} bytes, {sum(len(mesh[1]) for mesh in meshes)} vertices, {sum(len(mesh[4]) for mesh in meshes)} faces")


if __name__ == "__main__":
    main()
