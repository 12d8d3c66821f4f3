"""Baselines, posing, tables and the program's files on cases small enough to work out by hand. Needs no PyTorch."""

import json

import numpy as np
import pytest

from rigsmith_models.data.shards import Rig
from rigsmith_models.evaluation import baselines, fingers, metrics, pictures, posing, program, skeleton, tables
from rigsmith_models.evaluation.clustering import Clustering
from rigsmith_models.evaluation.measure import joint_figures, official_rig

ARM = np.array([[0, 0, 0], [0, 1, 0], [0, 2, 0]], float)
CHAIN = np.array([-1, 0, 1])


def box_mesh(low, high) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return np.array(low) + corners * (np.array(high) - np.array(low)), np.array(faces)


# ---- metrics ----


def test_the_tolerance_multiplier_decides_what_matches():
    predicted, tolerance = ARM + [0.1, 0, 0], np.array([0.08, 0.12, 0.3])
    figures = joint_figures(predicted, CHAIN, ARM, CHAIN, tolerance)
    assert (figures["iou_half"], figures["iou"], figures["iou_wide"]) == (pytest.approx(1 / 3), pytest.approx(2 / 3), 1)
    assert figures["cd_j2j"] == pytest.approx(0.1) and figures["joint_ratio"] == 1


def test_fingers_are_known_by_name_and_what_hangs_on_them_moves_up():
    names = ("hips", "hand.L", "Index1.L", "mixamorig:LeftHandRing2", "Spring", "Bip01_R_Finger0", "Thumb_ring_box")
    assert fingers.finger_joints(names, 7).tolist() == [False, False, True, True, False, True, True]
    assert not fingers.finger_joints((), 3).any()
    joints, parents = np.arange(15.0).reshape(5, 3), np.array([-1, 0, 1, 2, 2])
    kept, above = fingers.without_joints(joints, parents, np.array([False, True, True, False, False]))
    assert np.array_equal(kept, joints[[0, 3, 4]]) and above.tolist() == [-1, 0, 0]


def test_a_joint_is_found_by_its_own_partner_alone():
    found = metrics.found_joints(ARM[1:], ARM, np.full(3, 0.1))
    assert found.tolist() == [False, True, True]


def test_bone_distance_forgets_where_along_the_bone_joints_are():
    shifted = np.array([[0, 0, 0], [0, 0.5, 0], [0, 2, 0]], float)
    assert metrics.bone_to_bone(shifted, CHAIN, ARM, CHAIN) == pytest.approx(0)
    assert metrics.joint_to_joint(shifted, ARM) == pytest.approx(0.5 / 3)


def test_tree_edit_distance_counts_a_joint_that_hangs_elsewhere():
    # The fork's third branch hangs one joint deeper: take it off and put it on again.
    joints = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], float)
    assert metrics.tree_edit_distance(joints, np.array([-1, 0, 0, 0]), joints, np.array([-1, 0, 0, 2])) == 2


