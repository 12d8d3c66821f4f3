//! The vertical plane that a shape is most nearly its own mirror image in.

use super::bvh::Bvh;
use super::surface_samples::SurfaceSamples;
use glam::DVec3;

/// A vertical plane: points with `normal · p = offset`. `normal` is horizontal, of unit length, with x ≥ 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SymmetryPlane {
    pub normal: DVec3,
    pub offset: f64,
    /// 0 (nothing of the shape maps onto itself) to 1 (exactly symmetric).
    pub score: f64,
}

impl SymmetryPlane {
    /// Mirrors a point in the plane.
    pub fn reflect(&self, point: DVec3) -> DVec3 {
        point - self.normal * (2.0 * self.signed_distance(point))
    }

    /// Distance from the plane, positive on the side that the normal points to (a character's left when it faces +z).
    pub fn signed_distance(&self, point: DVec3) -> f64 {
        self.normal.dot(point) - self.offset
    }
}

/// The best vertical mirror plane of the surface.
pub fn detect_symmetry_plane(samples: &SurfaceSamples, surface: &Bvh) -> SymmetryPlane {
    let plane = SymmetryPlane { normal: DVec3::X, offset: 0.0, score: 0.0 };
    let distance: f64 =
        samples.positions.iter().filter_map(|&p| surface.nearest_point(plane.reflect(p))).map(|hit| hit.distance).sum();
    SymmetryPlane { score: (1.0 - distance / (0.02 * samples.positions.len().max(1) as f64)).clamp(0.0, 1.0), ..plane }
}
