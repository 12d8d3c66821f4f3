"""Each network alone, on reference input for its stage, against the baseline that it must beat.

Networks are ONNX Runtime sessions of the shipped files: what is judged is what ships. Every function returns one row
of figures per character, as a dict of arrays.
"""

from collections.abc import Callable

import numpy as np

from ..data.bones import bone_features, candidate_pairs, is_bone, nearest_bones, weights_of_nearest_bones
from ..data.character import Character
from . import metrics
from .baselines import central_joint, shortest_tree
from .clustering import Clustering, joints_of
from .skeleton import cost_matrix, minimum_spanning_tree, outside_samples

BALL_MAX = 10  # as in the service
BONES_PER_VERTEX = 5
SKIN_CUT = 0.35  # entries below this part of the row's maximum are dropped, as in the service
INVERSE_DISTANCE_POWER = 4  # of the geometric skin baseline
ROOT_NEAR = 0.05

Network = Callable[..., np.ndarray]  # keyword inputs -> the one output


def shape_inputs(character: Character, seed: int = 0) -> dict[str, np.ndarray]:
    """positions, one_ring and at most 10 random members of the geodesic ball, rows starting with the own index."""
    count = len(character.positions)
    own = np.arange(count)[:, None]
    ball = character.geodesic_ball.astype(np.int64)
    order = (np.random.default_rng(seed).random(ball.shape) + (ball == own)).argsort(1)[:, :BALL_MAX]
    return {
        "positions": character.positions,
        "one_ring": np.concatenate([own, character.one_ring], axis=1).astype(np.int64),
        "geodesic_ball": np.concatenate([own, np.take_along_axis(ball, order, 1)], axis=1),
    }


def sigmoid(x: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(-x.astype(np.float64)))


def displaced(characters, displacement: Network, attention: Network) -> list[tuple[np.ndarray, np.ndarray]]:
    """-> per character displacement (V, 3) and attention (V,) in (0, 1)."""
    results = []
    for character in characters:
        shape = shape_inputs(character) | {"medial_offsets": character.medial_offsets}
        results.append((displacement(**shape), sigmoid(attention(**shape)).astype(np.float32)))
    return results


def joint_row(character: Character, joints: np.ndarray) -> dict[str, float]:
    """Figures of one set of predicted joints; without any joint, one at the centre of the vertices counts as predicted."""
    failed = len(joints) == 0
    if failed:
        joints = character.positions.mean(0, keepdims=True)
    iou, precision, recall = metrics.matched_joints(joints, character.joints, character.tolerance)
    return {
        "cd_j2j": metrics.joint_to_joint(joints, character.joints), "iou": iou, "precision": precision, "recall": recall,
        "iou_half": metrics.matched_joints(joints, character.joints, character.tolerance, 0.5)[0],
        "joints": len(joints), "joints_reference": len(character.joints), "failed": float(failed),
    }


def joint_stage(characters, predictions, settings: Clustering) -> dict[str, np.ndarray]:
    rows = []
    for character, (displacement, attention) in zip(characters, predictions):
        length = np.linalg.norm(displacement, axis=1)
        joints = joints_of(character.positions + displacement, length, attention, settings)
        rows.append(joint_row(character, joints))
    return columns(rows)


def point_figures(characters, predictions) -> dict[str, np.ndarray]:
    """Before clustering: Chamfer of the displaced points, and how well attention tells the mask (area under the curve)."""
    rows = []
    for character, (displacement, attention) in zip(characters, predictions):
        points = character.positions + displacement
        mask = character.attention_mask
        rank = attention.argsort().argsort() + 1
        inside, outside = mask.sum(), (~mask).sum()
        area = (rank[mask].sum() - inside * (inside + 1) / 2) / max(inside * outside, 1)
        rows.append({"chamfer": metrics.joint_to_joint(points, character.joints), "attention_auc": float(area)})
    return columns(rows)


def pair_features(character: Character) -> np.ndarray:
    """Length and inside share of all pairs of joints, (P, 2)."""
    start, end = character.joints[candidate_pairs(len(character.joints)).T]
    return np.stack([np.linalg.norm(start - end, axis=1), character.inside_share], axis=1).astype(np.float32)


