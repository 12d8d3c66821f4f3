//! The occupied cells of a shape: those inside, and those that the surface passes. What lies beside what, which parts hang
//! together, and how wide the gaps between parts are.
//!
//! Lengths and places are in cells of the [`VoxelGrid`] unless said otherwise; C is the number of occupied cells, which are
//! numbered in the grid's order.

use super::voxel_grid::{RESOLUTION, VoxelGrid, surface_cells};
use crate::mesh::Mesh;
use glam::DVec3;
use std::collections::BTreeMap;

/// Cells that a way inside the shape may pass.
pub(super) struct SolidCells {
    origin: DVec3,
    /// Cells per unit of the normalised frame.
    pub(super) scale: f64,
    /// Number among the occupied cells, or [`EMPTY`]. `[88³]`
    number: Vec<u32>,
    /// Places of the occupied cells, ascending. `[C]`
    places: Vec<[u8; 3]>,
}

const EMPTY: u32 = u32::MAX;
const CELLS: usize = RESOLUTION * RESOLUTION * RESOLUTION;

/// The narrowest gap between two parts: its length, and the cells at its ends (the lower number first).
pub(super) type Gap = (f32, u32, u32);

impl SolidCells {
    /// `solid` is that of `mesh`; both normalised.
    pub(super) fn new(mesh: &Mesh, solid: &VoxelGrid) -> Self {
        let scale = RESOLUTION as f64 / solid.side;
        let positions = mesh.positions.iter().map(|&position| (position - solid.origin) * scale).collect();
        let surface = surface_cells(&Mesh { positions, triangles: mesh.triangles.clone() });
        let mut number = vec![EMPTY; CELLS];
        let mut places = Vec::new();
        for index in (0..CELLS).filter(|&index| surface[index] || solid.inside[index]) {
            number[index] = places.len() as u32;
            places.push(place_of(index));
        }
        Self { origin: solid.origin, scale, number, places }
    }

    /// A point of the normalised frame in cell coordinates.
    pub(super) fn to_cells(&self, point: DVec3) -> DVec3 {
        (point - self.origin) * self.scale
    }

    pub(super) fn count(&self) -> u32 {
        self.places.len() as u32
    }

    pub(super) fn centre(&self, cell: u32) -> DVec3 {
        DVec3::from(self.places[cell as usize].map(f64::from)) + 0.5
    }

    /// The number of the cell at a whole-numbered place, if it is occupied.
    pub(super) fn number_at(&self, place: DVec3) -> Option<u32> {
        let inside = place.cmpge(DVec3::ZERO).all() && place.cmplt(DVec3::splat(RESOLUTION as f64)).all();
        let [x, y, z] = place.to_array().map(|at| at as usize);
        inside.then(|| self.number[(x * RESOLUTION + y) * RESOLUTION + z]).filter(|&number| number != EMPTY)
    }

    /// The occupied cells at and around a point, each with its distance to it; where there are none, the nearest cell.
    pub(super) fn around(&self, point: DVec3) -> Vec<(u32, f32)> {
        let last = DVec3::splat(RESOLUTION as f64 - 1.0);
        let here = point.floor().clamp(DVec3::ZERO, last);
        let offsets = OFFSETS.iter().copied().chain([[0, 0, 0]]);
        let near = offsets.filter_map(|offset| self.number_at(here + DVec3::from(offset.map(f64::from))));
        let mut cells: Vec<(u32, f32)> = near.map(|cell| (cell, self.centre(cell).distance(point) as f32)).collect();
        if cells.is_empty() {
            let all = (0..self.places.len() as u32).map(|cell| (cell, self.centre(cell).distance(point) as f32));
            cells.extend(all.min_by(|a, b| a.1.total_cmp(&b.1)));
        }
        cells
    }

    /// Calls `visit` with the occupied cells around `cell` and how far their centres are.
    pub(super) fn neighbours(&self, cell: u32, mut visit: impl FnMut(u32, f32)) {
        let place = self.places[cell as usize].map(i32::from);
        for (offset, length) in OFFSETS.iter().zip(OFFSET_LENGTHS) {
            let at: [i32; 3] = std::array::from_fn(|axis| place[axis] + i32::from(offset[axis]));
            if at.iter().all(|&at| (0..RESOLUTION as i32).contains(&at)) {
                let other = self.number[index_of(at.map(|at| at as usize))];
                if other != EMPTY {
                    visit(other, length);
                }
            }
        }
    }

    /// Which connected part each occupied cell belongs to, and how many there are.
    pub(super) fn parts(&self) -> (Vec<u32>, usize) {
        let mut part = vec![EMPTY; self.places.len()];
        let mut count = 0;
        let mut work = Vec::new();
        for first in 0..self.places.len() as u32 {
            if part[first as usize] != EMPTY {
                continue;
            }
            part[first as usize] = count;
            work.push(first);
            // Each cell enters the list once.
            while let Some(cell) = work.pop() {
                self.neighbours(cell, |other, _| {
                    if part[other as usize] == EMPTY {
                        part[other as usize] = count;
                        work.push(other);
                    }
                });
            }
            count += 1;
        }
        (part, count as usize)
    }

