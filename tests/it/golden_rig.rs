//! Rig assembly against the golden vectors of the RigNet reference: each stage at its own output.

use crate::golden::{Case, cases};
use glam::DVec3;
use rigsmith::cancellation::Cancellation;
use rigsmith::geometry::bone_pairs::samples;
use rigsmith::geometry::symmetry_plane::SymmetryPlane;
use rigsmith::mesh::adjacency::Neighbors;
use rigsmith::rig::Skeleton;
use rigsmith::rig::bone_features::{BONE_CHANNELS, BoneFeatures, NEAREST_BONES, bone_features};
use rigsmith::rig::bone_weights::{BoneWeights, PUBLISHED_PRUNE_SHARE};
use rigsmith::rig::detect_joints::{Evidence, Fineness, detect_joints};
use rigsmith::rig::joint_clustering::{MeanShift, ModeRule, dense_points, mean_shift, summed_density};
use rigsmith::rig::non_maximum_suppression::suppress_non_maxima;
use rigsmith::rig::spanning_tree::{
    BoneCosts, OutsideRule, Tree, middle_root, minimum_spanning_tree, symmetric_spanning_tree,
};
use rigsmith::rig::symmetrize::{MIDDLE_BAND, Side, symmetrize_joints, with_images};

/// The plane that the reference mirrors about.
const X_ZERO: SymmetryPlane = SymmetryPlane { normal: DVec3::X, offset: 0.0, score: 1.0 };

fn farthest(ours: &[DVec3], golden: &[DVec3]) -> f64 {
    assert_eq!(ours.len(), golden.len());
    ours.iter().zip(golden).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}

