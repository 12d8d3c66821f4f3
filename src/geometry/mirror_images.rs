//! Where the mirror image of each vertex lies on the same mesh.
//!
//! | in      | shape              | unit             |
//! |---------|--------------------|------------------|
//! | `mesh`  | `[V, 3]`, `[F, 3]` | normalised frame |
//! | `plane` |                    | normalised frame |
//!
//! Out `[V]`: three vertices and their weights (not negative, sum 1). Where a vertex is at the image's place, it alone; that
//! makes the images of an exactly symmetric mesh each other's. Else the nearest point of the surface, and `None` where nothing
//! is near: a prop in one hand has no image.

use super::bvh::Bvh;
use super::point_tree::PointTree;
use super::symmetry_plane::SymmetryPlane;
use super::transfer::Blend;
use crate::mesh::Mesh;
use rayon::prelude::*;
use std::sync::OnceLock;

/// A vertex this near to an image is at its place: exporters round, and a plane that was found is off by less.
const SAME_PLACE: f64 = 1e-4;
/// An image farther from the surface than this has no counterpart: the width of a thin limb.
const NEAR: f64 = 0.02;

/// For every vertex of `mesh` the place of its mirror image.
pub fn mirror_images(mesh: &Mesh, plane: &SymmetryPlane) -> Vec<Option<Blend>> {
    let (vertices, surface) = (PointTree::new(&mesh.positions), OnceLock::new());
    let image = |&position: &_| {
        let image = plane.reflect(position);
        let (nearest, squared) = vertices.nearest(image)?;
        if squared <= SAME_PLACE * SAME_PLACE {
            return Some([(nearest, 1.0), (nearest, 0.0), (nearest, 0.0)]);
        }
        let hit = surface.get_or_init(|| Bvh::new(mesh)).nearest_point_where(image, NEAR, |_| true)?;
        let corners = mesh.triangles[hit.triangle as usize];
        Some([0, 1, 2].map(|corner| (corners[corner], hit.barycentric[corner])))
    };
    mesh.positions.par_iter().map(image).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::{joined, sphere, tube};
    use glam::DVec3;

    const PLANE: SymmetryPlane = SymmetryPlane::CANONICAL;

    #[test]
    fn images_on_a_symmetric_mesh_are_vertices_and_each_others() {
        let mesh = joined(&[
            tube(DVec3::new(0.3, 0.0, 0.0), 0.1, 0.5, 8, 4),
            tube(DVec3::new(-0.3, 0.0, 0.0), 0.1, 0.5, 8, 4),
        ]);
        let images = mirror_images(&mesh, &PLANE);
        for (vertex, image) in images.iter().enumerate() {
            let [(there, share), ..] = image.expect("an image");
            assert_eq!(share, 1.0);
            assert!(mesh.positions[there as usize].distance(PLANE.reflect(mesh.positions[vertex])) < 1e-9);
            let [(back, _), ..] = images[there as usize].expect("an image");
            assert_eq!(mesh.positions[back as usize], mesh.positions[vertex]);
        }
    }

    #[test]
    fn other_triangles_give_a_place_between_and_a_lone_part_none() {
        let body = joined(&[sphere(DVec3::X * 0.3, 0.2, 24), sphere(DVec3::X * -0.3, 0.2, 31)]);
        let count = body.positions.len();
        let mesh = joined(&[body, sphere(DVec3::new(0.9, 0.9, 0.0), 0.05, 8)]);
        for (vertex, image) in mirror_images(&mesh, &PLANE).into_iter().enumerate() {
            assert_eq!(image.is_some(), vertex < count, "vertex {vertex}");
            let Some(image) = image else { continue };
            let place: DVec3 = image.iter().map(|&(at, share)| mesh.positions[at as usize] * share).sum();
            assert!(place.distance(PLANE.reflect(mesh.positions[vertex])) <= NEAR);
        }
    }
}
