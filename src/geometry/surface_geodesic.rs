//! Distance along the surface, by shortest paths over a graph of surface samples.
//! RigNet [Xu et al. 2020], Section 4.1 ("geodesic neighbourhoods"); constants of the published code; shortest paths by
//! Dijkstra's algorithm [1959].
//!
//! | in         | shape            | unit                                       |
//! |------------|------------------|--------------------------------------------|
//! | `samples`  | `[S, 3]` and normals | normalised; evenly spread over the surface |
//! | `vertices` | `[V, 3]`         | normalised                                 |
//!
//! The graph joins each sample with its [`NEAREST`] nearest others unless their normals are near opposite, both ways.
//! It ignores the faces, so it bridges small gaps between shells. A vertex stands at its nearest sample: two vertices of
//! one sample are at distance 0.
//! # Departures from the published code
//! - Two samples at one place are joined with length 0; a sparse matrix reads that as no edge.
//! - The paths that are asked for are found, not all pairs.

use super::point_tree::PointTree;
use super::surface_samples::SurfaceSamples;
use crate::mesh::adjacency::Neighbors;
use glam::DVec3;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Radius of a geodesic ball.
pub const BALL_RADIUS: f64 = 0.06;
/// Distance added to the Euclidean one between samples that no path joins.
pub const UNREACHABLE: f64 = 8.0;
/// Each sample is joined with this many others.
const NEAREST: usize = 5;
/// Samples whose normals have a cosine at or below this lie on opposite sides of something thin.
const OPPOSITE: f64 = -0.5;

/// The graph of samples and the sample of every vertex.
pub struct SurfaceGeodesic {
    /// `[S, 3]`
    sample_positions: Vec<DVec3>,
    /// `[V]`: nearest sample of each vertex, the lowest of equally near ones.
    sample_of_vertex: Vec<u32>,
    /// Edges of sample s: `edges[offsets[s]..offsets[s + 1]]`.
    offsets: Vec<u32>,
    edges: Vec<Edge>,
}

#[derive(Clone, Copy)]
struct Edge {
    to: u32,
    length: f64,
}

impl SurfaceGeodesic {
    /// Normals need not have unit length. Without samples every vertex stands alone; see [`Self::balls`].
    pub fn new(samples: &SurfaceSamples, vertices: &[DVec3]) -> Self {
        let tree = PointTree::new(&samples.positions);
        let normals: Vec<DVec3> = samples.normals.iter().map(|normal| normal.normalize_or_zero()).collect();
        let chosen: Vec<Vec<(f64, u32)>> = (0..samples.positions.len())
            .into_par_iter()
            .map(|sample| {
                let mut found = Vec::with_capacity(NEAREST);
                tree.nearest_others(sample as u32, samples.positions[sample], NEAREST, &mut found);
                found.retain(|&(_, other)| normals[sample].dot(normals[other as usize]) > OPPOSITE);
                found
            })
            .collect();
        let (offsets, edges) = both_ways(&chosen);
        let sample_of_vertex =
            vertices.par_iter().map(|&vertex| tree.nearest(vertex).map_or(0, |(sample, _)| sample)).collect();
        Self { sample_positions: samples.positions.clone(), sample_of_vertex, offsets, edges }
    }

    /// Nearest sample of each vertex, `[V]`.
    pub fn sample_of_vertex(&self) -> &[u32] {
        &self.sample_of_vertex
    }

    /// Distances from `vertex` to all vertices, `[V]`.
    pub fn row(&self, vertex: usize) -> Vec<f64> {
        self.nearest_sources(&[vertex as u32]).into_iter().map(|nearest| nearest.distance).collect()
    }

