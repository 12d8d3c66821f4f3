"""Every produced file loaded and posed in Blender: each vertex must land where our own linear blend skinning puts it,
within 1e-4 of the character's height.

    python blender.py FOLDER      (a Python 3.11 with bpy 5.0.1; `make check-blender` makes one)
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Quaternion

TOLERANCE = 1e-4  # of the height
# glTF's y up to Blender's z up: (x, y, z) -> (x, -z, y).
TO_GLTF = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], float)
TO_BLENDER = Matrix(((1, 0, 0), (0, 0, -1), (0, 1, 0)))


def load(path: Path) -> tuple[bpy.types.Object, list[bpy.types.Object]]:
    """The armature and the skinned meshes of a file."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(path), merge_vertices=False)
    armatures = [item for item in bpy.data.objects if item.type == "ARMATURE"]
    skinned = [
        item for item in bpy.data.objects
        if item.type == "MESH" and any(modifier.type == "ARMATURE" for modifier in item.modifiers)
    ]  # fmt: skip
    if len(armatures) != 1:
        raise ValueError(f"{len(armatures)} armatures in Blender")
    return armatures[0], skinned


def turn(armature: bpy.types.Object, joints: list[dict]) -> None:
    """Turns each bone about its head by a rotation given in the axes of the world at rest, on top of its parent's.

    Blender's bones have axes of their own, within those of the armature: with B the bone's rest axes and A the armature's, the
    turn R becomes (A B)^-1 C R C^-1 A B, C from glTF's axes to Blender's.
    """
    own = armature.matrix_world.to_quaternion().to_matrix()
    for joint in joints:
        bone = armature.pose.bones.get(joint["name"])
        if bone is None:
            raise ValueError(f"the joint {joint['name']} is not a bone in Blender")
        x, y, z, w = joint["in_world"]
        in_blender = TO_BLENDER @ Quaternion((w, x, y, z)).to_matrix() @ TO_BLENDER.transposed()
        rest = own @ bone.bone.matrix_local.to_3x3()
        bone.rotation_mode = "QUATERNION"
        bone.rotation_quaternion = (rest.inverted() @ in_blender @ rest).to_quaternion()
    bpy.context.view_layer.update()


def vertices(item: bpy.types.Object, posed: bool) -> np.ndarray:
    """World positions in glTF's axes, (V, 3)."""
    source = item.evaluated_get(bpy.context.evaluated_depsgraph_get()) if posed else item
    flat = np.empty(len(source.data.vertices) * 3, np.float32)
    source.data.vertices.foreach_get("co", flat)
    world = np.array(source.matrix_world)
    return (flat.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3]) @ TO_GLTF.T


def check(path: Path, expected: dict) -> tuple[str | None, float]:
    """What is wrong, if anything, and the largest distance as a share of the height."""
    armature, skinned = load(path)
    rest = np.concatenate([vertices(item, posed=False) for item in skinned])
    turn(armature, expected["joints"])
    posed = np.concatenate([vertices(item, posed=True) for item in skinned])
    if len(posed) != len(rest):
        return f"{len(posed)} posed vertices, {len(rest)} at rest", 0.0

    # Blender drops vertices that no face uses and joins the primitives of a mesh, so vertices are found by their rest
    # position; several at one place (seams) must all be among what is expected there.
    expected_rest = np.concatenate([np.array(entry["rest"]).reshape(-1, 3) for entry in expected["primitives"]])
    expected_posed = np.concatenate([np.array(entry["positions"]).reshape(-1, 3) for entry in expected["primitives"]])
    height = expected["height"]
    places: dict[tuple, list[int]] = {}
    for index, place in enumerate(np.round(expected_rest / (height * 1e-5)).astype(int)):
        places.setdefault(tuple(place), []).append(index)
    largest, unknown = 0.0, 0
    steps = [(x, y, z) for x in (0, -1, 1) for y in (0, -1, 1) for z in (0, -1, 1)]
    for place, point in zip(np.round(rest / (height * 1e-5)).astype(int), posed):
        near = [index for step in steps for index in places.get(tuple(place + step), ())]
        if not near:
            unknown += 1
            continue
        largest = max(largest, np.linalg.norm(expected_posed[near] - point, axis=1).min() / height)
    if unknown:
        return f"{unknown} of {len(rest)} vertices are somewhere else at rest", largest
    if not largest <= TOLERANCE:
        return f"a vertex is {largest:.2e} of the height away", largest
    return None, largest


def main() -> int:
    folder = Path(sys.argv[1])
    cases = json.loads((folder / "cases.json").read_text())
    failed, worst = 0, 0.0
    for case in cases:
        try:
            problem, distance = check(folder / case["output"], json.loads((folder / case["pose"]).read_text()))
        except (ValueError, RuntimeError) as error:
            problem, distance = str(error), 0.0
        worst = max(worst, distance)
        if problem:
            failed += 1
            print(f"FAILED Blender: {case['name']}: {problem}", flush=True)
    print(f"Blender: largest distance {worst:.2e} of the height over {len(cases)} files")
    print(f"Blender {bpy.app.version_string}: {len(cases) - failed} passed, {failed} failed")
    return 1 if failed or not cases else 0


if __name__ == "__main__":
    sys.exit(main())
