//! Joint sets for every level of detail, such that more detail never gives fewer joints.
//!
//! A count of modes is not monotone in the bandwidth, so detail does not simply choose one. Modes are found at two bandwidths
//! only, h (the middle level) and h/2, and every level is a part of those, nested by construction:
//!
//! * Each mode has a *reach*: its distance to the nearest denser mode of the same bandwidth [as in the density peaks of
//!   Rodriguez and Laio 2014], endless for the densest. Level l has a radius R that falls and a least density that falls with l.
//!   A mode *stands* at a level if its reach is above R and its density is enough: from level to level, standing modes
//!   only join.
//! * Up to the middle level the joints are the standing modes of h.
//! * Above it each mode of h is refined: the modes of h/2 that lie nearest to it are its parts, and where two or more of them
//!   stand they take its place. So it is replaced by no fewer joints than it was, counting mirror images, and joints that
//!   need no refinement do not move when detail is raised.
//!
//! Two joints of one level are farther apart than h/2: modes of h are more than h apart, modes of h/2 more than h/2, and a
//! part of one mode is more than h/2 away from every other mode, being nearer to its own.

use super::detect_joints::{JOINTS_MAX, JOINTS_MIN};
use super::modes::{Mode, joint_count, mode_share};
use crate::cancellation::Cancelled;

/// The highest level of detail; the lowest is 0.
pub const LEVELS: usize = 20;
const MIDDLE_LEVEL: usize = LEVELS / 2;

/// The radius halves from the lowest level to the middle and again to the highest.
fn radius_at(level: usize, bandwidth: f64) -> f64 {
    bandwidth * (1.0 - 2.0 * level as f64 / LEVELS as f64).exp2()
}

/// A mode and its distance to the nearest denser one.
#[derive(Clone, Copy, Debug)]
struct Ranked {
    mode: Mode,
    reach: f64,
}

/// The joint sets of one mesh.
pub(super) struct JointLevels<F> {
    bandwidth: f64,
    /// Loosens the least density of a mode.
    share_factor: f64,
    modes_at: F,
    coarse: Vec<Ranked>,
    /// For each coarse mode its parts; found when first needed.
    parts: Option<Vec<Vec<Ranked>>>,
}

impl<F: Fn(f64) -> Result<Vec<Mode>, Cancelled>> JointLevels<F> {
    /// `modes_at` gives the modes of a bandwidth, densest first, farther apart than it.
    pub fn new(bandwidth: f64, share_factor: f64, modes_at: F) -> Result<Self, Cancelled> {
        let coarse = ranked(modes_at(bandwidth)?);
        Ok(Self { bandwidth, share_factor, modes_at, coarse, parts: None })
    }

    /// The modes of a level, densest first, and its radius. If they are too few or too many: those of the nearest level
    /// that is neither, if there is one.
    pub fn at(&mut self, level: usize) -> Result<(Vec<Mode>, f64), Cancelled> {
        let mut level = level.min(LEVELS);
        let mut modes = self.standing_at(level)?;
        while joint_count(&modes) > JOINTS_MAX && level > 0 {
            level -= 1;
            modes = self.standing_at(level)?;
        }
        while joint_count(&modes) < JOINTS_MIN && level < LEVELS {
            level += 1;
            modes = self.standing_at(level)?;
        }
        modes.sort_by(|a, b| b.density.total_cmp(&a.density));
        Ok((modes, radius_at(level, self.bandwidth)))
    }

    fn standing_at(&mut self, level: usize) -> Result<Vec<Mode>, Cancelled> {
        let radius = radius_at(level, self.bandwidth);
        let share = mode_share(radius) * self.share_factor;
        let stands = |ranked: &&Ranked| ranked.reach > radius && ranked.mode.density >= share;
        if level < MIDDLE_LEVEL {
            return Ok(self.coarse.iter().filter(stands).map(|ranked| ranked.mode).collect());
        }
        if level == MIDDLE_LEVEL {
            return Ok(self.coarse.iter().map(|ranked| ranked.mode).collect());
        }
        if self.parts.is_none() {
            let fine = ranked((self.modes_at)(0.5 * self.bandwidth)?);
            self.parts = Some(parts_of(&self.coarse, &fine));
        }
        let mut modes = Vec::new();
        for (coarse, parts) in self.coarse.iter().zip(self.parts.iter().flatten()) {
            let standing: Vec<Mode> = parts.iter().filter(stands).map(|ranked| ranked.mode).collect();
            if standing.len() >= 2 {
                modes.extend(standing);
            } else {
                modes.push(coarse.mode);
            }
        }
        Ok(modes)
    }
}

