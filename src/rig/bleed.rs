//! Bleeding: weight of a joint on vertices that are far from it over the surface.
//!
//! | in     | shape     | space                       |
//! |--------|-----------|-----------------------------|
//! | `mesh` | `[V, 3]`  | normalised                  |
//! | `ring` | `[V, …]`  | neighbours by an edge       |
//! | `skin` | `[V, ≤N]` | rows of the mesh's vertices |
//!
//! Pure; O(J · E log V).

use super::SkinWeights;
use crate::mesh::Mesh;
use crate::mesh::adjacency::Neighbors;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Over the surface, this far from where a joint reigns, its weight is bleeding: a quarter of the character's height.
const BLEED_REACH: f64 = 0.25;
/// Parts that hang together only in space are bridged up to this distance: hair, eyes, clothes.
const BRIDGE: f64 = 0.03;

/// Per joint: share of its weight farther than [`BLEED_REACH`] over the surface from the vertices that it moves most.
pub(super) fn bleed(mesh: &Mesh, ring: &Neighbors, skin: &SkinWeights, joint_count: usize) -> Vec<f64> {
    let mut reigned: Vec<Vec<u32>> = vec![Vec::new(); joint_count];
    for (vertex, row) in skin.rows.iter().enumerate() {
        if let Some(list) = row.first().and_then(|first| reigned.get_mut(first.joint as usize)) {
            list.push(vertex as u32);
        }
    }
    (0..joint_count)
        .map(|joint| {
            let Some(sources) = reigned.get(joint).filter(|sources| !sources.is_empty()) else { return 0.0 };
            let reached = within_reach(mesh, ring, sources);
            let (mut far, mut total) = (0.0, 0.0);
            for (vertex, row) in skin.rows.iter().enumerate() {
                let weight = row.iter().find(|part| part.joint as usize == joint);
                let Some(weight) = weight.map(|part| f64::from(part.weight)) else { continue };
                total += weight;
                let place = mesh.positions[vertex];
                // Another part of the mesh is near when it is near in space.
                let beside = || sources.iter().any(|&source| mesh.positions[source as usize].distance(place) <= BRIDGE);
                if !reached[vertex] && !beside() {
                    far += weight;
                }
            }
            if total > 0.0 { far / total } else { 0.0 }
        })
        .collect()
}

/// Which vertices lie within [`BLEED_REACH`] of `sources` along the edges [Dijkstra 1959].
fn within_reach(mesh: &Mesh, ring: &Neighbors, sources: &[u32]) -> Vec<bool> {
    let mut best = vec![f64::INFINITY; mesh.positions.len()];
    // Distances are positive, so their bits sort as they do.
    let mut queue: BinaryHeap<Reverse<(u64, u32)>> = BinaryHeap::new();
    for &source in sources {
        best[source as usize] = 0.0;
        queue.push(Reverse((0, source)));
    }
    while let Some(Reverse((bits, vertex))) = queue.pop() {
        let distance = f64::from_bits(bits);
        if distance > best[vertex as usize] {
            continue;
        }
        for &next in ring.row(vertex as usize) {
            let step = mesh.positions[vertex as usize].distance(mesh.positions[next as usize]);
            let through = distance + step;
            if through <= BLEED_REACH && through < best[next as usize] {
                best[next as usize] = through;
                queue.push(Reverse((through.to_bits(), next)));
            }
        }
    }
    best.into_iter().map(f64::is_finite).collect()
}