def bone_stage(characters, bone: Network) -> dict[str, np.ndarray]:
    """Tree on the reference joints from the reference root; baseline: minimum spanning tree of joint distances."""
    rows = []
    for character in characters:
        joints, parents = character.joints, character.parents.astype(int)
        pairs = candidate_pairs(len(joints))
        features = pair_features(character)
        length = features[:, 0].astype(float)
        logit = bone(positions=character.positions, joints=joints, pairs=pairs.astype(np.int64), pair_features=features)
        root = int(np.flatnonzero(parents < 0)[0])
        outside = outside_samples(length, character.inside_share)
        ours = minimum_spanning_tree(cost_matrix(len(joints), pairs, logit, outside), root)
        nearest = shortest_tree(joints, root)
        truth = is_bone(parents, pairs)
        rows.append({
            "edit_distance": metrics.tree_edit_distance(joints, ours, joints, parents),
            "edit_distance_baseline": metrics.tree_edit_distance(joints, nearest, joints, parents),
            "bones_found": is_bone(ours, pairs)[truth].mean(), "bones_found_baseline": is_bone(nearest, pairs)[truth].mean(),
            "pair_accuracy": ((logit > 0) == truth).mean(),
        })
    return columns(rows)


def root_stage(characters, root: Network) -> dict[str, np.ndarray]:
    """Share of characters whose root is found, or a joint at its place (``near``: within a twentieth of the longest side);
    baseline: the reference joint nearest to the centre of all joints."""
    rows = []
    for character in characters:
        truth = int(np.flatnonzero(character.parents < 0)[0])
        features = pair_features(character)
        ours = int(root(positions=character.positions, joints=character.joints, pair_features=features).argmax())
        row = {}
        for suffix, chosen in (("", ours), ("_baseline", central_joint(character.joints))):
            distance = np.linalg.norm(character.joints[chosen] - character.joints[truth])
            row |= {"accuracy" + suffix: float(distance == 0), "near" + suffix: float(distance < ROOT_NEAR), "distance" + suffix: distance}
        rows.append(row)
    return columns(rows)


def skin_stage(characters, skin: Network) -> dict[str, np.ndarray]:
    """Weights on the reference skeleton; baseline: inverse fourth power of the distance to the same 5 bones."""
    rows = []
    for character in characters:
        start, end = character.bone_ends.astype(int).T
        distance = character.bone_distance.astype(np.float32)
        nearest = nearest_bones(distance, BONES_PER_VERTEX)
        features, mask = bone_features(character.joints[start], character.joints[end], start == end, distance, nearest)
        logit = skin(**shape_inputs(character), bone_features=features, bone_mask=mask).astype(np.float64)
        share = np.exp(logit - logit.max(1, keepdims=True)) * mask
        inverse = mask / (np.take_along_axis(distance, nearest, 1) + 1e-3) ** INVERSE_DISTANCE_POWER
        reference = character.skin_weights.astype(np.float64)
        reachable = weights_of_nearest_bones(character.skin_weights, start[nearest]).sum(1).mean()
        row = {"mass_in_five": float(reachable)}
        for suffix, weights in (("", share), ("_baseline", inverse)):
            ours = weights_of_joints(weights, start[nearest], len(character.joints))
            row["precision" + suffix], row["recall" + suffix], row["l1" + suffix] = metrics.skin_agreement(ours, reference)
        rows.append(row)
    return columns(rows)


def weights_of_joints(weights: np.ndarray, owner: np.ndarray, joint_count: int) -> np.ndarray:
    """weights, owner: (V, K) -> (V, J), small entries cut as in the service, rows normalised."""
    dense = np.zeros((len(weights), joint_count))
    np.add.at(dense, (np.arange(len(weights))[:, None], owner), weights)
    dense[dense < SKIN_CUT * dense.max(1, keepdims=True)] = 0
    return dense / dense.sum(1, keepdims=True)


def columns(rows: list[dict[str, float]]) -> dict[str, np.ndarray]:
    return {name: np.array([row[name] for row in rows], float) for name in rows[0]}
