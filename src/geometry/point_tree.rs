//! Nearest points among many: a balanced k-d tree [Bentley 1975], halved at the median of the widest axis.
//!
//! | in          | shape    | unit      |
//! |-------------|----------|-----------|
//! | `positions` | `[N, 3]` | any space |
//!
//! Equal distances are ordered by index, so answers depend on the points alone.

use glam::DVec3;

/// The tree. Its shape is implied by ranges: every range longer than a leaf is halved in the middle.
pub struct PointTree {
    /// Points in tree order.
    positions: Vec<DVec3>,
    /// `[N]`: index of each point as given.
    index: Vec<u32>,
    /// The halvings in depth-first order.
    cuts: Vec<Cut>,
}

/// Where a range is halved, and which halving is the first of its right half.
#[derive(Clone, Copy)]
struct Cut {
    axis: usize,
    place: f64,
    right: usize,
}

const LEAF_MAX: usize = 8;

impl PointTree {
    pub fn new(positions: &[DVec3]) -> Self {
        let mut items: Vec<(DVec3, u32)> = positions.iter().copied().zip(0..).collect();
        let mut cuts = Vec::with_capacity(2 * positions.len() / LEAF_MAX + 1);
        halve(&mut items, &mut cuts);
        Self {
            positions: items.iter().map(|item| item.0).collect(),
            index: items.iter().map(|item| item.1).collect(),
            cuts,
        }
    }

    /// Index and squared distance of the nearest point; `None` without points.
    pub fn nearest(&self, point: DVec3) -> Option<(u32, f64)> {
        let mut best = (f64::INFINITY, u32::MAX);
        self.visit(point, f64::INFINITY, &mut |index, squared| {
            best = if (squared, index) < best { (squared, index) } else { best };
            best.0
        });
        (best.1 != u32::MAX).then_some((best.1, best.0))
    }

    /// The `count` points nearest to point `index` (at `point`), itself left out: (squared distance, index), ascending.
    pub fn nearest_others(&self, index: u32, point: DVec3, count: usize, found: &mut Vec<(f64, u32)>) {
        found.clear();
        if count == 0 {
            return;
        }
        self.visit(point, f64::INFINITY, &mut |other, squared| {
            if other != index {
                let at = found.partition_point(|&known| known < (squared, other));
                if at < count {
                    found.truncate(count - 1);
                    found.insert(at, (squared, other));
                }
            }
            if found.len() == count { found[count - 1].0 } else { f64::INFINITY }
        });
    }

    /// Calls `on_point(index, squared distance)` for every point within `radius`.
    pub fn within(&self, point: DVec3, radius: f64, mut on_point: impl FnMut(u32, f64)) {
        let limit = radius * radius;
        self.visit(point, limit, &mut |index, squared| {
            on_point(index, squared);
            limit
        });
    }

    /// Visits points within the squared limit, near halves first; `on_point` returns the new limit.
    fn visit(&self, point: DVec3, limit: f64, on_point: &mut impl FnMut(u32, f64) -> f64) {
        let mut limit = limit;
        self.descend(0, self.positions.len(), 0, DVec3::ZERO, point, &mut limit, on_point);
    }

    /// `gap`: per axis the distance from the point to this range's half space.
    #[allow(clippy::too_many_arguments)] // one recursion, all of it state
    fn descend(
        &self,
        start: usize,
        end: usize,
        cut: usize,
        gap: DVec3,
        point: DVec3,
        limit: &mut f64,
        on_point: &mut impl FnMut(u32, f64) -> f64,
    ) {
        if end - start <= LEAF_MAX {
            for at in start..end {
                let squared = self.positions[at].distance_squared(point);
                if squared <= *limit {
                    *limit = on_point(self.index[at], squared);
                }
            }
            return;
        }
        let middle = start.midpoint(end);
        let Cut { axis, place, right } = self.cuts[cut];
        let signed = point[axis] - place;
        let left = (start, middle, cut + 1);
        let right = (middle, end, right);
        let (near, far) = if signed < 0.0 { (left, right) } else { (right, left) };
        self.descend(near.0, near.1, near.2, gap, point, limit, on_point);
        let mut beyond = gap;
        beyond[axis] = signed.abs();
        if beyond.length_squared() <= *limit {
            self.descend(far.0, far.1, far.2, beyond, point, limit, on_point);
        }
    }
}

fn halve(items: &mut [(DVec3, u32)], cuts: &mut Vec<Cut>) {
    if items.len() <= LEAF_MAX {
        return;
    }
    let low = items.iter().fold(DVec3::INFINITY, |low, item| low.min(item.0));
    let high = items.iter().fold(DVec3::NEG_INFINITY, |high, item| high.max(item.0));
    let axis = (high - low).max_position();
    let middle = items.len() / 2;
    items.select_nth_unstable_by(middle, |a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1)));
    let own = cuts.len();
    cuts.push(Cut { axis, place: items[middle].0[axis], right: 0 });
    let (left, right) = items.split_at_mut(middle);
    halve(left, cuts);
    cuts[own].right = cuts.len();
    halve(right, cuts);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Few distinct coordinates, so that equal distances and coincident points are common.
    fn points() -> impl Strategy<Value = Vec<DVec3>> {
        prop::collection::vec((0..6u8, 0..6u8, 0..6u8), 1..120)
            .prop_map(|all| all.into_iter().map(|(x, y, z)| DVec3::new(x.into(), y.into(), z.into())).collect())
    }

    proptest! {
        #[test]
        fn the_tree_answers_as_a_sort_of_all_points_does(points in points(), x in 0.0..6.0f64, count in 0..7usize) {
            let tree = PointTree::new(&points);
            let probe = DVec3::new(x.round(), x, 2.0);
            let mut all: Vec<(f64, u32)> = points.iter().map(|p| p.distance_squared(probe)).zip(0..).collect();
            all.sort_by(|a, b| a.partial_cmp(b).unwrap());
            prop_assert_eq!(tree.nearest(probe), Some((all[0].1, all[0].0)));
            let mut found = Vec::new();
            tree.nearest_others(3, probe, count, &mut found);
            let others: Vec<(f64, u32)> = all.iter().copied().filter(|&(_, index)| index != 3).take(count).collect();
            prop_assert_eq!(&found, &others);
            let mut within = Vec::new();
            tree.within(probe, 2.0, |index, squared| within.push((squared, index)));
            within.sort_by(|a, b| a.partial_cmp(b).unwrap());
            all.retain(|&(squared, _)| squared <= 4.0);
            prop_assert_eq!(within, all);
        }
    }

    #[test]
    fn no_points_have_no_nearest() {
        assert_eq!(PointTree::new(&[]).nearest(DVec3::ZERO), None);
    }
}
