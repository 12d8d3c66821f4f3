"""Metrics on cases small enough to work out by hand. Needs no PyTorch."""

import numpy as np
import pytest

from rigsmith_models.evaluation import metrics
from rigsmith_models.evaluation.clustering import Clustering, joints_of
from rigsmith_models.evaluation.skeleton import cost_matrix, minimum_spanning_tree

LINE = np.array([[0, 0, 0], [0, 0.5, 0], [0, 1, 0]], float)
CHAIN = np.array([-1, 0, 1])


def test_a_skeleton_is_at_no_distance_from_itself():
    assert metrics.joint_to_joint(LINE, LINE) == 0
    assert metrics.joint_to_bone(LINE, CHAIN, LINE, CHAIN) == pytest.approx(0)
    assert metrics.bone_to_bone(LINE, CHAIN, LINE, CHAIN) == pytest.approx(0)
    assert metrics.tree_edit_distance(LINE, CHAIN, LINE, CHAIN) == 0


def test_the_joint_distance_averages_both_directions():
    assert metrics.joint_to_joint(LINE[:1], LINE) == pytest.approx(0.5 * (0 + (0 + 0.5 + 1) / 3))


def test_a_joint_in_the_middle_of_a_bone_costs_no_bone_distance():
    shorter = LINE[[0, 2]]
    assert metrics.bone_to_bone(shorter, np.array([-1, 0]), LINE, CHAIN) == pytest.approx(0)


def test_a_match_needs_the_tolerance_and_is_one_to_one():
    predicted = np.array([[0, 0.01, 0], [0, 0.02, 0], [0, 0.6, 0]])
    iou, precision, recall = metrics.matched_joints(predicted, LINE, np.array([0.05, 0.05, 0.05]))
    assert (iou, precision, recall) == (pytest.approx(1 / 3), pytest.approx(1 / 3), pytest.approx(1 / 3))
    assert metrics.matched_joints(predicted[[0, 2]], LINE, np.array([0.05, 0.2, 0.05]))[0] == pytest.approx(0.8)


def test_one_joint_more_is_one_edit():
    joints = np.concatenate([LINE, [[1, 0, 0]]])
    assert metrics.tree_edit_distance(joints, np.array([-1, 0, 1, 0]), LINE, CHAIN) == 1


def test_a_star_is_four_edits_from_a_chain():
    joints = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], float)
    star, chain = np.array([-1, 0, 0, 0]), np.array([-1, 0, 1, 2])
    # Star: root and three leaves. Chain: a root and three below each other. Two joints have to move.
    assert metrics.tree_edit_distance(joints, star, joints, chain) == 4


def test_skin_figures_count_influences_and_sum_differences():
    reference = np.array([[1.0, 0], [0.5, 0.5]])
    predicted = np.array([[1.0, 0], [1.0, 0]])
    assert metrics.skin_agreement(predicted, reference) == (1.0, pytest.approx(2 / 3), 0.5)


def test_the_bootstrap_interval_holds_the_mean_and_repeats():
    values = np.random.default_rng(1).random(30)
    low, high = metrics.bootstrap_interval(values)
    assert low < values.mean() < high and (low, high) == metrics.bootstrap_interval(values)


def test_clusters_of_points_become_joints_mirrored_and_snapped():
    rng = np.random.default_rng(0)
    middle = [0.004, 0.5, 0.0] + rng.normal(0, 0.003, (40, 3))
    left = [0.3, 0.7, 0.0] + rng.normal(0, 0.003, (40, 3))
    points = np.concatenate([middle, left]).astype(np.float32)
    joints = joints_of(points, np.zeros(80), np.ones(80), Clustering())
    joints = joints[np.argsort(joints[:, 0])]
    np.testing.assert_allclose(joints, [[-0.3, 0.7, 0], [0, 0.5, 0], [0.3, 0.7, 0]], atol=0.01)


def test_the_cheapest_tree_spans_all_joints():
    pairs = np.stack(np.triu_indices(4, 1), axis=1)
    logit = np.where(pairs[:, 1] - pairs[:, 0] == 1, 5.0, -5.0)
    assert minimum_spanning_tree(cost_matrix(4, pairs, logit), 1).tolist() == [1, -1, 1, 2]
