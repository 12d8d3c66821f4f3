"""All figures of one character: the program's rig and skin, and every baseline on the same mesh.

A measured character is plain data (``Measured``), so that tables, intervals and paired differences can be made from a file.
A mesh that the program refuses counts as the poorest rig: one joint in the middle of the vertices, which moves them all.
"""

from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from ..data.prepare import character_of, service_features, without_flat_faces
from ..data.shards import Rig
from . import baselines, metrics, stages
from .clustering import Clustering
from .fingers import finger_joints, without_joints
from .posing import posed_distances
from .program import Program, Refused, Rigged

MULTIPLIERS = {"": 1.0, "_half": 0.5, "_wide": 1.5}  # of the tolerance, by suffix of the figure's name
SKIN_METHODS = ("auto", "heter_skin_net", "rignet", "geodesic_heat", "geodesic_voxel")  # the default first


@dataclass
class Measured:
    """Figures by stage, system and name: ``figures["skin"]["rignet"]["l1"]``."""

    meta: dict
    figures: dict[str, dict[str, dict[str, float]]] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)

    def as_json(self) -> dict:
        return asdict(self)


@dataclass
class Setting:
    """What is measured with."""

    program: Program
    networks: dict[str, stages.Network]  # the shipped files, for tree and root on reference joints
    clustering: Clustering  # of the medial baseline
    nearest: baselines.NearestRig | None


def measured(rig: Rig, setting: Setting) -> tuple[Measured, Rigged, np.ndarray]:
    """-> the figures, and for pictures the rig that was made and its weights on the reference skeleton."""
    vertices, joints, parents = rig.vertices.astype(float), rig.joints.astype(float), rig.parents.astype(int)
    faces = without_flat_faces(rig.faces, rig.vertices)
    result = Measured({key: rig.meta.get(key, "") for key in ("id", "name", "source", "family", "category", "style")}
                      | {"vertices": len(vertices), "joints": len(joints)})
    # The tolerances come with it; the neighbour tables and bone features are the program's own.
    character = character_of(
        Rig(rig.vertices, faces, rig.joints, rig.parents, rig.weights, rig.meta),
        service_features([Rig(rig.vertices, faces, rig.joints, rig.parents, rig.weights, rig.meta)], setting.program.path)[0],
        np.random.default_rng(0))

    made = attempt(lambda: setting.program.rig(vertices, rig.faces), vertices, "rig", result)
    result.figures["joints"] = {"rigsmith": joint_figures(made.joints, made.parents, joints, parents, character.tolerance)}
    result.figures["rig"] = {"rigsmith": soundness(made, joints, parents)}
    fingers = finger_joints(rig.names, len(joints))
    folded = attempt(lambda: setting.program.rig(vertices, rig.faces, "--fingers", "off"), vertices, "fingers off", result)
    body = without_joints(joints, parents, fingers)
    result.figures["body"] = {"rigsmith": joint_figures(folded.joints, folded.parents, *body, character.tolerance[~fingers])}
    if fingers.any():
        found = metrics.found_joints(made.joints, joints, character.tolerance)
        result.figures["rig"]["rigsmith"] |= {"fingers_found": float(found[fingers].mean()), "others_found": float(found[~fingers].mean())}
    medial = baselines.medial_joints(vertices, faces, setting.clustering)
    medial = medial if len(medial) else vertices.mean(0, keepdims=True)
    tree = baselines.shortest_tree(medial, baselines.central_joint(medial))
    result.figures["joints"]["medial_points"] = joint_figures(medial, tree, joints, parents, character.tolerance)
    if setting.nearest:
        near = setting.nearest.skeleton(vertices, faces, rig.meta.get("id", ""))
        result.figures["joints"]["nearest_rig"] = joint_figures(*near, joints, parents, character.tolerance)

    result.figures["tree"], result.figures["root"] = tree_and_root(character, setting.networks)

    reference = rig.weights.astype(float)
    result.figures["skin"], shown = {}, None
    for method in SKIN_METHODS:
        skinned = attempt(lambda: setting.program.skin(vertices, rig.faces, joints, parents, "--skin-method", method),
                          vertices, method, result, len(joints))
        shown = skinned.weights if shown is None else shown
        result.figures["skin"][method] = skin_figures(vertices, joints, parents, skinned.weights, reference)
    for name, weigh in (("closest_bone", baselines.closest_bone), ("inverse_distance", baselines.inverse_distance)):
        weights = weigh(vertices, joints, parents)
        result.figures["skin"][name] = skin_figures(vertices, joints, parents, weights, reference)
    return result, made, shown


