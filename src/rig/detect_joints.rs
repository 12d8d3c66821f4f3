//! From displaced vertices and attention to joints: between 2 and 100 of them, or an honest refusal.
//! RigNet [Xu et al. 2020], Section 4.1.
//!
//! | in          | shape    | unit                                                       |
//! |-------------|----------|------------------------------------------------------------|
//! | `vertices`  | `[V, 3]` | normalised frame                                           |
//! | `displaced` | `[V, 3]` | normalised frame; where the network says the joints are    |
//! | `attention` | `[V]`    | any; scaled to [0, 1] over the mesh                        |
//!
//! Steps: attention scaled, points without any or outside the solid dropped, mirrored about the plane, gathered by mean
//! shift, thinned to modes on one side of the plane, mirrored back. No two joints are nearer than half the bandwidth.
//! # Departures from the published code
//! - Thresholds that keep fewer than two joints are loosened step by step ([`ATTEMPTS`]); theirs fail later.
//! - Modes count by the attention they gather, a measure that does not change with the number of points.
//! - The suppression radius grows with the displacement around a mode: far-moved points scatter more.
//! - Middle joints are put on the plane before suppression, so that they stay apart; theirs can coincide.
//! - The solid is not asked where it would throw away most of the attention: thin or open shapes have little inside.
//! - Joints are listed from the top down; theirs follow the order of the vertices.

use super::joint_clustering::{self, MeanShift, ModeRule, attention_density, mean_shift, scaled_attention};
use super::joint_levels::{JointLevels, LEVELS};
use super::non_maximum_suppression::survivors_by_density;
use super::symmetrize::{MIDDLE_BAND, Side, SidedJoints, fold, symmetrize_joints, with_images};
use crate::cancellation::{Cancellation, Cancelled};
use crate::geometry::symmetry_plane::SymmetryPlane;
use crate::geometry::voxel_grid::VoxelGrid;
use glam::DVec3;

pub const JOINTS_MIN: usize = 2;
pub const JOINTS_MAX: usize = 100;

/// Bandwidth in the middle of the detail range (best on the validation rigs).
pub const BANDWIDTH_DEFAULT: f64 = 0.05;
/// Bandwidths that make sense in the normalised frame; others are brought into this range.
pub const BANDWIDTH_RANGE: std::ops::RangeInclusive<f64> = 0.005..=0.5;

/// Scaled attention at or below this says nothing (published value).
const ATTENTION_MIN: f64 = 1e-3;
/// Least share of the total attention that a mode gathers at the default bandwidth (validated: the published rule finds
/// twice too many joints); it scales with the bandwidth.
const MODE_SHARE: f64 = 0.01;
/// Suppression radius in parts of the mean displacement around a mode, where that is above the bandwidth (validated).
const SPREAD_FACTOR: f64 = 0.5;
/// The solid is believed if at least this share of the attention is inside it.
const INSIDE_ATTENTION_MIN: f64 = 0.5;

/// What the networks say of one mesh.
#[derive(Clone, Copy, Debug)]
pub struct Evidence<'a> {
    pub vertices: &'a [DVec3],
    pub displaced: &'a [DVec3],
    pub attention: &'a [f64],
}

/// How close together joints may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fineness {
    /// 0 (few joints) to 1 (many), in [`LEVELS`] steps; a higher value never gives fewer joints.
    Detail(f64),
    /// The bandwidth h of Eq. 6 itself.
    Bandwidth(f64),
}

/// Joints of a character, no two at one place.
#[derive(Clone, Debug, PartialEq)]
pub struct DetectedJoints {
    /// `[J, 3]`, 2 ≤ J ≤ 100. With a symmetry plane: negative side, middle, positive side in the order of the negative.
    pub positions: Vec<DVec3>,
    /// `[J]`, where a symmetry plane was given.
    pub sides: Option<Vec<Side>>,
    /// The bandwidth that decided how close together joints are.
    pub bandwidth: f64,
    /// Steps of [`ATTEMPTS`] that gave too few joints before this result.
    pub failed_attempts: usize,
}

/// Why there are no joints.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DetectJointsError {
    #[error("no joints were found: {tried}")]
    NotFound { tried: String },
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A loosening of the rules.
#[derive(Clone, Copy, Debug)]
pub struct Attempt {
    pub ask_solid: bool,
    pub mode_share_factor: f64,
    pub bandwidth_factor: f64,
}

/// What is tried in turn until there are two joints.
pub const ATTEMPTS: [Attempt; 6] = [
    Attempt { ask_solid: true, mode_share_factor: 1.0, bandwidth_factor: 1.0 },
    Attempt { ask_solid: false, mode_share_factor: 1.0, bandwidth_factor: 1.0 },
    Attempt { ask_solid: false, mode_share_factor: 0.25, bandwidth_factor: 1.0 },
    Attempt { ask_solid: false, mode_share_factor: 0.25, bandwidth_factor: 0.5 },
    Attempt { ask_solid: false, mode_share_factor: 0.0, bandwidth_factor: 0.25 },
    Attempt { ask_solid: false, mode_share_factor: 0.0, bandwidth_factor: 0.1 },
];

