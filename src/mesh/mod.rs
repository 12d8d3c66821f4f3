//! Triangle meshes as plain data, and the steps that make an upload's mesh fit to work on.
//!
//! In order: [`normalize`] (upload space to the normalised frame), [`weld`] (one vertex per place),
//! [`working_mesh`] (1,000 to about 4,000 vertices), [`adjacency`] (who is whose neighbour).

use glam::DVec3;

pub mod adjacency;
pub mod face_orientation;
pub mod normalize;
#[cfg(test)]
pub(crate) mod test_shapes;
pub mod weld;
pub mod working_mesh;

/// A triangle mesh in one space; which space, the owner says.
///
/// `positions` `[V, 3]`; `triangles` `[F, 3]`, 0-based, counter-clockwise seen from outside. Every index is below V
/// and every position finite: [`crate::formats`] refuses anything else.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    pub positions: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// The three corners of a triangle.
    pub fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle].map(|corner| self.positions[corner as usize])
    }

    /// The normal of a triangle, as long as twice its area; zero for a degenerate one.
    pub fn area_normal(&self, triangle: usize) -> DVec3 {
        let [a, b, c] = self.corners(triangle);
        (b - a).cross(c - a)
    }

    /// Unit normals of the vertices `[V, 3]`: the normalised sum of the area normals of the faces around each.
    /// Zero where a vertex has no face with area, or where they cancel.
    pub fn vertex_normals(&self) -> Vec<DVec3> {
        let mut normals = vec![DVec3::ZERO; self.positions.len()];
        for (index, corners) in self.triangles.iter().enumerate() {
            let normal = self.area_normal(index);
            for &corner in corners {
                normals[corner as usize] += normal;
            }
        }
        normals.into_iter().map(DVec3::normalize_or_zero).collect()
    }

    /// Least and greatest corner of the axis-aligned bounding box; `None` without vertices.
    pub fn bounding_box(&self) -> Option<(DVec3, DVec3)> {
        bounding_box(&self.positions)
    }
}

/// Least and greatest corner of the axis-aligned bounding box; `None` without points.
pub fn bounding_box(positions: &[DVec3]) -> Option<(DVec3, DVec3)> {
    let first = *positions.first()?;
    Some(positions.iter().fold((first, first), |(low, high), &p| (low.min(p), high.max(p))))
}