def attempt(run, vertices: np.ndarray, what: str, result: Measured, joint_count: int = 1) -> Rigged:
    """What ``run`` gives; if the program refuses, the poorest rig, and the refusal is noted."""
    try:
        return run()
    except Refused as refusal:
        result.failures.append(f"{what}: {refusal}")
        weights = np.zeros((len(vertices), joint_count))
        weights[:, 0] = 1
        return Rigged(vertices.mean(0, keepdims=True), np.array([-1]), weights, {})


def joint_figures(predicted, predicted_parents, joints, parents, tolerance) -> dict[str, float]:
    figures = {
        "cd_j2j": metrics.joint_to_joint(predicted, joints),
        "cd_j2b": metrics.joint_to_bone(predicted, predicted_parents, joints, parents),
        "cd_b2b": metrics.bone_to_bone(predicted, predicted_parents, joints, parents),
    }
    for suffix, multiplier in MULTIPLIERS.items():
        iou, precision, recall = metrics.matched_joints(predicted, joints, tolerance, multiplier)
        figures |= {f"iou{suffix}": iou, f"precision{suffix}": precision, f"recall{suffix}": recall}
    return figures | {
        "tree_edit": metrics.tree_edit_distance(predicted, predicted_parents, joints, parents),
        "joints": float(len(predicted)), "joint_ratio": len(predicted) / len(joints),
    }


def soundness(made: Rigged, joints, parents) -> dict[str, float]:
    """What a rig must not have, and how long it took."""
    root, own_root = joints[parents < 0][0], made.joints[made.parents < 0][0]
    plane = (made.report.get("symmetry") or {}).get("plane")
    figures = {
        "unweighted": float((made.weights.sum(1) < 0.5).sum()),
        "not_finite": float((~np.isfinite(made.weights)).sum() + (~np.isfinite(made.joints)).sum()),
        "root_distance": float(np.linalg.norm(root - own_root)),
        "by_nearest_bone": float(made.report.get("skin", {}).get("by_nearest_bone", 0)) / len(made.weights),
        "seconds": sum(made.report.get("timings_ms", {}).values()) / 1000,
    }
    if plane:
        figures["mirror_error"] = metrics.mirror_error(made.joints, np.array(plane["normal"]), np.array(plane["point"]))
    return figures


def tree_and_root(character, networks: dict[str, stages.Network]) -> tuple[dict, dict]:
    """On reference joints, from the reference root."""
    bone = {name: float(values[0]) for name, values in stages.bone_stage([character], networks["rignet_bone"]).items()}
    root = {name: float(values[0]) for name, values in stages.root_stage([character], networks["rignet_root"]).items()}
    tree = {
        "rigsmith": {"tree_edit": bone["edit_distance"], "bones_found": bone["bones_found"]},
        "shortest_tree": {"tree_edit": bone["edit_distance_baseline"], "bones_found": bone["bones_found_baseline"]},
    }
    return tree, {
        who: {name: root[name + suffix] for name in ("accuracy", "near")} for who, suffix in (("rigsmith", ""), ("central_joint", "_baseline"))}


def skin_figures(vertices, joints, parents, weights, reference) -> dict[str, float]:
    precision, recall, l1 = metrics.skin_agreement(weights, reference)
    mean, greatest = posed_distances(vertices, joints, parents, weights, reference)
    return {"l1": l1, "precision": precision, "recall": recall, "posed_mean": mean, "posed_max": greatest}


def official_rig(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """RigNet's text format -> joints (J, 3), parents (J,). The copies that the published code splits a branching joint into
    (``name_dup_k``) are the joint again."""
    place: dict[str, np.ndarray] = {}
    parent: dict[str, str] = {}
    for line in path.read_text().splitlines():
        words = line.split()
        if words[:1] == ["joints"] and "_dup_" not in words[1]:
            place[words[1]] = np.array(words[2:5], float)
        elif words[:1] == ["hier"]:
            above, below = (word.split("_dup_")[0] for word in words[1:3])
            if above != below:
                parent[below] = above
    names = sorted(place, key=lambda name: depth(name, parent))
    index = {name: k for k, name in enumerate(names)}
    return np.array([place[name] for name in names]), np.array([index.get(parent.get(name, ""), -1) for name in names])


def depth(name: str, parent: dict[str, str]) -> int:
    """Steps up to the root; no more than there are joints."""
    steps = 0
    while name in parent and steps <= len(parent):
        name, steps = parent[name], steps + 1
    return steps
