"""What the networks should learn about a character, from rays of its joints. RigNet [Xu et al. 2020], Sections 4.1 and 6."""

import numpy as np
from scipy.spatial import cKDTree

RAYS_PER_BONE = 14
NEAR_HIT_FACTOR, NEAR_HIT_PERCENTILE = 2.0, 20
MASK_RADIUS = 0.02
MASK_VERTICES_MIN = 6


def first_hits(vertices, faces, origins, directions) -> np.ndarray:
    """Distance of each ray to the mesh, nan where it misses (Moeller and Trumbore). origins, directions: (R, 3) -> (R,)."""
    corner, edge_1, edge_2 = vertices[faces[:, 0]], vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    distances = np.full(len(origins), np.nan)
    for ray, (origin, direction) in enumerate(zip(origins, directions)):
        across = np.cross(direction, edge_2)
        determinant = (edge_1 * across).sum(1)
        usable = np.abs(determinant) > 1e-12
        inverse = 1.0 / np.where(usable, determinant, 1.0)
        offset = origin - corner
        u = (offset * across).sum(1) * inverse
        turned = np.cross(offset, edge_1)
        v = (turned @ direction) * inverse
        distance = (edge_2 * turned).sum(1) * inverse
        hit = usable & (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 1e-6)
        if hit.any():
            distances[ray] = distance[hit].min()
    return distances


def perpendicular(direction: np.ndarray) -> np.ndarray:
    """RAYS_PER_BONE unit vectors at equal angles in the plane perpendicular to a unit vector -> (R, 3)."""
    helper = np.array([1.0, 0, 0]) if abs(direction[0]) < 0.8 else np.array([0, 1.0, 0])
    a = np.cross(direction, helper)
    a /= np.linalg.norm(a)
    b = np.cross(direction, a)
    angle = np.arange(RAYS_PER_BONE) * 2 * np.pi / RAYS_PER_BONE
    return np.cos(angle)[:, None] * a + np.sin(angle)[:, None] * b


def joint_rays(vertices, faces, joints, parents) -> list[tuple[np.ndarray, np.ndarray]]:
    """Per joint: distances (H,) and points (H, 3) of the first hits of rays perpendicular to its bones."""
    directions: list[list[np.ndarray]] = [[] for _ in joints]
    for child, parent in enumerate(parents):
        if parent >= 0:
            along = joints[child] - joints[parent]
            length = np.linalg.norm(along)
            if length > 1e-6:
                directions[child].append(along / length)
                directions[parent].append(along / length)
    hits = []
    for joint, own in zip(joints, directions):
        rays = np.concatenate([perpendicular(d) for d in own or [np.array([0, 1.0, 0])]])
        distance = first_hits(vertices, faces, np.repeat(joint[None], len(rays), 0), rays)
        hit = np.isfinite(distance)
        hits.append((distance[hit], joint + rays[hit] * distance[hit, None]))
    return hits


def tolerance(vertices, rays, joints) -> np.ndarray:
    """(J,), mean distance from joint to surface: half the local shape diameter. Joints without a hit: nearest vertex."""
    tree = cKDTree(vertices)
    return np.array([d.mean() if len(d) else tree.query(j)[0] for (d, _), j in zip(rays, joints)], np.float32)


def attention_mask(vertices, rays, joints) -> np.ndarray:
    """(V,) bool: near a hit that is closer than twice the 20th percentile; at least the 6 nearest vertices of a joint."""
    mask, tree = np.zeros(len(vertices), bool), cKDTree(vertices)
    for (distance, points), joint in zip(rays, joints):
        chosen: set[int] = set()
        if len(distance):
            near = points[distance < NEAR_HIT_FACTOR * np.percentile(distance, NEAR_HIT_PERCENTILE)]
            chosen.update(v for found in tree.query_ball_point(near, MASK_RADIUS) for v in found)
        mask[list(chosen) if len(chosen) >= MASK_VERTICES_MIN else tree.query(joint, min(MASK_VERTICES_MIN, len(vertices)))[1]] = True
    return mask
