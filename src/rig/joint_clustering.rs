//! Joint detection: attention-weighted mean shift, then the density of the points it gathers.
//! RigNet [Xu et al. 2020], Section 4.1, Eq. 6; mean shift in the blurring form of [Cheng 1995].
//!
//! | in          | shape    | unit                                        |
//! |-------------|----------|---------------------------------------------|
//! | `points`    | `[M, 3]` | normalised frame: longest side is 1         |
//! | `attention` | `[M]`    | 0 to 1                                      |
//! | `bandwidth` | scalar   | normalised, above zero; larger, fewer modes |
//!
//! Out: points `[M, 3]` gathered at the joints, in the order of the input; permuting the input permutes the output bit by
//! bit. With a symmetry plane the points are half of a set whose other half are their mirror images: images stay images
//! through every step, so only the given half is moved. Pure: no clock, no randomness, no I/O.
//! # Departures from the paper
//! - All points move together and the kernel is recomputed from moved points (the published code does so too); the paper
//!   moves each point among fixed ones.
//! - The loop is bounded by [`MeanShift::iterations_max`]; the paper iterates until convergence.
//! - [`MeanShift::ours`] has no floor in the denominator: the published one pulls points of little attention toward the origin
//!   (with small bandwidths by percents).
//! - [`MeanShift::ours`] takes ten long steps instead of up to 39 short ones, and no step depends on how many points there
//!   are (the published stop rule is a norm over all points, so larger meshes iterate longer).

use super::cell_grid::{KernelSum, kernel_sums};
use super::symmetrize::with_images;
use crate::cancellation::{Cancellation, Cancelled};
use crate::geometry::symmetry_plane::SymmetryPlane;
use glam::DVec3;
use rayon::prelude::*;

/// How points move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanShift {
    /// h of Eq. 6, above zero.
    pub bandwidth: f64,
    /// The part of the mean-shift vector that a point moves at once, in (0, 1].
    pub step: f64,
    /// At most this many updates.
    pub iterations_max: usize,
    /// Stop once the Frobenius norm of a whole update is at most this.
    pub update_norm_min: f64,
    /// Added to the denominator of Eq. 6.
    pub mass_floor: f64,
}

impl MeanShift {
    /// The published code's rule in interactive use.
    pub const fn published(bandwidth: f64) -> Self {
        Self { bandwidth, step: 0.3, iterations_max: 39, update_norm_min: 1e-3, mass_floor: 1e-10 }
    }

    /// Ten steps of 0.9, the rule that mode shares and bandwidth were calibrated with.
    pub const fn ours(bandwidth: f64) -> Self {
        Self { bandwidth, step: 0.9, iterations_max: 10, update_norm_min: 0.0, mass_floor: 0.0 }
    }
}

/// Moves every point along its mean-shift vector until the rule says stop, among all points and, with a plane, their images.
pub fn mean_shift(
    points: &[DVec3],
    attention: &[f64],
    plane: Option<&SymmetryPlane>,
    rule: &MeanShift,
    cancellation: &Cancellation,
) -> Result<Vec<DVec3>, Cancelled> {
    let order = canonical_order(points, attention);
    let mut moved: Vec<DVec3> = order.iter().map(|&index| points[index as usize]).collect();
    let attention: Vec<f64> = order.iter().map(|&index| attention[index as usize]).collect();
    for _ in 0..rule.iterations_max {
        cancellation.check()?;
        let next = mean_shift_step(&moved, &attention, plane, rule);
        let squared: f64 = next.iter().zip(&moved).map(|(after, before)| after.distance_squared(*before)).sum();
        moved = next;
        if squared.sqrt() <= rule.update_norm_min {
            break;
        }
    }
    Ok(in_original_order(&order, &moved))
}

/// Moves every point once (Eq. 6).
///
/// ```text
/// m_v = Σ_u a_u K(q_u − q_v) q_u / Σ_u a_u K(q_u − q_v) − q_v      K(x) = max(h² − ‖x‖², 0)      q_v ← q_v + step · m_v
/// ```
/// A point whose neighbourhood holds no attention stays where it is.
fn mean_shift_step(points: &[DVec3], attention: &[f64], plane: Option<&SymmetryPlane>, rule: &MeanShift) -> Vec<DVec3> {
    let sums = sums_at_points(points, attention, plane, rule.bandwidth);
    let moved = points.par_iter().zip(sums).map(|(&point, sum)| {
        if sum.mass > 0.0 { point + rule.step * (sum.moment / (sum.mass + rule.mass_floor) - point) } else { point }
    });
    moved.collect()
}

