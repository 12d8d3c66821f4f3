//! Who touches whom: one-rings, connected components, edge statistics. RigNet [Xu et al. 2020], Section 4.1 ("one-ring").
//!
//! Shapes: one row of vertex indices per vertex `[V, any]`. No space and no unit: connectivity only.

use super::Mesh;

/// Rows of vertex indices in compressed form: row `v` is `members[offsets[v]..offsets[v + 1]]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Neighbors {
    /// `[V + 1]`, ascending from 0.
    pub offsets: Vec<u32>,
    pub members: Vec<u32>,
}

impl Neighbors {
    /// Compresses one list per vertex.
    pub fn from_rows<R: AsRef<[u32]>>(rows: &[R]) -> Self {
        let mut offsets = Vec::with_capacity(rows.len() + 1);
        offsets.push(0);
        let mut members = Vec::with_capacity(rows.iter().map(|row| row.as_ref().len()).sum());
        for row in rows {
            members.extend_from_slice(row.as_ref());
            offsets.push(members.len() as u32);
        }
        Self { offsets, members }
    }

    pub fn vertex_count(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    pub fn row(&self, vertex: usize) -> &[u32] {
        &self.members[self.offsets[vertex] as usize..self.offsets[vertex + 1] as usize]
    }
}

/// For every vertex all distinct other corners of the faces that contain it, ascending. A vertex without faces has an
/// empty row; self loops never appear.
pub fn one_ring(mesh: &Mesh) -> Neighbors {
    let mut pairs = Vec::with_capacity(mesh.triangles.len() * 6);
    for &[a, b, c] in &mesh.triangles {
        pairs.extend([(a, b), (a, c), (b, a), (b, c), (c, a), (c, b)]);
    }
    pairs.retain(|(from, to)| from != to);
    pairs.sort_unstable();
    pairs.dedup();
    let mut offsets = vec![0u32; mesh.positions.len() + 1];
    for &(from, _) in &pairs {
        offsets[from as usize + 1] += 1;
    }
    for vertex in 0..mesh.positions.len() {
        offsets[vertex + 1] += offsets[vertex];
    }
    Neighbors { offsets, members: pairs.into_iter().map(|(_, to)| to).collect() }
}

/// Which connected part each vertex belongs to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Components {
    pub count: usize,
    /// `[V]`, numbered in the order of first vertices.
    pub of_vertex: Vec<u32>,
}

/// Parts connected by shared vertices of faces. A vertex without faces is a part of its own.
pub fn components(mesh: &Mesh) -> Components {
    let mut sets = DisjointSets::new(mesh.positions.len());
    for &[a, b, c] in &mesh.triangles {
        sets.join(a, b);
        sets.join(b, c);
    }
    sets.components()
}

/// Sets of numbers that can only grow together; the least member names the set.
pub(crate) struct DisjointSets(Vec<u32>);

impl DisjointSets {
    pub(crate) fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    pub(crate) fn find(&mut self, member: u32) -> u32 {
        let mut at = member;
        while self.0[at as usize] != at {
            self.0[at as usize] = self.0[self.0[at as usize] as usize];
            at = self.0[at as usize];
        }
        at
    }

    pub(crate) fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.0[a.max(b) as usize] = a.min(b);
    }

    fn components(mut self) -> Components {
        let mut of_vertex = vec![u32::MAX; self.0.len()];
        let mut count = 0u32;
        for vertex in 0..self.0.len() {
            let least = self.find(vertex as u32) as usize;
            if of_vertex[least] == u32::MAX {
                of_vertex[least] = count;
                count += 1;
            }
            of_vertex[vertex] = of_vertex[least];
        }
        Components { count: count as usize, of_vertex }
    }
}

/// How the faces of a mesh meet, for `check` and for deciding how far orientation can be trusted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EdgeStatistics {
    /// Distinct undirected edges.
    pub edges: usize,
    /// Edges of one face only: the rim of an opening.
    pub boundary: usize,
    /// Edges of three or more faces.
    pub non_manifold: usize,
    /// Edges of two faces that run the same way along it: one of the two is inside out.
    pub inconsistent: usize,
}

pub fn edge_statistics(mesh: &Mesh) -> EdgeStatistics {
    // (low, high, runs from low to high)
    let mut sides = Vec::with_capacity(mesh.triangles.len() * 3);
    for &[a, b, c] in &mesh.triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            if from != to {
                sides.push((from.min(to), from.max(to), from < to));
            }
        }
    }
    sides.sort_unstable();
    let mut statistics = EdgeStatistics::default();
    for edge in sides.chunk_by(|left, right| (left.0, left.1) == (right.0, right.1)) {
        statistics.edges += 1;
        match edge {
            [_] => statistics.boundary += 1,
            [(_, _, first), (_, _, second)] => statistics.inconsistent += usize::from(first == second),
            _ => statistics.non_manifold += 1,
        }
    }
    statistics
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn mesh(vertices: usize, triangles: &[[u32; 3]]) -> Mesh {
        let positions = (0..vertices).map(|i| DVec3::new(i as f64, (i * i) as f64, 1.0 / (1.0 + i as f64))).collect();
        Mesh { positions, triangles: triangles.to_vec() }
    }

    #[test]
    fn a_closed_tetrahedron_has_full_rings_and_no_open_edges() {
        let tetrahedron = mesh(4, &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]);
        let ring = one_ring(&tetrahedron);
        for vertex in 0..4 {
            let others: Vec<u32> = (0..4).filter(|&other| other != vertex).collect();
            assert_eq!(ring.row(vertex as usize), others);
        }
        assert_eq!(edge_statistics(&tetrahedron), EdgeStatistics { edges: 6, ..Default::default() });
        assert_eq!(components(&tetrahedron).count, 1);
    }

    #[test]
    fn open_flipped_and_shared_edges_are_told_apart() {
        assert_eq!(edge_statistics(&mesh(3, &[[0, 1, 2]])).boundary, 3);
        assert_eq!(edge_statistics(&mesh(4, &[[0, 1, 2], [0, 1, 3]])).inconsistent, 1);
        assert_eq!(edge_statistics(&mesh(5, &[[0, 1, 2], [1, 0, 3], [0, 1, 4]])).non_manifold, 1);
    }

    #[test]
    fn lone_vertices_and_degenerate_faces_are_harmless() {
        let odd = mesh(4, &[[0, 0, 1], [2, 2, 2]]);
        assert_eq!(one_ring(&odd), Neighbors::from_rows(&[vec![1], vec![0], vec![], vec![]]));
        assert_eq!(components(&odd), Components { count: 3, of_vertex: vec![0, 0, 1, 2] });
        assert_eq!(one_ring(&Mesh::default()).vertex_count(), 0);
    }
}
