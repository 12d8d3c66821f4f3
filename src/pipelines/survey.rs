//! What can be told of a mesh without running a network: soundness, symmetry, stance, and what rigging it will cost.

use crate::geometry::bvh::Bvh;
use crate::geometry::self_intersection::self_intersecting;
use crate::geometry::stance::{Stance, stance};
use crate::geometry::surface_samples::SurfaceSamples;
use crate::geometry::symmetry_plane::{SymmetryPlane, detect_symmetry_plane};
use crate::mesh::Mesh;
use crate::mesh::adjacency::edge_statistics;
use crate::mesh::normalize::Normalization;
use crate::mesh::working_mesh::WorkingMesh;
use glam::{DMat3, DVec3};

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
    /// Whether the surface passes through itself; `None` where there are too many faces to tell in time.
    pub self_intersecting: Option<bool>,
    /// Extent along the up axis, in upload units.
    pub height: f64,
    /// Unit normal and a point of the best vertical mirror plane, in upload space,
    pub symmetry_plane: (DVec3, DVec3),
    /// and how well it mirrors the shape, 0 to 1.
    pub symmetry_score: f64,
    pub stance: Stance,
    /// Seconds of one core for a whole rig, roughly.
    pub seconds: f64,
    pub memory_mib: u64,
}

/// Enough samples to score a symmetry plane and to find arms; the rig itself uses more.
const SAMPLES: usize = 2_000;

/// `None` when nothing of `mesh` (upload space) has an area. `to_upright` as in [`super::Subject`].
pub fn survey(mesh: &Mesh, to_upright: DMat3) -> Option<Survey> {
    let normalization = Normalization::new(&mesh.positions, to_upright)?;
    let normalised = normalised(mesh, &normalization);
    let working = WorkingMesh::new(&normalised).ok()?;
    let (low, high) = normalised.bounding_box()?;
    let welded = &working.welded.mesh;
    let edges = edge_statistics(welded);
    let samples = SurfaceSamples::new(&working.mesh, SAMPLES);
    let symmetry = detect_symmetry_plane(&samples, &Bvh::new(&working.mesh));
    let (seconds, memory_mib) = estimate(working.mesh.positions.len(), mesh.triangles.len());
    Some(Survey {
        components: working.component_of_welded.iter().max().map_or(0, |&last| last as usize + 1),
        boundary_edges: edges.boundary,
        nonmanifold_edges: edges.non_manifold,
        self_intersecting: self_intersecting(welded),
        degenerate_faces: mesh.triangles.len() - working.welded.mesh.triangles.len(),
        height: (high.y - low.y) / normalization.scale,
        symmetry_plane: plane_in_upload(&symmetry, &normalization),
        symmetry_score: symmetry.score,
        stance: stance(&working.mesh, &samples, &symmetry),
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

/// Unit normal and one point of a plane of the normalised frame, in upload space.
pub(super) fn plane_in_upload(plane: &SymmetryPlane, normalization: &Normalization) -> (DVec3, DVec3) {
    let point = normalization.invert(plane.normal * plane.offset);
    let beyond = normalization.invert(plane.normal * (plane.offset + 1.0));
    ((beyond - point).normalize_or_zero(), point)
}

/// CPU-seconds and MiB of one job: a fit to the table of `docs/performance.md`.
fn estimate(working_vertices: usize, upload_triangles: usize) -> (f64, u64) {
    let seconds = 0.08 + 0.000_28 * working_vertices as f64 + 3e-6 * upload_triangles as f64;
    let memory_mib = 160 + working_vertices as u64 / 45 + upload_triangles as u64 / 3_000;
    (seconds, memory_mib)
}
