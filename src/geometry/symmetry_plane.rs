//! The vertical plane that a shape is most nearly its own mirror image in. The methods take characters to be symmetric in
//! x = 0 (RigNet [Xu et al. 2020], Section 4.1, "symmetrization"); here the plane is found.
//!
//! | in        | shape         | unit       |
//! |-----------|---------------|------------|
//! | `samples` | `[S, 3]`      | normalised |
//! | `surface` | hierarchy     | normalised |
//!
//! Error of a plane: how far the mirrored samples are from the surface, each at most [`FAR`], on average. The search
//! starts from planes through the middle of the box (x = 0 is one of them) and of the surface, in all directions, on few
//! samples; the best are refined by fitting the plane to the pairs of a sample and its mirror image's nearest surface
//! point, in the manner of the iterative closest point [Besl and McKay 1992]. x = 0 wins unless another is clearly better.

use super::bvh::Bvh;
use super::surface_samples::SurfaceSamples;
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::f64::consts::PI;

/// A vertical plane: points with `normal · p = offset`. `normal` is horizontal, of unit length, with x ≥ 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SymmetryPlane {
    pub normal: DVec3,
    pub offset: f64,
    /// 0 (mirrored, the surface lies [`FAR`] from itself on average) to 1 (exactly symmetric).
    pub score: f64,
}

/// A mirrored sample counts as at most this far from the surface: about the width of a limb.
const FAR: f64 = 0.05;
/// Directions tried at first: every 5 degrees.
const DIRECTIONS: usize = 36;
/// Samples used to try a direction, to refine a plane, and to judge it.
const SAMPLES_TRIED: usize = 160;
const SAMPLES_REFINED: usize = 320;
const SAMPLES_JUDGED: usize = 1_000;
/// Best starts that are refined, and steps of refinement of each.
const STARTS: usize = 4;
const STEPS: usize = 8;
/// Steps of the best plane with all samples that judge it.
const LAST_STEPS: usize = 4;
/// Another plane must beat x = 0 by this much of the score: poses and props make small differences.
const CANONICAL_LEAD: f64 = 0.05;

impl SymmetryPlane {
    /// x = 0, unjudged.
    pub const CANONICAL: Self = Self { normal: DVec3::X, offset: 0.0, score: 0.0 };

    /// Mirrors a point in the plane.
    pub fn reflect(&self, point: DVec3) -> DVec3 {
        point - self.normal * (2.0 * self.signed_distance(point))
    }

    /// The mirror image of a direction.
    pub fn reflect_direction(&self, direction: DVec3) -> DVec3 {
        direction - self.normal * (2.0 * self.normal.dot(direction))
    }

    /// Distance from the plane, positive on the side that the normal points to (a character's left when it faces +z).
    pub fn signed_distance(&self, point: DVec3) -> f64 {
        self.normal.dot(point) - self.offset
    }
}

/// The best vertical mirror plane of the surface. x = 0 with score 0 where there is no surface.
pub fn detect_symmetry_plane(samples: &SurfaceSamples, surface: &Bvh) -> SymmetryPlane {
    if samples.positions.is_empty() {
        return SymmetryPlane::CANONICAL;
    }
    let search = Search { surface, samples: &samples.positions };
    let canonical = search.judged(SymmetryPlane::CANONICAL);
    if canonical.score > 1.0 - CANONICAL_LEAD {
        return canonical; // nothing can lead by enough
    }
    let refined = |start| search.judged(search.refined(start, SAMPLES_REFINED, STEPS));
    let best = search.starts().into_par_iter().map(refined).collect::<Vec<_>>();
    let mut best = best.into_iter().fold(canonical, |best, plane| {
        let lead = if best == canonical { CANONICAL_LEAD } else { 0.0 };
        if plane.score > best.score + lead { plane } else { best }
    });
    if best != canonical {
        let last = search.judged(search.refined(best, SAMPLES_JUDGED, LAST_STEPS));
        best = if last.score > best.score { last } else { best };
    }
    // The canonical plane, if refinement only wandered around it.
    let near = (best.normal.x - 1.0).abs() < 1e-4 && best.offset.abs() < 1e-3;
    if near { canonical } else { best }
}

struct Search<'a> {
    surface: &'a Bvh,
    samples: &'a [DVec3],
}

impl Search<'_> {
    /// About `count` samples, spread over all of them.
    fn some(&self, count: usize) -> impl Iterator<Item = DVec3> {
        let step = (self.samples.len() / count).max(1);
        self.samples.iter().copied().step_by(step)
    }

    fn error(&self, plane: SymmetryPlane, count: usize) -> f64 {
        let (mut sum, mut counted) = (0.0, 0);
        for sample in self.some(count) {
            let hit = self.surface.nearest_point_where(plane.reflect(sample), FAR, |_| true);
            sum += hit.map_or(FAR, |hit| hit.distance);
            counted += 1;
        }
        sum / f64::from(counted.max(1))
    }

    fn judged(&self, plane: SymmetryPlane) -> SymmetryPlane {
        SymmetryPlane { score: (1.0 - self.error(plane, SAMPLES_JUDGED) / FAR).clamp(0.0, 1.0), ..plane }
    }

    /// The best planes in all directions through the middle of the surface.
    fn starts(&self) -> Vec<SymmetryPlane> {
        let centre = self.samples.iter().sum::<DVec3>() / self.samples.len() as f64;
        let mut tried: Vec<(f64, SymmetryPlane)> = (0..DIRECTIONS)
            .into_par_iter()
            .map(|direction| {
                let angle = PI * (direction as f64 / DIRECTIONS as f64 - 0.5);
                let normal = DVec3::new(angle.cos(), 0.0, angle.sin());
                let plane = SymmetryPlane { normal, offset: normal.dot(centre), score: 0.0 };
                (self.error(plane, SAMPLES_TRIED), plane)
            })
            .collect();
        tried.sort_by(|a, b| a.0.total_cmp(&b.0));
        tried.truncate(STARTS);
        tried.into_iter().map(|(_, plane)| plane).collect()
    }

    /// Fits the plane to what its mirror images find, `steps` times.
    fn refined(&self, start: SymmetryPlane, count: usize, steps: usize) -> SymmetryPlane {
        (0..steps).fold(start, |plane, _| {
            let pairs = self.some(count).filter_map(|sample| {
                let hit = self.surface.nearest_point_where(plane.reflect(sample), 2.0 * FAR, |_| true)?;
                Some((DVec2::new(sample.x, sample.z), DVec2::new(hit.position.x, hit.position.z)))
            });
            fitted(&pairs.collect::<Vec<_>>()).unwrap_or(plane)
        })
    }
}

