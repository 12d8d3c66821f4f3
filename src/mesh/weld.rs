//! One vertex per place: the seams of an upload (UV, normals, parts) closed before any geometry is done.
//!
//! | in     | shape              | unit      |
//! |--------|--------------------|-----------|
//! | `mesh` | `[V, 3]`, `[F, 3]` | any space |
//!
//! Vertices nearer than [`TOLERANCE`] times the longest side become one, across parts. Chains of near vertices collapse
//! as a whole, so the result does not depend on the order of vertices (positions move by less than the tolerance).
//! Faces that lose a corner are dropped, and so are faces on the same three vertices as an earlier one, whichever way
//! they turn: the back faces of a two-sided material would double every count. Vertices without a face are left out;
//! their weights come later from the nearest surface.

use super::adjacency::DisjointSets;
use super::{Mesh, bounding_box};
use glam::{DVec3, I64Vec3};
use std::collections::HashMap;

/// Share of the longest side within which two vertices are one place. Single-precision files place seam vertices
/// within 1.2e-7 of each other; the finest modelled detail (eyelashes of a 2 m figure) is above 1e-5.
pub const TOLERANCE: f64 = 1e-6;

/// A mesh with one vertex per place, and where each vertex of the original went.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Welded {
    pub mesh: Mesh,
    /// `[V of the original]`; `None` for a vertex that no remaining face uses.
    pub vertex_of_original: Vec<Option<u32>>,
    /// Faces dropped because two corners are one place.
    pub degenerate_faces: usize,
    /// Faces dropped because an earlier face has the same corners.
    pub duplicate_faces: usize,
}

/// Welds all vertices of `mesh`. Vertices are numbered by first use in the faces; faces keep their order.
pub fn weld(mesh: &Mesh) -> Welded {
    let place = places(&mesh.positions);
    let mut welded = Welded { vertex_of_original: vec![None; mesh.positions.len()], ..Welded::default() };
    let mut number_of_place: Vec<Option<u32>> = vec![None; mesh.positions.len()];
    let corners: Vec<[u32; 3]> = mesh.triangles.iter().map(|face| face.map(|corner| place[corner as usize])).collect();
    let repeated = repeated_faces(&corners);
    for (index, &face) in corners.iter().enumerate() {
        let [a, b, c] = face;
        if a == b || b == c || c == a {
            welded.degenerate_faces += 1;
        } else if repeated[index] {
            welded.duplicate_faces += 1;
        } else {
            let numbered = face.map(|corner| {
                *number_of_place[corner as usize].get_or_insert_with(|| {
                    welded.mesh.positions.push(mesh.positions[corner as usize]);
                    welded.mesh.positions.len() as u32 - 1
                })
            });
            welded.mesh.triangles.push(numbered);
        }
    }
    for (vertex, &place) in place.iter().enumerate() {
        welded.vertex_of_original[vertex] = number_of_place[place as usize];
    }
    welded
}

/// For each position the least index of those at its place.
fn places(positions: &[DVec3]) -> Vec<u32> {
    let Some((low, high)) = bounding_box(positions) else { return Vec::new() };
    let cell = TOLERANCE * (high - low).max_element();
    let mut sets = DisjointSets::new(positions.len());
    let cell_of = |position: DVec3| if cell > 0.0 { (position - low) / cell } else { DVec3::ZERO };
    // One place per cell of the tolerance's size ...
    let mut first_in_cell: HashMap<I64Vec3, u32> = HashMap::with_capacity(positions.len());
    for (vertex, &position) in positions.iter().enumerate() {
        let first = *first_in_cell.entry(cell_of(position).floor().as_i64vec3()).or_insert(vertex as u32);
        sets.join(first, vertex as u32);
    }
    // ... and vertices close to a cell's wall join the place behind the wall.
    for (vertex, &position) in positions.iter().enumerate() {
        let scaled = cell_of(position);
        let home = scaled.floor();
        let step = (scaled - home).to_array().map(|inside| i64::from(inside > 1.0 - WALL) - i64::from(inside < WALL));
        for corner in 1..8 {
            let chosen = [0, 1, 2].map(|axis| if corner >> axis & 1 == 1 { step[axis] } else { 0 });
            if (0..3).any(|axis| corner >> axis & 1 == 1 && step[axis] == 0) {
                continue;
            }
            if let Some(&behind) = first_in_cell.get(&(home.as_i64vec3() + I64Vec3::from_array(chosen)))
                && positions[behind as usize].distance(position) <= cell
            {
                sets.join(behind, vertex as u32);
            }
        }
    }
    (0..positions.len() as u32).map(|vertex| sets.find(vertex)).collect()
}

/// Share of a cell that counts as its wall: above the rounding of single precision (0.12 of a cell).
const WALL: f64 = 0.2;

/// Whether an earlier face has the same three corners, in any order.
fn repeated_faces(faces: &[[u32; 3]]) -> Vec<bool> {
    let mut order: Vec<([u32; 3], u32)> = faces
        .iter()
        .enumerate()
        .map(|(index, face)| {
            let mut sorted = *face;
            sorted.sort_unstable();
            (sorted, index as u32)
        })
        .collect();
    order.sort_unstable();
    let mut repeated = vec![false; faces.len()];
    for pair in order.windows(2) {
        if let [(earlier, _), (later, index)] = pair {
            repeated[*index as usize] = earlier == later;
        }
    }
    repeated
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_seam_closes_and_every_split_vertex_finds_its_place() {
        let mesh = Mesh {
            positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X, DVec3::Y + DVec3::splat(1e-7), DVec3::ONE],
            triangles: vec![[0, 1, 2], [3, 5, 4]],
        };
        let welded = weld(&mesh);
        assert_eq!(welded.mesh.triangles, [[0, 1, 2], [1, 3, 2]]);
        assert_eq!(welded.vertex_of_original, [0, 1, 2, 1, 2, 3].map(Some));
    }

    #[test]
    fn degenerate_and_repeated_faces_go_and_lone_vertices_map_to_none() {
        let mesh = Mesh {
            positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::ONE],
            triangles: vec![[0, 1, 2], [2, 1, 0], [0, 1, 1], [1, 2, 0]],
        };
        let welded = weld(&mesh);
        assert_eq!((welded.mesh.triangles.len(), welded.duplicate_faces, welded.degenerate_faces), (1, 2, 1));
        assert_eq!(welded.vertex_of_original[3], None);
    }

    #[test]
    fn nothing_and_one_place_weld_to_nothing() {
        assert_eq!(weld(&Mesh::default()), Welded::default());
        let one_place = Mesh { positions: vec![DVec3::splat(1e9); 3], triangles: vec![[0, 1, 2]] };
        assert_eq!(weld(&one_place).degenerate_faces, 1);
        let beyond =
            Mesh { positions: vec![DVec3::splat(-1e308), DVec3::splat(1e308), DVec3::X], triangles: vec![[0, 1, 2]] };
        weld(&beyond);
    }

    proptest! {
        #[test]
        fn places_nearer_than_float_noise_are_one_wherever_they_lie(
            x in -1.0..1.0f64, y in -1.0..1.0f64, z in -1.0..1.0f64, noise in prop::array::uniform3(-1.2e-7..1.2e-7f64),
        ) {
            let at = DVec3::new(x, y, z);
            let near = at + DVec3::from_array(noise);
            let positions = vec![DVec3::splat(-1.0), DVec3::ONE, at, near];
            let place = places(&positions);
            prop_assert_eq!(place[2], place[3]);
        }
    }
}
