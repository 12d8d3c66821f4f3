//! Thin ends of a part of a surface, such as the fingers of a hand.
//!
//! | in         | shape              | unit                                              |
//! |------------|--------------------|---------------------------------------------------|
//! | `mesh`     | `[V, 3]`, `[F, 3]` | normalised; welded                                |
//! | `one_ring` | `[V, any]`         | the same mesh's neighbours by an edge             |
//! | `region`   | `[R]`              | the part's vertices, ascending                    |
//! | `start`    |                    | normalised; a point near which the part begins    |
//!
//! Distances run along the edges, from where the part meets the rest of the mesh. Let a level fall from the greatest distance to
//! none: the vertices beyond it make pieces that appear at tips, grow and join (a merge tree [Carr, Snoeyink and Axen 2003]). When
//! two pieces join that are both longer than they are thick, each is a branch; bumps disappear in what they join. What fingers
//! grow out of is no branch itself. Pieces of the mesh that share no vertex (gloves, robots) count as touching where the gap
//! between them is narrowest. The rule is ours. Pure; O(R log R), O(R²) where there are several pieces.

use crate::mesh::Mesh;
use crate::mesh::adjacency::{DisjointSets, Neighbors};
use glam::DVec3;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Shorter pieces are bumps, in longest sides.
const LENGTH_MIN: f64 = 0.012;
/// A branch is at least this many times as long as it is thick, along the surface,
const SLENDERNESS_MIN: f64 = 0.7;
/// and has so many vertices: fewer tell no direction.
const VERTICES_MIN: usize = 5;
/// A piece is measured in so many slices of equal distance; the last holds the tip, which is no measure of thickness.
const SLICES: usize = 4;
/// A slice with fewer vertices has no thickness.
const SLICE_VERTICES_MIN: usize = 3;
/// The base lies where this share of the branch's vertices is behind.
const BEHIND_BASE: f64 = 0.02;

/// A thin end.
#[derive(Clone, Debug, PartialEq)]
pub struct Branch {
    /// Of each of its vertices.
    pub distances: Vec<f64>,
    /// Distance along the surface at which it leaves the rest.
    pub level: f64,
    /// Both ends of a straight line through its middle.
    pub base: DVec3,
    pub tip: DVec3,
    /// Mean diameter, root mean square around the line.
    pub thickness: f64,
}

impl Branch {
    pub fn length(&self) -> f64 {
        self.base.distance(self.tip)
    }
}

/// The branches of a part, and how far each of its vertices is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceBranches {
    /// `[R]`
    pub distances: Vec<f64>,
    pub branches: Vec<Branch>,
}

/// Finds the branches of `region`; none where it has too few vertices.
pub fn surface_branches(mesh: &Mesh, one_ring: &Neighbors, region: &[u32], start: DVec3) -> SurfaceBranches {
    if region.is_empty() {
        return SurfaceBranches::default();
    }
    let graph = Graph::new(mesh, one_ring, region, start);
    let distances = graph.distances();
    let branches = MergeTree { graph: &graph, distances: &distances }.branches();
    SurfaceBranches { distances, branches }
}

/// The edges within a region. Vertices are numbered by their places in it.
struct Graph {
    positions: Vec<DVec3>,
    edges: Vec<Vec<u32>>,
    /// Where the region meets the rest of the mesh; never empty.
    sources: Vec<u32>,
}

impl Graph {
    fn new(mesh: &Mesh, one_ring: &Neighbors, region: &[u32], start: DVec3) -> Self {
        let mut place: Vec<Option<u32>> = vec![None; mesh.positions.len()];
        for (own, &vertex) in (0..).zip(region) {
            place[vertex as usize] = Some(own);
        }
        let ring = |vertex: u32| one_ring.row(vertex as usize).iter().map(|&other| place[other as usize]);
        let positions: Vec<DVec3> = region.iter().map(|&vertex| mesh.positions[vertex as usize]).collect();
        let edges = region.iter().map(|&vertex| ring(vertex).flatten().collect()).collect();
        let meets_the_rest = |own: &u32| ring(region[*own as usize]).any(|other| other.is_none());
        let sources = (0..region.len() as u32).filter(meets_the_rest).collect();
        let mut graph = Self { positions, edges, sources };
        let from_start = |own: &u32| graph.positions[*own as usize].distance_squared(start);
        let first = (0..region.len() as u32).min_by(|a, b| from_start(a).total_cmp(&from_start(b))).unwrap_or(0);
        if graph.sources.is_empty() {
            graph.sources.push(first);
        }
        graph.join_pieces(first);
        graph
    }