/// The mirror line that best maps the first of each pair to the second, seen from above.
///
/// With both sides centred, a reflection about a normal at angle φ is best where Σ p'ᵀ R q' is largest; that sum is
/// −(cos 2φ · Σ(p₁q₁ − p₂q₂) + sin 2φ · Σ(p₁q₂ + p₂q₁)). The centre of each pair lies on the line.
fn fitted(pairs: &[(DVec2, DVec2)]) -> Option<SymmetryPlane> {
    let count = pairs.len() as f64;
    let (from, to) = pairs.iter().fold((DVec2::ZERO, DVec2::ZERO), |(from, to), pair| (from + pair.0, to + pair.1));
    let (from, to) = (from / count, to / count);
    let (mut cosine, mut sine) = (0.0, 0.0);
    for &(p, q) in pairs {
        let (p, q) = (p - from, q - to);
        cosine -= p.x * q.x - p.y * q.y;
        sine -= p.x * q.y + p.y * q.x;
    }
    if cosine == 0.0 && sine == 0.0 || !count.is_normal() {
        return None;
    }
    let angle = 0.5 * sine.atan2(cosine); // in (−90°, 90°]: x ≥ 0
    let normal = DVec3::new(angle.cos(), 0.0, angle.sin());
    let middle = (from + to) * 0.5;
    Some(SymmetryPlane { normal, offset: normal.x * middle.x + normal.z * middle.y, score: 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use crate::mesh::test_shapes::{degenerate, joined, sphere, tube};
    use glam::DMat3;

    /// Body, head forward of it, two arms: symmetric in x = 0 only.
    fn figure(arm: f64) -> Mesh {
        joined(&[
            tube(DVec3::ZERO, 0.15, 0.7, 30, 20),
            sphere(DVec3::new(0.0, 0.8, 0.12), 0.15, 20),
            sphere(DVec3::new(0.35, 0.6, 0.05), arm, 20),
            sphere(DVec3::new(-0.35, 0.6, 0.05), 0.08, 20),
        ])
    }

    fn detect(mesh: &Mesh) -> SymmetryPlane {
        detect_symmetry_plane(&SurfaceSamples::new(mesh, 4_000), &Bvh::new(mesh))
    }

    #[test]
    fn an_exactly_symmetric_figure_has_exactly_the_canonical_plane() {
        let plane = detect(&figure(0.08));
        assert_eq!((plane.normal, plane.offset), (DVec3::X, 0.0));
        assert!(plane.score > 0.99, "{}", plane.score);
    }

    #[test]
    fn turning_and_moving_the_figure_turns_and_moves_the_plane() {
        for degrees in [17.0, 45.0, 90.0, 133.0] {
            let turn = DMat3::from_rotation_y(f64::to_radians(degrees));
            let shift = DVec3::new(0.1, 0.0, -0.2);
            let mut mesh = figure(0.08);
            mesh.positions.iter_mut().for_each(|position| *position = turn * *position + shift);
            let plane = detect(&mesh);
            let normal = turn * DVec3::X;
            let agreement = plane.normal.dot(normal);
            assert!(agreement.abs() > 0.9999, "{degrees}: {plane:?}");
            assert!((plane.offset * agreement.signum() - normal.dot(shift)).abs() < 2e-3, "{degrees}: {plane:?}");
            assert!(plane.score > 0.97, "{degrees}: {plane:?}");
        }
    }

    #[test]
    fn a_lopsided_figure_scores_lower() {
        assert!(detect(&figure(0.16)).score < detect(&figure(0.08)).score - 0.02);
        let plane = detect(&joined(&[sphere(DVec3::ZERO, 0.1, 20), sphere(DVec3::new(0.9, 0.3, 0.2), 0.3, 20)]));
        assert!(plane.normal.is_normalized() && (0.0..=1.0).contains(&plane.score));
    }

    #[test]
    fn reflection_twice_is_nothing_and_degenerate_shapes_have_a_plane() {
        let plane = SymmetryPlane { normal: DVec3::new(0.6, 0.0, 0.8), offset: 0.3, score: 1.0 };
        let point = DVec3::new(1.0, 2.0, 3.0);
        assert!(plane.reflect(plane.reflect(point)).distance(point) < 1e-12);
        assert!((plane.signed_distance(plane.reflect(point)) + plane.signed_distance(point)).abs() < 1e-12);
        for mesh in degenerate() {
            assert!(detect(&mesh).normal.is_normalized());
        }
    }
}