fn largest_difference(ours: &[f32], golden: &[f32]) -> f32 {
    assert_eq!(ours.len(), golden.len());
    ours.iter().zip(golden).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

fn sides(case: &Case, name: &str) -> Vec<Side> {
    let side = |side: i64| [Side::Negative, Side::Middle, Side::Positive][(side + 1) as usize];
    case.ints(name).into_iter().map(side).collect()
}

fn parents(case: &Case, name: &str) -> Vec<Option<usize>> {
    case.ints(name).into_iter().map(|parent| usize::try_from(parent).ok()).collect()
}

fn shifted(case: &Case, updates: usize) -> Vec<DVec3> {
    let rule = MeanShift { iterations_max: updates, ..MeanShift::published(case.scalar("cluster_bandwidth")) };
    let (points, attention) = (case.points("cluster_q_in"), case.f64s("cluster_attention_in"));
    mean_shift(&points, &attention, None, &rule, &Cancellation::default()).expect("not cancelled")
}

#[test]
fn golden_points_are_followed_by_their_images() {
    for case in cases() {
        let points = case.points("cluster_q_in");
        let (originals, images) = points.split_at(points.len() / 2);
        assert_eq!(with_images(originals, &X_ZERO)[originals.len()..], *images, "{}", case.id);
    }
}

#[test]
fn golden_mean_shift_agrees_after_one_step_and_at_the_stop() {
    for case in cases() {
        assert!(farthest(&shifted(&case, 1), &case.points("cluster_after_one_step")) < 1e-6, "{}", case.id);
        let updates = case.scalar("cluster_max_iter") as usize - 1;
        assert!(farthest(&shifted(&case, updates), &case.points("cluster_converged")) < 1e-6, "{}", case.id);
    }
}

#[test]
fn golden_modes_follow_from_the_converged_points() {
    for case in cases() {
        let bandwidth = case.scalar("cluster_bandwidth");
        let points = case.points("cluster_converged");
        let density = summed_density(&points, bandwidth);
        for (ours, golden) in density.iter().zip(case.f64s("cluster_density")) {
            assert!((ours - golden).abs() < 1e-6 * golden.max(1.0), "{}: density {ours}, not {golden}", case.id);
        }
        let rule = ModeRule::ShareOfSummedDensity(case.scalar("cluster_threshold"));
        let dense = dense_points(&density, &case.f64s("cluster_attention_in"), rule);
        let kept: Vec<DVec3> = dense.iter().map(|&point| points[point]).collect();
        let kept_density: Vec<f64> = dense.iter().map(|&point| density[point]).collect();
        let modes: Vec<DVec3> =
            suppress_non_maxima(&kept, &kept_density, |_| bandwidth).into_iter().map(|mode| kept[mode]).collect();
        let golden = case.points("cluster_modes");
        assert_eq!(modes.len(), golden.len(), "{}", case.id);
        // A middle mode and its image are equally dense but for the last digit: which of them survives, and so where it
        // stands in the list, is left open. They are less than 1e-4 apart.
        for mode in &golden {
            let nearest = modes.iter().map(|ours| ours.distance(*mode)).fold(f64::INFINITY, f64::min);
            assert!(nearest < 1e-4, "{}: no mode near {mode}, but {nearest} away", case.id);
        }
    }
}

#[test]
fn golden_modes_are_symmetrized_to_the_same_joints() {
    for case in cases() {
        let sided = symmetrize_joints(&case.points("cluster_modes"), &X_ZERO, MIDDLE_BAND);
        assert!(farthest(&sided.positions, &case.points("cluster_joints")) < 1e-12, "{}", case.id);
        assert_eq!(sided.sides, sides(&case, "cluster_joint_side"), "{}", case.id);
    }
}

#[test]
fn golden_evidence_gives_official_joints_and_few_are_missed_with_our_own_rules() {
    for case in cases() {
        let (vertices, displaced) = (case.points("vertices"), case.points("cluster_q_all"));
        let attention = case.f64s("cluster_attention_all");
        let evidence = Evidence { vertices: &vertices, displaced: &displaced, attention: &attention };
        let found = detect_joints(&evidence, None, Some(&X_ZERO), Fineness::Detail(0.5), &Cancellation::default())
            .expect("joints");
        let official = case.points("joints");
        let distance =
            |joint: &DVec3, to: &[DVec3]| to.iter().map(|o| o.distance(*joint)).fold(f64::INFINITY, f64::min);
        for joint in &found.positions {
            assert!(distance(joint, &official) < 0.01, "{}: {joint} is no official joint", case.id);
        }
        let missed = official.iter().filter(|joint| distance(joint, &found.positions) > 0.01).count();
        assert!(missed * 10 <= official.len(), "{}: {missed} of {} missed", case.id, official.len());
    }
}

/// Samples of each pair that are outside the reference's solid.
fn outside_counts(case: &Case, joints: &[DVec3], pairs: &[[usize; 2]]) -> Vec<usize> {
    let shares = case.f64s("pair_attr");
    let outside = pairs.iter().zip(shares.chunks_exact(2)).map(|(&[a, b], attributes)| {
        let count = samples(joints[a], joints[b]).count();
        assert!((joints[a].distance(joints[b]) - attributes[0]).abs() < 1e-6, "{}", case.id);
        count - (attributes[1] * count as f64).round() as usize
    });
    outside.collect()
}

fn cost_matrices(case: &Case, name: &str) -> Vec<Vec<f64>> {
    let joint_count = case.shape(name)[1];
    case.f64s(name).chunks_exact(joint_count * joint_count).map(<[f64]>::to_vec).collect()
}

#[test]
fn golden_costs_are_corrected_as_published_with_the_replace_rule() {
    for case in cases() {
        let joints = case.points("joints");
        let pairs: Vec<[usize; 2]> =
            case.ints("pairs").chunks_exact(2).map(|pair| [pair[0] as usize, pair[1] as usize]).collect();
        let outside = outside_counts(&case, &joints, &pairs);
        let sides = sides(&case, "joint_side");
        for (raw, golden) in cost_matrices(&case, "mst_cost_raw").iter().zip(cost_matrices(&case, "mst_cost")) {
            let mut costs = BoneCosts::from_matrix(joints.len(), raw);
            costs.correct(&pairs, &outside, Some(&sides), OutsideRule::Replace);
            for &[a, b] in &pairs {
                let (ours, golden) = (costs.between(a, b), golden[a * joints.len() + b]);
                assert!((ours - golden).abs() < 1e-9, "{}: cost {a}-{b} {ours}, not {golden}", case.id);
            }
        }
    }
}

#[test]
fn golden_trees_are_the_same_plain_and_symmetric() {
    for case in cases() {
        let (joints, sides) = (case.points("joints"), sides(&case, "joint_side"));
        let (roots, symmetric_roots) = (case.ints("mst_root"), case.ints("mst_root_symmetric"));
        let plain = parents(&case, "mst_parent_plain");
        let symmetric = parents(&case, "mst_parent_symmetric");
        let keys = case.f64s("mst_key_symmetric");
        for (run, matrix) in cost_matrices(&case, "mst_cost").iter().enumerate() {
            let (costs, row) =
                (BoneCosts::from_matrix(joints.len(), matrix), run * joints.len()..(run + 1) * joints.len());
            let root = roots[run] as usize;
            assert_eq!(minimum_spanning_tree(&costs, root).parents, plain[row.clone()], "{} run {run}", case.id);
            assert_eq!(middle_root(&joints, &sides, root), symmetric_roots[run] as usize, "{} run {run}", case.id);
            let tree = symmetric_spanning_tree(&costs, &joints, &sides, root);
            assert_eq!(tree.parents, symmetric[row.clone()], "{} run {run}", case.id);
            for (ours, golden) in tree.keys.iter().zip(&keys[row]) {
                assert!((ours - golden).abs() < 1e-9, "{} run {run}: key {ours}, not {golden}", case.id);
            }
        }
    }
}

/// The official skeleton in our order, and each joint's index in the golden order.
fn official_skeleton(case: &Case) -> (Skeleton, Vec<usize>) {
    let parents = parents(case, "skel_parent");
    let tree = Tree { root: case.scalar("skel_root") as usize, keys: vec![0.0; parents.len()], parents };
    Skeleton::from_tree(&case.points("skel_joints"), &tree)
}

#[test]
fn golden_bones_are_the_same_in_the_same_order() {
    for case in cases() {
        let (skeleton, order) = official_skeleton(&case);
        let bones = skeleton.bones();
        let joints: Vec<i64> =
            bones.iter().flat_map(|bone| [order[bone.start_joint] as i64, order[bone.end_joint] as i64]).collect();
        assert_eq!(joints, case.ints("bone_joints"), "{}", case.id);
        let leaf: Vec<i64> = bones.iter().map(|bone| i64::from(bone.is_leaf())).collect();
        assert_eq!(leaf, case.ints("bone_leaf"), "{}", case.id);
        let ends: Vec<DVec3> = bones.iter().flat_map(|bone| [bone.start, bone.end]).collect();
        assert!(farthest(&ends, &case.points("bones")) < 1e-6, "{}", case.id);
    }
}

#[test]
fn golden_skin_features_follow_from_the_distances() {
    for case in cases() {
        let distance = case.f32s("bone_volumetric");
        let bones = official_skeleton(&case).0.bones();
        let features = bone_features(&distance, &bones);
        let golden_nearest = case.ints("skin_nearest");
        let golden_values = case.f32s("skin_features");
        let mut swapped = 0;
        for (slot, (&ours, &golden)) in features.nearest.iter().zip(&golden_nearest).enumerate() {
            let row = slot / NEAREST_BONES * bones.len();
            assert_eq!(distance[row + ours as usize], distance[row + golden as usize], "{} slot {slot}", case.id);
            if i64::from(ours) != golden {
                swapped += 1;
                continue;
            }
            let channels = slot * BONE_CHANNELS..(slot + 1) * BONE_CHANNELS;
            for (ours, golden) in features.values[channels.clone()].iter().zip(&golden_values[channels]) {
                assert!(
                    (ours - golden).abs() <= 1e-5 * golden.abs().max(1.0),
                    "{} slot {slot}: {ours}, not {golden}",
                    case.id
                );
            }
        }
        // A leaf bone is as far as the end of the bone before it, for all vertices beyond that end.
        assert!(swapped * 5 <= golden_nearest.len(), "{}: {swapped} of {} slots differ", case.id, golden_nearest.len());
    }
}

fn one_ring(case: &Case) -> Neighbors {
    let mut rows = vec![Vec::new(); case.shape("vertices")[0]];
    for edge in case.ints("tpl_edges").chunks_exact(2) {
        rows[edge[0] as usize].push(edge[1] as u32);
    }
    Neighbors::from_rows(&rows)
}

#[test]
fn golden_weights_agree_before_and_after_filter_and_at_the_end() {
    for case in cases() {
        let nearest: Vec<u32> = case.ints("skin_nearest").into_iter().map(|bone| bone as u32).collect();
        let features = BoneFeatures { values: Vec::new(), mask: vec![1.0; nearest.len()], nearest };
        let bone_count = case.shape("bone_volumetric")[1];
        let before = BoneWeights::from_logits(&case.f32s("net_skin_logit"), &features, bone_count);
        assert!(
            largest_difference(&before.values, &case.f32s("skin_bone_weights_before_filter")) < 1e-6,
            "{}",
            case.id
        );
        let after = before.one_ring_mean(&one_ring(&case));
        assert!(largest_difference(&after.values, &case.f32s("skin_bone_weights_after_filter")) < 1e-6, "{}", case.id);
        let last = after.pruned(PUBLISHED_PRUNE_SHARE);
        assert!(largest_difference(&last.values, &case.f32s("skin_bone_weights_final")) < 1e-6, "{}", case.id);
    }
}