    /// All other vertices within `radius` of each vertex, ascending, `[V, any]`.
    pub fn balls(&self, radius: f64) -> Neighbors {
        let (vertex_offsets, vertices) = self.vertices_by_sample();
        let at_sample = |s: usize| &vertices[vertex_offsets[s] as usize..vertex_offsets[s + 1] as usize];
        // Vertices of one sample share a ball: found once per sample that has vertices.
        let ball_of_sample: Vec<Vec<u32>> = (0..self.sample_positions.len())
            .into_par_iter()
            .map_init(
                || Search::new(self.sample_positions.len()),
                |search, sample| {
                    if at_sample(sample).is_empty() {
                        return Vec::new();
                    }
                    let reached = search.within(self, sample as u32, radius);
                    let mut ball: Vec<u32> = reached.iter().flat_map(|&s| at_sample(s as usize)).copied().collect();
                    ball.sort_unstable();
                    ball
                },
            )
            .collect();
        let mut balls = Neighbors { offsets: vec![0], members: Vec::new() };
        for (vertex, &sample) in self.sample_of_vertex.iter().enumerate() {
            let ball = ball_of_sample.get(sample as usize).map_or(&[][..], Vec::as_slice);
            balls.members.extend(ball.iter().copied().filter(|&other| other as usize != vertex));
            balls.offsets.push(balls.members.len() as u32);
        }
        balls
    }

    /// For each vertex the nearest of `sources` (vertices) along the surface and how far it is, `[V]`; of equally near
    /// sources the lowest. Without sources every vertex is its own, at distance 0.
    pub fn nearest_sources(&self, sources: &[u32]) -> Vec<NearestSource> {
        let own = |vertex: usize| NearestSource { source: vertex as u32, distance: 0.0 };
        if sources.is_empty() || self.sample_positions.is_empty() {
            return (0..self.sample_of_vertex.len()).map(own).collect();
        }
        let mut starts: Vec<(u32, u32)> =
            sources.iter().map(|&vertex| (self.sample_of_vertex[vertex as usize], vertex)).collect();
        starts.sort_unstable();
        starts.dedup_by_key(|&mut (sample, _)| sample);
        let mut best = self.shortest_paths(&starts);
        for (sample, nearest) in best.iter_mut().enumerate() {
            if nearest.distance.is_infinite() {
                *nearest = self.straight(sample, &starts);
            }
        }
        self.sample_of_vertex.iter().map(|&sample| best[sample as usize]).collect()
    }

    /// Shortest paths from several samples at once, each with the vertex that stands for it. `[S]`
    fn shortest_paths(&self, starts: &[(u32, u32)]) -> Vec<NearestSource> {
        let unreached = NearestSource { source: u32::MAX, distance: f64::INFINITY };
        let mut best = vec![unreached; self.sample_positions.len()];
        let mut queue = BinaryHeap::with_capacity(self.sample_positions.len());
        for &(sample, vertex) in starts {
            best[sample as usize] = NearestSource { source: vertex, distance: 0.0 };
            queue.push(Reverse((0, vertex, sample)));
        }
        // Every turn settles a sample or drops an entry; each edge makes at most one entry per improvement.
        while let Some(Reverse((bits, source, sample))) = queue.pop() {
            let here = NearestSource { source, distance: f64::from_bits(bits) };
            if here != best[sample as usize] {
                continue;
            }
            for edge in self.edges_of(sample) {
                let there = NearestSource { source, distance: here.distance + edge.length };
                if there.before(&best[edge.to as usize]) {
                    best[edge.to as usize] = there;
                    queue.push(Reverse((there.distance.to_bits(), source, edge.to)));
                }
            }
        }
        best
    }

    /// The nearest start as the crow flies, for a sample that no path reaches.
    fn straight(&self, sample: usize, starts: &[(u32, u32)]) -> NearestSource {
        let at = self.sample_positions[sample];
        let nearest = starts.iter().map(|&(start, vertex)| NearestSource {
            source: vertex,
            distance: UNREACHABLE + at.distance(self.sample_positions[start as usize]),
        });
        nearest.min_by(NearestSource::order).unwrap_or(NearestSource { source: u32::MAX, distance: f64::INFINITY })
    }

    fn edges_of(&self, sample: u32) -> &[Edge] {
        &self.edges[self.offsets[sample as usize] as usize..self.offsets[sample as usize + 1] as usize]
    }

