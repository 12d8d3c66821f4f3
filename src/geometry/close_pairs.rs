//! All pairs of points nearer to each other than a radius, on a grid of cells as wide as the radius.
//!
//! | in          | shape    | unit      |
//! |-------------|----------|-----------|
//! | `positions` | `[N, 3]` | any space |
//!
//! Only occupied cells take memory, so the extent does not matter; time grows with the points and the pairs.

use glam::{DVec3, IVec3};

/// Calls `on_pair(i, j, squared distance)` once for every pair within `radius` (above zero), in an order that depends on
/// the points alone.
pub fn for_each_close_pair(positions: &[DVec3], radius: f64, mut on_pair: impl FnMut(u32, u32, f64)) {
    let Some((low, high)) = crate::mesh::bounding_box(positions) else { return };
    // Cell coordinates stay below 2^20, so that a key holds three of them.
    let width = radius.max((high - low).max_element() / f64::from(1 << 19));
    let cell_of = |position: DVec3| ((position - low) / width).as_ivec3() + IVec3::ONE;
    let mut items: Vec<(u64, u32)> = positions.iter().map(|&position| key(cell_of(position))).zip(0..).collect();
    items.sort_unstable();
    let places: Vec<DVec3> = items.iter().map(|&(_, index)| positions[index as usize]).collect();
    let limit = radius * radius;
    let mut start = 0;
    for cell in items.chunk_by(|a, b| a.0 == b.0) {
        let end = start + cell.len();
        let here = cell.first().map_or(IVec3::ZERO, |&(_, index)| cell_of(positions[index as usize]));
        // The cells behind this one in the order of keys: the rest of its row, and four rows of three.
        let rows = ROWS_BEHIND.map(|step| {
            let row = here + IVec3::new(step[0], step[1], 0);
            let first = items.partition_point(|&(other, _)| other < key(row - IVec3::Z));
            let behind = items[first..].partition_point(|&(other, _)| other <= key(row + IVec3::Z));
            first..first + behind
        });
        let next = end + items[end..].partition_point(|&(other, _)| other <= key(here + IVec3::Z));
        for at in start..end {
            for other in (at + 1..next).chain(rows.iter().cloned().flatten()) {
                let squared = places[at].distance_squared(places[other]);
                if squared <= limit {
                    on_pair(items[at].1, items[other].1, squared);
                }
            }
        }
        start = end;
    }
}

const ROWS_BEHIND: [[i32; 2]; 4] = [[0, 1], [1, -1], [1, 0], [1, 1]];

/// Orders cells by x, then y, then z.
fn key(cell: IVec3) -> u64 {
    ((cell.x as u64) << 42) + ((cell.y as u64) << 21) + cell.z as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    proptest! {
        #[test]
        fn every_close_pair_comes_once_and_no_other(
            points in prop::collection::vec((-9..9i8, -9..9i8, -9..9i8), 0..80), radius in 0.5..6.0f64,
        ) {
            let points: Vec<DVec3> =
                points.into_iter().map(|(x, y, z)| DVec3::new(f64::from(x), f64::from(y), f64::from(z)) * 0.7).collect();
            let mut found: BTreeMap<(u32, u32), usize> = BTreeMap::new();
            for_each_close_pair(&points, radius, |i, j, squared| {
                assert_eq!(points[i as usize].distance_squared(points[j as usize]), squared);
                *found.entry((i.min(j), i.max(j))).or_default() += 1;
            });
            let mut all = BTreeMap::new();
            for i in 0..points.len() {
                for j in i + 1..points.len() {
                    if points[i].distance_squared(points[j]) <= radius * radius {
                        all.insert((i as u32, j as u32), 1);
                    }
                }
            }
            prop_assert_eq!(found, all);
        }
    }
}
