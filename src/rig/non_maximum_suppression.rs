//! One point per mode: the densest point takes out its neighbours, then the densest that is left, and so on.
//! RigNet [Xu et al. 2020], Section 4.1 ("non-maximum suppression").
//!
//! | in        | shape    | unit                                  |
//! |-----------|----------|---------------------------------------|
//! | `points`  | `[M, 3]` | any space                             |
//! | `density` | `[M]`    | any; only the order matters           |
//! | `radius`  | function of the index | as the points            |
//!
//! # Departures from the paper
//! - Equal densities are ordered by position, then by index; the published code leaves them to an unstable sort.

use super::joint_clustering::by_position;
use glam::DVec3;

/// Indices of the survivors, ascending.
///
/// In descending density each point that still stands removes every other within (≤) its radius. O(M · survivors).
pub fn suppress_non_maxima(points: &[DVec3], density: &[f64], radius: impl Fn(usize) -> f64) -> Vec<usize> {
    let mut survivors = survivors_by_density(points, density, radius);
    survivors.sort_unstable();
    survivors
}

/// The same in descending density.
pub(super) fn survivors_by_density(points: &[DVec3], density: &[f64], radius: impl Fn(usize) -> f64) -> Vec<usize> {
    let mut standing: Vec<usize> = (0..points.len()).collect();
    standing.sort_by(|&a, &b| density[b].total_cmp(&density[a]).then(by_position(points[a], points[b])));
    let mut survivors = Vec::new();
    while let Some(&densest) = standing.first() {
        survivors.push(densest);
        let reach = radius(densest);
        standing.retain(|&other| other != densest && points[other].distance(points[densest]) > reach);
    }
    survivors
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_denser_of_two_close_points_stays_and_a_far_one_too() {
        let points = [DVec3::ZERO, DVec3::X * 0.5, DVec3::X * 2.0];
        assert_eq!(suppress_non_maxima(&points, &[1.0, 2.0, 0.1], |_| 1.0), [1, 2]);
        assert_eq!(suppress_non_maxima(&points, &[2.0, 1.0, 0.1], |_| 1.0), [0, 2]);
    }

    #[test]
    fn equal_densities_are_decided_by_position_not_by_order() {
        let (a, b) = (DVec3::ZERO, DVec3::Y * 0.5);
        assert_eq!(suppress_non_maxima(&[a, b], &[1.0, 1.0], |_| 1.0), [0]);
        assert_eq!(suppress_non_maxima(&[b, a], &[1.0, 1.0], |_| 1.0), [1]);
    }

    proptest! {
        #[test]
        fn survivors_are_apart_and_every_other_point_is_near_one(
            raw in prop::collection::vec((0.0..1.0f64, 0.0..1.0f64, 0.0..1.0f64, 0..4u8), 1..60), radius in 0.05..0.5f64,
        ) {
            let points: Vec<DVec3> = raw.iter().map(|&(x, y, z, _)| DVec3::new(x, y, z)).collect();
            let density: Vec<f64> = raw.iter().map(|&(.., density)| f64::from(density)).collect();
            let kept = suppress_non_maxima(&points, &density, |_| radius);
            for (at, &a) in kept.iter().enumerate() {
                prop_assert!(kept[at + 1..].iter().all(|&b| points[a].distance(points[b]) > radius));
            }
            for (point, &value) in points.iter().zip(&density) {
                prop_assert!(kept.iter().any(|&k| point.distance(points[k]) <= radius && density[k] >= value));
            }
        }
    }
}