    /// Vertices in the order of their samples, ascending within each; and where each sample's begin.
    fn vertices_by_sample(&self) -> (Vec<u32>, Vec<u32>) {
        let mut offsets = vec![0u32; self.sample_positions.len() + 1];
        let mut vertices: Vec<u32> = (0..self.sample_of_vertex.len() as u32).collect();
        vertices.sort_by_key(|&vertex| self.sample_of_vertex[vertex as usize]);
        for &sample in &self.sample_of_vertex {
            if let Some(count) = offsets.get_mut(sample as usize + 1) {
                *count += 1;
            }
        }
        for sample in 1..offsets.len() {
            offsets[sample] += offsets[sample - 1];
        }
        (offsets, vertices)
    }
}

/// The nearest of several source vertices along the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearestSource {
    pub source: u32,
    pub distance: f64,
}

impl NearestSource {
    fn order(&self, other: &Self) -> std::cmp::Ordering {
        self.distance.total_cmp(&other.distance).then(self.source.cmp(&other.source))
    }

    fn before(&self, other: &Self) -> bool {
        self.order(other).is_lt()
    }
}

/// The edges `(squared length, other)` that samples chose, seen from both ends, each once.
fn both_ways(chosen: &[Vec<(f64, u32)>]) -> (Vec<u32>, Vec<Edge>) {
    let mut pairs: Vec<(u32, u32, f64)> = Vec::with_capacity(chosen.len() * 2 * NEAREST);
    for (sample, row) in (0u32..).zip(chosen) {
        for &(squared, other) in row {
            pairs.extend([(sample, other, squared.sqrt()), (other, sample, squared.sqrt())]);
        }
    }
    pairs.sort_unstable_by_key(|&(from, to, _)| (from, to));
    pairs.dedup_by_key(|&mut (from, to, _)| (from, to));
    let mut offsets = vec![0u32; chosen.len() + 1];
    for &(from, ..) in &pairs {
        offsets[from as usize + 1] += 1;
    }
    for sample in 1..offsets.len() {
        offsets[sample] += offsets[sample - 1];
    }
    (offsets, pairs.into_iter().map(|(_, to, length)| Edge { to, length }).collect())
}

/// Memory of a bounded search, used again for the next one.
struct Search {
    distance: Vec<f64>,
    reached: Vec<u32>,
    queue: BinaryHeap<Reverse<(u64, u32)>>,
}

impl Search {
    fn new(sample_count: usize) -> Self {
        Self { distance: vec![f64::INFINITY; sample_count], reached: Vec::new(), queue: BinaryHeap::new() }
    }

