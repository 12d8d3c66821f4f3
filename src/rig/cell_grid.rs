//! Weighted sums over the neighbours of every point, for kernels that vanish beyond a radius.
//!
//! | in        | shape    | unit                                        |
//! |-----------|----------|---------------------------------------------|
//! | `points`  | `[M, 3]` | any space, finite                           |
//! | `weights` | `[M]`    | not negative                                |
//! | `radius`  | scalar   | as the points; the side of a cell           |
//!
//! Points are sorted into cubic cells whose side is half the radius, so all neighbours of a point lie in the 125 cells around
//! its own: 25 runs of the sorted order, since cells are sorted by x, y, z. Cost grows with the number of neighbouring
//! pairs, not with M². Only occupied cells are stored. Every sum runs over its neighbours in sorted order (cell, then
//! index), so results are the same for any number of threads.

use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// The quadratic kernel `max(radius² − ‖p − q‖², 0)` summed around one point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct KernelSum {
    /// Σ weight · kernel
    pub mass: f64,
    /// Σ weight · kernel · position
    pub moment: DVec3,
}

/// For each of the first `count` points the sum over all points (itself included) of weight times the quadratic kernel.
pub(super) fn kernel_sums(points: &[DVec3], weights: &[f64], radius: f64, count: usize) -> Vec<KernelSum> {
    debug_assert_eq!(points.len(), weights.len());
    let grid = CellGrid::new(points, weights, radius);
    let by_cell: Vec<Vec<(u32, KernelSum)>> = grid.cells.par_iter().map(|cell| grid.sums_in(cell, count)).collect();
    let mut sums = vec![KernelSum::default(); count];
    for (point, sum) in by_cell.into_iter().flatten() {
        sums[point as usize] = sum;
    }
    sums
}

type CellKey = [i64; 3];

struct Cell {
    key: CellKey,
    /// Its points, in the sorted order.
    members: Range<usize>,
}

/// Points in sorted order, one array per coordinate so that loops over neighbours become vector instructions.
struct CellGrid {
    squared_radius: f64,
    /// Sorted place → original index.
    order: Vec<u32>,
    cells: Vec<Cell>,
    x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
    weight: Vec<f64>,
}

/// Sums are kept in this many lanes, which are added up in a fixed order at the end.
const LANES: usize = 4;
/// Sides of a cell in one radius.
const CELLS_PER_RADIUS: i64 = 2;

impl CellGrid {
    fn new(points: &[DVec3], weights: &[f64], radius: f64) -> Self {
        let mut keyed: Vec<(CellKey, u32)> = points
            .iter()
            .zip(0..)
            .map(|(point, index)| (cell_of(*point, radius / CELLS_PER_RADIUS as f64), index))
            .collect();
        keyed.sort_unstable();
        let mut cells: Vec<Cell> = Vec::new();
        for (place, (key, _)) in keyed.iter().enumerate() {
            match cells.last_mut() {
                Some(cell) if cell.key == *key => cell.members.end = place + 1,
                _ => cells.push(Cell { key: *key, members: place..place + 1 }),
            }
        }
        let order: Vec<u32> = keyed.into_iter().map(|(_, index)| index).collect();
        let sorted = |value: &dyn Fn(usize) -> f64| order.iter().map(|&index| value(index as usize)).collect();
        Self {
            squared_radius: radius * radius,
            cells,
            x: sorted(&|index| points[index].x),
            y: sorted(&|index| points[index].y),
            z: sorted(&|index| points[index].z),
            weight: sorted(&|index| weights[index]),
            order,
        }
    }

    /// Sums for those members of one cell that are among the first `count` points, with their index.
    fn sums_in(&self, cell: &Cell, count: usize) -> Vec<(u32, KernelSum)> {
        let asked = |place: &usize| (self.order[*place] as usize) < count;
        if !cell.members.clone().any(|place| asked(&place)) {
            return Vec::new();
        }
        let runs = self.runs_around(cell.key);
        let sum = |place: usize| (self.order[place], self.sum_at([self.x[place], self.y[place], self.z[place]], &runs));
        cell.members.clone().filter(asked).map(sum).collect()
    }