/// Modes with their reach; `modes` are in descending density.
fn ranked(modes: Vec<Mode>) -> Vec<Ranked> {
    let reach = |at: usize| {
        let denser = modes[..at].iter().map(|other| other.position.distance(modes[at].position));
        denser.fold(f64::INFINITY, f64::min)
    };
    (0..modes.len()).map(|at| Ranked { mode: modes[at], reach: reach(at) }).collect()
}

/// Each fine mode goes to the coarse mode nearest to it.
fn parts_of(coarse: &[Ranked], fine: &[Ranked]) -> Vec<Vec<Ranked>> {
    let mut parts = vec![Vec::new(); coarse.len()];
    for part in fine {
        let distance = |at: &usize| coarse[*at].mode.position.distance_squared(part.mode.position);
        if let Some(nearest) = (0..coarse.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))) {
            parts[nearest].push(*part);
        }
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::non_maximum_suppression::survivors_by_density;
    use glam::DVec3;
    use proptest::prelude::*;

    /// Modes of a bandwidth as suppression leaves them.
    fn thinned(points: &[(DVec3, f64, bool)], bandwidth: f64) -> Vec<Mode> {
        let positions: Vec<DVec3> = points.iter().map(|point| point.0).collect();
        let density: Vec<f64> = points.iter().map(|point| point.1).collect();
        let kept = survivors_by_density(&positions, &density, |_| bandwidth).into_iter();
        let mode = |at: usize| Mode {
            position: positions[at],
            density: density[at],
            joint_count: if points[at].2 { 2 } else { 1 },
        };
        kept.map(mode).filter(|mode| mode.density >= mode_share(bandwidth)).collect()
    }

    fn points(count: std::ops::Range<usize>) -> impl Strategy<Value = Vec<(DVec3, f64, bool)>> {
        let point = (0.0..1.0f64, 0.0..1.0f64, 0.0..0.05f64, any::<bool>());
        let place = |(x, y, density, side)| (DVec3::new(0.3 * x, 0.3 * y, 0.0), density, side);
        prop::collection::vec(point.prop_map(place), count)
    }

    #[test]
    fn a_pair_that_the_middle_level_sees_as_one_is_resolved_by_more_detail() {
        let between = Mode { position: DVec3::ZERO, density: 0.5, joint_count: 2 };
        let apart = |x: f64| Mode { position: DVec3::X * x, density: 0.25, joint_count: 2 };
        let far = Mode { position: DVec3::Y, density: 0.1, joint_count: 1 };
        let modes_at = |h: f64| Ok(if h > 0.04 { vec![between, far] } else { vec![apart(-0.018), apart(0.018), far] });
        let mut levels = JointLevels::new(0.05, 1.0, modes_at).expect("not cancelled");
        assert_eq!(levels.at(MIDDLE_LEVEL), Ok((vec![between, far], 0.05)));
        assert_eq!(levels.at(LEVELS).expect("not cancelled").0, [apart(-0.018), apart(0.018), far]);
    }

    proptest! {
        #[test]
        fn more_detail_never_gives_fewer_joints_and_joints_stay_apart(
            coarse in points(1..40), fine in points(1..200), share_factor in 0.0..1.5f64,
        ) {
            let modes_at = |h: f64| Ok(thinned(if h > 0.04 { &coarse } else { &fine }, h));
            let mut levels = JointLevels::new(0.05, share_factor, modes_at).expect("not cancelled");
            let mut before = 0;
            for level in 0..=LEVELS {
                let (modes, _) = levels.at(level).expect("not cancelled");
                let count = joint_count(&modes).min(JOINTS_MAX);
                prop_assert!(count >= before, "level {} has {}, the one before {}", level, count, before);
                before = count;
                for (at, mode) in modes.iter().enumerate() {
                    let apart = |other: &Mode| other.position.distance(mode.position) > 0.025 - 1e-12;
                    prop_assert!(modes[at + 1..].iter().all(apart));
                }
            }
        }
    }
}