    /// Joins pieces that share no edge over the narrowest gaps (Prim's algorithm), beginning with the piece of `first`.
    fn join_pieces(&mut self, first: u32) {
        let count = self.positions.len();
        let mut pieces = DisjointSets::new(count);
        for (own, others) in (0..).zip(&self.edges) {
            others.iter().for_each(|&other| pieces.join(own, other));
        }
        let piece: Vec<u32> = (0..count as u32).map(|own| pieces.find(own)).collect();
        let mut waiting: Vec<u32> = (0..count as u32).collect();
        let mut nearest: Vec<(f64, u32)> = vec![(f64::INFINITY, first); count];
        let mut joining = first;
        // Every turn takes a piece out of those that wait.
        loop {
            let (joined, others): (Vec<u32>, Vec<u32>) =
                waiting.into_iter().partition(|&own| piece[own as usize] == piece[joining as usize]);
            waiting = others;
            for &far in &waiting {
                for &near in &joined {
                    let gap = self.positions[far as usize].distance_squared(self.positions[near as usize]);
                    if gap < nearest[far as usize].0 {
                        nearest[far as usize] = (gap, near);
                    }
                }
            }
            let gap = |own: &u32| nearest[*own as usize].0;
            let Some(next) = waiting.iter().copied().min_by(|a, b| gap(a).total_cmp(&gap(b))) else { return };
            let near = nearest[next as usize].1;
            self.edges[next as usize].push(near);
            self.edges[near as usize].push(next);
            joining = next;
        }
    }

    /// Shortest ways along the edges from the sources, by Dijkstra's algorithm. `[R]`
    fn distances(&self) -> Vec<f64> {
        let mut distances = vec![f64::INFINITY; self.positions.len()];
        let mut queue = BinaryHeap::new();
        for &source in &self.sources {
            distances[source as usize] = 0.0;
            queue.push(Reverse((0, source)));
        }
        // Every turn settles a vertex or drops an entry; each edge makes at most one entry per improvement.
        while let Some(Reverse((bits, own))) = queue.pop() {
            let distance = f64::from_bits(bits);
            if distance > distances[own as usize] {
                continue;
            }
            for &other in &self.edges[own as usize] {
                let there = distance + self.positions[own as usize].distance(self.positions[other as usize]);
                if there < distances[other as usize] {
                    distances[other as usize] = there;
                    queue.push(Reverse((there.to_bits(), other)));
                }
            }
        }
        distances
    }
}

/// What lies beyond a level and hangs together.
#[derive(Default)]
struct Piece {
    vertices: Vec<u32>,
    farthest: f64,
    branches: Vec<Branch>,
}

struct MergeTree<'a> {
    graph: &'a Graph,
    distances: &'a [f64],
}

