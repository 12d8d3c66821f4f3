//! From the working mesh back to the vertices that were sent: where on its surface each of them belongs.

use super::bvh::Bvh;
use crate::mesh::Mesh;
use crate::mesh::working_mesh::WorkingMesh;

/// Three vertices of the working mesh and their weights; not negative, sum 1.
pub type Blend = [(u32, f64); 3];

/// For every vertex of `original` (normalised) the place on the working mesh that its results come from. `[V original]`.
pub fn transfer_map(original: &Mesh, working: &WorkingMesh) -> Vec<Blend> {
    let surface = Bvh::new(&working.mesh);
    original
        .positions
        .iter()
        .map(|&position| match surface.nearest_point(position) {
            Some(hit) => {
                let corners = working.mesh.triangles[hit.triangle as usize];
                [0, 1, 2].map(|k| (corners[k], hit.barycentric[k]))
            }
            None => [(0, 1.0), (0, 0.0), (0, 0.0)],
        })
        .collect()
}
