//! Joints connected into a tree: the cheapest one that spans them. RigNet [Xu et al. 2020], Section 4.2; the algorithm is
//! Prim's [1957], dense, from the root outward.
//!
//! | in            | shape    | unit                                              |
//! |---------------|----------|---------------------------------------------------|
//! | `pairs`       | `[P, 2]` | joint indices; the bone network's candidates      |
//! | `probability` | `[P]`    | 0 to 1                                            |
//! | `outside`     | `[P]`    | samples of the segment that are not inside        |
//!
//! # Departures from the paper
//! - Costs are at least [`COST_MIN`]. The published code takes only costs above zero for edges, so that its most certain
//!   bones (probability 1 in 32 bits) are missing from the graph.
//! - [`OutsideRule::Add`] is ours: the published code *replaces* the cost of a bone that leaves the shape, which makes a very
//!   unlikely bone cheaper. [`OutsideRule::Replace`] is kept for comparison with it.
//! - A pair without a probability costs [`COST_MAX`] and is an edge all the same, so every joint is reached: the published
//!   procedure fails when one is not.

use super::symmetrize::{Side, twins};
use glam::DVec3;

/// No bone is cheaper.
pub const COST_MIN: f64 = 1e-6;
/// No bone is dearer before the outside penalty: −ln(1e-10).
pub const COST_MAX: f64 = 23.025850929940457;
/// Keeps the logarithm finite (published value).
const PROBABILITY_FLOOR: f64 = 1e-10;
/// Cost per outside sample (published value).
const OUTSIDE_COST: f64 = 2.0;
/// One sample may be outside without penalty (published value): joints near the surface round to either side.
const OUTSIDE_FREE: usize = 1;
/// Bones within the symmetry plane are favoured by this factor (published value).
const MIDDLE_FACTOR: f64 = 0.5;

/// What happens to the cost of a bone that leaves the shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutsideRule {
    /// cost + 2 · outside samples.
    Add,
    /// 2 · outside samples, whatever the cost was (published).
    Replace,
}

/// Symmetric costs between joints, `[J, J]` row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct BoneCosts {
    joint_count: usize,
    costs: Vec<f64>,
}

impl BoneCosts {
    /// `−ln(p + 1e-10)` within [[`COST_MIN`], [`COST_MAX`]].
    pub fn from_probabilities(joint_count: usize, pairs: &[[usize; 2]], probability: &[f64]) -> Self {
        let mut costs = Self { joint_count, costs: vec![COST_MAX; joint_count * joint_count] };
        for (&[a, b], &p) in pairs.iter().zip(probability) {
            let cost = -(p + PROBABILITY_FLOOR).ln();
            costs.set(a, b, if cost.is_nan() { COST_MAX } else { cost.clamp(COST_MIN, COST_MAX) });
        }
        costs
    }

    /// Costs as given, `[J, J]` row-major and symmetric; raised to [`COST_MIN`].
    pub fn from_matrix(joint_count: usize, costs: &[f64]) -> Self {
        Self { joint_count, costs: costs.iter().map(|&cost| cost.max(COST_MIN)).collect() }
    }

    pub fn joint_count(&self) -> usize {
        self.joint_count
    }

    pub fn between(&self, a: usize, b: usize) -> f64 {
        self.costs[a * self.joint_count + b]
    }

    fn set(&mut self, a: usize, b: usize, cost: f64) {
        self.costs[a * self.joint_count + b] = cost;
        self.costs[b * self.joint_count + a] = cost;
    }

    /// Penalises bones of which more than one sample is outside, then halves the cost of bones between middle joints
    /// (where `sides` are known).
    pub fn correct(&mut self, pairs: &[[usize; 2]], outside: &[usize], sides: Option<&[Side]>, rule: OutsideRule) {
        for (&[a, b], &outside) in pairs.iter().zip(outside) {
            let mut cost = self.between(a, b);
            if outside > OUTSIDE_FREE {
                let penalty = OUTSIDE_COST * outside as f64;
                cost = match rule {
                    OutsideRule::Add => cost + penalty,
                    OutsideRule::Replace => penalty,
                };
            }
            if sides.is_some_and(|sides| sides[a] == Side::Middle && sides[b] == Side::Middle) {
                cost *= MIDDLE_FACTOR;
            }
            self.set(a, b, cost.max(COST_MIN));
        }
    }
}