impl MergeTree<'_> {
    fn branches(&self) -> Vec<Branch> {
        let count = self.distances.len();
        let mut order: Vec<u32> = (0..count as u32).collect();
        order.sort_by(|&a, &b| self.distances[b as usize].total_cmp(&self.distances[a as usize]));
        let mut sets = DisjointSets::new(count);
        let mut pieces: Vec<Option<Piece>> = (0..count).map(|_| None).collect();
        let mut is_beyond = vec![false; count];
        for own in order {
            let level = self.distances[own as usize];
            is_beyond[own as usize] = true;
            pieces[own as usize] = Some(Piece { vertices: vec![own], farthest: level, branches: Vec::new() });
            for &other in self.graph.edges[own as usize].iter().filter(|&&other| is_beyond[other as usize]) {
                let (one, two) = (sets.find(own), sets.find(other));
                if one == two {
                    continue;
                }
                if let (Some(a), Some(b)) = (pieces[one as usize].take(), pieces[two as usize].take()) {
                    sets.join(one, two);
                    pieces[sets.find(one) as usize] = Some(self.joined(a, b, level));
                }
            }
        }
        pieces.into_iter().flatten().flat_map(|piece| piece.branches).collect()
    }

    fn joined(&self, a: Piece, b: Piece, level: f64) -> Piece {
        let (mut large, mut small) = if a.vertices.len() < b.vertices.len() { (b, a) } else { (a, b) };
        // The small one first: it is mostly a single vertex.
        let both = self.significant(&small, level).and_then(|some| Some((self.significant(&large, level)?, some)));
        large.branches = match both {
            Some((mut found, some)) => {
                found.extend(some);
                found
            }
            None => {
                large.branches.append(&mut small.branches);
                large.branches
            }
        };
        large.vertices.append(&mut small.vertices);
        large.farthest = large.farthest.max(small.farthest);
        large
    }

    /// The branches of a piece that ends at `level`, or itself as one; `None` for a bump.
    fn significant(&self, piece: &Piece, level: f64) -> Option<Vec<Branch>> {
        if !piece.branches.is_empty() {
            return Some(piece.branches.clone());
        }
        let length = piece.farthest - level;
        if length < LENGTH_MIN || piece.vertices.len() < VERTICES_MIN {
            return None;
        }
        let branch = self.measured(&piece.vertices, level, length)?;
        (length >= SLENDERNESS_MIN * branch.thickness).then(|| vec![branch])
    }

    /// A straight line through vertices at distances from `level` to `level + length`, and how thick they lie around it.
    fn measured(&self, vertices: &[u32], level: f64, length: f64) -> Option<Branch> {
        let slice_of = |own: u32| {
            let slice = (self.distances[own as usize] - level) / length * SLICES as f64;
            (slice as usize).min(SLICES - 1)
        };
        let mut slices: [Vec<DVec3>; SLICES] = Default::default();
        for &own in vertices {
            slices[slice_of(own)].push(self.graph.positions[own as usize]);
        }
        let direction = (mean(slices.last()?)? - mean(slices.first()?)?).try_normalize()?;
        let spreads: Vec<f64> = slices[..SLICES - 1]
            .iter()
            .filter(|slice| slice.len() >= SLICE_VERTICES_MIN)
            .filter_map(|slice| {
                let middle = mean(slice)?;
                let around =
                    slice.iter().map(|&place| (place - middle).reject_from_normalized(direction).length_squared());
                Some((around.sum::<f64>() / slice.len() as f64).sqrt())
            })
            .collect();
        let thickness = 2.0 * spreads.iter().sum::<f64>() / spreads.len().max(1) as f64;
        let middle =
            vertices.iter().map(|&own| self.graph.positions[own as usize]).sum::<DVec3>() / vertices.len() as f64;
        let mut along: Vec<f64> =
            vertices.iter().map(|&own| (self.graph.positions[own as usize] - middle).dot(direction)).collect();
        along.sort_by(f64::total_cmp);
        let base = along[(BEHIND_BASE * (along.len() - 1) as f64) as usize];
        let (base, tip) = (middle + direction * base, middle + direction * *along.last()?);
        let distances = vertices.iter().map(|&own| self.distances[own as usize]).collect();
        (!spreads.is_empty()).then_some(Branch { distances, level, base, tip, thickness })
    }
}

