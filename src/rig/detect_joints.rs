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

use super::joint_levels::{JointLevels, LEVELS};
use super::modes::{Mode, PointCloud, joint_count};
use super::symmetrize::{MIDDLE_BAND, Side, SidedJoints, symmetrize_joints};
use crate::cancellation::{Cancellation, Cancelled};
use crate::geometry::symmetry_plane::SymmetryPlane;
use crate::geometry::voxel_grid::VoxelGrid;
use glam::DVec3;

pub const JOINTS_MIN: usize = 2;
pub const JOINTS_MAX: usize = 100;

/// Bandwidth in the middle of the detail range. On 30 organic validation characters, whole pipeline: IoU .503, .505, .516, .506 and
/// CD-J2J 5.05, 5.12, 5.32, 5.41 % at .035, .038, .041, .045, with 26.3, 23.7, 21.1, 18.6 joints where the artists have 23.0.
pub const BANDWIDTH_DEFAULT: f64 = 0.038;
/// Bandwidths that make sense in the normalised frame; others are brought into this range.
pub const BANDWIDTH_RANGE: std::ops::RangeInclusive<f64> = 0.005..=0.5;

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
    /// 0 (few joints) to 1 (many), in 20 steps; a higher value never gives fewer joints.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::voxel_grid::RESOLUTION;
    use proptest::prelude::*;

    const X_ZERO: SymmetryPlane = SymmetryPlane { normal: DVec3::X, offset: 0.0, score: 1.0 };

    /// Vertices around joints and where a fair network would put them.
    #[derive(Clone)]
    struct Figure {
        vertices: Vec<DVec3>,
        displaced: Vec<DVec3>,
        attention: Vec<f64>,
    }

    impl Figure {
        /// `per_joint` points scattered by up to 0.008 about every joint.
        fn new(joints: &[DVec3], per_joint: usize) -> Self {
            let count = joints.len() * per_joint;
            // The golden ratio's multiples fill [0, 1) evenly and never repeat.
            let scatter = |k: usize, step: f64| ((k + 1) as f64 * step).fract() - 0.5;
            let offset = |k: usize| DVec3::new(scatter(k, 0.618034), scatter(k, 0.754878), scatter(k, 0.569840));
            let joint = |k: usize| joints[k / per_joint];
            Self {
                vertices: (0..count).map(|k| joint(k) + 0.08 * offset(k).normalize_or_zero()).collect(),
                displaced: (0..count).map(|k| joint(k) + 0.016 * offset(k)).collect(),
                attention: (0..count).map(|k| 0.6 + 0.8 * scatter(k, 0.324718)).collect(),
            }
        }

        fn evidence(&self) -> Evidence<'_> {
            Evidence { vertices: &self.vertices, displaced: &self.displaced, attention: &self.attention }
        }

        fn joints(&self, plane: Option<&SymmetryPlane>, fineness: Fineness) -> DetectedJoints {
            detect_joints(&self.evidence(), None, plane, fineness, &Cancellation::default()).expect("joints")
        }

        fn mapped(&self, map: impl Fn(DVec3) -> DVec3) -> Self {
            let all = |points: &[DVec3]| points.iter().map(|&point| map(point)).collect();
            Self { vertices: all(&self.vertices), displaced: all(&self.displaced), attention: self.attention.clone() }
        }
    }

    /// A man of eleven joints: pelvis, chest, head, hands, elbows, knees, feet.
    fn man() -> Vec<DVec3> {
        let side = |x: f64| {
            [(0.45, 0.75), (0.28, 0.75), (0.1, 0.27), (0.1, 0.03)].map(|(out, up)| DVec3::new(x * out, up, 0.01))
        };
        let middle = [0.5, 0.72, 0.92].map(|y| DVec3::Y * y);
        [&middle[..], &side(-1.0), &side(1.0)].concat()
    }

    /// The greatest distance from a joint of one set to the nearest of the other, both ways.
    fn apart(a: &[DVec3], b: &[DVec3]) -> f64 {
        let nearest = |p: &DVec3, to: &[DVec3]| to.iter().map(|q| q.distance(*p)).fold(f64::INFINITY, f64::min);
        a.iter().map(|p| nearest(p, b)).chain(b.iter().map(|p| nearest(p, a))).fold(0.0, f64::max)
    }

    #[test]
    fn a_man_has_his_joints_with_and_without_a_plane() {
        for plane in [Some(&X_ZERO), None] {
            let found = Figure::new(&man(), 60).joints(plane, Fineness::Detail(0.5));
            assert_eq!(found.positions.len(), man().len());
            assert!(apart(&found.positions, &man()) < 0.005);
            assert_eq!(found.failed_attempts, 0);
        }
    }

    #[test]
    fn with_a_plane_joints_are_exact_mirror_images_and_middle_ones_lie_on_it() {
        let found = Figure::new(&man(), 60).joints(Some(&X_ZERO), Fineness::Detail(0.5));
        let sides = found.sides.expect("a plane was given");
        let twins = super::super::symmetrize::twins(&sides);
        for (joint, &twin) in twins.iter().enumerate() {
            assert_eq!(found.positions[twin], X_ZERO.reflect(found.positions[joint]));
            assert_eq!(twin == joint, sides[joint] == Side::Middle);
        }
    }

    #[test]
    fn joints_beside_the_plane_become_one_and_none_is_lost() {
        for x in [0.0, 0.012, 0.019, 0.021, 0.024, 0.026, 0.035] {
            let found =
                Figure::new(&[DVec3::Y, DVec3::X * x, DVec3::X * -x], 60).joints(Some(&X_ZERO), Fineness::Detail(0.5));
            assert!([2, 3].contains(&found.positions.len()), "at {x}: {:?}", found.positions);
            for (at, joint) in found.positions.iter().enumerate() {
                assert!(found.positions[at + 1..].iter().all(|other| other.distance(*joint) > 0.025), "at {x}");
            }
        }
    }

    #[test]
    fn the_order_of_vertices_changes_no_bit() {
        let figure = Figure::new(&man(), 40);
        let mut reversed = figure.clone();
        reversed.vertices.reverse();
        reversed.displaced.reverse();
        reversed.attention.reverse();
        for plane in [Some(&X_ZERO), None] {
            assert_eq!(
                figure.joints(plane, Fineness::Detail(0.7)).positions,
                reversed.joints(plane, Fineness::Detail(0.7)).positions
            );
        }
    }

    #[test]
    fn moving_and_mirroring_the_evidence_moves_and_mirrors_the_joints() {
        let figure = Figure::new(&man(), 40);
        let joints = figure.joints(Some(&X_ZERO), Fineness::Detail(0.5)).positions;
        let shift = DVec3::new(0.3, -0.1, 0.7);
        let beside = SymmetryPlane { offset: 0.3, ..X_ZERO };
        let moved = figure.mapped(|p| p + shift).joints(Some(&beside), Fineness::Detail(0.5)).positions;
        assert!(apart(&moved, &joints.iter().map(|&joint| joint + shift).collect::<Vec<_>>()) < 1e-6);
        let mirrored = figure.mapped(|p| X_ZERO.reflect(p)).joints(Some(&X_ZERO), Fineness::Detail(0.5)).positions;
        assert!(apart(&mirrored, &joints) < 1e-6);
    }

    #[test]
    fn points_at_one_place_are_refused_and_the_message_says_what_was_tried() {
        let figure = Figure::new(&[DVec3::ONE], 30).mapped(|_| DVec3::ONE);
        let found = detect_joints(&figure.evidence(), None, None, Fineness::Detail(0.5), &Cancellation::default());
        let message = found.expect_err("one joint is no skeleton").to_string();
        assert!(message.contains("30 displaced points") && message.contains("1 at bandwidth 0.0019"), "{message}");
    }

    #[test]
    fn two_close_joints_are_found_by_loosening_the_rules() {
        let found = Figure::new(&[DVec3::ONE, DVec3::ONE + DVec3::Y * 0.03], 30).joints(None, Fineness::Bandwidth(0.2));
        assert!(found.failed_attempts > 0);
        assert!(found.positions.len() >= JOINTS_MIN);
    }

    #[test]
    fn nothing_and_nonsense_are_refused_without_panic() {
        let nothing = Evidence { vertices: &[], displaced: &[], attention: &[] };
        let nan = [DVec3::NAN; 3];
        let nonsense = Evidence { vertices: &nan, displaced: &nan, attention: &[f64::NAN, 1.0, 0.5] };
        for evidence in [nothing, nonsense] {
            for fineness in [Fineness::Detail(f64::NAN), Fineness::Bandwidth(f64::INFINITY), Fineness::Bandwidth(-1.0)]
            {
                let found = detect_joints(&evidence, None, Some(&X_ZERO), fineness, &Cancellation::default());
                assert!(matches!(found, Err(DetectJointsError::NotFound { .. })));
            }
        }
    }

    #[test]
    fn a_solid_that_holds_almost_nothing_is_not_believed() {
        let figure = Figure::new(&man(), 40);
        let empty =
            VoxelGrid { origin: DVec3::new(-0.5, 0.0, -0.5), side: 1.0, inside: vec![false; RESOLUTION.pow(3)] };
        let plain = figure.joints(None, Fineness::Detail(0.5));
        let with = |solid| {
            detect_joints(&figure.evidence(), Some(solid), None, Fineness::Detail(0.5), &Cancellation::default())
        };
        assert_eq!(with(&empty), Ok(plain.clone()));
        let mut headless = VoxelGrid { inside: vec![true; RESOLUTION.pow(3)], ..empty };
        for cell in 0..headless.inside.len() {
            headless.inside[cell] = cell / RESOLUTION % RESOLUTION < 75;
        }
        assert_eq!(with(&headless).expect("joints").positions.len(), plain.positions.len() - 1);
    }

    fn places(count: std::ops::Range<usize>) -> impl Strategy<Value = Vec<DVec3>> {
        let place = (-1.0..1.0f64, 0.0..1.0f64, -1.0..1.0f64).prop_map(|(x, y, z)| DVec3::new(0.5 * x, y, 0.1 * z));
        prop::collection::vec(place, count)
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

        #[test]
        fn more_detail_never_gives_fewer_joints(joints in places(2..60), symmetric in any::<bool>()) {
            let figure = Figure::new(&joints, 9);
            let plane = symmetric.then_some(&X_ZERO);
            let mut before = 0;
            for level in 0..=LEVELS {
                let count = figure.joints(plane, Fineness::Detail(level as f64 / LEVELS as f64)).positions.len();
                prop_assert!(count >= before, "level {}: {}, before {}", level, count, before);
                before = count;
            }
        }

        #[test]
        fn there_are_two_to_a_hundred_joints_and_none_coincide(
            joints in places(2..400), h in 0.001..0.8f64, symmetric in any::<bool>(),
        ) {
            let found = Figure::new(&joints, 2).joints(symmetric.then_some(&X_ZERO), Fineness::Bandwidth(h));
            prop_assert!((JOINTS_MIN..=JOINTS_MAX).contains(&found.positions.len()));
            for (at, joint) in found.positions.iter().enumerate() {
                let nearest = found.positions[at + 1..].iter().map(|other| other.distance(*joint));
                prop_assert!(nearest.fold(f64::INFINITY, f64::min) > found.bandwidth.min(2.0 * MIDDLE_BAND) - 1e-9);
            }
        }
    }
}
