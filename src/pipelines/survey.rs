//! What can be told of a mesh without running a network: soundness, symmetry, and what rigging it will cost.

use crate::geometry::bvh::Bvh;
use crate::geometry::surface_samples::SurfaceSamples;
use crate::geometry::symmetry_plane::detect_symmetry_plane;
use crate::mesh::Mesh;
use crate::mesh::adjacency::{components, edge_statistics};
use crate::mesh::normalize::Normalization;
use crate::mesh::working_mesh::WorkingMesh;
use glam::DMat3;

/// Facts of an upload's mesh and an estimate of the work.
#[derive(Clone, Debug, PartialEq)]
pub struct Survey {
    /// Connected parts of the welded mesh.
    pub components: usize,
    /// Edges with one face.
    pub boundary_edges: usize,
    /// Edges with more than two faces.
    pub nonmanifold_edges: usize,
    /// Faces without an area, or listed twice.
    pub degenerate_faces: usize,
    /// Extent along the up axis, in upload units.
    pub height: f64,
    /// How well the best vertical plane mirrors the shape, 0 to 1.
    pub symmetry_score: f64,
    /// Seconds of one core for a whole rig, roughly.
    pub seconds: f64,
    pub memory_mib: u64,
}

/// Enough samples to score a symmetry plane; the rig itself uses more.
const SAMPLES: usize = 1_000;

/// `None` when nothing of `mesh` (upload space) has an area. `to_upright` as in [`super::Subject`].
pub fn survey(mesh: &Mesh, to_upright: DMat3) -> Option<Survey> {
    let normalization = Normalization::new(&mesh.positions, to_upright)?;
    let normalised = normalised(mesh, &normalization);
    let working = WorkingMesh::new(&normalised).ok()?;
    let (low, high) = normalised.bounding_box()?;
    let edges = edge_statistics(&working.welded.mesh);
    let surface = Bvh::new(&working.mesh);
    let symmetry = detect_symmetry_plane(&SurfaceSamples::new(&working.mesh, SAMPLES), &surface);
    let (seconds, memory_mib) = estimate(working.mesh.positions.len(), mesh.triangles.len());
    Some(Survey {
        components: components(&working.welded.mesh).count,
        boundary_edges: edges.boundary,
        nonmanifold_edges: edges.non_manifold,
        degenerate_faces: mesh.triangles.len() - working.welded.mesh.triangles.len(),
        height: (high.y - low.y) / normalization.scale,
        symmetry_score: symmetry.score,
        seconds,
        memory_mib,
    })
}

/// The mesh in the normalised frame.
pub fn normalised(mesh: &Mesh, normalization: &Normalization) -> Mesh {
    Mesh {
        positions: mesh.positions.iter().map(|&position| normalization.apply(position)).collect(),
        triangles: mesh.triangles.clone(),
    }
}

/// CPU-seconds and MiB of one job: a fit to the table of `docs/performance.md`.
fn estimate(working_vertices: usize, upload_triangles: usize) -> (f64, u64) {
    let seconds = 0.05 + 0.000_25 * working_vertices as f64 + 3e-6 * upload_triangles as f64;
    let memory_mib = 160 + working_vertices as u64 / 45 + upload_triangles as u64 / 3_000;
    (seconds, memory_mib)
}
