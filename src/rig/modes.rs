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
/// Least share of the total attention that a mode gathers at the default bandwidth; it scales with the bandwidth (on 30
/// validation characters, whole pipeline: IoU .501, .505, .515 and CD-J2J 5.09, 5.12, 5.22 % at .0034, .0038, .0051; the published
/// rule finds twice too many joints).
const MODE_SHARE: f64 = 0.0038;
/// Suppression radius in parts of the mean displacement around a mode, where that is above the bandwidth (likewise: IoU .491, .505,
/// .525, .480 and CD-J2J 5.20, 5.12, 5.20, 5.54 % at .25, .38, .5, .68).
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

/// Displaced points that say something. With a plane each of them stands for its mirror image too. `[M]`
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
        Self {
            attention: kept.iter().map(|&v| attention[v]).collect(),
            displacement: kept.iter().map(|&v| evidence.vertices[v].distance(evidence.displaced[v])).collect(),
            points: kept.iter().map(|&v| evidence.displaced[v]).collect(),
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
        let rule = MeanShift::ours(bandwidth);
        let gathered = mean_shift(&self.points, &self.attention, self.plane, &rule, cancellation)?;
        let density = attention_density(&gathered, &self.attention, self.plane, bandwidth);
        let (gathered, density, attention, displacement) = match self.plane {
            Some(plane) => (
                with_images(&gathered, plane),
                density.repeat(2),
                self.attention.repeat(2),
                self.displacement.repeat(2),
            ),
            None => (gathered, density, self.attention.clone(), self.displacement.clone()),
        };
        let rule = ModeRule::ShareOfAttention(mode_share(bandwidth) * share_factor);
        let dense = dense_points(&density, &attention, rule);
        let positions: Vec<DVec3> = dense.iter().map(|&point| gathered[point]).collect();
        let (half, positions) = match self.plane {
            Some(plane) => fold(&positions, plane, middle_band(bandwidth)),
            None => ((0..positions.len()).collect(), positions),
        };
        let total: f64 = attention.iter().sum();
        let density: Vec<f64> = half.iter().map(|&point| density[dense[point]] / total).collect();
        let radius = |at: usize| {
            let center = gathered[dense[half[at]]];
            let spread = mean_around(center, bandwidth, &gathered, &displacement, &attention);
            bandwidth * (SPREAD_FACTOR * spread / BANDWIDTH_DEFAULT).max(1.0)
        };
        let modes = survivors_by_density(&positions, &density, radius).into_iter().map(|at| Mode {
            position: positions[at],
            density: density[at],
            joint_count: self.plane.map_or(1, |plane| if plane.signed_distance(positions[at]) < -1e-9 { 2 } else { 1 }),
        });
        Ok(modes.collect())
    }
}

/// Mean of the values of the points within `radius` of `center`, weighted by attention.
fn mean_around(center: DVec3, radius: f64, points: &[DVec3], values: &[f64], attention: &[f64]) -> f64 {
    let near = (0..points.len()).filter(|&point| points[point].distance_squared(center) < radius * radius);
    let (sum, weight) = near
        .fold((0.0, 0.0), |(sum, weight), point| (sum + attention[point] * values[point], weight + attention[point]));
    if weight > 0.0 { sum / weight } else { 0.0 }
}

/// Modes nearer to the plane than half a bandwidth are one joint with their image.
fn middle_band(bandwidth: f64) -> f64 {
    MIDDLE_BAND.max(0.5 * bandwidth)
}
