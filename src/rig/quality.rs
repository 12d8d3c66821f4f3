//! What can be said of a rig without knowing the right answer. Cheap; for reports and tests.

use super::SkinWeights;
use crate::geometry::symmetry_plane::SymmetryPlane;
use glam::DVec3;

/// The share of joints for which `is_inside` holds; 1 without joints.
pub fn inside_share(joints: &[DVec3], is_inside: impl Fn(DVec3) -> bool) -> f64 {
    if joints.is_empty() {
        return 1.0;
    }
    joints.iter().filter(|joint| is_inside(**joint)).count() as f64 / joints.len() as f64
}

/// Mean distance from each joint's mirror image to the nearest joint, in the joints' unit; 0 for a symmetric skeleton.
pub fn mirror_error(joints: &[DVec3], plane: &SymmetryPlane) -> f64 {
    let nearest = |image: DVec3| joints.iter().map(|joint| joint.distance(image)).fold(f64::INFINITY, f64::min);
    let total: f64 = joints.iter().map(|&joint| nearest(plane.reflect(joint))).sum();
    total / joints.len().max(1) as f64
}

/// Vertices without a weight above zero; [`SkinWeights`] promises none.
pub fn unweighted_vertices(skin: &SkinWeights) -> usize {
    skin.rows.iter().filter(|row| !row.iter().any(|influence| influence.weight > 0.0)).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLANE: SymmetryPlane = SymmetryPlane { normal: DVec3::X, offset: 0.0, score: 1.0 };

    #[test]
    fn a_symmetric_skeleton_has_no_mirror_error_and_a_shifted_one_has() {
        let joints = [DVec3::new(-0.2, 1.0, 0.0), DVec3::Y, DVec3::new(0.2, 1.0, 0.0)];
        assert_eq!(mirror_error(&joints, &PLANE), 0.0);
        assert!((mirror_error(&joints.map(|joint| joint + DVec3::X * 0.01), &PLANE) - 0.02).abs() < 1e-12);
        assert_eq!(mirror_error(&[], &PLANE), 0.0);
    }

    #[test]
    fn shares_and_counts() {
        assert_eq!(inside_share(&[DVec3::ZERO, DVec3::Y], |joint| joint.y > 0.5), 0.5);
        assert_eq!(unweighted_vertices(&SkinWeights { rows: vec![Vec::new()] }), 1);
    }
}
