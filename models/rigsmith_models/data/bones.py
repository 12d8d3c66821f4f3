"""Bones of a joint tree, in the order of the reference (breadth first), and candidate pairs of joints."""

from collections import deque

import numpy as np


def bones_of_tree(parents: np.ndarray) -> np.ndarray:
    """(J,) -> (B, 2) joint indices (start, end). A leaf joint is followed by its own bone (j, j) of length zero."""
    children: dict[int, list[int]] = {}
    for child, parent in enumerate(parents):
        children.setdefault(int(parent), []).append(child)
    bones, pending = [], deque(children.get(-1, []))
    while pending:
        joint = pending.popleft()
        for child in children.get(joint, []):
            bones.append((joint, child))
            if child not in children:
                bones.append((child, child))
            pending.append(child)
    return np.array(bones or [(0, 0)], np.int16).reshape(-1, 2)


def candidate_pairs(joint_count: int) -> np.ndarray:
    """-> (P, 2), all i < j, rows in lexicographic order."""
    return np.stack(np.triu_indices(joint_count, 1), axis=1)


def is_bone(parents: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """(J,), (P, 2) -> (P,) bool, in either direction."""
    start, end = pairs[:, 0], pairs[:, 1]
    return (parents[start] == end) | (parents[end] == start)


def nearest_bones(distance: np.ndarray, bone_count: int) -> np.ndarray:
    """(V, B) -> (V, bone_count), ascending by distance; with fewer bones the nearest one fills the row."""
    order = np.argsort(distance, axis=1, kind="stable")[:, :bone_count]
    missing = bone_count - order.shape[1]
    return np.concatenate([order, np.repeat(order[:, :1], missing, axis=1)], axis=1) if missing else order


def bone_features(bone_start, bone_end, leaf, distance, nearest) -> tuple[np.ndarray, np.ndarray]:
    """SkinNet's input per vertex (RigNet, Section 4.3).

    bone_start, bone_end: (B, 3), leaf: (B,), distance: (V, B), nearest: (V, K) -> features (V, K*8), mask (V, K).
    """
    inverse = 1.0 / (np.take_along_axis(distance, nearest, 1).astype(np.float64) + 1e-10)
    features = np.concatenate(
        [bone_start[nearest], bone_end[nearest], inverse[..., None], leaf[nearest][..., None]], axis=2)
    mask = np.broadcast_to(np.arange(nearest.shape[1]) < distance.shape[1], nearest.shape)
    return features.reshape(len(nearest), -1).astype(np.float32), mask.astype(np.float32)


def weights_of_nearest_bones(skin_weights: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """Target of SkinNet. skin_weights: (V, J), owner: (V, K) start joint of each near bone -> (V, K), not normalised.

    Of several near bones that start at one joint, only the nearest gets the joint's weight.
    """
    target = np.take_along_axis(skin_weights.astype(np.float32), owner, axis=1)
    for slot in range(1, owner.shape[1]):
        target[(owner[:, :slot] == owner[:, slot : slot + 1]).any(1), slot] = 0.0
    return target
