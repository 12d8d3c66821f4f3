//! The cells of a regular grid that the surface touches, none missed.
//!
//! | in     | shape              | unit      |
//! |--------|--------------------|-----------|
//! | `mesh` | `[V, 3]`, `[F, 3]` | any space |
//!
//! A cell counts if its closed box meets a closed triangle: separating axes of box and triangle [Akenine-Möller 2001]. A
//! surface marked this way cannot be passed between cells that share only a corner.

use crate::mesh::Mesh;
use glam::DVec3;

/// Cells around the mesh's bounding box on every side: an outer layer that nothing enters, and one to walk around the mesh.
const MARGIN: usize = 2;

/// Where the cells of a grid lie.
#[derive(Clone, Debug)]
pub(super) struct Lattice {
    /// Least corner.
    origin: DVec3,
    /// Length of a cell's edge.
    pub(super) cell: f64,
    pub(super) size: [usize; 3],
}

impl Lattice {
    /// `resolution` cells along the longest side of the bounding box, and a margin. `None` where the mesh has no extent.
    pub(super) fn around(mesh: &Mesh, resolution: usize) -> Option<Self> {
        let (low, high) = mesh.bounding_box()?;
        let cell = (high - low).max_element() / resolution as f64;
        if !(cell.is_normal() && cell.recip().is_finite()) {
            return None;
        }
        let cells = |extent: f64| ((extent / cell).ceil() as usize).clamp(1, resolution) + 2 * MARGIN;
        let size = (high - low).to_array().map(cells);
        Some(Self { origin: low - cell * MARGIN as f64, cell, size })
    }

    pub(super) fn count(&self) -> usize {
        self.size.iter().product()
    }

    /// A point in cell coordinates.
    pub(super) fn to_cells(&self, point: DVec3) -> DVec3 {
        (point - self.origin) / self.cell
    }

    /// The cell that holds a point in cell coordinates, the outer layer excluded.
    pub(super) fn holding(&self, place: DVec3) -> usize {
        let at: [usize; 3] = std::array::from_fn(|axis| (place[axis].max(0.0) as usize).clamp(1, self.size[axis] - 2));
        self.index(at)
    }

    pub(super) fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (x * self.size[1] + y) * self.size[2] + z
    }

    pub(super) fn place(&self, index: usize) -> [usize; 3] {
        let [_, height, depth] = self.size;
        [index / (height * depth), index / depth % height, index % depth]
    }

    /// Middle of a cell, in cell coordinates.
    pub(super) fn centre(&self, index: usize) -> DVec3 {
        DVec3::from(self.place(index).map(|at| at as f64)) + 0.5
    }

    /// Whether a cell lies in the outer layer.
    pub(super) fn is_outermost(&self, index: usize) -> bool {
        self.place(index).into_iter().zip(self.size).any(|(at, size)| at == 0 || at + 1 == size)
    }

    /// The cells that the surface of `mesh` touches. `[count]`
    pub(super) fn surface(&self, mesh: &Mesh) -> Vec<bool> {
        let mut touched = vec![false; self.count()];
        for triangle in 0..mesh.triangles.len() {
            self.mark(mesh.corners(triangle).map(|corner| self.to_cells(corner)), &mut touched);
        }
        touched
    }

    fn mark(&self, corners: [DVec3; 3], touched: &mut [bool]) {
        let [a, b, c] = corners;
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let first: [usize; 3] = std::array::from_fn(|axis| (low[axis].max(1.0) as usize).min(self.size[axis] - 2));
        let last: [usize; 3] = std::array::from_fn(|axis| (high[axis].max(1.0) as usize).min(self.size[axis] - 2));
        if first == last {
            touched[self.index(first)] = true;
            return;
        }
        let normal = (b - a).cross(c - a);
        // Along the axis that the triangle faces most, each column of cells meets its plane in a few cells only.
        let steep = (0..3).max_by(|&i, &j| normal[i].abs().total_cmp(&normal[j].abs())).unwrap_or(0);
        let (second, third) = ((steep + 1) % 3, (steep + 2) % 3);
        for i in first[second]..=last[second] {
            for j in first[third]..=last[third] {
                let mut span = (first[steep], last[steep]);
                if normal[steep] != 0.0 {
                    let (slope_i, slope_j) = (normal[second] / normal[steep], normal[third] / normal[steep]);
                    let middle =
                        a[steep] - slope_i * (i as f64 + 0.5 - a[second]) - slope_j * (j as f64 + 0.5 - a[third]);
                    let reach = 0.5 * (slope_i.abs() + slope_j.abs()) + SLACK;
                    span.0 = span.0.max((middle - reach - 1.0).max(0.0) as usize);
                    span.1 = span.1.min((middle + reach).max(0.0) as usize);
                }
                for k in span.0..=span.1 {
                    let mut place = [0; 3];
                    (place[steep], place[second], place[third]) = (k, i, j);
                    let index = self.index(place);
                    if !touched[index] && meets(corners, normal, DVec3::from(place.map(|at| at as f64)) + 0.5) {
                        touched[index] = true;
                    }
                }
            }
        }
    }
}

