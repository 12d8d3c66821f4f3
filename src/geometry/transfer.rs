//! From the working mesh back to the vertices that were sent: where on its surface each of them belongs.
//!
//! | in         | shape        | unit       |
//! |------------|--------------|------------|
//! | `original` | `[V, 3]`     | normalised |
//! | `working`  | working mesh | normalised |
//!
//! Out: per original vertex three working vertices and their weights (not negative, sum 1).
//! A vertex that the working mesh kept gets itself. One that was simplified away goes along the edges of the welded mesh
//! to the nearest kept vertex, and from there over the faces around it to the nearest surface point, on faces that face
//! the same way before others. The way there stays on the surface, so it crosses no gap: a sleeve near the
//! body does not take the body's weights. Only a vertex that no face uses, or whose part was simplified away as a
//! whole, goes straight to the nearest surface point.

use super::bvh::Bvh;
use super::triangle::Triangle;
use crate::mesh::Mesh;
use crate::mesh::adjacency::{Neighbors, one_ring};
use crate::mesh::working_mesh::WorkingMesh;
use glam::DVec3;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::OnceLock;

/// Three vertices of the working mesh and their weights; not negative, sum 1.
pub type Blend = [(u32, f64); 3];

/// For every vertex of `original` the place on the working mesh that its results come from. `[V original]`
pub fn transfer_map(original: &Mesh, working: &WorkingMesh) -> Vec<Blend> {
    let kept_of_welded = kept_vertices(working);
    let nearest_kept = nearest_kept_along_edges(&working.welded.mesh, &kept_of_welded);
    let around = Surroundings::new(&working.mesh);
    let normals = working.welded.mesh.vertex_normals();
    let surface = OnceLock::new();
    (0..original.positions.len())
        .into_par_iter()
        .map(|vertex| {
            let position = original.positions[vertex];
            let welded = working.welded.vertex_of_original.get(vertex).copied().flatten();
            let kept = welded.and_then(|welded| kept_of_welded[welded as usize]);
            if let Some(kept) = kept {
                return [(kept, 1.0), (kept, 0.0), (kept, 0.0)];
            }
            let near = welded.and_then(|welded| {
                let kept = nearest_kept[welded as usize]?;
                around.nearest(&working.mesh, kept, position, normals[welded as usize])
            });
            near.unwrap_or_else(|| straight(surface.get_or_init(|| Bvh::new(&working.mesh)), &working.mesh, position))
        })
        .collect()
}

/// The working vertex at the place of each welded vertex, where there is one. `[V welded]`
fn kept_vertices(working: &WorkingMesh) -> Vec<Option<u32>> {
    let mut kept = vec![None; working.welded.mesh.positions.len()];
    for (vertex, welded) in (0u32..).zip(&working.welded_of_vertex) {
        if let Some(welded) = *welded {
            kept[welded as usize] = Some(vertex);
        }
    }
    kept
}

/// The working vertex whose place is nearest along edges; `None` in parts that lost all their vertices. `[V welded]`
fn nearest_kept_along_edges(welded: &Mesh, kept: &[Option<u32>]) -> Vec<Option<u32>> {
    let mut nearest = kept.to_vec();
    if kept.iter().all(Option::is_some) {
        return nearest;
    }
    let ring = one_ring(welded);
    let mut distance: Vec<f64> = kept.iter().map(|kept| if kept.is_some() { 0.0 } else { f64::INFINITY }).collect();
    let mut queue: BinaryHeap<Reverse<(u64, u32, u32)>> = BinaryHeap::new();
    let starts = (0u32..).zip(kept).filter_map(|(vertex, kept)| kept.map(|kept| Reverse((0, kept, vertex))));
    queue.extend(starts);
    // Dijkstra: each vertex is settled once, each edge makes at most one entry per improvement.
    while let Some(Reverse((bits, source, vertex))) = queue.pop() {
        let here = f64::from_bits(bits);
        if here > distance[vertex as usize] || nearest[vertex as usize] != Some(source) {
            continue;
        }
        for &other in ring.row(vertex as usize) {
            let there = here + welded.positions[vertex as usize].distance(welded.positions[other as usize]);
            let known = (distance[other as usize], nearest[other as usize].unwrap_or(u32::MAX));
            if (there, source) < known {
                distance[other as usize] = there;
                nearest[other as usize] = Some(source);
                queue.push(Reverse((there.to_bits(), source, other)));
            }
        }
    }
    nearest
}

/// The faces around each vertex of the working mesh.
struct Surroundings {
    faces: Neighbors,
}

impl Surroundings {
    fn new(mesh: &Mesh) -> Self {
        let mut rows = vec![Vec::new(); mesh.positions.len()];
        for (face, corners) in (0u32..).zip(&mesh.triangles) {
            corners.iter().for_each(|&corner| rows[corner as usize].push(face));
        }
        Self { faces: Neighbors::from_rows(&rows) }
    }

