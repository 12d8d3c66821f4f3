"""Shared test material: a small character made in place, so that no test needs data from outside the repository."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

from rigsmith_models.data import Character  # noqa: E402
from rigsmith_models.data.bones import bones_of_tree  # noqa: E402


def stick_figure(seed: int, vertex_count: int = 90) -> Character:
    """Points around a T-shaped tree of joints, with every field that a cache holds."""
    rng = np.random.default_rng(seed)
    joints = np.array([[0, 0.4, 0], [0, 0.7, 0], [0, 0.95, 0], [0.4, 0.7, 0], [-0.4, 0.7, 0], [0.1, 0.05, 0], [-0.1, 0.05, 0]])
    joints = (joints * rng.uniform(0.8, 1.0, 3)).astype(np.float32)
    parents = np.array([-1, 0, 1, 1, 1, 0, 0], np.int16)
    owner = rng.integers(0, len(joints), vertex_count)
    positions = (joints[owner] + rng.normal(0, 0.05, (vertex_count, 3))).astype(np.float32)
    near = np.linalg.norm(positions[:, None] - positions, axis=2).argsort(1).astype(np.int32)
    ends = bones_of_tree(parents)
    middle = 0.5 * (joints[ends[:, 0]] + joints[ends[:, 1]])
    weights = np.zeros((vertex_count, len(joints)), np.float16)
    weights[np.arange(vertex_count), owner] = 1
    links = np.stack([np.roll(np.arange(8), -v) % len(joints) for v in range(vertex_count)]).astype(np.uint8)
    mask = np.ones((vertex_count, 8), bool)
    mask[:, 7] = False  # seven joints: the eighth link is empty
    return Character(
        links=links, link_mask=mask, link_features=rng.uniform(0.05, 1.0, (vertex_count, 8, 13)).astype(np.float16),
        joint_features=rng.normal(0, 0.3, (len(joints), 8)).astype(np.float32),
        positions=positions, medial_offsets=(joints[owner] - positions) * 0.5, one_ring=near[:, 1:7], geodesic_ball=near[:, 1:15], joints=joints, parents=parents,
        skin_weights=weights, attention_mask=rng.random(vertex_count) < 0.4, tolerance=np.full(len(joints), 0.06, np.float32),
        inside_share=rng.random(21).astype(np.float32), bone_ends=ends,
        bone_distance=np.linalg.norm(positions[:, None] - middle, axis=2).astype(np.float16),
        meta={"name": f"stick-{seed}", "style": "synthetic" if seed % 2 else "lowpoly", "draw_weight": 1.0},
    )


@pytest.fixture
def stick_figures() -> list[Character]:
    return [stick_figure(seed) for seed in range(8)]
