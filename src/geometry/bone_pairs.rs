//! What the bone network and the spanning tree want to know of a segment between two joints.
//! RigNet [Xu et al. 2020], Section 4.2 (features of a candidate bone).
//!
//! All in the normalised frame. Samples: n = round(length / [`STEP`]) points from the start (excluded) to the end
//! (included), as in the published code.

use super::voxel_grid::VoxelGrid;
use glam::DVec3;

/// Distance between samples on a bone.
pub const STEP: f64 = 0.01;

/// A segment between two joints, measured against the solid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BonePair {
    pub length: f64,
    pub sample_count: usize,
    /// Samples that are not inside.
    pub outside_count: usize,
}

impl BonePair {
    pub fn new(start: DVec3, end: DVec3, solid: &VoxelGrid) -> Self {
        let length = start.distance(end);
        let sample_count = sample_count(length);
        let outside = samples(start, end).filter(|&sample| !solid.contains(sample)).count();
        Self { length, sample_count, outside_count: outside }
    }

    /// The part of the samples that lies inside; 0 for a bone too short to have samples.
    pub fn inside_share(&self) -> f64 {
        (self.sample_count - self.outside_count) as f64 / (self.sample_count as f64 + 1e-10)
    }
}

/// Ties to even, as the published code rounds. At most [`SAMPLES_MAX`].
fn sample_count(length: f64) -> usize {
    ((length / STEP).round_ties_even() as usize).min(SAMPLES_MAX)
}

/// Bones are at most √3 long in the normalised frame (174 samples); joints far outside are cut off here.
const SAMPLES_MAX: usize = 10_000;

/// The samples on a bone.
pub fn samples(start: DVec3, end: DVec3) -> impl Iterator<Item = DVec3> {
    let count = sample_count(start.distance(end));
    (1..=count).map(move |k| start + (end - start) * (k as f64 / count as f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::sphere;

    #[test]
    fn half_of_a_bone_that_leaves_through_the_surface_is_outside() {
        let solid = VoxelGrid::solid(&sphere(DVec3::ZERO, 0.5, 40));
        let pair = BonePair::new(DVec3::ZERO, DVec3::X, &solid);
        assert_eq!((pair.length, pair.sample_count), (1.0, 100));
        assert!((pair.inside_share() - 0.5).abs() < 0.02, "{}", pair.inside_share());
        assert_eq!(BonePair::new(DVec3::ZERO, DVec3::Y * 0.3, &solid).outside_count, 0);
    }

    #[test]
    fn short_bones_have_no_samples_and_share_nothing() {
        let solid = VoxelGrid::solid(&sphere(DVec3::ZERO, 0.5, 40));
        let pair = BonePair::new(DVec3::ZERO, DVec3::X * 0.004, &solid);
        assert_eq!((pair.sample_count, pair.inside_share()), (0, 0.0));
        assert_eq!(samples(DVec3::ZERO, DVec3::X * 1e12).count(), SAMPLES_MAX);
    }

    #[test]
    fn samples_leave_out_the_start_and_end_at_the_end() {
        let all: Vec<DVec3> = samples(DVec3::ZERO, DVec3::X * 0.03).collect();
        assert_eq!(all.len(), 3);
        assert_eq!(all[2], DVec3::X * 0.03);
        assert!(all[0].distance(DVec3::X * 0.01) < 1e-15);
    }
}
