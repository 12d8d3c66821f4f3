//! From each vertex to the middle of the body part that it covers: half of the local diameter along the inward normal.
//! Shape diameter function [Shapira, Shamir and Cohen-Or 2008].
//!
//! | in        | shape              | unit                       |
//! |-----------|--------------------|----------------------------|
//! | `mesh`    | `[V, 3]`, `[F, 3]` | any space; welded          |
//! | `surface` | `[F]`              | the same mesh's hierarchy  |
//!
//! Out: `[V]` vectors, in the mesh's unit. Zero where no ray leaves the body: on sheets and at wide holes.
//!
//! The diameter is the median over a cone of rays about the inward normal, so that a ray down a limb does not count. A ray
//! ends where it *leaves* a surface; what it enters (the body under a coat) lies on its way. Faces are first turned to look
//! outward ([`crate::mesh::face_orientation`]). O(V log F), in parallel, same bits for any number of threads.

use super::bvh::Bvh;
use crate::mesh::Mesh;
use crate::mesh::face_orientation::outward;
use glam::DVec3;
use rayon::prelude::*;

/// Rays in the cone, beside the one along the inward normal.
const CONE_RAYS: usize = 6;
/// Between a ray of the cone and the inward normal.
const CONE_RADIANS: f64 = 35.0 * std::f64::consts::PI / 180.0;
/// Rays start this share of the longest side inside, so as not to meet the faces of their own vertex.
const START: f64 = 1e-4;

/// The vector from each vertex to the middle of the body.
pub fn medial_offsets(mesh: &Mesh, surface: &Bvh) -> Vec<DVec3> {
    let triangles = outward(mesh);
    let facing: Vec<DVec3> = triangles
        .iter()
        .map(|corners| {
            let [a, b, c] = corners.map(|corner| mesh.positions[corner as usize]);
            (b - a).cross(c - a)
        })
        .collect();
    let mut normals = vec![DVec3::ZERO; mesh.positions.len()];
    for (corners, &across) in triangles.iter().zip(&facing) {
        for &corner in corners {
            normals[corner as usize] += across;
        }
    }
    let (low, high) =
        mesh.positions.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)));
    let start = START * (high - low).max_element();
    let leaves = |triangle: u32, direction: DVec3| facing[triangle as usize].dot(direction) > 0.0;
    (mesh.positions.par_iter().zip(&normals))
        .map(|(&vertex, normal)| {
            let Some(inward) = (-*normal).try_normalize() else { return DVec3::ZERO };
            let mut lengths: Vec<f64> = cone(inward)
                .filter_map(|direction| {
                    let origin = vertex + inward * start;
                    surface.first_hit_among(origin, direction, |triangle| leaves(triangle, direction))
                })
                .map(|hit| hit.t)
                .collect();
            if lengths.len() <= CONE_RAYS / 2 {
                return DVec3::ZERO;
            }
            lengths.sort_by(f64::total_cmp);
            inward * (0.5 * lengths[(lengths.len() - 1) / 2])
        })
        .collect()
}

/// Unit vectors: `axis`, and the cone about it.
fn cone(axis: DVec3) -> impl Iterator<Item = DVec3> {
    let (across, other) = axis.any_orthonormal_pair();
    let (sine, cosine) = CONE_RADIANS.sin_cos();
    let around = (0..CONE_RAYS).map(move |ray| {
        let (up, right) = (std::f64::consts::TAU * ray as f64 / CONE_RAYS as f64).sin_cos();
        axis * cosine + (across * right + other * up) * sine
    });
    std::iter::once(axis).chain(around)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::{degenerate, joined, sphere, tube};

    fn offsets(mesh: &Mesh) -> Vec<DVec3> {
        medial_offsets(mesh, &Bvh::new(mesh))
    }

    /// Off the caps, the middle of a tube is its axis.
    #[test]
    fn a_tube_leads_to_its_axis() {
        let mesh = tube(DVec3::ZERO, 0.1, 1.0, 24, 40);
        let mut met = 0;
        for (vertex, offset) in mesh.positions.iter().zip(offsets(&mesh)) {
            if (0.2..0.8).contains(&vertex.y) {
                let middle = *vertex + offset;
                assert!(DVec3::new(middle.x, 0.0, middle.z).length() < 0.02, "{vertex} leads to {middle}");
                met += 1;
            }
        }
        assert!(met > 100);
    }

    #[test]
    fn the_inside_of_a_shell_is_found_whichever_way_its_faces_look() {
        let mesh = sphere(DVec3::ZERO, 0.5, 16);
        let turned = Mesh { triangles: mesh.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect(), ..mesh.clone() };
        for (own, other) in offsets(&mesh).into_iter().zip(offsets(&turned)) {
            assert!((own - other).length() < 1e-9 && own.length() > 0.3, "{own} {other}");
        }
    }

    /// A coat two hundredths off the body leads to the body's middle, not between coat and body.
    #[test]
    fn a_coat_leads_to_the_middle_of_the_body() {
        let mesh = joined(&[tube(DVec3::ZERO, 0.1, 1.0, 24, 40), tube(DVec3::ZERO, 0.12, 1.0, 24, 40)]);
        for (vertex, offset) in mesh.positions.iter().zip(offsets(&mesh)) {
            if (0.3..0.7).contains(&vertex.y) {
                assert!(offset.length() > 0.08, "{vertex} {offset}");
            }
        }
    }

    #[test]
    fn degenerate_shapes_are_survived() {
        for mesh in degenerate() {
            assert!(offsets(&mesh).iter().all(|offset| offset.is_finite()));
        }
    }
}
