//! Distance along the surface, by shortest paths over a graph of surface samples.
//! RigNet [Xu et al. 2020], Section 4.1 ("geodesic neighbourhoods"), constants of the published code.

use super::surface_samples::SurfaceSamples;
use crate::mesh::adjacency::Neighbors;
use glam::DVec3;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Radius of a geodesic ball.
pub const BALL_RADIUS: f64 = 0.06;
/// Distance added to the Euclidean one between samples that no path joins.
pub const UNREACHABLE: f64 = 8.0;

/// The graph of samples and the sample of every vertex.
pub struct SurfaceGeodesic {
    pub samples: SurfaceSamples,
    /// `[V]`: nearest sample of each vertex, the lowest of equally near ones.
    pub sample_of_vertex: Vec<u32>,
    edges: Vec<Vec<(u32, f64)>>,
}

impl SurfaceGeodesic {
    /// `vertices` `[V, 3]`, the same space as the samples.
    pub fn new(samples: SurfaceSamples, vertices: &[DVec3]) -> Self {
        let nearest = |p: DVec3| {
            let mut order: Vec<u32> = (0..samples.positions.len() as u32).collect();
            order.sort_by(|&a, &b| {
                samples.positions[a as usize].distance(p).total_cmp(&samples.positions[b as usize].distance(p))
            });
            order.truncate(6);
            order
        };
        let mut edges = vec![Vec::new(); samples.positions.len()];
        for (sample, &position) in samples.positions.iter().enumerate() {
            for other in nearest(position) {
                if other as usize != sample && samples.normals[sample].dot(samples.normals[other as usize]) > -0.5 {
                    let length = position.distance(samples.positions[other as usize]);
                    edges[sample].push((other, length));
                    edges[other as usize].push((sample as u32, length));
                }
            }
        }
        let sample_of_vertex = vertices.iter().map(|&v| nearest(v).first().copied().unwrap_or(0)).collect();
        Self { samples, sample_of_vertex, edges }
    }

    /// Distances from `vertex` to all vertices `[V]`.
    pub fn row(&self, vertex: usize) -> Vec<f64> {
        let from = self.sample_of_vertex[vertex];
        let distance = self.shortest(&[(from, 0)], f64::INFINITY);
        let origin = self.samples.positions[from as usize];
        self.sample_of_vertex
            .iter()
            .map(|&s| {
                if distance[s as usize].0.is_finite() {
                    distance[s as usize].0
                } else {
                    UNREACHABLE + origin.distance(self.samples.positions[s as usize])
                }
            })
            .collect()
    }

    /// All other vertices within `radius` of each vertex, ascending.
    pub fn balls(&self, radius: f64) -> Neighbors {
        let rows: Vec<Vec<u32>> = (0..self.sample_of_vertex.len())
            .map(|vertex| {
                let row = self.row(vertex);
                (0..row.len() as u32)
                    .filter(|&other| other as usize != vertex && row[other as usize] <= radius)
                    .collect()
            })
            .collect();
        Neighbors::from_rows(&rows)
    }

    /// For each vertex the nearest of `sources` (vertices, not empty) along the surface, and how far it is. `[V]`.
    pub fn nearest_sources(&self, sources: &[u32]) -> Vec<(u32, f64)> {
        let starts: Vec<(u32, u32)> = sources.iter().map(|&v| (self.sample_of_vertex[v as usize], v)).collect();
        let distance = self.shortest(&starts, f64::INFINITY);
        self.sample_of_vertex.iter().map(|&s| (distance[s as usize].1, distance[s as usize].0)).collect()
    }

    fn shortest(&self, starts: &[(u32, u32)], limit: f64) -> Vec<(f64, u32)> {
        let mut best = vec![(f64::INFINITY, u32::MAX); self.edges.len()];
        let mut queue = BinaryHeap::new();
        for &(sample, label) in starts {
            queue.push((Reverse(0u64), Reverse(label), sample));
        }
        while let Some((Reverse(bits), Reverse(label), sample)) = queue.pop() {
            let distance = f64::from_bits(bits);
            if (distance, label) >= best[sample as usize] || distance > limit {
                continue;
            }
            best[sample as usize] = (distance, label);
            for &(other, length) in &self.edges[sample as usize] {
                queue.push((Reverse((distance + length).to_bits()), Reverse(label), other));
            }
        }
        best
    }
}