def test_a_mirrored_skeleton_has_no_mirror_error():
    joints = np.array([[-1, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    assert metrics.mirror_error(joints, np.array([1.0, 0, 0]), np.zeros(3)) == 0
    assert metrics.mirror_error(joints + [0.1, 0, 0], np.array([1.0, 0, 0]), np.zeros(3)) == pytest.approx(0.2)


def test_skin_precision_and_recall_count_influences_not_vertices():
    reference = np.array([[0.5, 0.5, 0], [1, 0, 0]])
    predicted = np.array([[0.5, 0.25, 0.25], [1, 0, 0]])
    precision, recall, l1 = metrics.skin_agreement(predicted, reference)
    assert (precision, recall, l1) == (pytest.approx(3 / 4), 1, pytest.approx(0.25))


def test_an_interval_of_equal_values_is_a_point():
    assert metrics.bootstrap_interval(np.full(9, 0.25)) == (0.25, 0.25)
    assert metrics.bootstrap_interval_of_median(np.array([1.0, 1, 1, 1, 9]))[0] == 1


# ---- posing ----


def test_a_bent_elbow_carries_the_hand_and_leaves_the_upper_arm():
    bent = np.stack([np.eye(3), posing.rotation(np.array([0, 0, 1.0]), np.pi / 2), np.eye(3)])
    vertices = np.array([[0, 0.5, 0], [0, 2, 0]])
    moved = posing.posed(vertices, ARM, CHAIN, np.array([[1, 0, 0], [0, 0, 1.0]]), bent)
    assert moved == pytest.approx(np.array([[0, 0.5, 0], [-1, 1, 0]]))


def test_equal_skins_move_alike_and_a_wrong_vertex_shows():
    vertices, right = np.array([[0.1, 0.5, 0], [0.1, 1.5, 0]]), np.array([[1, 0, 0], [0, 1.0, 0]])
    assert posing.posed_distances(vertices, ARM, CHAIN, right, right) == (0, 0)
    mean, greatest = posing.posed_distances(vertices, ARM, CHAIN, right[::-1], right)
    assert greatest >= mean > 0


def test_poses_turn_three_joints_of_ten():
    turned = [np.abs(r - np.eye(3)).max() > 1e-6 for r in posing.random_pose(10, 4)]
    assert sum(turned) == 3


# ---- baselines ----


def test_medial_points_of_a_bar_lie_on_its_axis():
    vertices, faces = box_mesh([0, 0, 0], [0.1, 1, 0.1])
    for _ in range(3):  # one vertex at each edge's middle, so that rays do not all start at corners
        vertices, faces = quartered(vertices, faces)
    joints = baselines.medial_joints(vertices - [0.05, 0, 0.05], faces, Clustering(density_min=0.001))
    inner = joints[(joints[:, 1] > 0.2) & (joints[:, 1] < 0.8)]
    assert len(inner) and np.abs(inner[:, [0, 2]]).max() < 0.02


def quartered(vertices, faces):
    """Every triangle as four."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, index = np.unique(edges, axis=0, return_inverse=True)
    ab, bc, ca = index.reshape(3, -1) + len(vertices)
    a, b, c = faces.T
    split = [np.stack(corners, 1) for corners in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.concatenate([vertices, vertices[unique].mean(1)]), np.concatenate(split)


class Shard:
    def __init__(self, rigs):
        self.rigs = rigs

    def __len__(self):
        return len(self.rigs)

    def __getitem__(self, k):
        return self.rigs[k]


def test_the_nearest_rig_is_stretched_to_the_box_and_never_the_character_itself():
    def rig(name, high, joints):
        vertices, faces = box_mesh([0, 0, 0], high)
        return Rig(vertices, faces, np.array(joints, float), np.array([-1, 0]), None, {"id": name})

    flat = rig("flat", [1, 1, 1], [[0.4, 0, 0], [1, 1, 1]])
    flat.vertices[:4] = [[0.4, 0, 0.4], [0.4, 0, 0.6], [0.4, 1, 0.4], [0.4, 1, 0.6]]  # a wedge
    near = baselines.NearestRig([Shard([flat, rig("cube", [1, 1, 1], [[0.5, 0, 0.5], [0.5, 1, 0.5]])])])
    vertices, faces = box_mesh([0, 0, 0], [0.2, 2, 0.4])
    joints, parents = near.skeleton(vertices, faces, "mine")
    assert joints == pytest.approx(np.array([[0.1, 0, 0.2], [0.1, 2, 0.2]])) and list(parents) == [-1, 0]
    assert near.skeleton(vertices, faces, "cube")[0][0] == pytest.approx([0, 0, 0])


def test_the_shortest_tree_and_the_central_joint():
    joints = np.array([[0, 0, 0], [3, 0, 0], [1, 0, 0], [2, 0, 0]], float)
    assert list(baselines.shortest_tree(joints, 0)) == [-1, 3, 0, 2]
    assert baselines.central_joint(joints) in (2, 3)


def test_a_bone_that_leaves_the_body_costs_two_a_sample():
    pairs, logit = np.array([[0, 1], [0, 2], [1, 2]]), np.zeros(3)
    outside = skeleton.outside_samples(np.array([0.1, 0.1, 0.1]), np.array([1.0, 0.9, 0.5]))
    assert list(outside) == [0, 1, 5]
    cost = skeleton.cost_matrix(3, pairs, logit, outside)
    assert cost[0, 1] == pytest.approx(np.log(2)) == cost[0, 2] and cost[1, 2] == pytest.approx(np.log(2) + 10)


def test_the_closest_bone_of_a_point_beyond_the_end_is_the_end_joints():
    points = np.array([[0.1, 0.4, 0], [0.1, 1.4, 0], [0.1, 2.5, 0]])
    assert list(baselines.closest_bone(points, ARM, CHAIN).argmax(1)) == [0, 1, 2]
    weights = baselines.inverse_distance(points, ARM, CHAIN)
    assert weights.sum(1) == pytest.approx(1) and list(weights[:2].argmax(1)) == [0, 1]


# ---- files and tables ----


def test_the_programs_rig_file_is_read_row_by_row():
    rig = {"joints": [{"name": "a", "parent": None, "position": [0, 0, 0]}, {"name": "b", "parent": 0, "position": [0, 1, 0]}],
           "skins": [{"joints": [[0], [1, 0]], "weights": [[1.0], [0.75, 0.25]]}]}
    made = program.rigged_of(rig, {}, 2)
    assert list(made.parents) == [-1, 0] and made.weights.tolist() == [[1, 0], [0.25, 0.75]]
    with pytest.raises(program.Refused):
        program.rigged_of(rig, {}, 3)


def test_copies_of_a_branching_joint_are_one_joint_again(tmp_path):
    text = ("joints hips 0 0 0\njoints hips_dup_0 0.1 0 0\njoints leg 0 -1 0\njoints arm 1 0 0\nroot hips\nskin 0 leg 1.0\n"
            "hier hips hips_dup_0\nhier hips_dup_0 leg\nhier leg arm\n")
    (tmp_path / "rig.txt").write_text(text)
    joints, parents = official_rig(tmp_path / "rig.txt")
    assert joints.tolist() == [[0, 0, 0], [0, -1, 0], [1, 0, 0]] and list(parents) == [-1, 0, 1]


def character(iou: float, rival: float) -> dict:
    return {"meta": {}, "failures": [], "figures": {
        "joints": {"rigsmith": {"iou": iou, "joint_ratio": 1.0}, "nearest_rig": {"iou": rival}},
        "rig": {"rigsmith": {"unweighted": 0.0, "not_finite": 0.0}}}}


def test_a_difference_is_paired_and_named_only_when_its_interval_excludes_zero():
    group = tables.summary([character(0.1 * k, 0.1 * k - 0.05) for k in range(1, 9)])
    means = group["stages"]["joints"]["rigsmith"]["iou"]
    difference = group["differences"]["joints"]["nearest_rig"]["iou"]
    assert means["mean"] == pytest.approx(0.45) and means["interval"][1] - means["interval"][0] > 0.2
    assert difference["interval"] == pytest.approx((0.05, 0.05)) and tables.verdict(difference, less_is_better=False) == "better"
    assert tables.verdict(difference, less_is_better=True) == "worse"
    assert tables.verdict({"interval": (-0.1, 0.2)}, True) == "open"
    assert group["stages"]["joints"]["rigsmith"]["cd_j2j"] is None, "a figure that nobody has is no number"
    text = "\n".join(tables.group_text("Organic", json.loads(json.dumps(group))))
    assert "0.450" in text and "+0.050 [+0.050, +0.050] better" in text and "medial_points" not in text


def test_a_picture_row_has_four_cells():
    vertices, faces = box_mesh([0, 0, 0], [0.5, 1, 0.5])
    weights = np.eye(3)[[0] * 4 + [1] * 4]
    row = pictures.row(vertices, faces, (ARM / 2, CHAIN, weights), (ARM / 2, CHAIN), weights, "box")
    assert row.size == (4 * pictures.CELL, pictures.CELL + 16)
    assert pictures.sheet([row, row]).size[1] == 2 * row.size[1]
