//! The inside of a shape as 88³ cells. RigNet [Xu et al. 2020], Section 4.2 ("voxelized shape").

use crate::mesh::Mesh;
use glam::DVec3;

/// Cells per side.
pub const RESOLUTION: usize = 88;

/// Which cells of a cube are inside.
#[derive(Clone, Debug, PartialEq)]
pub struct VoxelGrid {
    /// Least corner of the cube.
    pub origin: DVec3,
    /// Side of the cube.
    pub side: f64,
    /// `[88, 88, 88]` in the order x, y, z (z fastest).
    pub inside: Vec<bool>,
}

impl VoxelGrid {
    /// The solid of `mesh` in its bounding cube (anchored at the least corner).
    pub fn solid(mesh: &Mesh) -> Self {
        let (low, high) = mesh.bounding_box().unwrap_or((DVec3::ZERO, DVec3::ONE));
        Self { origin: low, side: (high - low).max_element(), inside: vec![true; RESOLUTION.pow(3)] }
    }

    /// Whether the cell that holds `point` is inside.
    pub fn contains(&self, point: DVec3) -> bool {
        let cell = ((point - self.origin) / self.side * RESOLUTION as f64).floor();
        let limit = RESOLUTION as f64;
        if !(cell.cmpge(DVec3::ZERO).all() && cell.cmplt(DVec3::splat(limit)).all()) {
            return false;
        }
        let [x, y, z] = cell.to_array().map(|index| index as usize);
        self.inside[(x * RESOLUTION + y) * RESOLUTION + z]
    }
}
