//! Skin weights that fall with the distance from the bones. Geodesic voxel binding [Dionne and de Lasa 2013], Section 4.
//!
//! | in         | shape    | unit                                  |
//! |------------|----------|---------------------------------------|
//! | `distance` | `[V, B]` | through the solid, normalised frame   |
//!
//! Out: weights over bones, `[V, B]`, rows of sum 1 (0 where no bone has a finite distance).
//! # Departures from the paper
//! - Bones that leave one joint move together, so the joint is as far as the nearest of them; theirs weighs influences one by
//!   one, which favours joints with many children.
//! - The exponent is a parameter; theirs is 2, which blends limbs into the trunk.

use super::bone_weights::BoneWeights;
use super::skeleton::Bone;
use rayon::prelude::*;

/// How weights fall with distance: `w = ((1 − λ) d + λ d²)^−p`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Falloff {
    /// λ, 0 to 1.
    pub quadratic_share: f64,
    /// p; the paper's is 2.
    pub exponent: f64,
}

/// What rigs are made with, together with the two constants below.
///
/// On 76 training rigs with their own skeletons, organic / box: mean L1 .60 / .80, precision .74 / .45, recall .80 / .91. Exponent 2
/// (the paper's) with the same smoothing: .84 / 1.1; 6: .64 / .88; 20 and 30: the same within .01 with less recall. λ of 0 and .5
/// change L1 by less than .01. Measured with leaf bones that go on to the surface, before `nearest_of_joints` passed over
/// the bones that end in them.
pub const FALLOFF: Falloff = Falloff { quadratic_share: 0.2, exponent: 14.0 };
/// How often the falloff's rows are smoothed over the one-ring: exponents that artists' weights ask for leave ragged edges ...
pub const VOXEL_SMOOTHINGS: usize = 4;
/// ... and what is dropped then, as a share of a row's greatest.
pub const VOXEL_TRACE_SHARE: f32 = 0.1;

/// Nearer than this (normalised) a vertex belongs to the bone alone; keeps the weight finite.
const DISTANCE_MIN: f64 = 1e-6;

/// Weights of every vertex over `bones` from its `distance` to each `[V, B]`.
pub fn falloff_weights(distance: &[f32], bones: &[Bone], falloff: &Falloff) -> BoneWeights {
    let mut values = vec![0.0; distance.len()];
    if bones.is_empty() {
        return BoneWeights { bone_count: 0, values };
    }
    values.par_chunks_exact_mut(bones.len()).zip(distance.par_chunks_exact(bones.len())).for_each(|(row, distance)| {
        let nearest = nearest_of_joints(distance, bones);
        let least = nearest.iter().flatten().map(|&bone| distance[bone]).fold(f32::INFINITY, f32::min);
        let against_least = |bone: usize| share(distance[bone], falloff) / share(least, falloff);
        let shares: Vec<(usize, f64)> = nearest.into_iter().flatten().map(|bone| (bone, against_least(bone))).collect();
        let sum: f64 = shares.iter().map(|(_, share)| share).sum();
        for (bone, share) in shares {
            row[bone] = (share / sum) as f32;
        }
    });
    BoneWeights { bone_count: bones.len(), values }
}

/// A bone that is nearer than this share of its leaf bone's distance is nearer along its length, not by its end.
const NEARER: f32 = 0.98;

/// For each joint the nearest of the bones that leave it, if any has a finite distance; ties to the lower index.
///
/// A bone that ends in a leaf joint is as near as that joint to all that lies beyond it: a head beyond its neck, a hand beyond its
/// arm. There the leaf joint answers alone.
pub(super) fn nearest_of_joints(distance: &[f32], bones: &[Bone]) -> Vec<Option<usize>> {
    let joint_count = bones.iter().map(|bone| bone.start_joint + 1).max().unwrap_or(0);
    let mut nearest: Vec<Option<usize>> = vec![None; joint_count];
    let beyond_its_end = |index: usize| {
        let leaf = bones.get(index + 1).filter(|next| next.is_leaf() && next.start_joint == bones[index].end_joint);
        !bones[index].is_leaf() && leaf.is_some() && distance[index] >= NEARER * distance[index + 1]
    };
    let in_reach = |&(index, _): &(usize, &Bone)| distance[index].is_finite() && !beyond_its_end(index);
    for (index, bone) in bones.iter().enumerate().filter(in_reach) {
        let known = &mut nearest[bone.start_joint];
        if known.is_none_or(|known| distance[index] < distance[known]) {
            *known = Some(index);
        }
    }
    nearest
}

fn share(distance: f32, falloff: &Falloff) -> f64 {
    let distance = f64::from(distance).max(DISTANCE_MIN);
    let blended = (1.0 - falloff.quadratic_share) * distance + falloff.quadratic_share * distance * distance;
    blended.powf(-falloff.exponent)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use proptest::prelude::*;

    fn bone(start_joint: usize) -> Bone {
        Bone { start: DVec3::ZERO, end: DVec3::ZERO, start_joint, end_joint: start_joint + 1 }
    }

    const PAPER: Falloff = Falloff { quadratic_share: 0.0, exponent: 2.0 };

    #[test]
    fn twice_as_far_weighs_a_quarter_by_the_papers_rule() {
        let weights = falloff_weights(&[0.1, 0.2, f32::INFINITY], &[bone(0), bone(1), bone(2)], &PAPER);
        assert!((weights.values[0] - 0.8).abs() < 1e-6 && (weights.values[1] - 0.2).abs() < 1e-6);
        assert_eq!(weights.values[2], 0.0);
    }

    #[test]
    fn bones_of_one_joint_count_once() {
        let weights = falloff_weights(&[0.1, 0.1, 0.2], &[bone(0), bone(0), bone(1)], &PAPER);
        assert!((weights.values[0] - 0.8).abs() < 1e-6, "{:?}", weights.values);
        assert_eq!(weights.values[1], 0.0);
    }

    #[test]
    fn a_vertex_that_no_bone_reaches_has_no_weight() {
        assert_eq!(falloff_weights(&[f32::INFINITY; 2], &[bone(0), bone(1)], &PAPER).values, [0.0, 0.0]);
        assert!(falloff_weights(&[], &[], &PAPER).values.is_empty());
    }

    proptest! {
        #[test]
        fn rows_sum_to_one_and_nearer_joints_never_weigh_less(
            distance in prop::collection::vec(0.0..2.0f32, 1..12), exponent in 1.0..8.0f64, quadratic_share in 0.0..1.0f64,
        ) {
            let bones: Vec<Bone> = (0..distance.len()).map(bone).collect();
            let row = falloff_weights(&distance, &bones, &Falloff { quadratic_share, exponent }).values;
            prop_assert!((row.iter().sum::<f32>() - 1.0).abs() < 1e-5);
            for (a, b) in (0..row.len()).flat_map(|a| (0..row.len()).map(move |b| (a, b))) {
                prop_assert!(distance[a] > distance[b] || row[a] >= row[b]);
            }
        }
    }
}