    /// The nearest point on the faces around `kept`, and then, as long as that comes nearer, around the corners of the
    /// nearest face; on faces that face along `normal` before any other.
    fn nearest(&self, mesh: &Mesh, kept: u32, position: DVec3, normal: DVec3) -> Option<Blend> {
        let mut best: Option<(Rank, Blend)> = None;
        let mut look_around = |vertices: &[u32]| {
            let before = best.map(|(rank, _)| rank);
            for face in vertices.iter().flat_map(|&vertex| self.faces.row(vertex as usize)).copied() {
                let (point, weights) = Triangle::new(mesh.corners(face as usize)).nearest(position);
                let away = mesh.area_normal(face as usize).dot(normal) < 0.0;
                let rank = (away, point.distance_squared(position), face);
                if best.is_none_or(|(known, _)| rank < known) {
                    best = Some((rank, blend(mesh.triangles[face as usize], weights)));
                }
            }
            let improved = best.map(|(rank, _)| rank) != before;
            best.filter(|_| improved).map(|((.., face), _)| mesh.triangles[face as usize])
        };
        let mut corners = look_around(&[kept]);
        for _ in 0..WALK_MAX {
            let Some(here) = corners else { break };
            corners = look_around(&here);
        }
        best.map(|(_, blend)| blend)
    }
}

/// Faces away, squared distance, index: the least is the best.
type Rank = (bool, f64, u32);

/// Faces that the search for the nearest surface point may walk over; simplified meshes need two or three.
const WALK_MAX: usize = 32;

fn straight(surface: &Bvh, mesh: &Mesh, position: DVec3) -> Blend {
    let hit = surface.nearest_point(position);
    hit.map_or([(0, 1.0), (0, 0.0), (0, 0.0)], |hit| blend(mesh.triangles[hit.triangle as usize], hit.barycentric))
}

fn blend(corners: [u32; 3], weights: [f64; 3]) -> Blend {
    [0, 1, 2].map(|corner| (corners[corner], weights[corner]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::{joined, tube};
    use crate::mesh::working_mesh::Change;

    fn place(working: &WorkingMesh, blend: Blend) -> DVec3 {
        blend.iter().map(|&(vertex, weight)| working.mesh.positions[vertex as usize] * weight).sum()
    }

    fn assert_sound(map: &[Blend]) {
        for blend in map {
            assert!(blend.iter().all(|&(_, weight)| weight >= 0.0));
            assert!((blend.iter().map(|&(_, weight)| weight).sum::<f64>() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn kept_and_split_meshes_give_every_vertex_itself() {
        for (around, along, change) in [(8, 10, Change::Split), (30, 40, Change::Kept)] {
            let mesh = tube(DVec3::ZERO, 0.1, 1.0, around, along);
            let working = WorkingMesh::new(&mesh).unwrap();
            assert_eq!(working.change, change);
            for (vertex, blend) in transfer_map(&mesh, &working).into_iter().enumerate() {
                assert_eq!(blend[0].1, 1.0);
                assert_eq!(working.mesh.positions[blend[0].0 as usize], mesh.positions[vertex]);
            }
        }
    }

    #[test]
    fn a_sleeve_never_takes_from_the_body_under_it() {
        let (body, sleeve) = (tube(DVec3::ZERO, 0.1, 1.0, 80, 150), tube(DVec3::ZERO, 0.102, 1.0, 80, 150));
        let body_vertices = body.positions.len();
        let mesh = joined(&[body, sleeve]);
        let working = WorkingMesh::new(&mesh).unwrap();
        assert_eq!(working.change, Change::Simplified);
        let map = transfer_map(&mesh, &working);
        assert_sound(&map);
        let body_part = working.component_of_welded[0];
        for (vertex, blend) in map.into_iter().enumerate() {
            for (from, weight) in blend {
                let is_body = working.component_of_vertex[from as usize] == body_part;
                assert!(weight == 0.0 || is_body == (vertex < body_vertices));
            }
            let moved = place(&working, blend).distance(mesh.positions[vertex]);
            assert!(moved < 0.02, "vertex {vertex} moved {moved}");
        }
    }

    #[test]
    fn a_vertex_without_faces_takes_from_the_nearest_surface() {
        let mut mesh = tube(DVec3::ZERO, 0.1, 1.0, 30, 40);
        mesh.positions.push(DVec3::new(0.3, 0.5, 0.0));
        let working = WorkingMesh::new(&mesh).unwrap();
        let blend = transfer_map(&mesh, &working).pop().unwrap();
        assert!(place(&working, blend).distance(DVec3::new(0.1, 0.5, 0.0)) < 1e-6);
    }
}
