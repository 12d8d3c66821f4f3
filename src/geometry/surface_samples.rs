//! Points spread evenly over a surface, with normals. RigNet [Xu et al. 2020] measures surface distances on 4,000.

use crate::mesh::Mesh;
use glam::DVec3;

/// How many samples the surface distances use.
pub const SAMPLE_COUNT: usize = 4_000;

/// Points on a surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceSamples {
    pub positions: Vec<DVec3>,
    /// Unit length, interpolated from the vertices.
    pub normals: Vec<DVec3>,
}

impl SurfaceSamples {
    /// About `count` samples of `mesh`, evenly spread.
    pub fn new(mesh: &Mesh, count: usize) -> Self {
        let normals = mesh.vertex_normals();
        let stride = (mesh.triangles.len() / count.max(1)).max(1);
        let chosen: Vec<usize> = (0..mesh.triangles.len()).step_by(stride).collect();
        let positions = chosen.iter().map(|&face| mesh.corners(face).into_iter().sum::<DVec3>() / 3.0).collect();
        let normal = |face: usize| mesh.triangles[face].iter().map(|&corner| normals[corner as usize]).sum::<DVec3>();
        Self { positions, normals: chosen.iter().map(|&face| normal(face).normalize_or_zero()).collect() }
    }
}
