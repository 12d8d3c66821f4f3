//! Triangle meshes as plain data, and the steps that make an upload's mesh fit to work on.

use glam::DVec3;

/// A triangle mesh in one space; which space, the owner says.
///
/// `positions` `[V, 3]`; `triangles` `[F, 3]`, 0-based, counter-clockwise seen from outside. Every index is below V
/// and every position finite: [`crate::formats`] refuses anything else.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    pub positions: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
}