/// Kernel sums at `points` over them and, with a plane, their images. `[M]`
fn sums_at_points(points: &[DVec3], weights: &[f64], plane: Option<&SymmetryPlane>, bandwidth: f64) -> Vec<KernelSum> {
    match plane {
        Some(plane) => kernel_sums(&with_images(points, plane), &weights.repeat(2), bandwidth, points.len()),
        None => kernel_sums(points, weights, bandwidth, points.len()),
    }
}

/// Published density: `d_v = Σ_u max(h² − ‖q_u − q_v‖², 0)`, without attention. `[M]`
pub fn summed_density(points: &[DVec3], bandwidth: f64) -> Vec<f64> {
    density(points, &vec![1.0; points.len()], None, bandwidth)
}

/// Our density: `d_v = Σ_u a_u max(1 − ‖q_u − q_v‖² / h², 0)`, the attention gathered around a point. `[M]`
/// With a plane, of the points and their images.
pub fn attention_density(
    points: &[DVec3],
    attention: &[f64],
    plane: Option<&SymmetryPlane>,
    bandwidth: f64,
) -> Vec<f64> {
    let scale = 1.0 / (bandwidth * bandwidth);
    density(points, attention, plane, bandwidth).into_iter().map(|mass| mass * scale).collect()
}

fn density(points: &[DVec3], weights: &[f64], plane: Option<&SymmetryPlane>, bandwidth: f64) -> Vec<f64> {
    let order = canonical_order(points, weights);
    let sorted: Vec<DVec3> = order.iter().map(|&index| points[index as usize]).collect();
    let weights: Vec<f64> = order.iter().map(|&index| weights[index as usize]).collect();
    let masses: Vec<f64> =
        sums_at_points(&sorted, &weights, plane, bandwidth).into_iter().map(|sum| sum.mass).collect();
    in_original_order(&order, &masses)
}

/// Which gathered points are dense enough to be joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ModeRule {
    /// Density above this share of the sum of densities over all points (published; its meaning shrinks with M).
    ShareOfSummedDensity(f64),
    /// Density at least this share of the total attention (the same for any M).
    ShareOfAttention(f64),
}

/// Indices of the points that pass the rule, ascending.
pub fn dense_points(density: &[f64], attention: &[f64], rule: ModeRule) -> Vec<usize> {
    let total: f64 = match rule {
        ModeRule::ShareOfSummedDensity(_) => density.iter().sum(),
        ModeRule::ShareOfAttention(_) => attention.iter().sum(),
    };
    let passes = |&index: &usize| match rule {
        ModeRule::ShareOfSummedDensity(share) => density[index] / total > share,
        ModeRule::ShareOfAttention(share) => density[index] > 0.0 && density[index] >= share * total,
    };
    (0..density.len()).filter(passes).collect()
}

/// Attention scaled to [0, 1] over the mesh, so that thresholds mean the same for a timid network and a bold one.
/// Constant attention becomes 1 everywhere.
pub fn scaled_attention(attention: &[f64]) -> Vec<f64> {
    let low = attention.iter().copied().fold(f64::INFINITY, f64::min);
    let high = attention.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let span = high - low;
    attention.iter().map(|&value| if span > 0.0 { (value - low) / span } else { 1.0 }).collect()
}

/// An order that depends on what the points are and not on how they are listed: sums run in it.
fn canonical_order(points: &[DVec3], weights: &[f64]) -> Vec<u32> {
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.par_sort_by(|&a, &b| {
        let (a, b) = (a as usize, b as usize);
        by_position(points[a], points[b]).then(weights[a].total_cmp(&weights[b]))
    });
    order
}

/// Ascending x, then y, then z.
pub(super) fn by_position(a: DVec3, b: DVec3) -> std::cmp::Ordering {
    a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z))
}

