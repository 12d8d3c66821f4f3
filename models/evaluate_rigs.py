"""Whole rigs of the built program against artists' rigs: the figure that a user would feel.

    python models/evaluate_rigs.py --rigsmith target/release/rigsmith --rigs DATA/rigs/val.npz DATA/rigs/val2.npz \
        --cache CACHE/val.npz CACHE/val2.npz [-- OPTIONS OF rigsmith rig]

Every validation character is written as an OBJ at its own resolution, rigged by `rigsmith rig`, and its skeleton compared:
CD-J2J, IoU, precision, recall, CD-J2B, CD-B2B and tree edit distance as `rigsmith_models/evaluation/metrics.py` defines them.
The caches (`rigsmith_models.data.prepare`, same order) hold the reference tolerances. Validation only: never the hidden test part.
"""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from rigsmith_models.data.character import read_cache
from rigsmith_models.data.shards import RigShard
from rigsmith_models.evaluation import metrics

COLUMNS = ("cd_j2j", "iou", "precision", "recall", "joints", "joints_reference", "cd_j2b", "cd_b2b", "tree_edit")


def rigged(program: Path, vertices: np.ndarray, faces: np.ndarray, options: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Joints (J, 3) and parents (J,) that the program gives the mesh; the axes are named, as they are known here."""
    with tempfile.TemporaryDirectory() as folder:
        mesh, rig = Path(folder) / "mesh.obj", Path(folder) / "mesh.rig.json"
        lines = ["v %.7f %.7f %.7f" % tuple(v) for v in vertices] + ["f %d %d %d" % tuple(f + 1) for f in faces]
        mesh.write_text("\n".join(lines) + "\n")
        command = [str(program), "rig", str(mesh), "-o", str(rig), "--up", "y", "--front", "z", *options]
        subprocess.run(command, check=True, capture_output=True)
        joints = json.loads(rig.read_text())["joints"]
    parents = [-1 if joint["parent"] is None else joint["parent"] for joint in joints]
    return np.array([joint["position"] for joint in joints]), np.array(parents)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigsmith", type=Path, required=True)
    parser.add_argument("--rigs", type=Path, nargs="+", required=True)
    parser.add_argument("--cache", type=Path, nargs="+", required=True)
    parser.add_argument("options", nargs="*", help="after --: handed to `rigsmith rig`")
    arguments = parser.parse_args()
    rows: dict[str, list] = {"organic": [], "box": []}
    for rigs, cache in zip(arguments.rigs, arguments.cache, strict=True):
        shard = RigShard(rigs)
        for k, character in enumerate(read_cache(cache)):
            rig = shard[k]
            joints, parents = rigged(arguments.rigsmith, rig.vertices, rig.faces, arguments.options)
            reference, reference_parents = rig.joints.astype(float), rig.parents.astype(int)
            rows["box" if character.meta.get("style") == "box" else "organic"].append((
                metrics.joint_to_joint(joints, reference),
                *metrics.matched_joints(joints, reference, character.tolerance),
                len(joints), len(reference),
                metrics.joint_to_bone(joints, parents, reference, reference_parents),
                metrics.bone_to_bone(joints, parents, reference, reference_parents),
                metrics.tree_edit_distance(joints, parents, reference, reference_parents),
            ))  # fmt: skip
    for style, values in rows.items():
        means = np.mean(values, axis=0)
        print(f"{style}: {len(values)} characters; " + ", ".join(f"{n} {m:.4f}" for n, m in zip(COLUMNS, means)))


if __name__ == "__main__":
    main()
