//! Whether a surface passes through itself, as clothes that sink into a body do. For the check: such meshes are rigged all the same.
//!
//! In: a mesh with one vertex per place. An edge that pierces a face which shares none of its ends is a crossing.
//! Faces that lie on each other in one plane are none.

use super::bvh::Bvh;
use crate::mesh::Mesh;
use rayon::prelude::*;

/// A mesh with more faces is not looked at: a check answers within two seconds.
pub const FACES_MAX: usize = 100_000;
/// Shares of an edge at its ends where touching is no piercing: seams of single-precision files end there.
const END: f64 = 1e-4;

/// `None` for a mesh of more than [`FACES_MAX`] faces.
pub fn self_intersecting(mesh: &Mesh) -> Option<bool> {
    if mesh.triangles.len() > FACES_MAX {
        return None;
    }
    let bvh = Bvh::new(mesh);
    let pierces = |from: u32, to: u32| {
        let (start, end) = (mesh.positions[from as usize], mesh.positions[to as usize]);
        let way = end - start;
        let apart = |face: u32| !mesh.triangles[face as usize].iter().any(|&corner| corner == from || corner == to);
        bvh.first_hit_among(start + way * END, way * (1.0 - 2.0 * END), apart).is_some_and(|hit| hit.t <= 1.0)
    };
    let mut edges: Vec<(u32, u32)> = mesh
        .triangles
        .iter()
        .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)])
        .map(|(a, b)| (a.min(b), a.max(b)))
        .collect();
    edges.sort_unstable();
    edges.dedup();
    Some(edges.into_par_iter().any(|(from, to)| from != to && pierces(from, to)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::{cuboid, joined, sphere, torus};
    use glam::DVec3;

    #[test]
    fn only_surfaces_that_pass_through_each_other_cross() {
        let ball = |x: f64| sphere(DVec3::new(x, 0.0, 0.0), 0.5, 16);
        assert_eq!(self_intersecting(&ball(0.0)), Some(false));
        assert_eq!(self_intersecting(&torus(0.5, 0.2, 24)), Some(false));
        assert_eq!(self_intersecting(&joined(&[ball(0.0), ball(0.7)])), Some(true));
        assert_eq!(self_intersecting(&joined(&[ball(0.0), ball(1.2)])), Some(false));
        let inside = cuboid(DVec3::ZERO, DVec3::splat(0.1));
        assert_eq!(self_intersecting(&joined(&[ball(0.0), inside])), Some(false), "one within the other");
        assert_eq!(self_intersecting(&Mesh::default()), Some(false));
    }

    #[test]
    fn boxes_that_share_a_wall_do_not_cross_and_too_many_faces_are_not_looked_at() {
        let side_by_side = joined(&[cuboid(DVec3::ZERO, DVec3::ONE), cuboid(DVec3::X * 2.0, DVec3::ONE)]);
        assert_eq!(self_intersecting(&side_by_side), Some(false));
        let mut many = cuboid(DVec3::ZERO, DVec3::ONE);
        many.triangles = many.triangles.repeat(FACES_MAX / 12 + 1);
        assert_eq!(self_intersecting(&many), None);
    }
}