/// A rooted tree over joints.
#[derive(Clone, Debug, PartialEq)]
pub struct Tree {
    pub root: usize,
    /// `[J]`, `None` for the root alone.
    pub parents: Vec<Option<usize>>,
    /// `[J]`: the cost at which each joint was reached; 0 for the root.
    pub keys: Vec<f64>,
}

/// The cheapest tree, grown from `root`; ties go to the lowest index. O(J²).
pub fn minimum_spanning_tree(costs: &BoneCosts, root: usize) -> Tree {
    let mut growth = Growth::new(costs, root);
    while let Some(joint) = growth.cheapest() {
        growth.take(joint);
    }
    growth.into_tree(root)
}

/// The same for joints with mirror twins: a joint on a side brings its twin along, hung from the twin of its parent (or
/// from the same parent, if that is in the middle), so that left and right have the same tree.
///
/// Grows from [`middle_root`]; without any middle joint the root stays, and its twin is its first child. A middle joint
/// that is reached through a side joint hangs from one side only.
pub fn symmetric_spanning_tree(costs: &BoneCosts, positions: &[DVec3], sides: &[Side], root: usize) -> Tree {
    let twins = twins(sides);
    let root = middle_root(positions, sides, root);
    let mut growth = Growth::new(costs, root);
    while let Some(joint) = growth.cheapest() {
        growth.take(joint);
        let twin = twins[joint];
        if growth.taken[twin] {
            continue;
        }
        // The twin of a parent was taken with it, so it is in the tree already.
        let twin_parent = growth.parents[joint].map_or(joint, |parent| twins[parent]);
        growth.parents[twin] = Some(twin_parent);
        growth.keys[twin] = costs.between(twin_parent, twin);
        growth.take(twin);
    }
    growth.into_tree(root)
}

/// `root` if it is a middle joint, else the middle joint nearest to it (the lowest index of equals); `root` if there is none.
pub fn middle_root(positions: &[DVec3], sides: &[Side], root: usize) -> usize {
    if sides[root] == Side::Middle {
        return root;
    }
    let distance = |joint: &usize| positions[*joint].distance_squared(positions[root]);
    (0..sides.len())
        .filter(|&joint| sides[joint] == Side::Middle)
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        .unwrap_or(root)
}

/// Prim's tree while it grows.
struct Growth<'a> {
    costs: &'a BoneCosts,
    taken: Vec<bool>,
    parents: Vec<Option<usize>>,
    keys: Vec<f64>,
}

impl<'a> Growth<'a> {
    fn new(costs: &'a BoneCosts, root: usize) -> Self {
        let joint_count = costs.joint_count();
        let mut keys = vec![f64::INFINITY; joint_count];
        keys[root] = 0.0;
        Self { costs, taken: vec![false; joint_count], parents: vec![None; joint_count], keys }
    }

    /// The joint that costs least to reach; `None` once all are taken.
    fn cheapest(&self) -> Option<usize> {
        (0..self.keys.len()).filter(|&joint| !self.taken[joint]).min_by(|&a, &b| self.keys[a].total_cmp(&self.keys[b]))
    }

    fn take(&mut self, joint: usize) {
        self.taken[joint] = true;
        for other in 0..self.keys.len() {
            let cost = self.costs.between(joint, other);
            if !self.taken[other] && cost < self.keys[other] {
                self.keys[other] = cost;
                self.parents[other] = Some(joint);
            }
        }
    }