fn mean(points: &[DVec3]) -> Option<DVec3> {
    (!points.is_empty()).then(|| points.iter().sum::<DVec3>() / points.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::adjacency::one_ring;
    use crate::mesh::test_shapes::{degenerate, joined, sphere, tube};
    use crate::mesh::weld::weld;
    use glam::DQuat;

    /// Half the width of the finger of a sheet, in longest sides.
    const STEP: f64 = 0.005;

    /// A flat hand of squares: a palm, and out of it strips two squares wide, of these lengths.
    fn sheet(strips: &[u32]) -> Mesh {
        let width = 4 * strips.len() as u32;
        let palm = (0..20).flat_map(|row| (0..width).map(move |column| (column, row)));
        let strips = strips.iter().zip(0..).flat_map(|(&length, strip)| {
            (20..20 + length).flat_map(move |row| (4 * strip + 1..4 * strip + 3).map(move |column| (column, row)))
        });
        let mut mesh = Mesh::default();
        for (column, row) in palm.chain(strips) {
            let first = mesh.positions.len() as u32;
            let corners = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(x, y)| (f64::from(column + x), f64::from(row + y)));
            mesh.positions.extend(corners.map(|(x, y)| DVec3::new(x, y, 0.0) * STEP));
            mesh.triangles.extend([[0, 1, 2], [0, 2, 3]].map(|face| face.map(|corner| first + corner)));
        }
        weld(&mesh).mesh
    }

    /// Branches of what lies above the first rows.
    fn found(mesh: &Mesh) -> SurfaceBranches {
        let region: Vec<u32> =
            (0..mesh.positions.len() as u32).filter(|&v| mesh.positions[v as usize].y > STEP).collect();
        surface_branches(mesh, &one_ring(mesh), &region, DVec3::ZERO)
    }

    #[test]
    fn strips_of_a_sheet_are_branches_with_their_length_and_place() {
        let SurfaceBranches { branches, distances } = found(&sheet(&[8, 12, 10]));
        let mut seen: Vec<(f64, f64, f64)> = branches.iter().map(|b| (b.base.x, b.base.y, b.length())).collect();
        seen.sort_by(|a, b| a.0.total_cmp(&b.0));
        assert_eq!(seen.len(), 3, "{seen:?}");
        for ((x, y, length), (strip, rows)) in seen.into_iter().zip([(0.0, 8.0), (1.0, 12.0), (2.0, 10.0)]) {
            assert!((x - (4.0 * strip + 2.0) * STEP).abs() < 0.3 * STEP, "{x}");
            assert!((y - 20.0 * STEP).abs() < 1.5 * STEP, "{y}");
            assert!((length - rows * STEP).abs() < 1.5 * STEP, "{length} for {rows} rows");
        }
        assert!(distances.iter().all(|distance| distance.is_finite()));
    }

    #[test]
    fn bumps_and_a_lone_end_are_no_branches() {
        assert_eq!(found(&sheet(&[2, 1, 2])).branches, []);
        assert_eq!(found(&sheet(&[12])).branches, []);
        assert_eq!(found(&sphere(DVec3::ZERO, 0.4, 30)).branches, []);
    }

    #[test]
    fn parts_that_share_no_vertex_hang_together_over_the_narrowest_gap() {
        let finger = |x: f64| tube(DVec3::new(x, 0.102, 0.0), 0.008, 0.06, 8, 8);
        let mesh = joined(&[sheet(&[0, 0, 0]), finger(0.01), finger(0.03), finger(0.05)]);
        let branches = found(&mesh).branches;
        assert_eq!(branches.len(), 3, "{branches:?}");
        for branch in branches {
            assert!((branch.length() - 0.06).abs() < 0.01, "{}", branch.length());
            assert!((branch.thickness - 0.016).abs() < 0.004, "{}", branch.thickness);
            assert!((branch.tip - branch.base).normalize().y > 0.99);
        }
    }

    #[test]
    fn a_turned_part_has_turned_branches() {
        let (mesh, turn) = (sheet(&[8, 12, 10]), DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 1.1));
        let region: Vec<u32> =
            (0..mesh.positions.len() as u32).filter(|&v| mesh.positions[v as usize].y > STEP).collect();
        let ring = one_ring(&mesh);
        let turned = Mesh { positions: mesh.positions.iter().map(|&p| turn * p).collect(), ..mesh.clone() };
        let (one, other) =
            [&mesh, &turned].map(|mesh| surface_branches(mesh, &ring, &region, DVec3::ZERO).branches).into();
        assert_eq!((one.len(), other.len()), (3, 3));
        for straight in &one {
            let is_near = |turned: &Branch| {
                let apart = |one: DVec3, other: DVec3| (turn * one).distance(other);
                apart(straight.base, turned.base) < 2.0 * STEP && apart(straight.tip, turned.tip) < 2.0 * STEP
            };
            assert!(other.iter().any(is_near), "{straight:?} among {other:?}");
        }
    }

    #[test]
    fn degenerate_shapes_have_no_branches() {
        for mesh in degenerate() {
            let region: Vec<u32> = (0..mesh.positions.len() as u32).collect();
            assert_eq!(surface_branches(&mesh, &one_ring(&mesh), &region, DVec3::ZERO).branches, []);
        }
    }
}