/// Finds the joints. `solid` and `plane` are used where given.
pub fn detect_joints(
    evidence: &Evidence,
    solid: Option<&VoxelGrid>,
    plane: Option<&SymmetryPlane>,
    fineness: Fineness,
    cancellation: &Cancellation,
) -> Result<DetectedJoints, DetectJointsError> {
    let mut found = Vec::new();
    for (failed_attempts, attempt) in ATTEMPTS.iter().enumerate() {
        let points = PointCloud::new(evidence, solid.filter(|_| attempt.ask_solid), plane);
        let (modes, bandwidth) = match fineness {
            Fineness::Bandwidth(bandwidth) => {
                let bandwidth = within_range(bandwidth) * attempt.bandwidth_factor;
                (points.modes(bandwidth, attempt.mode_share_factor, cancellation)?, bandwidth)
            }
            Fineness::Detail(detail) => {
                let bandwidth = BANDWIDTH_DEFAULT * attempt.bandwidth_factor;
                let share_factor = attempt.mode_share_factor;
                JointLevels::new(bandwidth, share_factor, |h| points.modes(h, share_factor, cancellation))?
                    .at(level_of(detail))?
            }
        };
        let modes = strongest(modes, JOINTS_MAX);
        let joint_count = joint_count(&modes);
        if joint_count >= JOINTS_MIN {
            return Ok(arranged(modes, plane, bandwidth, failed_attempts));
        }
        found.push(format!("{joint_count} at bandwidth {bandwidth:.4}"));
    }
    Err(DetectJointsError::NotFound { tried: tried(evidence, &found) })
}

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
struct PointCloud<'a> {
    points: Vec<DVec3>,
    attention: Vec<f64>,
    /// How far each point was moved by the network.
    displacement: Vec<f64>,
    plane: Option<&'a SymmetryPlane>,
}

impl<'a> PointCloud<'a> {
    fn new(evidence: &Evidence, solid: Option<&VoxelGrid>, plane: Option<&'a SymmetryPlane>) -> Self {
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
    fn modes(&self, bandwidth: f64, share_factor: f64, cancellation: &Cancellation) -> Result<Vec<Mode>, Cancelled> {
        let gathered = mean_shift(&self.points, &self.attention, &MeanShift::ours(bandwidth), cancellation)?;
        let density = attention_density(&gathered, &self.attention, bandwidth);
        let rule = ModeRule::ShareOfAttention(mode_share(bandwidth) * share_factor);
        let dense = joint_clustering::dense_points(&density, &self.attention, rule);
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

fn within_range(bandwidth: f64) -> f64 {
    if bandwidth.is_nan() {
        BANDWIDTH_DEFAULT
    } else {
        bandwidth.clamp(*BANDWIDTH_RANGE.start(), *BANDWIDTH_RANGE.end())
    }
}

/// Detail in whole levels; not a number is the middle.
fn level_of(detail: f64) -> usize {
    let detail = if detail.is_nan() { 0.5 } else { detail.clamp(0.0, 1.0) };
    (detail * LEVELS as f64).round() as usize
}

/// The densest modes whose joints number at most `joints_max`; `modes` are in descending density.
fn strongest(modes: Vec<Mode>, joints_max: usize) -> Vec<Mode> {
    let mut left = joints_max;
    let fits = |mode: &Mode| {
        let fits = mode.joint_count <= left;
        left -= if fits { mode.joint_count } else { 0 };
        fits
    };
    modes.into_iter().filter(fits).collect()
}

/// Joints from the top down, and mirrored.
fn arranged(
    mut modes: Vec<Mode>,
    plane: Option<&SymmetryPlane>,
    bandwidth: f64,
    failed_attempts: usize,
) -> DetectedJoints {
    modes.sort_by(|a, b| {
        let (a, b) = (a.position, b.position);
        b.y.total_cmp(&a.y).then(a.x.total_cmp(&b.x)).then(a.z.total_cmp(&b.z))
    });
    let positions: Vec<DVec3> = modes.iter().map(|mode| mode.position).collect();
    match plane {
        Some(plane) => {
            let SidedJoints { positions, sides } = symmetrize_joints(&positions, plane, MIDDLE_BAND);
            DetectedJoints { positions, sides: Some(sides), bandwidth, failed_attempts }
        }
        None => DetectedJoints { positions, sides: None, bandwidth, failed_attempts },
    }
}

/// What was tried, for the sender.
fn tried(evidence: &Evidence, found: &[String]) -> String {
    let highest = evidence.attention.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    format!(
        "{} displaced points with attention up to {highest:.3} gave {} joints; at least {JOINTS_MIN} are needed",
        evidence.displaced.len(),
        found.join(", "),
    )
}
