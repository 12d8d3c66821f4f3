//! Neighbourhoods as the networks read them: a rectangle of vertex indices, each row its own vertex first.
//! RigNet [Xu et al. 2020], Section 4.1, Eqs. 3-5.
//!
//! Out: `[V, K]` int64, row-major. Rows shorter than K are filled with their own vertex, which is also the self loop of
//! the edge convolution: under a maximum a repeated neighbour changes nothing.
//! # Departures from the paper
//! - At most `cap` members of a geodesic ball are chosen by a fixed hash, where the published code draws them at random.
//! - The cap is on the vertices that a vertex pools *from*. The published code caps how many vertices pool from it.

use super::place_hash::{mix, place_hash};
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
/// Width of the rings of [`NeighborTable::capped`], normalised: a ball has about sixty.
const RING: f64 = 1e-3;

impl NeighborTable {
    /// All members of every row, in their order.
    pub fn padded(neighbors: &Neighbors) -> Self {
        let longest = (0..neighbors.vertex_count()).map(|vertex| neighbors.row(vertex).len()).max().unwrap_or(0);
        Self::filled(neighbors.vertex_count(), longest, |vertex, row| row.extend_from_slice(neighbors.row(vertex)))
    }

    /// At most `cap` members of every row, ascending: those in the rings around the vertex ([`RING`] wide) that a fixed hash
    /// ranks first, nearer before farther within a ring. The choice depends on distances alone, so it is the same however the
    /// shape is turned, mirrored or numbered; another `seed` makes another choice. `positions` `[V, 3]`, normalised.
    ///
    /// The networks are sensitive to this choice: another random ten moved displaced points by 2 % of the longest side on
    /// average (sample character, 4,007 vertices), so it must not change with the frame.
    pub fn capped(neighbors: &Neighbors, cap: usize, positions: &[DVec3], seed: u64) -> Self {
        let places: Vec<u64> = positions.iter().map(|&position| place_hash(position)).collect();
        let mut ranked: Vec<(u64, u64, u64, u32)> = Vec::new();
        Self::filled(neighbors.vertex_count(), cap, |vertex, row| {
            let all = neighbors.row(vertex);
            if all.len() <= cap {
                row.extend_from_slice(all);
                return;
            }
            ranked.clear();
            ranked.extend(all.iter().map(|&member| {
                let distance = positions[vertex].distance(positions[member as usize]);
                let ring = mix((distance / RING) as u64 ^ seed.rotate_left(32));
                // Not negative, so the bits sort as the numbers do. Equal distances are told apart by place.
                (ring, distance.to_bits(), places[member as usize], member)
            }));
            ranked.select_nth_unstable(cap);
            row.extend(ranked[..cap].iter().map(|&(_, _, _, member)| member));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::surface_geodesic::{BALL_RADIUS, SurfaceGeodesic};
    use crate::geometry::surface_samples::SurfaceSamples;
    use crate::mesh::adjacency::one_ring;
    use crate::mesh::test_shapes::torus;

    #[test]
    fn padded_rows_begin_with_their_vertex_and_repeat_it() {
        let table = NeighborTable::padded(&Neighbors::from_rows(&[vec![1, 2], vec![0], vec![]]));
        assert_eq!((table.vertex_count, table.width), (3, 3));
        assert_eq!(table.indices, [0, 1, 2, 1, 0, 1, 2, 2, 2]);
        assert_eq!(NeighborTable::padded(&Neighbors::from_rows(&[[0u32; 0]; 2])).indices, [0, 1]);
    }

    #[test]
    fn capped_rows_are_members_of_the_ball_and_follow_the_places() {
        let mesh = torus(0.4, 0.15, 60);
        let geodesic = SurfaceGeodesic::new(&SurfaceSamples::new(&mesh, 4_000), &mesh.positions);
        let balls = geodesic.balls(BALL_RADIUS);
        let table = NeighborTable::capped(&balls, 4, &mesh.positions, 0);
        // The same places in reverse order.
        let last = mesh.positions.len() as u32 - 1;
        let rows: Vec<Vec<u32>> =
            (0..=last).map(|v| balls.row((last - v) as usize).iter().map(|member| last - member).collect()).collect();
        let reversed: Vec<DVec3> = mesh.positions.iter().rev().copied().collect();
        let mirrored = NeighborTable::capped(&Neighbors::from_rows(&rows), 4, &reversed, 0);
        for vertex in 0..mesh.positions.len() {
            let row = table.row(vertex);
            assert_eq!(row[0], vertex as i64);
            assert!(row[1..].iter().all(|&m| m == vertex as i64 || balls.row(vertex).contains(&(m as u32))));
            let mut other: Vec<i64> =
                mirrored.row(last as usize - vertex).iter().map(|&m| i64::from(last) - m).collect();
            let mut row = row.to_vec();
            row.sort_unstable();
            other.sort_unstable();
            assert_eq!(row, other);
        }
        assert_eq!(NeighborTable::padded(&one_ring(&mesh)).width, 7);
    }
}
