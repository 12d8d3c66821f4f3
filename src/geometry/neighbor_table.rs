//! Neighbourhoods as the networks read them: a rectangle of vertex indices, each row its own vertex first.
//! RigNet [Xu et al. 2020], Section 4.1, Eqs. 3-5.
//!
//! Out: `[V, K]` int64, row-major. Rows shorter than K are filled with their own vertex, which is also the self loop of
//! the edge convolution: under a maximum a repeated neighbour changes nothing.
//! # Departures from the paper
//! - At most `cap` members of a geodesic ball are chosen by a fixed hash, where the published code draws them at random.
//! - The cap is on the vertices that a vertex pools *from*. The published code caps how many vertices pool from it.

use crate::mesh::adjacency::Neighbors;
use glam::DVec3;

/// A padded table of neighbours.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NeighborTable {
    pub vertex_count: usize,
    /// K: the longest row, own vertex included; at least 1.
    pub width: usize,
    /// `[V, K]`, row-major.
    pub indices: Vec<i64>,
}

/// At most this many members of a geodesic ball are pooled.
pub const GEODESIC_CAP: usize = 10;

impl NeighborTable {
    /// All members of every row, in their order.
    pub fn padded(neighbors: &Neighbors) -> Self {
        let longest = (0..neighbors.vertex_count()).map(|vertex| neighbors.row(vertex).len()).max().unwrap_or(0);
        Self::filled(neighbors.vertex_count(), longest, |vertex, row| row.extend_from_slice(neighbors.row(vertex)))
    }

    /// At most `cap` members of every row, ascending: those whose place hashes lowest, so that the choice does not
    /// depend on how vertices are numbered. `positions` `[V, 3]`, normalised.
    pub fn capped(neighbors: &Neighbors, cap: usize, positions: &[DVec3]) -> Self {
        let places: Vec<u64> = positions.iter().map(|&position| place_hash(position)).collect();
        let mut ranked: Vec<(u64, u32)> = Vec::new();
        Self::filled(neighbors.vertex_count(), cap, |vertex, row| {
            let all = neighbors.row(vertex);
            if all.len() <= cap {
                row.extend_from_slice(all);
                return;
            }
            ranked.clear();
            let own = places[vertex];
            ranked.extend(all.iter().map(|&member| (mix(own ^ places[member as usize].rotate_left(17)), member)));
            ranked.select_nth_unstable(cap);
            row.extend(ranked[..cap].iter().map(|&(_, member)| member));
            row.sort_unstable();
        })
    }

    /// A table of rows with up to `longest` members that `fill` appends.
    fn filled(vertex_count: usize, longest: usize, mut fill: impl FnMut(usize, &mut Vec<u32>)) -> Self {
        let width = longest + 1;
        let mut indices = Vec::with_capacity(vertex_count * width);
        let mut row = Vec::with_capacity(longest);
        for vertex in 0..vertex_count {
            row.clear();
            fill(vertex, &mut row);
            indices.push(vertex as i64);
            indices.extend(row.iter().map(|&member| i64::from(member)));
            indices.resize((vertex + 1) * width, vertex as i64);
        }
        Self { vertex_count, width, indices }
    }

    /// One row: own vertex, members, padding.
    pub fn row(&self, vertex: usize) -> &[i64] {
        &self.indices[vertex * self.width..(vertex + 1) * self.width]
    }
}

/// A number that depends only on where a vertex is, to 2^-20 of the longest side.
fn place_hash(position: DVec3) -> u64 {
    let cell = (position * f64::from(1 << 20)).round().as_i64vec3();
    mix(cell.x as u64 ^ mix(cell.y as u64 ^ mix(cell.z as u64)))
}

/// Mixes 64 bits so that near inputs give unrelated outputs (the finaliser of SplitMix64 [Steele et al. 2014]).
fn mix(value: u64) -> u64 {
    let value = value.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let value = (value ^ (value >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    value ^ (value >> 31)
}
