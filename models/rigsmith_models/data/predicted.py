"""Skeletons that the service predicts, with the tree and the weights that the artist's skeleton gives them.

Bone and root networks must connect what the joint networks find: joints off their places, missing ones, too many of them. Any
set of points gets a tree here: each is projected onto the reference bones, and the shortest tree by the way along the
reference skeleton connects them.
"""

import numpy as np
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree, shortest_path

from .shards import Rig

EDGE_MIN = 1e-9  # added to every edge: the library takes zeros for none


def ways_along(points: np.ndarray, joints: np.ndarray, parents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Length of the way between points: to the nearest reference bone, along the bones, and out again; and to the root.

    points: (N, 3), joints: (J, 3), parents: (J,) -> (N, N), (N,).
    """
    child = np.flatnonzero(parents >= 0)
    start, end = joints[parents[child]], joints[child]
    along = end - start
    squared = np.maximum((along**2).sum(1), 1e-12)
    share = np.clip(((points[:, None] - start) * along).sum(2) / squared, 0, 1)  # (N, B)
    distance = np.linalg.norm(start + share[..., None] * along - points[:, None], axis=2)
    bone = distance.argmin(1)
    row = np.arange(len(points))
    off, length = distance[row, bone], np.sqrt(squared)[bone]
    ends = np.stack([parents[child][bone], child[bone]], axis=1)  # (N, 2)
    to_end = np.stack([share[row, bone] * length, (1 - share[row, bone]) * length], axis=1)

    edges = np.zeros((len(joints), len(joints)))
    edges[child, parents[child]] = np.linalg.norm(joints[child] - joints[parents[child]], axis=1) + EDGE_MIN
    between_joints = shortest_path(edges, directed=False)
    ways = to_end[:, None, :, None] + between_joints[ends[:, None, :, None], ends[None, :, None, :]] + to_end[None, :, None, :]
    between = ways.reshape(len(points), len(points), 4).min(2)
    same = bone[:, None] == bone[None]
    between[same] = np.abs(to_end[:, None, 0] - to_end[None, :, 0])[same]
    root = int(np.flatnonzero(parents < 0)[0])
    to_root = (to_end + between_joints[ends, root]).min(1) + off
    return between + off[:, None] + off[None], to_root


def with_joints(rig: Rig, points: np.ndarray) -> Rig:
    """The rig with ``points`` (N, 3) for joints, root first, parents before children; each joint's weights go to the point that
    is nearest along the skeleton."""
    between, to_root = ways_along(np.concatenate([points, rig.joints]), rig.joints.astype(float), rig.parents.astype(int))
    own = between[: len(points), : len(points)] + EDGE_MIN
    tree = minimum_spanning_tree(np.triu(own, 1))
    root = int(to_root[: len(points)].argmin())
    order, parents = breadth_first_order(tree, root, directed=False)
    place = np.empty(len(points), int)
    place[order] = np.arange(len(points))
    ordered = np.where(parents[order] < 0, -1, place[np.maximum(parents[order], 0)])
    heir = place[between[len(points) :, : len(points)].argmin(1)]
    weights = np.zeros((len(rig.vertices), len(points)), np.float32)
    np.add.at(weights, (slice(None), heir), rig.weights)
    return Rig(rig.vertices, rig.faces, points[order].astype(np.float32), ordered.astype(np.int16), weights, rig.meta)
