"""What needs no network of ours: the marks that each stage must beat, on the same meshes.

Everything in the normalised frame. ``skeleton.py`` has the spanning tree, ``clustering.py`` the clustering.
"""

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from ..data.bones import bones_of_tree
from ..data.shards import RigShard
from ..data.targets import first_hits
from .clustering import Clustering, joints_of
from .skeleton import minimum_spanning_tree

MEDIAL_VERTICES = 1000  # rays are cast from so many vertices at most
SHAPE_SAMPLES = 256
NEAREST_BONES = 5
INVERSE_POWER = 4  # of the distance; 2 blends limbs into the trunk


# ---- joints ---------------------------------------------------------------------------------------------------------


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) unit, by area; a vertex without faces gets zeros."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], np.cross(b - a, c - a))
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


def medial_joints(vertices: np.ndarray, faces: np.ndarray, settings: Clustering) -> np.ndarray:
    """Each vertex moved halfway to the opposite side of the body, then the clustering of the networks' points. -> (J, 3)

    The way goes inward along the normal; a vertex whose ray leaves through no surface stays. All attend alike.
    """
    chosen = np.sort(np.random.default_rng(0).permutation(len(vertices))[:MEDIAL_VERTICES])
    inward = -vertex_normals(vertices, faces)[chosen]
    across = first_hits(vertices, faces, vertices[chosen] + 1e-5 * inward, inward)
    length = np.where(np.isfinite(across), across / 2, 0.0)
    return joints_of(vertices[chosen] + inward * length[:, None], length, np.ones(len(chosen)), settings)


class NearestRig:
    """The skeleton of the training rig whose surface is most alike, stretched to the character's bounding box."""

    def __init__(self, shards: list[RigShard]):
        self.rigs = [shard[k] for shard in shards for k in range(len(shard))]
        self.surfaces = [cKDTree(surface_in_unit_box(rig.vertices, rig.faces)) for rig in self.rigs]

    def skeleton(self, vertices: np.ndarray, faces: np.ndarray, identity: str) -> tuple[np.ndarray, np.ndarray]:
        """-> joints (J, 3), parents (J,). ``identity``: the character's own rig is passed over."""
        tree = cKDTree(surface_in_unit_box(vertices, faces))
        apart = [
            np.inf if rig.meta["id"] == identity
            else surface.query(tree.data)[0].mean() + tree.query(surface.data)[0].mean()
            for rig, surface in zip(self.rigs, self.surfaces)]
        rig = self.rigs[int(np.argmin(apart))]
        (low, side), (own_low, own_side) = box(vertices), box(rig.vertices)
        return low + (rig.joints - own_low) / own_side * side, rig.parents.astype(int)


def box(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least corner and sides of the bounding box."""
    low = vertices.min(0).astype(float)
    return low, np.maximum(vertices.max(0) - low, 1e-6)


def surface_in_unit_box(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Points spread over the surface by area, fixed seed, the box stretched to the unit cube. -> (SHAPE_SAMPLES, 3)"""
    rng = np.random.default_rng(1)
    a, b, c = (vertices[faces[:, k]].astype(float) for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    face = rng.choice(len(faces), SHAPE_SAMPLES, p=area / area.sum())
    u, v = rng.random((2, SHAPE_SAMPLES, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    low, side = box(vertices)
    return (a[face] + u * (b - a)[face] + v * (c - a)[face] - low) / side


# ---- tree and root --------------------------------------------------------------------------------------------------


def shortest_tree(joints: np.ndarray, root: int) -> np.ndarray:
    """Euclidean minimum spanning tree -> parents (J,)."""
    return minimum_spanning_tree(cdist(joints, joints), root)


def central_joint(joints: np.ndarray) -> int:
    """The joint nearest to the centroid of all."""
    return int(np.linalg.norm(joints - joints.mean(0), axis=1).argmin())


# ---- skin -----------------------------------------------------------------------------------------------------------


def straight_distances(points: np.ndarray, joints: np.ndarray, parents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance of every point to every bone (V, B), and the joint that each bone's weights belong to (B,)."""
    start, end = bones_of_tree(parents).astype(int).T
    along = joints[end] - joints[start]
    squared = np.maximum((along**2).sum(1), 1e-12)
    t = np.clip(((points[:, None] - joints[start]) * along).sum(2) / squared, 0, 1)
    return np.linalg.norm(points[:, None] - joints[start] - t[..., None] * along, axis=2), start


def closest_bone(points: np.ndarray, joints: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """Each point follows its nearest bone alone; beyond an end joint that is the end joint's, not the one before. -> (V, J)"""
    distance, owner = straight_distances(points, joints, parents)
    # A leaf bone stands right after the bone that ends in its joint, and what lies beyond is as near to both.
    last_of_equals = distance.shape[1] - 1 - np.round(distance[:, ::-1], 9).argmin(1)
    return np.eye(len(joints))[owner[last_of_equals]]


def inverse_distance(points: np.ndarray, joints: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """The inverse fourth power of the straight distance to the five nearest bones, rows of sum 1. -> (V, J)"""
    distance, owner = straight_distances(points, joints, parents)
    near = np.argsort(distance, axis=1, kind="stable")[:, :NEAREST_BONES]
    share = 1.0 / (np.take_along_axis(distance, near, 1) + 1e-3) ** INVERSE_POWER
    weights = np.zeros((len(points), len(joints)))
    np.add.at(weights, (np.arange(len(points))[:, None], owner[near]), share)
    return weights / weights.sum(1, keepdims=True)


