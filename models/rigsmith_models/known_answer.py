"""The known-answer inputs of every network: a closed formula that any language reproduces bit for bit.

Described for other implementations in ``models/artifacts/README.md``; NumPy only.
"""

import numpy as np

GRID = 8
VERTEX_COUNT, JOINT_COUNT = GRID * GRID, 6
LINKS, LINK_CHANNELS, JOINT_CHANNELS, SIGHT = 8, 13, 8, 32
SEED = {"positions": 0, "joints": 3, "pair_features": 4, "bone_features": 5, "medial_offsets": 6, "joint_features": 7, "link_features": 8}
# Steps on the grid, own vertex first. The tables hold the vertex so many columns right and rows up, held to the grid.
ONE_RING_STEPS = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1))
BALL_STEPS = (*ONE_RING_STEPS, (1, -1), (-1, 1), (2, 0), (-2, 0))


def uniform(tensor: int, count: int) -> np.ndarray:
    """splitmix64 of (tensor << 40) + i -> (count,) float64 in [0, 1), for i = 0 .. count - 1."""
    with np.errstate(over="ignore"):
        z = np.uint64(tensor << 40) + np.arange(count, dtype=np.uint64) + np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    return (z >> np.uint64(11)).astype(np.float64) / 2.0**53


def points(tensor: int, count: int) -> np.ndarray:
    """(count, 3): x and z in [-0.5, 0.5), y in [0, 1)."""
    return uniform(tensor, 3 * count).reshape(count, 3) - np.array([0.5, 0.0, 0.5])


def sheet() -> np.ndarray:
    """(V, 3): vertex v in column c = v mod 8 and row r = v div 8 of a bent sheet, plus a little noise.

    ``x = 0.4 (c/7 - 0.5)``, ``y = 0.25 + 0.4 r/7``, ``z = 0.8 (c/7 - 0.5)^2``, each plus ``0.02 (u - 0.5)``. The spacing is
    that of a real mesh: the networks amplify rounding on shapes unlike any that they were trained on.
    """
    row, column = np.divmod(np.arange(VERTEX_COUNT), GRID)
    across, up = column / (GRID - 1) - 0.5, row / (GRID - 1)
    noise = uniform(SEED["positions"], 3 * VERTEX_COUNT).reshape(VERTEX_COUNT, 3)
    return np.stack([0.4 * across, 0.25 + 0.4 * up, 0.8 * across**2], axis=1) + 0.02 * (noise - 0.5)


def table(steps) -> np.ndarray:
    """(V, len(steps)) neighbour table of the grid."""
    row, column = np.divmod(np.arange(VERTEX_COUNT), GRID)
    right, up = np.array(steps).T
    rows = np.clip(row[:, None] + up, 0, GRID - 1)
    return rows * GRID + np.clip(column[:, None] + right, 0, GRID - 1)


def bone_features() -> np.ndarray:
    """(V, 40): per bone start (3), end (3) as in ``points``, 1 / (0.05 + u), and 1 where u >= 0.5 else 0."""
    u = uniform(SEED["bone_features"], VERTEX_COUNT * 40).reshape(-1, 8)
    ends = u[:, :6] - np.array([0.5, 0.0, 0.5] * 2)
    return np.concatenate([ends, 1.0 / (0.05 + u[:, 6:7]), u[:, 7:] >= 0.5], axis=1).reshape(VERTEX_COUNT, 40)


def inputs(names: list[str] | tuple[str, ...]) -> dict[str, np.ndarray]:
    """The named inputs, computed in float64 and rounded once to float32."""
    joint = np.arange(JOINT_COUNT)
    pairs = np.stack(np.triu_indices(JOINT_COUNT, 1), axis=1).astype(np.int64)
    every = {
        "positions": sheet().astype(np.float32),
        "medial_offsets": (0.1 * points(SEED["medial_offsets"], VERTEX_COUNT)).astype(np.float32),
        "one_ring": table(ONE_RING_STEPS),
        "geodesic_ball": table(BALL_STEPS),
        "joints": points(SEED["joints"], JOINT_COUNT).astype(np.float32),
        "pairs": pairs,
        "pair_features": uniform(SEED["pair_features"], 2 * len(pairs)).reshape(-1, 2).astype(np.float32),
        "bone_features": bone_features().astype(np.float32),
        "joint_features": (uniform(SEED["joint_features"], JOINT_COUNT * JOINT_CHANNELS) - 0.5).reshape(JOINT_COUNT, -1).astype(np.float32),
        "joint_neighbours": np.stack([joint, np.maximum(joint - 1, 0), np.minimum(joint + 1, JOINT_COUNT - 1)], axis=1),
        "links": (np.arange(VERTEX_COUNT)[:, None] + np.arange(LINKS)) % JOINT_COUNT,
        "link_mask": np.ones((VERTEX_COUNT, LINKS), np.float32),
        "link_features": uniform(SEED["link_features"], VERTEX_COUNT * LINKS * LINK_CHANNELS)
        .reshape(VERTEX_COUNT, LINKS, LINK_CHANNELS).astype(np.float32),
        "joint_links": np.arange(JOINT_COUNT * SIGHT).reshape(JOINT_COUNT, SIGHT) % (VERTEX_COUNT * LINKS),
        "joint_mask": np.ones(JOINT_COUNT, np.float32),
        "bone_mask": np.ones((VERTEX_COUNT, 5), np.float32),
    }
    return {name: every[name] for name in names}