    /// All samples within `radius` of `start`.
    fn within(&mut self, graph: &SurfaceGeodesic, start: u32, radius: f64) -> &[u32] {
        for &sample in &self.reached {
            self.distance[sample as usize] = f64::INFINITY;
        }
        self.reached.clear();
        self.reached.push(start);
        self.distance[start as usize] = 0.0;
        self.queue.push(Reverse((0, start)));
        while let Some(Reverse((bits, sample))) = self.queue.pop() {
            let distance = f64::from_bits(bits);
            if distance > self.distance[sample as usize] {
                continue;
            }
            for edge in graph.edges_of(sample) {
                let there = distance + edge.length;
                let known = &mut self.distance[edge.to as usize];
                if there <= radius && there < *known {
                    if known.is_infinite() {
                        self.reached.push(edge.to);
                    }
                    *known = there;
                    self.queue.push(Reverse((there.to_bits(), edge.to)));
                }
            }
        }
        &self.reached
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::surface_samples::SAMPLE_COUNT;
    use crate::mesh::Mesh;
    use crate::mesh::test_shapes::{degenerate, joined, sphere, tube};

    fn of(mesh: &Mesh) -> SurfaceGeodesic {
        SurfaceGeodesic::new(&SurfaceSamples::new(mesh, SAMPLE_COUNT), &mesh.positions)
    }

    #[test]
    fn distances_on_a_sphere_are_arcs_and_the_matrix_is_symmetric() {
        let mesh = sphere(DVec3::ZERO, 0.5, 40);
        let geodesic = of(&mesh);
        let rows: Vec<Vec<f64>> = (0..mesh.positions.len()).step_by(37).map(|vertex| geodesic.row(vertex)).collect();
        let (mut stretch, mut pairs) = (0.0, 0.0);
        for (index, row) in rows.iter().enumerate() {
            let from = mesh.positions[index * 37];
            for (to, &distance) in mesh.positions.iter().zip(row) {
                let arc = 0.5 * from.angle_between(*to);
                assert!(distance > 0.9 * arc - 0.03 && distance < 2.0 * arc + 0.06, "{distance} for an arc of {arc}");
                if arc > 0.1 {
                    stretch += distance / arc;
                    pairs += 1.0;
                }
            }
            for (other, other_row) in rows.iter().enumerate() {
                assert!((row[other * 37] - other_row[index * 37]).abs() < 1e-12);
            }
        }
        assert!((1.0..1.1).contains(&(stretch / pairs)), "paths are {} times as long as arcs", stretch / pairs);
    }

    #[test]
    fn balls_hold_what_rows_hold() {
        let mesh = tube(DVec3::ZERO, 0.1, 1.0, 30, 40);
        let geodesic = of(&mesh);
        let balls = geodesic.balls(BALL_RADIUS);
        for vertex in (0..mesh.positions.len()).step_by(53) {
            let row = geodesic.row(vertex);
            let near = |&other: &u32| other as usize != vertex && row[other as usize] <= BALL_RADIUS;
            let expected: Vec<u32> = (0..row.len() as u32).filter(near).collect();
            assert_eq!(balls.row(vertex), expected);
        }
    }

    #[test]
    fn the_nearest_source_is_the_least_of_the_rows() {
        let mesh = joined(&[sphere(DVec3::ZERO, 0.2, 24), sphere(DVec3::X, 0.2, 24)]);
        let geodesic = of(&mesh);
        let half = mesh.positions.len() as u32 / 2;
        for sources in [vec![3, 40, 101], vec![half + 5], vec![7, half + 9]] {
            let rows: Vec<Vec<f64>> = sources.iter().map(|&source| geodesic.row(source as usize)).collect();
            for (vertex, nearest) in geodesic.nearest_sources(&sources).into_iter().enumerate() {
                let least = rows.iter().map(|row| row[vertex]).fold(f64::INFINITY, f64::min);
                assert!((nearest.distance - least).abs() < 1e-12);
                let at = sources.iter().position(|&source| source == nearest.source).unwrap();
                assert!((rows[at][vertex] - least).abs() < 1e-12);
            }
        }
        let across = geodesic.row(0)[half as usize];
        assert!((across - UNREACHABLE - 1.0).abs() < 0.03, "{across}");
    }

    #[test]
    fn samples_at_one_place_are_joined() {
        let positions = vec![DVec3::ZERO, DVec3::ZERO, DVec3::X * 0.01, DVec3::X * 0.01];
        let samples = SurfaceSamples { positions: positions.clone(), normals: vec![DVec3::Y; 4] };
        let geodesic = SurfaceGeodesic::new(&samples, &positions);
        assert_eq!(geodesic.row(0), [0.0, 0.0, 0.01, 0.01]);
    }

    #[test]
    fn opposite_sides_of_a_sheet_are_far_apart() {
        let side = |y: f64| (0..400).map(move |i| DVec3::new(f64::from(i % 20) * 0.02, y, f64::from(i / 20) * 0.02));
        let positions: Vec<DVec3> = side(0.0).chain(side(0.001)).collect();
        let normals = (0..800).map(|i| if i < 400 { -DVec3::Y } else { DVec3::Y }).collect();
        let geodesic = SurfaceGeodesic::new(&SurfaceSamples { positions: positions.clone(), normals }, &positions);
        assert!(geodesic.row(210)[610] > UNREACHABLE);
    }

    #[test]
    fn degenerate_shapes_have_distances() {
        for mesh in degenerate() {
            let geodesic = of(&mesh);
            assert_eq!(geodesic.balls(BALL_RADIUS).vertex_count(), mesh.positions.len());
            assert_eq!(geodesic.nearest_sources(&[]).len(), mesh.positions.len());
            if !mesh.positions.is_empty() {
                assert_eq!(geodesic.row(0).len(), mesh.positions.len());
            }
        }
    }
}
