"""Claims about generated characters that training relies on."""

import numpy as np
import pytest

from rigsmith_models.data.synthetic import generate
from rigsmith_models.data.synthetic.families import FAMILIES
from rigsmith_models.data.synthetic.sketch import Sketch
from rigsmith_models.data.synthetic.surface import split_long_edges


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_makes_a_sound_character(family):
    character = generate(7, family=family)
    vertices, faces, joints = character.vertices, character.faces, character.joints
    assert np.isfinite(vertices).all() and np.isfinite(joints).all()
    assert faces.min() >= 0 and faces.max() < len(vertices)
    assert np.unique(faces).size == len(vertices), "every vertex is in a face"
    assert 900 <= len(vertices) <= 4000
    low, high = vertices.min(0), vertices.max(0)
    assert (high - low).max() == pytest.approx(1, abs=1e-5)
    assert low[1] == pytest.approx(0, abs=1e-5)
    assert low[[0, 2]] + high[[0, 2]] == pytest.approx(0, abs=1e-5)
    parents = character.parents
    assert parents[0] == -1 and len(parents) == len(joints) >= 2
    assert all(0 <= parent < joint for joint, parent in enumerate(parents) if joint > 0)
    weights = character.weights
    assert weights.shape == (len(vertices), len(joints))
    assert weights.min() >= 0 and weights.sum(1) == pytest.approx(1, abs=1e-5)
    assert (weights > 0).sum(1).max() <= 4


def test_skirts_have_joints_outside_their_cloth():
    away = []
    for seed in range(4):
        made = generate(seed, target_vertices=1000, family="skirted")
        hips = np.bincount(made.parents[1:]).argmax()
        ring = made.joints[made.parents == hips]
        reach = np.hypot(*(ring - made.joints[hips])[:, [0, 2]].T)
        assert (reach > 0.04).sum() >= 8, "a ring of eight panels hangs on the hips"
        away.append(reach.max())
    assert max(away) > min(away) + 0.01


def test_the_same_seed_is_the_same_character():
    first, second = generate(3), generate(3)
    assert first.family == second.family
    for field in ("vertices", "faces", "joints", "parents", "weights"):
        assert np.array_equal(getattr(first, field), getattr(second, field)), field


def test_other_seeds_are_other_characters():
    assert not np.array_equal(generate(1, family="human").joints, generate(2, family="human").joints)


@pytest.mark.parametrize("family", ["human", "quadruped", "dragon", "bird", "bug"])
def test_left_and_right_joints_are_exact_mirror_images(family):
    sketch = Sketch(np.random.default_rng(11))
    FAMILIES[family][1](sketch)
    joints = {tuple(joint) for joint in sketch.joints}
    mirrored = {(-x, y, z) for x, y, z in joints}
    assert joints == mirrored


def test_the_vertex_count_follows_the_target():
    for target in (800, 1500, 3000):
        character = generate(21, target_vertices=target, family="human")
        assert abs(len(character.vertices) - target) < 0.15 * target


def test_splitting_edges_keeps_the_surface_and_its_edges_together():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])

    def area(vertices, faces):
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2

    finer, finer_faces = split_long_edges(vertices, faces, 50)
    assert len(finer) == 50
    assert area(finer, finer_faces) == pytest.approx(area(vertices, faces))
    directed = [tuple(edge) for face in finer_faces for edge in zip(face, np.roll(face, -1))]
    assert len(set(directed)) == len(directed)
    assert {(b, a) for a, b in directed} == set(directed), "closed: every edge is used once in each direction"
