//! The inside of a shape as 88³ cells. RigNet [Xu et al. 2020], Section 4.2 (share of a bone outside the shape).
//!
//! | in     | shape              | unit                 |
//! |--------|--------------------|----------------------|
//! | `mesh` | `[V, 3]`, `[F, 3]` | normalised           |
//!
//! No watertight mesh is needed. Along each axis a line runs through the middle of every column of cells and counts how
//! often it enters and leaves the surface (winding number); a line that does not leave as often as it enters ran through
//! an opening and abstains. A cell is inside where most of the lines through it that did not abstain say so; where all
//! three abstain, where nothing but surface separates it from the outside.
//! # Departures from the published code
//! - Winding numbers in place of a depth-buffer voxeliser: shells that overlap stay solid, thin parts stay connected.
//! - A point is looked up in the cell that holds it. The published code rounds, which shifts the solid by half a cell.

use crate::mesh::Mesh;
use crate::mesh::face_orientation::outward;
use glam::DVec3;
use rayon::prelude::*;

/// Cells per side.
pub const RESOLUTION: usize = 88;
const CELLS: usize = RESOLUTION * RESOLUTION * RESOLUTION;
const COLUMNS: usize = RESOLUTION * RESOLUTION;

/// Which cells of a cube are inside.
#[derive(Clone, Debug, PartialEq)]
pub struct VoxelGrid {
    /// Least corner of the cube.
    pub origin: DVec3,
    /// Side of the cube.
    pub side: f64,
    /// `[88, 88, 88]` in the order x, y, z (z fastest).
    pub inside: Vec<bool>,
}

impl VoxelGrid {
    /// The solid of `mesh` in its bounding cube (anchored at the least corner). Without extent nothing is inside.
    pub fn solid(mesh: &Mesh) -> Self {
        let (low, high) = mesh.bounding_box().unwrap_or((DVec3::ZERO, DVec3::ZERO));
        let side = (high - low).max_element();
        let cells = RESOLUTION as f64 / side;
        if !(cells.is_finite() && cells > 0.0) {
            return Self { origin: low, side: 1.0, inside: vec![false; CELLS] };
        }
        let positions = mesh.positions.iter().map(|&position| (position - low) * cells).collect();
        let scaled = Mesh { positions, triangles: outward(mesh) };
        let lines: Vec<Lines> = (0..3).into_par_iter().map(|axis| Lines::new(&scaled, axis)).collect();
        Self { origin: low, side, inside: vote(&lines, &scaled) }
    }

    /// Whether the cell that holds `point` is inside; outside the cube nothing is.
    pub fn contains(&self, point: DVec3) -> bool {
        let cell = ((point - self.origin) / self.side * RESOLUTION as f64).floor();
        let limit = DVec3::splat(RESOLUTION as f64);
        if !(cell.cmpge(DVec3::ZERO).all() && cell.cmplt(limit).all()) {
            return false;
        }
        let [x, y, z] = cell.to_array().map(|index| index as usize);
        self.inside.get((x * RESOLUTION + y) * RESOLUTION + z).copied().unwrap_or(false)
    }

    /// The last point inside on the way from `from` along the unit vector `direction`; `from` itself if it is outside.
    pub fn last_inside(&self, from: DVec3, direction: DVec3) -> DVec3 {
        let step = self.side / (2 * RESOLUTION) as f64;
        // No way through the cube is longer than its diagonal, 1.74 sides.
        let ways = (0..4 * RESOLUTION).map(|count| from + direction * (step * count as f64));
        ways.take_while(|&point| self.contains(point)).last().unwrap_or(from)
    }
}

/// What the lines along one axis say.
struct Lines {
    /// `[88, 88, 88]`, x, y, z: inside by this axis.
    inside: Vec<bool>,
    /// `[88, 88]`: whether the line of a column abstains. Columns are numbered by the two other axes in cyclic order.
    abstains: Vec<bool>,
    axis: usize,
}

/// A line meets a triangle: in which column, at which cell coordinate, entering (1) or leaving (-1).
type Crossing = (u32, f64, i8);

