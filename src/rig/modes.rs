//! Modes of displaced points at one bandwidth. RigNet [Xu et al. 2020], Section 4.1, Eq. 6.
//!
//! Points that say something, mirrored about the plane, are gathered by mean shift and thinned to one per place on one side of
//! the plane. Frame, units and departures: [`super::detect_joints`].

use super::detect_joints::{BANDWIDTH_DEFAULT, Evidence};
use super::joint_clustering::{MeanShift, ModeRule, attention_density, dense_points, mean_shift, scaled_attention};
use super::non_maximum_suppression::survivors_by_density;
use super::symmetrize::{MIDDLE_BAND, fold, with_images};
use crate::cancellation::{Cancellation, Cancelled};
use crate::geometry::symmetry_plane::SymmetryPlane;
use crate::geometry::voxel_grid::VoxelGrid;
use glam::DVec3;

/// Scaled attention at or below this says nothing (published value).
const ATTENTION_MIN: f64 = 1e-3;
/// Least share of the total attention that a mode gathers at the default bandwidth (on 30 validation characters, whole
/// pipeline: IoU .406 and CD-J2J 6.9 % at .005, .389 and 7.1 % at .01; the published rule finds
/// twice too many joints); it scales with the bandwidth.
const MODE_SHARE: f64 = 0.005;
/// Suppression radius in parts of the mean displacement around a mode, where that is above the bandwidth: as calibrated
/// (on three networks it neither helped reliably nor hurt).
const SPREAD_FACTOR: f64 = 0.5;
/// The solid is believed if at least this share of the attention is inside it. (Never asking it: IoU .366 instead of .406.)
const INSIDE_ATTENTION_MIN: f64 = 0.5;

/// A place where points gathered, on the negative side of the plane or on it (anywhere without a plane).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Mode {
    pub position: DVec3,
    /// Share of the total attention gathered here.
    pub density: f64,
    /// 2 for a mode that has a mirror image, else 1.
    pub joint_count: usize,
}

pub(super) fn joint_count(modes: &[Mode]) -> usize {
    modes.iter().map(|mode| mode.joint_count).sum()
}

/// The least share of attention that a mode of this bandwidth gathers.
pub(super) fn mode_share(bandwidth: f64) -> f64 {
    MODE_SHARE * bandwidth / BANDWIDTH_DEFAULT
}

/// Displaced points that say something, with their mirror images. `[M]`
pub(super) struct PointCloud<'a> {
    points: Vec<DVec3>,
    attention: Vec<f64>,
    /// How far each point was moved by the network.
    displacement: Vec<f64>,
    plane: Option<&'a SymmetryPlane>,
}

impl<'a> PointCloud<'a> {
    pub fn new(evidence: &Evidence, solid: Option<&VoxelGrid>, plane: Option<&'a SymmetryPlane>) -> Self {
        let attention = scaled_attention(evidence.attention);
        let says = |&v: &usize| attention[v] > ATTENTION_MIN && evidence.displaced[v].is_finite();
        let speaking: Vec<usize> = (0..evidence.displaced.len()).filter(says).collect();
        let inside: Vec<usize> = match solid {
            Some(solid) => speaking.iter().copied().filter(|&v| solid.contains(evidence.displaced[v])).collect(),
            None => speaking.clone(),
        };
        let total = |vertices: &[usize]| vertices.iter().map(|&v| attention[v]).sum::<f64>();
        let kept = if total(&inside) >= INSIDE_ATTENTION_MIN * total(&speaking) { inside } else { speaking };
        let points: Vec<DVec3> = kept.iter().map(|&v| evidence.displaced[v]).collect();
        let twice = |values: Vec<f64>| if plane.is_some() { values.repeat(2) } else { values };
        Self {
            attention: twice(kept.iter().map(|&v| attention[v]).collect()),
            displacement: twice(kept.iter().map(|&v| evidence.vertices[v].distance(evidence.displaced[v])).collect()),
            points: plane.map_or_else(|| points.clone(), |plane| with_images(&points, plane)),
            plane,
        }
    }

    /// Modes at one bandwidth, densest first, farther apart than it; likewise from the images of others.
    pub fn modes(
        &self,
        bandwidth: f64,
        share_factor: f64,
        cancellation: &Cancellation,
    ) -> Result<Vec<Mode>, Cancelled> {
        let gathered = mean_shift(&self.points, &self.attention, &MeanShift::ours(bandwidth), cancellation)?;
        let density = attention_density(&gathered, &self.attention, bandwidth);
        let rule = ModeRule::ShareOfAttention(mode_share(bandwidth) * share_factor);
        let dense = dense_points(&density, &self.attention, rule);
        let positions: Vec<DVec3> = dense.iter().map(|&point| gathered[point]).collect();
        let (half, positions) = match self.plane {
            Some(plane) => fold(&positions, plane, middle_band(bandwidth)),
            None => ((0..positions.len()).collect(), positions),
        };
        let total: f64 = self.attention.iter().sum();
        let density: Vec<f64> = half.iter().map(|&point| density[dense[point]] / total).collect();
        let radius = |at: usize| {
            let spread = self.mean_displacement(&gathered, gathered[dense[half[at]]], bandwidth);
            bandwidth * (SPREAD_FACTOR * spread / BANDWIDTH_DEFAULT).max(1.0)
        };
        let modes = survivors_by_density(&positions, &density, radius).into_iter().map(|at| Mode {
            position: positions[at],
            density: density[at],
            joint_count: self.plane.map_or(1, |plane| if plane.signed_distance(positions[at]) < -1e-9 { 2 } else { 1 }),
        });
        Ok(modes.collect())
    }

    /// How far the points gathered around `center` were moved by the network, weighted by attention.
    fn mean_displacement(&self, gathered: &[DVec3], center: DVec3, bandwidth: f64) -> f64 {
        let near = (0..gathered.len()).filter(|&point| gathered[point].distance(center) < bandwidth);
        let (moved, attention) = near.fold((0.0, 0.0), |(moved, attention), point| {
            (moved + self.attention[point] * self.displacement[point], attention + self.attention[point])
        });
        if attention > 0.0 { moved / attention } else { 0.0 }
    }
}

/// Modes nearer to the plane than half a bandwidth are one joint with their image.
fn middle_band(bandwidth: f64) -> f64 {
    MIDDLE_BAND.max(0.5 * bandwidth)
}
