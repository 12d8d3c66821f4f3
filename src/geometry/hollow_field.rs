//! The grid that HollowDist searches: which cells the surface touches, where the vertices are, and which cells are remembered.
//! [`super::hollow_distance`] says what it is for.

use super::surface_voxels::Lattice;
use crate::mesh::Mesh;

/// The grid of one mesh, and where its vertices are in it.
pub(super) struct Field {
    pub lattice: Lattice,
    pub is_mesh: Vec<bool>,
    /// Offsets between indices of neighbours: the first six share a face.
    pub steps: [isize; 26],
    /// The cell of each vertex, as a number in `kept`. `[V]`
    pub cell_of_vertex: Vec<u32>,
    /// Cells whose layers the search keeps: first those that hold a vertex and their neighbours, then the other mesh cells.
    pub kept: Vec<u32>,
    /// How many of them are the first: all that the vertices ask for.
    pub near_count: usize,
    /// Number in `kept`, or `u32::MAX`. `[cells]`
    pub number: Vec<u32>,
    /// Whether a kept cell holds a vertex.
    pub holds_vertex: Vec<bool>,
    pub holding_count: u32,
}

impl Field {
    pub fn new(lattice: Lattice, mesh: &Mesh) -> Self {
        let is_mesh = lattice.surface(mesh);
        let mut is_near = vec![false; lattice.count()];
        let steps = steps(&lattice);
        let cell_of = |&position| lattice.holding(lattice.to_cells(position)) as u32;
        let mut cell_of_vertex: Vec<u32> = mesh.positions.iter().map(cell_of).collect();
        for &cell in &cell_of_vertex {
            is_near[cell as usize] = true;
            steps.iter().for_each(|&step| is_near[(cell as usize).wrapping_add_signed(step)] = true);
        }
        let cells = 0..lattice.count() as u32;
        let mut kept: Vec<u32> = cells.clone().filter(|&cell| is_near[cell as usize]).collect();
        let near_count = kept.len();
        kept.extend(cells.filter(|&cell| is_mesh[cell as usize] && !is_near[cell as usize]));
        let mut number = vec![u32::MAX; lattice.count()];
        kept.iter().enumerate().for_each(|(at, &cell)| number[cell as usize] = at as u32);
        let mut holds_vertex = vec![false; kept.len()];
        for cell in &mut cell_of_vertex {
            *cell = number[*cell as usize];
            holds_vertex[*cell as usize] = true;
        }
        let holding_count = holds_vertex.iter().filter(|holds| **holds).count() as u32;
        Self { lattice, is_mesh, steps, cell_of_vertex, kept, near_count, number, holds_vertex, holding_count }
    }
}

/// From a cell's index to its neighbours': over faces first.
fn steps(lattice: &Lattice) -> [isize; 26] {
    let strides = [lattice.size[1] * lattice.size[2], lattice.size[2], 1].map(|stride| stride as isize);
    let mut all: Vec<[isize; 3]> = (0..27).map(|code| [code / 9 - 1, code / 3 % 3 - 1, code % 3 - 1]).collect();
    all.retain(|offset| *offset != [0; 3]);
    all.sort_by_key(|offset| offset.iter().map(|at| at.abs()).sum::<isize>() > 1);
    std::array::from_fn(|at| all[at].iter().zip(strides).map(|(at, stride)| at * stride).sum())
}
