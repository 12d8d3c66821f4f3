//! What the skin network reads of each vertex's nearest bones. RigNet [Xu et al. 2020], Section 4.3.
//!
//! | in         | shape    | unit                                                        |
//! |------------|----------|-------------------------------------------------------------|
//! | `distance` | `[V, B]` | volumetric geodesic distance, normalised                    |
//! | `bones`    | `[B]`    | segments, normalised frame                                  |
//!
//! Out, per vertex and per one of its K = 5 nearest bones, nearest first: start (3), end (3), 1 / (distance + 1e-10), leaf flag.
//! The inverse distance has no upper bound (1e10 for a vertex on a bone); the network clamps what it reads.
//! # Departures from the paper
//! - The leaf flag, which the published code adds (K × 8 numbers instead of K × 7).
//! - With fewer than five bones the empty slots repeat the nearest bone and are masked; they never write weights. In the
//!   published code they overwrite the weight of bone 0 with zero.

use super::skeleton::Bone;
use rayon::prelude::*;

/// K: how many bones compete for a vertex.
pub const NEAREST_BONES: usize = 5;
/// Numbers per bone.
pub const BONE_CHANNELS: usize = 8;
/// Keeps the inverse finite (published value).
const DISTANCE_FLOOR: f64 = 1e-10;

/// Features of each vertex's nearest bones.
#[derive(Clone, Debug, PartialEq)]
pub struct BoneFeatures {
    /// `[V, K · 8]` row-major.
    pub values: Vec<f32>,
    /// `[V, K]`: 1 for a bone, 0 for an empty slot.
    pub mask: Vec<f32>,
    /// `[V, K]`: which bone each slot is; an empty slot repeats the nearest.
    pub nearest: Vec<u32>,
}

/// Features for every vertex. Equal distances are ordered by bone index; a distance that is no number comes last.
///
/// Without bones there are no features: all three arrays are empty.
pub fn bone_features(distance: &[f32], bones: &[Bone]) -> BoneFeatures {
    if bones.is_empty() {
        return BoneFeatures { values: Vec::new(), mask: Vec::new(), nearest: Vec::new() };
    }
    let nearest: Vec<[u32; NEAREST_BONES]> = distance.par_chunks_exact(bones.len()).map(nearest_bones).collect();
    let filled = bones.len().min(NEAREST_BONES);
    let values = nearest.iter().zip(distance.chunks_exact(bones.len()));
    let values =
        values.flat_map(|(row, distance)| row.map(|bone| describe(&bones[bone as usize], distance[bone as usize])));
    BoneFeatures {
        values: values.flatten().collect(),
        mask: nearest.iter().flat_map(|_| (0..NEAREST_BONES).map(|slot| f32::from(slot < filled))).collect(),
        nearest: nearest.into_iter().flatten().collect(),
    }
}

/// The bones of least distance, ascending; the nearest again where there are fewer than K.
fn nearest_bones(distance: &[f32]) -> [u32; NEAREST_BONES] {
    let mut order: Vec<u32> = (0..distance.len() as u32).collect();
    let compare = |a: &u32, b: &u32| {
        let (left, right) = (distance[*a as usize], distance[*b as usize]);
        left.is_nan().cmp(&right.is_nan()).then(left.total_cmp(&right)).then(a.cmp(b))
    };
    if order.len() > NEAREST_BONES {
        order.select_nth_unstable_by(NEAREST_BONES - 1, compare);
        order.truncate(NEAREST_BONES);
    }
    order.sort_unstable_by(compare);
    std::array::from_fn(|slot| order.get(slot).copied().unwrap_or(order[0]))
}

fn describe(bone: &Bone, distance: f32) -> [f32; BONE_CHANNELS] {
    let (start, end) = (bone.start.as_vec3(), bone.end.as_vec3());
    let inverse = (1.0 / (f64::from(distance) + DISTANCE_FLOOR)) as f32;
    [start.x, start.y, start.z, end.x, end.y, end.z, inverse, f32::from(bone.is_leaf())]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn bone(at: f64) -> Bone {
        Bone { start: DVec3::X * at, end: DVec3::X * (at + 1.0), start_joint: 0, end_joint: 1 }
    }

    #[test]
    fn the_nearest_bones_come_first_and_ties_go_to_the_lower_index() {
        let bones: Vec<Bone> = (0..7).map(|k| bone(f64::from(k))).collect();
        let features = bone_features(&[0.9, 0.2, 0.5, 0.2, 0.1, f32::NAN, 0.7], &bones);
        assert_eq!(features.nearest, [4, 1, 3, 2, 6]);
        assert_eq!(features.mask, [1.0; 5]);
        assert_eq!(features.values[..8], [4.0, 0.0, 0.0, 5.0, 0.0, 0.0, 10.0, 0.0]);
    }

    #[test]
    fn empty_slots_repeat_the_nearest_bone_and_are_masked() {
        let features = bone_features(&[0.4, 0.2], &[bone(0.0), bone(1.0)]);
        assert_eq!(features.nearest, [1, 0, 1, 1, 1]);
        assert_eq!(features.mask, [1.0, 1.0, 0.0, 0.0, 0.0]);
        assert_eq!(features.values[16..24], features.values[..8]);
    }

    #[test]
    fn a_vertex_on_a_bone_has_finite_features() {
        assert_eq!(bone_features(&[0.0], &[bone(0.0)]).values[6], 1e10);
    }
}
