"""Shards, caches, bones and augmentation on generated characters. Needs no PyTorch."""

import json

import numpy as np
import pytest
from scipy.spatial import cKDTree

from rigsmith_models.data import augment, read_cache, targets, travel, write_cache
from rigsmith_models.data.bones import (
    bone_features, bones_of_tree, candidate_pairs, is_bone, nearest_bones, weights_of_nearest_bones)
from rigsmith_models.data.character import ARRAYS
from rigsmith_models.data.shards import RigShard

CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (0.0, 1.0) for z in (-0.5, 0.5)])
CUBE_FACES = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
                       [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])


def test_a_shard_gives_back_its_rigs(tmp_path):
    arrays = {
        "vertices": CUBE.astype(np.float32), "faces": CUBE_FACES.astype(np.int32),
        "joints": np.array([[0, 0.2, 0], [0, 0.8, 0]], np.float32), "parents": np.array([-1, 0], np.int16),
        "names": np.array(["root", "tip"]), "w_indptr": np.arange(0, 17, 2, dtype=np.int32), "w_joint": np.tile([0, 1], 8).astype(np.uint8),
        "w_value": np.tile([16384, 49151], 8).astype(np.uint16),
    }
    meta = np.frombuffer(json.dumps([{"name": "cube"}]).encode(), np.uint8)
    np.savez_compressed(tmp_path / "tiny.npz", meta_json=meta, **{f"0000/{k}": v for k, v in arrays.items()})
    shard = RigShard(tmp_path / "tiny.npz")
    assert len(shard) == 1 and shard[0].meta == {"name": "cube"}
    assert shard[0].names == ("root", "tip")
    np.testing.assert_allclose(shard[0].weights, np.tile([0.25, 0.75], (8, 1)), atol=1e-4)


def test_a_cache_gives_back_its_characters(tmp_path, stick_figures):
    write_cache(tmp_path / "cache.npz", stick_figures)
    for written, read in zip(stick_figures, read_cache(tmp_path / "cache.npz"), strict=True):
        assert written.meta == read.meta
        for name in ARRAYS:
            np.testing.assert_array_equal(getattr(written, name), getattr(read, name))


def test_every_leaf_joint_has_a_bone_of_its_own_right_after_the_bone_that_ends_there():
    assert bones_of_tree(np.array([-1, 0, 0, 1])).tolist() == [[0, 1], [0, 2], [2, 2], [1, 3], [3, 3]]


def test_bones_are_pairs_in_either_direction():
    pairs = candidate_pairs(3)
    assert pairs.tolist() == [[0, 1], [0, 2], [1, 2]]
    assert is_bone(np.array([1, -1, 1]), pairs).tolist() == [True, False, True]


def test_a_rig_with_few_bones_is_padded_with_the_nearest_and_masked():
    distance = np.array([[0.3, 0.1]])
    nearest = nearest_bones(distance, 5)
    assert nearest.tolist() == [[1, 0, 1, 1, 1]]
    features, mask = bone_features(np.zeros((2, 3)), np.ones((2, 3)), np.array([0, 1]), distance, nearest)
    assert features.shape == (1, 40) and mask.tolist() == [[1, 1, 0, 0, 0]]
    assert features[0, 6] == pytest.approx(10) and features[0, 7] == 1


def test_a_joints_weight_goes_to_its_nearest_bone_only():
    weights = np.array([[0.7, 0.3]])
    assert weights_of_nearest_bones(weights, np.array([[0, 0, 1]])).tolist() == [[pytest.approx(0.7), 0, pytest.approx(0.3)]]


def test_rays_measure_the_half_width_of_a_cube_and_mark_its_vertices():
    joints, parents = np.array([[0, 0.25, 0], [0, 0.75, 0]]), np.array([-1, 0])
    rays = targets.joint_rays(CUBE, CUBE_FACES, joints, parents)
    assert all(0.5 <= value <= 0.5 * 2**0.5 for value in targets.tolerance(CUBE, rays, joints))
    assert targets.attention_mask(CUBE, rays, joints).sum() >= 6


def test_posing_moves_vertices_with_their_joints(stick_figures):
    for seed, figure in enumerate(stick_figures):
        posed = augment.random_pose(figure, np.random.default_rng(seed))
        owner = figure.skin_weights.argmax(1)
        before = np.linalg.norm(figure.positions - figure.joints[owner], axis=1)
        after = np.linalg.norm(posed.positions - posed.joints[owner], axis=1)
        np.testing.assert_allclose(after, before, atol=1e-5)


