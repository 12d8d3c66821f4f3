//! What a rig does to its mesh in motion: edges that stretch, volume that is lost. Lengths are normalised; pure.

use crate::mesh::Mesh;
use crate::mesh::adjacency::Neighbors;
use glam::{DQuat, DVec3};

/// Every joint but the root turns this far about each axis in turn.
const POSE_RADIANS: f64 = 35.0 * std::f64::consts::PI / 180.0;
/// Edges shorter than this say nothing of stretch.
const EDGE_LENGTH_MIN: f64 = 1e-4;
/// The share of edges that may be worse than the stretch that is told.
const STRETCH_TAIL: f64 = 0.01;
/// Less volume than this (in cubes of the longest side) is no solid.
const VOLUME_MIN: f64 = 1e-4;

/// The range of motion: about each axis forth and back, all joints but the root at once.
pub(super) fn poses(joint_count: usize) -> Vec<Vec<DQuat>> {
    let turns = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::Z, DVec3::NEG_Z];
    turns
        .iter()
        .map(|&axis| {
            let turned = DQuat::from_axis_angle(axis, POSE_RADIANS);
            (0..joint_count).map(|joint| if joint == 0 { DQuat::IDENTITY } else { turned }).collect()
        })
        .collect()
}

/// The factor by which the edge at the end of the tail is longer or shorter than at rest.
pub(super) fn stretch(ring: &Neighbors, rest: &[DVec3], posed: &[DVec3]) -> f64 {
    let mut factors = Vec::new();
    for vertex in 0..ring.vertex_count().min(rest.len()) {
        for next in ring.row(vertex).iter().map(|&next| next as usize).filter(|&next| next > vertex) {
            let (before, after) = (rest[vertex].distance(rest[next]), posed[vertex].distance(posed[next]));
            if before > EDGE_LENGTH_MIN {
                let after = after.max(EDGE_LENGTH_MIN * 0.1);
                factors.push((after / before).max(before / after));
            }
        }
    }
    factors.sort_unstable_by(f64::total_cmp);
    let place = ((1.0 - STRETCH_TAIL) * factors.len() as f64) as usize;
    factors.get(place.min(factors.len().saturating_sub(1))).copied().unwrap_or(1.0)
}

/// Signed volume by the divergence theorem: a sixth of the sum of `a · (b × c)`.
fn volume(triangles: &[[u32; 3]], positions: &[DVec3]) -> f64 {
    let corner = |index: u32| positions.get(index as usize).copied().unwrap_or_default();
    triangles.iter().map(|&[a, b, c]| corner(a).dot(corner(b).cross(corner(c)))).sum::<f64>() / 6.0
}

/// The largest share of the volume at rest that a pose loses or gains; `None` where there is no volume.
pub(super) fn volume_change(mesh: &Mesh, poses: &[Vec<DVec3>]) -> Option<f64> {
    let rest = volume(&mesh.triangles, &mesh.positions).abs();
    let changes = poses.iter().map(|posed| (volume(&mesh.triangles, posed).abs() / rest - 1.0).abs());
    (rest > VOLUME_MIN).then(|| changes.fold(0.0, f64::max))
}