fn in_original_order<T: Copy + Default>(order: &[u32], values: &[T]) -> Vec<T> {
    let mut original = vec![T::default(); values.len()];
    for (&index, &value) in order.iter().zip(values) {
        original[index as usize] = value;
    }
    original
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const H: f64 = 0.1;

    fn shifted(points: &[DVec3], attention: &[f64], rule: &MeanShift) -> Vec<DVec3> {
        mean_shift(points, attention, None, rule, &Cancellation::default()).expect("not cancelled")
    }

    /// Points in the unit cube and their attention.
    fn cloud() -> impl Strategy<Value = (Vec<DVec3>, Vec<f64>)> {
        let point = (0.0..1.0f64, 0.0..1.0f64, 0.0..1.0f64, 0.05..1.0f64);
        prop::collection::vec(point, 1..80).prop_map(|raw| {
            let points = raw.iter().map(|&(x, y, z, _)| 0.4 * DVec3::new(x, y, z)).collect();
            (points, raw.iter().map(|raw| raw.3).collect())
        })
    }

    fn farthest(a: &[DVec3], b: &[DVec3]) -> f64 {
        a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
    }

    #[test]
    fn two_heaps_gather_at_their_weighted_means() {
        let points = [0.0, 0.02, 1.0, 1.03].map(|x| DVec3::X * x);
        let moved = shifted(&points, &[1.0, 1.0, 1.0, 0.0], &MeanShift::ours(H));
        assert!(farthest(&moved, &[0.01, 0.01, 1.0, 1.0].map(|x| DVec3::X * x)) < 1e-6, "{moved:?}");
    }

    #[test]
    fn a_point_that_no_attention_reaches_stays() {
        let points = [DVec3::ONE, DVec3::ZERO];
        assert_eq!(shifted(&points, &[0.0, 1.0], &MeanShift::published(H))[0], DVec3::ONE);
    }

    #[test]
    fn cancelled_work_stops() {
        let cancellation = Cancellation::default();
        cancellation.cancel();
        assert_eq!(mean_shift(&[DVec3::ZERO], &[1.0], None, &MeanShift::ours(H), &cancellation), Err(Cancelled));
    }

    #[test]
    fn no_points_are_no_trouble() {
        assert!(shifted(&[], &[], &MeanShift::ours(H)).is_empty());
        assert!(dense_points(&[], &[], ModeRule::ShareOfAttention(0.01)).is_empty());
    }

    #[test]
    fn scaled_attention_spans_zero_to_one() {
        assert_eq!(scaled_attention(&[0.25, 0.75, 0.5]), [0.0, 1.0, 0.5]);
        assert_eq!(scaled_attention(&[0.3, 0.3]), [1.0, 1.0]);
    }

    #[test]
    fn the_attention_density_of_a_heap_is_its_attention() {
        let points = [DVec3::ONE, DVec3::ONE, DVec3::ZERO];
        let density = attention_density(&points, &[0.5, 1.0, 0.25], None, H);
        assert!(density.iter().zip([1.5, 1.5, 0.25]).all(|(a, b)| (a - b).abs() < 1e-12));
        assert_eq!(dense_points(&density, &[0.5, 1.0, 0.25], ModeRule::ShareOfAttention(0.5)), [0, 1]);
    }

    proptest! {
        #[test]
        fn listing_the_points_backward_changes_no_bit((points, attention) in cloud()) {
            let mut forward = shifted(&points, &attention, &MeanShift::ours(H));
            let backward = |values: &[f64]| values.iter().rev().copied().collect::<Vec<f64>>();
            let reversed: Vec<DVec3> = points.iter().rev().copied().collect();
            forward.reverse();
            prop_assert_eq!(forward, shifted(&reversed, &backward(&attention), &MeanShift::ours(H)));
            let density = attention_density(&points, &attention, None, H);
            prop_assert_eq!(backward(&density), attention_density(&reversed, &backward(&attention), None, H));
        }

        #[test]
        fn half_of_a_mirrored_set_moves_as_in_the_whole_set((points, attention) in cloud()) {
            let plane = SymmetryPlane { normal: DVec3::new(0.6, 0.0, 0.8), offset: 0.2, score: 1.0 };
            let rule = MeanShift { iterations_max: 4, ..MeanShift::ours(H) };
            let whole = shifted(&with_images(&points, &plane), &attention.repeat(2), &rule);
            let half = mean_shift(&points, &attention, Some(&plane), &rule, &Cancellation::default()).expect("not cancelled");
            prop_assert!(farthest(&with_images(&half, &plane), &whole) < 1e-9);
            let density = attention_density(&half, &attention, Some(&plane), H).repeat(2);
            let of_whole = attention_density(&whole, &attention.repeat(2), None, H);
            prop_assert!(density.iter().zip(of_whole).all(|(a, b)| (a - b).abs() < 1e-7));
        }

        #[test]
        fn translating_scaling_with_the_bandwidth_and_mirroring_commute_with_mean_shift((points, attention) in cloud()) {
            let rule = MeanShift { iterations_max: 4, ..MeanShift::ours(H) };
            let moved = shifted(&points, &attention, &rule);
            let maps: [&dyn Fn(DVec3) -> DVec3; 3] =
                [&|p| p + DVec3::new(3.1, -0.7, 0.05), &|p| p * 2.5, &|p| p * DVec3::new(-1.0, 1.0, 1.0)];
            for (map, scale) in maps.iter().zip([1.0, 2.5, 1.0]) {
                let rule = MeanShift { bandwidth: H * scale, ..rule };
                let mapped: Vec<DVec3> = points.iter().map(|&point| map(point)).collect();
                let expected: Vec<DVec3> = moved.iter().map(|&point| map(point)).collect();
                prop_assert!(farthest(&shifted(&mapped, &attention, &rule), &expected) < 1e-9 * scale);
            }
        }
    }
}