/// Distance between consecutive cells of a column along each axis.
const STRIDE: [usize; 3] = [RESOLUTION * RESOLUTION, RESOLUTION, 1];

impl Lines {
    /// `mesh` in cell coordinates.
    fn new(mesh: &Mesh, axis: usize) -> Self {
        let mut lines = Self { inside: vec![false; CELLS], abstains: vec![false; COLUMNS], axis };
        let mut crossings: Vec<Crossing> = Vec::new();
        for triangle in 0..mesh.triangles.len() {
            cross(mesh.corners(triangle), mesh.triangles[triangle], axis, &mut crossings);
        }
        crossings.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(b.2.cmp(&a.2)));
        for column in crossings.chunk_by(|a, b| a.0 == b.0) {
            lines.fill(column);
        }
        lines
    }

    /// Marks the cells of one column whose middles have a winding number other than zero.
    fn fill(&mut self, crossings: &[Crossing]) {
        let Some(&(column, ..)) = crossings.first() else { return };
        if crossings.iter().map(|&(.., way)| i32::from(way)).sum::<i32>() != 0 {
            self.abstains[column as usize] = true;
            return;
        }
        let (first_axis, second_axis) = others(self.axis);
        let start =
            column as usize / RESOLUTION * STRIDE[first_axis] + column as usize % RESOLUTION * STRIDE[second_axis];
        let mut winding = 0;
        let mut entered = 0.0;
        for &(_, at, way) in crossings {
            let before = winding;
            winding += i32::from(way);
            if before == 0 {
                entered = at;
            } else if winding == 0 {
                for cell in cells_between(entered, at) {
                    self.inside[start + cell * STRIDE[self.axis]] = true;
                }
            }
        }
    }

    fn column(&self, cell: [usize; 3]) -> usize {
        let (first_axis, second_axis) = others(self.axis);
        cell[first_axis] * RESOLUTION + cell[second_axis]
    }
}

/// The cells whose middles lie from `low` to `high`; where there are none, the cell that holds most of the way, so that
/// parts thinner than a cell do not vanish.
fn cells_between(low: f64, high: f64) -> std::ops::Range<usize> {
    let cell = |coordinate: f64| coordinate.clamp(0.0, RESOLUTION as f64) as usize;
    let (first, end) = (cell((low - 0.5).ceil()), cell((high - 0.5).floor() + 1.0));
    if first < end {
        return first..end;
    }
    let middle = cell((low + high) * 0.5).min(RESOLUTION - 1);
    middle..middle + 1
}

fn others(axis: usize) -> (usize, usize) {
    ((axis + 1) % 3, (axis + 2) % 3)
}

/// Appends where the lines along `axis` through the middles of columns meet a triangle.
///
/// A line through an edge or a corner meets exactly one of the triangles around it: each edge is evaluated from its
/// lower to its higher vertex, so both neighbours get the same number, and zero counts as one fixed side.
fn cross(corners: [DVec3; 3], vertices: [u32; 3], axis: usize, crossings: &mut Vec<Crossing>) {
    let (first_axis, second_axis) = others(axis);
    let flat = corners.map(|corner| [corner[first_axis], corner[second_axis]]);
    let low = [0, 1].map(|k| flat[0][k].min(flat[1][k]).min(flat[2][k]));
    let high = [0, 1].map(|k| flat[0][k].max(flat[1][k]).max(flat[2][k]));
    let columns = [0, 1].map(|k| {
        let first = (low[k] - 0.5).ceil().max(0.0) as usize;
        let end = ((high[k] - 0.5).floor() + 1.0).clamp(0.0, RESOLUTION as f64) as usize;
        first..end
    });
    for first in columns[0].clone() {
        for second in columns[1].clone() {
            let middle = [first as f64 + 0.5, second as f64 + 0.5];
            let side =
                |k: usize| side_of_edge((flat[k], vertices[k]), (flat[(k + 1) % 3], vertices[(k + 1) % 3]), middle);
            let (ab, bc, ca) = (side(0), side(1), side(2));
            if ab.0 != bc.0 || bc.0 != ca.0 {
                continue;
            }
            let total = ab.1 + bc.1 + ca.1;
            if total == 0.0 {
                continue;
            }
            let at = (bc.1 * corners[0][axis] + ca.1 * corners[1][axis] + ab.1 * corners[2][axis]) / total;
            // Counter-clockwise seen against the axis: the normal points along it, so the line leaves.
            crossings.push(((first * RESOLUTION + second) as u32, at, if ab.0 { -1 } else { 1 }));
        }
    }
}