/// A cell is taken for touched if the surface passes it by less than this share of its edge.
const SLACK: f64 = 1e-9;

/// Whether a triangle meets the unit cube about `centre`.
fn meets(corners: [DVec3; 3], normal: DVec3, centre: DVec3) -> bool {
    let [a, b, c] = corners.map(|corner| corner - centre);
    let apart = |axis: DVec3| {
        let reach = 0.5 * (axis.x.abs() + axis.y.abs() + axis.z.abs()) + SLACK * axis.abs().max_element();
        let (p, q, r) = (axis.dot(a), axis.dot(b), axis.dot(c));
        p.min(q).min(r) > reach || p.max(q).max(r) < -reach
    };
    let edges = [b - a, c - b, a - c];
    let crossed = edges.into_iter().flat_map(|edge| {
        [DVec3::new(0.0, -edge.z, edge.y), DVec3::new(edge.z, 0.0, -edge.x), DVec3::new(-edge.y, edge.x, 0.0)]
    });
    !([DVec3::X, DVec3::Y, DVec3::Z, normal].into_iter().chain(crossed).any(apart))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::{degenerate, sphere};
    use proptest::prelude::*;

    proptest! {
        /// Every point of a triangle lies in a touched cell, and every touched cell has a point of it within a corner's reach.
        #[test]
        fn a_triangle_touches_the_cells_of_its_points_and_no_others(corners in prop::array::uniform9(0.0..1.0f64)) {
            let corner = |at: usize| DVec3::from_slice(&corners[3 * at..]);
            let frame = [DVec3::ZERO, DVec3::ONE];
            let mesh = Mesh { positions: [frame.as_slice(), &[corner(0), corner(1), corner(2)]].concat(), triangles: vec![[2, 3, 4]] };
            let lattice = Lattice::around(&mesh, 20).unwrap();
            let touched = lattice.surface(&mesh);
            let mut nearest = vec![f64::INFINITY; lattice.count()];
            let steps = 200;
            for (i, j) in (0..=steps).flat_map(|i| (0..=steps - i).map(move |j| (i, j))) {
                let (s, t) = (f64::from(i) / f64::from(steps), f64::from(j) / f64::from(steps));
                let point = lattice.to_cells(corner(0) + (corner(1) - corner(0)) * s + (corner(2) - corner(0)) * t);
                let cell = lattice.holding(point);
                prop_assert!(touched[cell]);
                for (index, least) in nearest.iter_mut().enumerate().filter(|(index, _)| touched[*index]) {
                    let beyond = ((point - lattice.centre(index)).abs() - 0.5).max(DVec3::ZERO).length();
                    *least = least.min(beyond);
                }
            }
            // The points lie at most so far apart, in cells.
            let gap = 20.0 * 1.5 / f64::from(steps);
            prop_assert!((0..lattice.count()).all(|index| !touched[index] || nearest[index] < gap));
        }
    }

    #[test]
    fn a_sphere_encloses_its_inside() {
        let mesh = sphere(DVec3::ZERO, 0.5, 40);
        let lattice = Lattice::around(&mesh, 40).unwrap();
        let touched = lattice.surface(&mesh);
        let mut reached = vec![false; lattice.count()];
        let mut work = vec![lattice.holding(lattice.to_cells(DVec3::ZERO))];
        // Each cell enters the list at most 26 times.
        while let Some(cell) = work.pop() {
            assert!(!lattice.is_outermost(cell), "the inside leaks");
            if touched[cell] || std::mem::replace(&mut reached[cell], true) {
                continue;
            }
            let [x, y, z] = lattice.place(cell);
            let around = (0..27).map(|code| [x + code / 9 - 1, y + code / 3 % 3 - 1, z + code % 3 - 1]);
            work.extend(around.map(|place| lattice.index(place)).filter(|&other| !reached[other]));
        }
        assert!(reached.iter().filter(|reached| **reached).count() > 20_000);
    }

    #[test]
    fn degenerate_shapes_are_survived() {
        for mesh in degenerate() {
            if let Some(lattice) = Lattice::around(&mesh, 16) {
                lattice.surface(&mesh);
            }
        }
    }
}