def test_parts_grow_by_themselves_and_mirror_partners_alike(stick_figures):
    figure = stick_figures[0]
    owner = figure.skin_weights.argmax(1)
    grown = augment.random_pose(figure, np.random.default_rng(3), growth=0.3)
    before = np.linalg.norm(figure.positions - figure.joints[owner], axis=1)
    size = np.linalg.norm(grown.positions - grown.joints[owner], axis=1) / before
    per_joint = np.array([np.unique(size[owner == joint].round(3)) for joint in range(7)]).squeeze(1)
    np.testing.assert_allclose(np.linalg.norm(grown.medial_offsets, axis=1), per_joint[owner] * np.linalg.norm(figure.medial_offsets, axis=1), rtol=2e-3)
    assert per_joint[3] == per_joint[4] and per_joint[5] == per_joint[6]  # the arms, the legs
    assert len(set(per_joint)) == 5
    np.testing.assert_allclose(
        np.linalg.norm(grown.joints[1] - grown.joints[0]), per_joint[0] * np.linalg.norm(figure.joints[1] - figure.joints[0]), rtol=2e-3)


def test_what_travels_arrives(stick_figures, tmp_path):
    travel.write_travel(tmp_path / "some.travel", stick_figures)
    for sent, arrived in zip(stick_figures, travel.read_travel(tmp_path / "some.travel"), strict=True):
        far, place = cKDTree(arrived.positions).query(sent.positions)  # where each vertex went
        assert far.max() < 1e-4 and sorted(place) == list(range(len(place)))
        np.testing.assert_allclose(arrived.medial_offsets[place], sent.medial_offsets, atol=5e-4)
        np.testing.assert_allclose(arrived.skin_weights[place], sent.skin_weights, atol=4e-3)
        assert (arrived.attention_mask[place] == sent.attention_mask).all()
        assert (arrived.joints == sent.joints).all() and (arrived.parents == sent.parents).all() and arrived.meta == sent.meta
        assert (arrived.tolerance == sent.tolerance).all()
        for name, columns in (("one_ring", travel.ONE_RING_COLUMNS), ("geodesic_ball", travel.BALL_COLUMNS)):
            old, new = getattr(sent, name), getattr(arrived, name)
            for vertex in range(len(old)):
                known = {place[v] for v in old[vertex]}
                kept = set(new[place[vertex]]) - {place[vertex]}
                assert kept <= known and len(kept) == min(columns, len(known - {place[vertex]}))


def test_what_is_learnt_by_heart_is_one_of_each_family(stick_figures):
    for k, figure in enumerate(stick_figures):
        figure.meta |= {"family": f"family {k // 2}", "style": "box" if k < 2 else "lowpoly", "draw_weight": 0.2}
    chosen = travel.unlike(stick_figures, 2)
    assert [c.meta["family"] for c in chosen] == ["family 1", "family 2"] and all(c.meta["draw_weight"] == 1.0 for c in chosen)


def test_scaling_keeps_the_frame(stick_figures):
    for seed, figure in enumerate(stick_figures):
        scaled, _ = augment.random_scale(figure, np.random.default_rng(seed))
        low, high = scaled.positions.min(0), scaled.positions.max(0)
        assert (high - low).max() == pytest.approx(1, abs=1e-5) and low[1] == pytest.approx(0, abs=1e-6)
        assert low[2] + high[2] == pytest.approx(0, abs=1e-5)


def test_thinning_keeps_only_neighbours_that_are_there(stick_figures):
    for vertex_count in (40, 90, 120):
        kept, ring, ball = augment.thin(stick_figures[0], vertex_count, 5, 8, np.random.default_rng(1))
        assert ring.shape == (vertex_count, 6) and ball.shape == (vertex_count, 9)
        assert (ring[:, 0] == np.arange(vertex_count)).all()
        for row in range(vertex_count):
            original = set(stick_figures[0].one_ring[kept[row]]) | {kept[row]}
            assert set(kept[ring[row]]) <= original


def test_thinning_gives_rows_of_one_width_even_when_the_cache_has_fewer_columns(stick_figures):
    _, ring, ball = augment.thin(stick_figures[0], 40, 20, 30, np.random.default_rng(1))
    assert ring.shape == (40, 21) and ball.shape == (40, 31)
