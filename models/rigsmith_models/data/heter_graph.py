"""The heterogeneous graph of a thinned character. Layout and rules are those of ``rig::heter_graph`` in the service."""

import numpy as np

from .augment import MIRROR
from .character import Character

SIGHT, SEEN_FROM = 32, 0.05  # links that a joint looks at: how many, and from which heat on
HASH_FACTOR = np.uint32(2_654_435_761)  # of vertices, Knuth's
VECTORS_OF_LINK, VECTORS_OF_JOINT = (7, 10), (0, 3)  # columns where a vector starts
LINK_INPUTS = ("joint_features", "joint_neighbours", "links", "link_mask", "link_features", "joint_links", "joint_mask", "target")


def joint_neighbours(parents: np.ndarray) -> np.ndarray:
    """(J,) -> (J, K): the joint itself, its parent, its children; padded with itself."""
    rows = [[j] for j in range(len(parents))]
    for child, parent in enumerate(parents):
        if parent >= 0:
            rows[child].insert(1, int(parent))
            rows[int(parent)].append(child)
    columns = max(map(len, rows))
    return np.array([row + [row[0]] * (columns - len(row)) for row in rows], np.int64)


def joint_links(links: np.ndarray, seen: np.ndarray, joint_count: int) -> tuple[np.ndarray, np.ndarray]:
    """links, seen: (V, K) -> (J, SIGHT) links as vertex * K + slot, in the order of a hash of the vertex, and (J,) whether any.

    Which links a joint looks at depends on nothing but these links: a change elsewhere on the skeleton leaves them as they are.
    """
    columns = links.shape[1]
    valid = np.flatnonzero(seen.reshape(-1))
    joint = links.reshape(-1)[valid]
    hashed = (valid // columns).astype(np.uint32) * HASH_FACTOR
    order = np.lexsort((valid, hashed, joint))
    valid, joint = valid[order], joint[order]
    first = np.searchsorted(joint, np.arange(joint_count))
    count = np.searchsorted(joint, np.arange(joint_count), side="right") - first
    at = np.arange(SIGHT) % np.maximum(count[:, None], 1)
    chosen = np.append(valid, 0)[first[:, None] + at]
    return np.where(count[:, None] > 0, chosen, 0), count > 0


def heter_graph(character: Character, kept: np.ndarray, mirrored: bool, slots: int) -> dict[str, np.ndarray]:
    """Inputs of HeterSkinNet for the ``kept`` vertices, joints padded to ``slots``, and ``target`` (V, K), reference weights."""
    count = len(character.joints)
    links = character.links[kept].astype(np.int64)
    mask = character.link_mask[kept]
    features, of_joints = character.link_features[kept].astype(np.float32), character.joint_features.astype(np.float32).copy()
    if mirrored:
        for column in VECTORS_OF_LINK:
            features[:, :, column : column + 3] *= MIRROR
        for column in VECTORS_OF_JOINT:
            of_joints[:, column : column + 3] *= MIRROR
    seen, any_seen = joint_links(links, mask & (features[:, :, 3] >= SEEN_FROM), count)
    neighbours = joint_neighbours(character.parents)
    spare = slots - count
    own = np.repeat(np.arange(count, slots)[:, None], neighbours.shape[1], axis=1)
    return {
        "joint_features": np.concatenate([of_joints, np.repeat(of_joints[:1], spare, 0)]),
        "joint_neighbours": np.concatenate([neighbours, own]),
        "links": links, "link_mask": mask.astype(np.float32), "link_features": features,
        "joint_links": np.concatenate([seen, np.zeros((spare, SIGHT), np.int64)]),
        "joint_mask": np.concatenate([any_seen, np.zeros(spare, bool)]).astype(np.float32),
        "target": np.take_along_axis(character.skin_weights[kept].astype(np.float32), links, 1) * mask,
    }