/// On which side of a directed edge a point lies (true: left), and twice the signed area of the triangle they make.
fn side_of_edge(from: ([f64; 2], u32), to: ([f64; 2], u32), point: [f64; 2]) -> (bool, f64) {
    let reversed = from.1 > to.1;
    let (a, b) = if reversed { (to.0, from.0) } else { (from.0, to.0) };
    let area = (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0]);
    if reversed { (area < 0.0, -area) } else { (area >= 0.0, area) }
}

/// Inside where most lines that do not abstain say so.
fn vote(lines: &[Lines], mesh: &Mesh) -> Vec<bool> {
    let mut undecided = Vec::new();
    let mut inside = vec![false; CELLS];
    for (index, inside) in inside.iter_mut().enumerate() {
        let cell = [index / STRIDE[0], index / STRIDE[1] % RESOLUTION, index % RESOLUTION];
        let (mut votes, mut voters) = (0, 0);
        for line in lines {
            let abstains = line.abstains[line.column(cell)];
            voters += usize::from(!abstains);
            votes += usize::from(!abstains && line.inside[index]);
        }
        *inside = 2 * votes > voters;
        if voters == 0 {
            undecided.push(index);
        }
    }
    if !undecided.is_empty() {
        let open = reached_from_outside(mesh);
        undecided.into_iter().for_each(|cell| inside[cell] = !open[cell]);
    }
    inside
}

/// Cells that a path through faces of cells joins with the outside of the cube without touching a cell of the surface.
fn reached_from_outside(mesh: &Mesh) -> Vec<bool> {
    let closed = surface_cells(mesh);
    let mut reached = vec![false; CELLS];
    let mut work = Vec::new();
    let last = RESOLUTION - 1;
    for index in 0..CELLS {
        let cell = [index / STRIDE[0], index / STRIDE[1] % RESOLUTION, index % RESOLUTION];
        if !closed[index] && cell.iter().any(|&at| at == 0 || at == last) {
            reached[index] = true;
            work.push(index);
        }
    }
    // Each cell enters the list once.
    while let Some(index) = work.pop() {
        let cell = [index / STRIDE[0], index / STRIDE[1] % RESOLUTION, index % RESOLUTION];
        for axis in 0..3 {
            let next = [(cell[axis] > 0, index.wrapping_sub(STRIDE[axis])), (cell[axis] < last, index + STRIDE[axis])];
            for (exists, next) in next {
                if exists && !closed[next] && !reached[next] {
                    reached[next] = true;
                    work.push(next);
                }
            }
        }
    }
    reached
}

/// The cells that the surface runs through, `[88, 88, 88]`. `mesh` in cell coordinates.
pub(super) fn surface_cells(mesh: &Mesh) -> Vec<bool> {
    let mut cells = vec![false; CELLS];
    for triangle in 0..mesh.triangles.len() {
        mark_surface(mesh.corners(triangle), &mut cells);
    }
    cells
}

