"""Blender's heat weights [Baran and Popovic 2007] on the reference skeletons, for the skin table.

    blender --background --python models/blender_heat.py -- DATA/rigs/val.npz DATA/rigs/val2.npz -o weights.npz
    python models/blender_heat.py --figures weights.npz DATA/rigs/val.npz DATA/rigs/val2.npz

The first command needs Blender (or its `bpy` package) and NumPy alone; the second measures and writes blender_heat.json, which
evaluate_rigs.py puts into its tables. Every character becomes a mesh and an armature: one bone per joint and child, and
for an end joint one that goes on along the bone before it, a third as long. Then "parent with automatic weights". Vertices that
Blender leaves without weights (it gives up on some meshes, and then on all of their vertices) follow the closest bone; how
many those are is written down beside the figures.
"""

import json
import sys
from pathlib import Path

import numpy as np

RESULT = Path(__file__).parent / "blender_heat.json"
END_BONE = 1 / 3  # of the bone before an end joint
SHORTEST_BONE = 1e-3  # Blender deletes bones without a length


def bones_of(joints: np.ndarray, parents: np.ndarray) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """(joint that the bone's weights belong to, head, tail)."""
    bones = []
    for joint in range(len(joints)):
        children = np.flatnonzero(parents == joint)
        for child in children:
            bones.append((joint, joints[joint], joints[child]))
        if not len(children):
            along = joints[joint] - joints[parents[joint]] if parents[joint] >= 0 else np.array([0, 0.1, 0])
            bones.append((joint, joints[joint], joints[joint] + END_BONE * along))
    return bones


def heat_weights(bpy, vertices, faces, joints, parents) -> np.ndarray:
    """(V, J), rows of zeros where Blender found nothing."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    mesh = bpy.data.meshes.new("mesh")
    mesh.from_pydata(vertices.tolist(), [], faces.tolist())
    body = bpy.data.objects.new("mesh", mesh)
    armature = bpy.data.objects.new("armature", bpy.data.armatures.new("armature"))
    for thing in (body, armature):
        bpy.context.scene.collection.objects.link(thing)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    owner = {}
    for number, (joint, head, tail) in enumerate(bones_of(joints, parents)):
        if np.linalg.norm(tail - head) < SHORTEST_BONE:
            tail = head + np.array([0, SHORTEST_BONE, 0])
        bone = armature.data.edit_bones.new(f"bone_{number}")
        bone.head, bone.tail = head.tolist(), tail.tolist()
        owner[bone.name] = joint
    bpy.ops.object.mode_set(mode="OBJECT")
    body.select_set(True)
    armature.select_set(True)
    bpy.ops.object.parent_set(type="ARMATURE_AUTO")
    weights = np.zeros((len(vertices), len(joints)))
    names = {group.index: group.name for group in body.vertex_groups}
    for vertex in mesh.vertices:
        for entry in vertex.groups:
            weights[vertex.index, owner[names[entry.group]]] += entry.weight
    return weights


def run_in_blender(arguments: list[str]) -> None:
    import bpy

    output = Path(arguments[arguments.index("-o") + 1])
    found = {"version": np.array(bpy.app.version_string)}
    for shard in arguments[: arguments.index("-o")]:
        with np.load(shard) as archive:
            for k, meta in enumerate(json.loads(bytes(archive["meta_json"]))):
                vertices, faces, joints, parents = (
                    archive[f"{k:04d}/{name}"] for name in ("vertices", "faces", "joints", "parents"))
                found[meta["id"]] = heat_weights(bpy, vertices.astype(float), faces, joints.astype(float), parents).astype(np.float32)
                print(meta["id"], meta["name"], "without weights:", int((found[meta["id"]].sum(1) <= 0).sum()), "of", len(vertices), flush=True)
    np.savez(output, **found)


def write_figures(weights_path: Path, shards: list[Path]) -> None:
    from rigsmith_models.data.shards import RigShard
    from rigsmith_models.evaluation.baselines import closest_bone
    from rigsmith_models.evaluation.measure import skin_figures

    characters, version = {}, ""
    with np.load(weights_path) as archive:
        version = str(archive["version"])
        for shard in map(RigShard, shards):
            for k in range(len(shard)):
                rig = shard[k]
                vertices, joints, parents = rig.vertices.astype(float), rig.joints.astype(float), rig.parents.astype(int)
                weights = archive[rig.meta["id"]].astype(float)
                empty = weights.sum(1) <= 0
                weights[empty] = closest_bone(vertices[empty], joints, parents) if empty.any() else 0
                weights /= weights.sum(1, keepdims=True)
                figures = skin_figures(vertices, joints, parents, weights, rig.weights.astype(float))
                characters[rig.meta["id"]] = {n: round(v, 6) for n, v in figures.items()} | {"left_empty": float(empty.mean())}
    made = {"made_with": f"Blender {version}, automatic weights (bone heat), models/blender_heat.py", "characters": characters}
    RESULT.write_text(json.dumps(made, indent=1) + "\n")
    print(f"{len(characters)} characters, L1 {np.mean([c['l1'] for c in characters.values()]):.3f}")


def main() -> None:
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    if arguments[:1] == ["--figures"]:
        write_figures(Path(arguments[1]), [Path(path) for path in arguments[2:]])
    elif "-o" in arguments:
        run_in_blender(arguments)
    else:
        sys.exit(__doc__)


if __name__ == "__main__":
    main()