    fn into_tree(self, root: usize) -> Tree {
        Tree { root, parents: self.parents, keys: self.keys }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Costs of all pairs from a list of numbers in (0, 1).
    fn costs(joint_count: usize, numbers: &[f64]) -> BoneCosts {
        let pairs: Vec<[usize; 2]> = (0..joint_count).flat_map(|a| (a + 1..joint_count).map(move |b| [a, b])).collect();
        let probability: Vec<f64> = (0..pairs.len()).map(|k| numbers[k % numbers.len()]).collect();
        BoneCosts::from_probabilities(joint_count, &pairs, &probability)
    }

    fn reaches_root(tree: &Tree) -> bool {
        (0..tree.parents.len()).all(|start| {
            let mut joint = start;
            for _ in 0..tree.parents.len() {
                match tree.parents[joint] {
                    Some(parent) => joint = parent,
                    None => return joint == tree.root,
                }
            }
            false
        })
    }

    #[test]
    fn a_certain_bone_is_an_edge() {
        let costs = BoneCosts::from_probabilities(3, &[[0, 1], [0, 2], [1, 2]], &[1.0, 0.4, 0.5]);
        assert_eq!(costs.between(0, 1), COST_MIN);
        assert_eq!(minimum_spanning_tree(&costs, 0).parents, [None, Some(0), Some(1)]);
    }

    #[test]
    fn a_probability_that_is_no_number_is_no_recommendation() {
        let costs = BoneCosts::from_probabilities(2, &[[0, 1]], &[f64::NAN]);
        assert_eq!(costs.between(0, 1), COST_MAX);
    }

    #[test]
    fn leaving_the_shape_never_makes_a_bone_cheaper() {
        let pairs = [[0, 1]];
        let unlikely = BoneCosts::from_probabilities(2, &pairs, &[1e-9]);
        let corrected = |rule| {
            let mut costs = unlikely.clone();
            costs.correct(&pairs, &[3], None, rule);
            costs.between(0, 1)
        };
        assert!(corrected(OutsideRule::Add) > unlikely.between(0, 1));
        assert_eq!(corrected(OutsideRule::Replace), 6.0);
    }

    #[test]
    fn one_sample_outside_is_free_and_middle_bones_cost_half() {
        let pairs = [[0, 1]];
        let plain = BoneCosts::from_probabilities(2, &pairs, &[0.5]);
        let mut costs = plain.clone();
        costs.correct(&pairs, &[1], Some(&[Side::Middle, Side::Middle]), OutsideRule::Add);
        assert_eq!(costs.between(1, 0), 0.5 * plain.between(0, 1));
    }

    #[test]
    fn without_middle_joints_the_symmetric_tree_still_spans() {
        let sides = [Side::Negative, Side::Negative, Side::Negative, Side::Positive, Side::Positive, Side::Positive];
        let positions: Vec<DVec3> = (0..6).map(|k| DVec3::splat(f64::from(k))).collect();
        for root in 0..6 {
            let tree = symmetric_spanning_tree(&costs(6, &[0.3, 0.9, 0.2, 0.8]), &positions, &sides, root);
            assert!(reaches_root(&tree), "{tree:?}");
            assert_eq!(tree.parents[twins(&sides)[root]], Some(root));
        }
    }

    proptest! {
        #[test]
        fn the_tree_spans_and_no_swap_of_one_edge_makes_it_cheaper(
            numbers in prop::collection::vec(0.0..1.0f64, 28), root in 0..8usize,
        ) {
            let costs = costs(8, &numbers);
            let tree = minimum_spanning_tree(&costs, root);
            prop_assert!(reaches_root(&tree));
            let total: f64 = tree.keys.iter().sum();
            for joint in 0..8 {
                for parent in 0..8 {
                    let mut swapped = tree.clone();
                    swapped.parents[joint] = Some(parent);
                    if joint != root && joint != parent && reaches_root(&swapped) {
                        let cost = total - tree.keys[joint] + costs.between(parent, joint);
                        prop_assert!(cost >= total - 1e-12);
                    }
                }
            }
        }

        #[test]
        fn side_joints_hang_as_their_twins_do(
            numbers in prop::collection::vec(0.0..1.0f64, 45), middle in 1..5usize, root in 0..10usize,
        ) {
            let half = (10 - middle) / 2;
            let middle = 10 - 2 * half;
            let sides = [vec![Side::Negative; half], vec![Side::Middle; middle], vec![Side::Positive; half]].concat();
            let positions: Vec<DVec3> = (0..10).map(|k| DVec3::splat(f64::from(k))).collect();
            let tree = symmetric_spanning_tree(&costs(10, &numbers), &positions, &sides, root);
            prop_assert!(reaches_root(&tree));
            prop_assert_eq!(sides[tree.root], Side::Middle);
            let twins = twins(&sides);
            for (joint, parent) in tree.parents.iter().enumerate() {
                if let Some(parent) = *parent && sides[joint] != Side::Middle && parent != twins[joint] {
                    let twin_parent = tree.parents[twins[joint]];
                    prop_assert!(twin_parent == Some(twins[parent]) || twin_parent == Some(joint));
                }
            }
        }
    }
}
