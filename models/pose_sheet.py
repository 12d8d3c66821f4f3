"""Rigs of the built program in motion, on one picture: rest pose with skeleton, then two poses in which every limb is bent.

    python models/pose_sheet.py DATA/rigs/val.npz Rogue Horse Chick Fish Crab Stegosaurus -o sheet.png

For looking at: what an animator would complain about is seldom in a table.
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from rigsmith_models.data.shards import RigShard
from rigsmith_models.evaluation.pictures import CELL, View, draw_mesh, draw_skeleton, joint_colours
from rigsmith_models.evaluation.posing import posed, rotation
from rigsmith_models.evaluation.program import Program

LIMB_DEGREES, SPINE_DEGREES = 40.0, 12.0
MIDDLE = 0.02  # joints nearer to the mirror plane are of the spine, the head or the tail
BENT_DEPTH = 2  # so many joints of each limb are bent; what follows is fingers and toes


def limb_pose(joints: np.ndarray, parents: np.ndarray, stride: float) -> np.ndarray:
    """(J, 3, 3): limbs bent across their bones, left and right the other way round; the middle nods. ``stride`` is 1 or -1."""
    turns = np.repeat(np.eye(3)[None], len(joints), 0)
    depth = np.zeros(len(joints), int)
    for joint, parent in enumerate(parents):
        children = np.flatnonzero(parents == joint)
        if parent < 0 or not len(children):
            continue
        if abs(joints[joint, 0]) < MIDDLE:
            turns[joint] = rotation(np.array([1.0, 0, 0]), np.radians(SPINE_DEGREES * stride))
            continue
        depth[joint] = depth[parent] + 1
        bone = joints[children].mean(0) - joints[joint]
        is_level = abs(bone[0]) > np.abs(bone[1:]).max()
        axis = np.array([0.0, 0, 1] if is_level else [1.0, 0, 0])
        side = np.sign(joints[joint, 0])
        if depth[joint] <= BENT_DEPTH:
            turns[joint] = rotation(axis, np.radians(LIMB_DEGREES * stride * side * (1 if depth[joint] == 1 else 0.7)))
    return turns


def row(name: str, vertices: np.ndarray, faces: np.ndarray, program: Program) -> Image.Image:
    made = program.rig(vertices, faces)
    image = Image.new("RGB", (3 * CELL, CELL + 16), "white")
    draw, view = ImageDraw.Draw(image), View(vertices)
    colours = made.weights @ joint_colours(len(made.joints))
    for column, stride in enumerate((0.0, 1.0, -1.0)):
        shown = posed(vertices, made.joints, made.parents, made.weights, limb_pose(made.joints, made.parents, stride))
        draw_mesh(draw, view, column * CELL, 0, shown, faces, colours)
        if stride == 0:
            draw_skeleton(draw, view, 0, 0, made.joints, made.parents, "black")
    draw.text((4, CELL), f"{name}: {len(made.joints)} joints", fill="black")
    return image


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("shard", type=Path)
    parser.add_argument("names", nargs="+", help="of characters in the shard")
    parser.add_argument("--rigsmith", type=Path, default=Path(__file__).parent.parent / "target/release/rigsmith")
    parser.add_argument("--columns", type=int, default=2)
    parser.add_argument("-o", "--output", type=Path, required=True)
    arguments = parser.parse_args()
    shard, program = RigShard(arguments.shard), Program(arguments.rigsmith)
    index = {meta["name"]: k for k, meta in reversed(list(enumerate(shard.metas)))}
    unknown = [name for name in arguments.names if name not in index]
    if unknown:
        parser.error(f"{', '.join(unknown)}: not in {arguments.shard.name}, which has {', '.join(sorted(index))}")
    rows = [row(name, shard[index[name]].vertices.astype(float), shard[index[name]].faces, program) for name in arguments.names]
    width, height = rows[0].size
    lines = -(-len(rows) // arguments.columns)
    sheet = Image.new("RGB", (arguments.columns * width, lines * height), "white")
    for k, image in enumerate(rows):
        sheet.paste(image, (k % arguments.columns * width, k // arguments.columns * height))
    sheet.save(arguments.output)


if __name__ == "__main__":
    main()