    /// The sorted places of all points within [`CELLS_PER_RADIUS`] cells of `key`, as at most 25 runs.
    fn runs_around(&self, [x, y, z]: CellKey) -> Vec<Range<usize>> {
        const REACH: i64 = CELLS_PER_RADIUS;
        let mut runs = Vec::with_capacity((2 * REACH as usize + 1).pow(2));
        for (dx, dy) in (-REACH..=REACH).flat_map(|dx| (-REACH..=REACH).map(move |dy| (dx, dy))) {
            let first = self.cells.partition_point(|cell| cell.key < [x + dx, y + dy, z - REACH]);
            let last = [x + dx, y + dy, z + REACH];
            let after = first + self.cells[first..].iter().take_while(|cell| cell.key <= last).count();
            if after > first {
                runs.push(self.cells[first].members.start..self.cells[after - 1].members.end);
            }
        }
        runs
    }

    fn sum_at(&self, [x, y, z]: [f64; 3], runs: &[Range<usize>]) -> KernelSum {
        let (mut mass, mut mx, mut my, mut mz) = ([0.0; LANES], [0.0; LANES], [0.0; LANES], [0.0; LANES]);
        let mut add = |lane: usize, qx: f64, qy: f64, qz: f64, weight: f64| {
            let squared = (qx - x) * (qx - x) + (qy - y) * (qy - y) + (qz - z) * (qz - z);
            let share = (self.squared_radius - squared).max(0.0) * weight;
            mass[lane] += share;
            mx[lane] += share * qx;
            my[lane] += share * qy;
            mz[lane] += share * qz;
        };
        for run in runs {
            let (xs, ys) = (self.x[run.clone()].chunks_exact(LANES), self.y[run.clone()].chunks_exact(LANES));
            let (zs, ws) = (self.z[run.clone()].chunks_exact(LANES), self.weight[run.clone()].chunks_exact(LANES));
            let rest = (xs.remainder(), ys.remainder(), zs.remainder(), ws.remainder());
            for (((qx, qy), qz), weight) in xs.zip(ys).zip(zs).zip(ws) {
                for lane in 0..LANES {
                    add(lane, qx[lane], qy[lane], qz[lane], weight[lane]);
                }
            }
            for lane in 0..rest.0.len() {
                add(lane, rest.0[lane], rest.1[lane], rest.2[lane], rest.3[lane]);
            }
        }
        let total = |lanes: [f64; LANES]| (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]);
        KernelSum { mass: total(mass), moment: DVec3::new(total(mx), total(my), total(mz)) }
    }
}

fn cell_of(point: DVec3, radius: f64) -> CellKey {
    (point / radius).floor().to_array().map(|index| index as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on a bent line through many cells, some coincident, some alone in a cell.
    fn scattered(count: usize) -> (Vec<DVec3>, Vec<f64>) {
        let points = (0..count).map(|k| {
            let t = (k * 7919 % count) as f64 / count as f64;
            DVec3::new((9.0 * t).sin(), 2.0 * t - 1.0, (5.0 * t).cos() * t)
        });
        (points.collect(), (0..count).map(|k| (k % 5) as f64 * 0.25).collect())
    }

    #[test]
    fn cells_give_the_sums_over_all_pairs() {
        let (points, weights) = scattered(500);
        for radius in [0.003, 0.05, 0.4, 5.0] {
            for (point, sum) in points.iter().zip(kernel_sums(&points, &weights, radius, points.len())) {
                let kernel = |q: &DVec3| (radius * radius - point.distance_squared(*q)).max(0.0);
                let mass: f64 = points.iter().zip(&weights).map(|(q, w)| kernel(q) * w).sum();
                let moment: DVec3 = points.iter().zip(&weights).map(|(q, w)| *q * kernel(q) * *w).sum();
                assert!((sum.mass - mass).abs() <= 1e-12 * (1.0 + mass));
                assert!((sum.moment - moment).length() <= 1e-12 * (1.0 + mass));
            }
        }
    }

    #[test]
    fn one_thread_and_three_give_the_same_bits() {
        let (points, weights) = scattered(700);
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
            pool.install(|| kernel_sums(&points, &weights, 0.1, 500))
        };
        assert_eq!(with(1), with(3));
    }
}