    /// The narrowest gap between each pair of parts that face each other: length and the two cells. Found by growing all
    /// parts into the empty cells at once, each empty cell keeping the occupied cell that it was reached from.
    pub(super) fn gaps(&self, part: &[u32]) -> BTreeMap<(u32, u32), Gap> {
        let mut source = self.number.clone();
        let mut front: Vec<usize> = (0..CELLS).filter(|&index| source[index] != EMPTY).collect();
        let mut gaps: BTreeMap<(u32, u32), Gap> = BTreeMap::new();
        // Each cell of the grid stands in one front.
        while !front.is_empty() {
            let mut next = Vec::new();
            for index in front {
                let own = source[index];
                for step in faces_of(index) {
                    if source[step] == EMPTY {
                        source[step] = own;
                        next.push(step);
                        continue;
                    }
                    let (one, other) = (own.min(source[step]), own.max(source[step]));
                    let (a, b) = (part[one as usize], part[other as usize]);
                    if a != b {
                        let length = self.centre(one).distance(self.centre(other)) as f32;
                        let known = gaps.entry((a.min(b), a.max(b))).or_insert((length, one, other));
                        if (length, one, other) < *known {
                            *known = (length, one, other);
                        }
                    }
                }
            }
            front = next;
        }
        gaps
    }
}

/// The 26 cells around one.
const OFFSETS: [[i8; 3]; 26] = offsets();
const OFFSET_LENGTHS: [f32; 26] = offset_lengths();

const fn offsets() -> [[i8; 3]; 26] {
    let mut all = [[0; 3]; 26];
    let (mut index, mut code) = (0, 0);
    while code < 27 {
        if code != 13 {
            all[index] = [code / 9 - 1, code / 3 % 3 - 1, code % 3 - 1];
            index += 1;
        }
        code += 1;
    }
    all
}

const fn offset_lengths() -> [f32; 26] {
    let mut lengths = [0.0; 26];
    let mut index = 0;
    while index < 26 {
        let [x, y, z] = OFFSETS[index];
        lengths[index] = [0.0, 1.0, std::f32::consts::SQRT_2, 1.732_050_8][(x * x + y * y + z * z) as usize];
        index += 1;
    }
    lengths
}

fn index_of([x, y, z]: [usize; 3]) -> usize {
    (x * RESOLUTION + y) * RESOLUTION + z
}

fn place_of(index: usize) -> [u8; 3] {
    [index / (RESOLUTION * RESOLUTION), index / RESOLUTION % RESOLUTION, index % RESOLUTION].map(|at| at as u8)
}

/// The up to six cells that share a face with a cell of the grid.
fn faces_of(index: usize) -> impl Iterator<Item = usize> {
    let place = place_of(index).map(usize::from);
    (0..3).flat_map(move |axis| {
        let moved = |at: usize| {
            let mut place = place;
            place[axis] = at;
            index_of(place)
        };
        let below = place[axis].checked_sub(1).map(moved);
        let above = Some(place[axis] + 1).filter(|&at| at < RESOLUTION).map(moved);
        below.into_iter().chain(above)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::{joined, sphere};

    #[test]
    fn two_balls_are_two_parts_with_one_gap_between_them() {
        let mesh = joined(&[sphere(DVec3::ZERO, 0.2, 24), sphere(DVec3::X * 0.7, 0.2, 24)]);
        let cells = SolidCells::new(&mesh, &VoxelGrid::solid(&mesh));
        let (part, count) = cells.parts();
        assert_eq!((part.len() as u32, count), (cells.count(), 2));
        let gaps = cells.gaps(&part);
        let (length, one, other) = gaps[&(0, 1)];
        assert_eq!(gaps.len(), 1);
        assert!((f64::from(length) / cells.scale - 0.3).abs() < 0.03, "{length}");
        assert_eq!((part[one as usize], part[other as usize]), (0, 1));
    }

    #[test]
    fn neighbours_are_mutual_and_as_far_as_their_centres() {
        let mesh = sphere(DVec3::ZERO, 0.5, 16);
        let cells = SolidCells::new(&mesh, &VoxelGrid::solid(&mesh));
        for cell in (0..cells.count()).step_by(997) {
            cells.neighbours(cell, |other, length| {
                assert!((cells.centre(cell).distance(cells.centre(other)) - f64::from(length)).abs() < 1e-6);
                let mut back = false;
                cells.neighbours(other, |third, _| back |= third == cell);
                assert!(back);
            });
        }
    }

    #[test]
    fn a_point_finds_its_own_cell_and_one_far_away_finds_the_nearest() {
        let mesh = sphere(DVec3::ZERO, 0.5, 24);
        let cells = SolidCells::new(&mesh, &VoxelGrid::solid(&mesh));
        let around = cells.around(cells.to_cells(DVec3::ZERO));
        assert_eq!(around.len(), 27);
        assert!(around.iter().any(|&(_, distance)| distance < 0.9));
        assert_eq!(cells.around(cells.to_cells(DVec3::splat(0.49))).len(), 1);
    }
}