/// Marks the cells that points of a triangle, half a cell apart, lie in.
fn mark_surface([a, b, c]: [DVec3; 3], closed: &mut [bool]) {
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    let steps = (longest * 2.0).ceil().clamp(1.0, 4.0 * RESOLUTION as f64) as usize;
    for first in 0..=steps {
        for second in 0..=steps - first {
            let point = a + ((b - a) * first as f64 + (c - a) * second as f64) / steps as f64;
            let [x, y, z] = point.to_array().map(|at| (at.max(0.0) as usize).min(RESOLUTION - 1));
            closed[x * STRIDE[0] + y * STRIDE[1] + z] = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::{degenerate, joined, sphere, torus, tube, volume};

    /// Volume of the solid over the volume enclosed by `mesh`.
    fn filled(mesh: &Mesh, enclosed: f64) -> f64 {
        let grid = VoxelGrid::solid(mesh);
        let cell = grid.side / RESOLUTION as f64;
        grid.inside.iter().filter(|inside| **inside).count() as f64 * cell.powi(3) / enclosed
    }

    #[test]
    fn closed_shapes_fill_their_volume() {
        for mesh in [sphere(DVec3::new(3.0, 1.0, -2.0), 0.4, 40), torus(0.4, 0.1, 60)] {
            let share = filled(&mesh, volume(&mesh));
            assert!((share - 1.0).abs() < 0.02, "{share}");
        }
    }

    #[test]
    fn the_way_inside_ends_at_the_surface() {
        let grid = VoxelGrid::solid(&sphere(DVec3::ZERO, 0.5, 40));
        let end = grid.last_inside(DVec3::Y * 0.1, DVec3::Y);
        assert!((0.47..0.5).contains(&end.y) && end.x == 0.0, "{end}");
        assert_eq!(grid.last_inside(DVec3::Y * 0.6, DVec3::Y), DVec3::Y * 0.6);
        assert_eq!(grid.last_inside(DVec3::ZERO, DVec3::ZERO), DVec3::ZERO);
    }

    #[test]
    fn flipped_faces_and_whole_shells_inside_out_fill_as_well() {
        let straight = sphere(DVec3::ZERO, 0.4, 40);
        for modulus in [1, 2, 3, 7] {
            let mut mesh = straight.clone();
            mesh.triangles.iter_mut().step_by(modulus).for_each(|face| face.swap(0, 1));
            assert_eq!(VoxelGrid::solid(&mesh), VoxelGrid::solid(&straight));
        }
    }

    #[test]
    fn overlapping_shells_stay_solid_where_they_overlap() {
        let (left, right) = (sphere(DVec3::X * -0.2, 0.3, 40), sphere(DVec3::X * 0.2, 0.3, 40));
        let grid = VoxelGrid::solid(&joined(&[left, right]));
        assert!([-0.4, -0.2, 0.0, 0.2, 0.4].iter().all(|&x| grid.contains(DVec3::new(x, 0.01, 0.01))));
        assert!(!grid.contains(DVec3::new(0.0, 0.25, 0.01)));
    }

    #[test]
    fn open_tubes_and_spheres_with_holes_are_solid() {
        let mut open = tube(DVec3::ZERO, 0.2, 1.0, 40, 10);
        let share = filled(&open, 0.04 * std::f64::consts::PI);
        assert!((share - 1.0).abs() < 0.03, "{share}");
        open = sphere(DVec3::ZERO, 0.4, 40);
        let enclosed = volume(&open);
        open.triangles.retain(|face| open.positions[face[0] as usize].y < 0.3);
        let share = filled(&open, enclosed);
        assert!((0.9..1.02).contains(&share), "{share}");
    }

    #[test]
    fn parts_thinner_than_a_cell_do_not_vanish() {
        let rod = tube(DVec3::new(0.0, 0.0, 0.0), 0.004, 1.0, 12, 30);
        let cells = VoxelGrid::solid(&rod).inside.iter().filter(|inside| **inside).count();
        assert!(cells >= RESOLUTION, "{cells}");
    }

    #[test]
    fn degenerate_shapes_give_a_grid() {
        for mesh in degenerate() {
            assert_eq!(VoxelGrid::solid(&mesh).inside.len(), CELLS);
        }
        let grid = VoxelGrid::solid(&sphere(DVec3::ZERO, 0.4, 20));
        for outside in [DVec3::splat(0.41), DVec3::splat(-0.41), DVec3::splat(f64::NAN), DVec3::splat(1e300)] {
            assert!(!grid.contains(outside));
        }
    }
}
