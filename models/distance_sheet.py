"""HollowDist beside other distances, on one picture: how far each vertex is from one joint's bones, for its links alone.

    python models/distance_sheet.py DATA/rigs/val.npz Rogue 9 --rigsmith target/release/rigsmith -o docs/distances.png

Vertices that have no link to the joint are grey. One scale for all three: blue is near, yellow is far.
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from rigsmith_models.data.prepare import service_features, shard_rigs
from rigsmith_models.evaluation.pictures import CELL, View, draw_mesh, draw_skeleton

DISTANCES = ("HollowDist", "way through voxels", "straight line")  # the first channels of a link, src/rig/heter_graph.rs
NEAR, FAR, NOT_LINKED = np.array([30.0, 60, 200]), np.array([250.0, 220, 60]), np.array([215.0, 215, 215])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("shard", type=Path)
    parser.add_argument("name", help="of a character in the shard")
    parser.add_argument("joint", type=int, nargs="+", help="one row for each")
    parser.add_argument("--rigsmith", type=Path, default=Path(__file__).parent.parent / "target/release/rigsmith")
    parser.add_argument("-o", "--output", type=Path, required=True)
    arguments = parser.parse_args()
    known = shard_rigs(arguments.shard, None)
    rig = next((rig for rig in known if rig.meta["name"] == arguments.name), None)
    if rig is None:
        parser.error(f"{arguments.name}: not in {arguments.shard.name}, which has {', '.join(r.meta['name'] for r in known)}")
    made = service_features([rig], arguments.rigsmith.resolve())[0]
    image = Image.new("RGB", (len(DISTANCES) * CELL, len(arguments.joint) * CELL + 16), "white")
    draw, view = ImageDraw.Draw(image), View(rig.vertices)
    for row, joint in enumerate(arguments.joint):
        is_link = (made["links"] == joint) & (made["link_mask"] > 0.5)
        distance = np.where(is_link[..., None], made["link_features"][..., : len(DISTANCES)], np.inf).min(1)
        linked = np.isfinite(distance[:, 0])
        farthest = distance[linked].max()
        for column in range(len(DISTANCES)):
            share = np.where(linked, distance[:, column] / farthest, 0)[:, None]
            colours = np.where(linked[:, None], NEAR + share * (FAR - NEAR), NOT_LINKED)
            left, top = column * CELL, row * CELL
            draw_mesh(draw, view, left, top, rig.vertices.astype(float), rig.faces, colours)
            draw_skeleton(draw, view, left, top, rig.joints, rig.parents, "black")
    for column, name in enumerate(DISTANCES):
        draw.text((column * CELL + 4, len(arguments.joint) * CELL), name, fill="black")
    image.save(arguments.output)


if __name__ == "__main__":
    main()
