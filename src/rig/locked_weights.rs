//! Joints that keep the weights they had, while the others share what is left.
//!
//! | in          | shape       | meaning                                             |
//! |-------------|-------------|-----------------------------------------------------|
//! | skin        | `[V, ≤ N]`  | new weights                                         |
//! | `locks`     | `[V]`, `[J]`| old weights over the same joints, which of them stay |
//!
//! A locked joint has its old weight at every vertex, also where that is none. The rest of a vertex goes to the other joints in
//! the shares of the new weights; where these gave all to locked joints, in the shares of the old ones; and where there are none
//! either, to the nearest joint above that is not locked.

use super::skin_weights::{Trim, heaviest_first};
use super::{Influence, Skeleton, SkinWeights};
use rayon::prelude::*;

/// Old weights, and the joints that keep theirs.
#[derive(Clone, Copy, Debug)]
pub struct Locks<'a> {
    /// `[J]`
    pub joints: &'a [bool],
    /// `[V]`: each row of sum 1, or empty.
    pub rows: &'a [Vec<Influence>],
}

/// A vertex whose locked joints leave no room.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NoRoom {
    pub vertex: usize,
    /// Its locked joints, heaviest first.
    pub joints: Vec<u32>,
}

impl Locks<'_> {
    fn is_locked(&self, joint: u32) -> bool {
        self.joints.get(joint as usize).copied().unwrap_or(false)
    }
}

impl SkinWeights {
    /// The skin with the locked joints' weights as they were. Fails at the first vertex where they, with one more for the rest,
    /// are more than `trim` allows.
    pub fn with_locked(&self, locks: &Locks, skeleton: &Skeleton, trim: Trim) -> Result<Self, NoRoom> {
        let empty = Vec::new();
        let rows: Vec<Result<Vec<Influence>, NoRoom>> = (self.rows.par_iter().enumerate())
            .map(|(vertex, row)| {
                let old = locks.rows.get(vertex).unwrap_or(&empty);
                locked_row(row, old, locks, skeleton, trim).map_err(|joints| NoRoom { vertex, joints })
            })
            .collect();
        Ok(Self { rows: rows.into_iter().collect::<Result<_, _>>()? })
    }
}

fn locked_row(
    new: &[Influence],
    old: &[Influence],
    locks: &Locks,
    skeleton: &Skeleton,
    trim: Trim,
) -> Result<Vec<Influence>, Vec<u32>> {
    let locked: Vec<Influence> = old.iter().copied().filter(|influence| locks.is_locked(influence.joint)).collect();
    if locked.is_empty() && !new.iter().any(|influence| locks.is_locked(influence.joint)) {
        return Ok(new.to_vec());
    }
    let rest = 1.0 - locked.iter().map(|influence| f64::from(influence.weight)).sum::<f64>();
    let needs_more = rest >= trim.weight_min.max(f64::from(f32::EPSILON));
    if locked.len() + usize::from(needs_more) > trim.max_influences {
        return Err(locked.iter().map(|influence| influence.joint).collect());
    }
    let mut row = locked.clone();
    if needs_more {
        let others = others(new, old, locks, skeleton);
        row.extend(shared(&others, rest, trim, trim.max_influences - locked.len()));
    }
    row.sort_by(|a, b| b.weight.total_cmp(&a.weight).then(a.joint.cmp(&b.joint)));
    Ok(row)
}

/// Shares of the joints that are not locked.
fn others(new: &[Influence], old: &[Influence], locks: &Locks, skeleton: &Skeleton) -> Vec<(u32, f64)> {
    for row in [new, old] {
        let open = row.iter().filter(|influence| !locks.is_locked(influence.joint));
        let shares = heaviest_first(open.map(|open| (open.joint, f64::from(open.weight))).collect());
        if !shares.is_empty() {
            return shares;
        }
    }
    let above = |joint: &u32| skeleton.joints.get(*joint as usize)?.parent.map(|parent| parent as u32);
    let heaviest = new.first().or(old.first()).map(|influence| influence.joint);
    let on_the_way = std::iter::successors(heaviest, above).find(|&joint| !locks.is_locked(joint));
    // Where all above are locked too, any joint that is not.
    let any = || (0..skeleton.joints.len() as u32).find(|&joint| !locks.is_locked(joint));
    on_the_way.or_else(any).map(|joint| (joint, 1.0)).into_iter().collect()
}

/// The heaviest of `shares`, `count` at most, scaled to sum `whole`.
fn shared(shares: &[(u32, f64)], whole: f64, trim: Trim, count: usize) -> Vec<Influence> {
    let sum: f64 = shares.iter().map(|share| share.1).sum();
    let is_kept = |share: &&(u32, f64)| share.1 / sum * whole >= trim.weight_min;
    let kept = &shares[..shares.iter().take_while(is_kept).count().clamp(1.min(shares.len()), count)];
    let sum: f64 = kept.iter().map(|share| share.1).sum();
    let influence = |&(joint, share): &(u32, f64)| Influence { joint, weight: (share / sum * whole) as f32 };
    kept.iter().map(influence).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::Joint;
    use glam::DVec3;

    fn row(influences: &[(u32, f32)]) -> Vec<Influence> {
        influences.iter().map(|&(joint, weight)| Influence { joint, weight }).collect()
    }

    /// A chain of five joints, of which `locked` are locked.
    fn locked(new: &[(u32, f32)], old: &[(u32, f32)], locked: &[u32], max: usize) -> Result<Vec<Influence>, NoRoom> {
        let joint = |index: usize| Joint {
            name: format!("j{index}"),
            parent: index.checked_sub(1),
            position: DVec3::Y * index as f64,
        };
        let skeleton = Skeleton { joints: (0..5).map(joint).collect() };
        let joints: Vec<bool> = (0..5).map(|joint| locked.contains(&joint)).collect();
        let rows = [row(old)];
        let locks = Locks { joints: &joints, rows: &rows };
        let trim = Trim { max_influences: max, ..Trim::USUAL };
        let skin = SkinWeights { rows: vec![row(new)] };
        skin.with_locked(&locks, &skeleton, trim).map(|mut skin| skin.rows.remove(0))
    }

    #[track_caller]
    fn assert_row(found: Result<Vec<Influence>, NoRoom>, expected: &[(u32, f32)]) {
        let found = found.expect("room");
        let same = found.iter().zip(expected).all(|(a, b)| a.joint == b.0 && (a.weight - b.1).abs() < 1e-6);
        assert!(same && found.len() == expected.len(), "{found:?}");
    }

    #[test]
    fn locked_joints_keep_their_weights_and_the_others_share_the_rest() {
        let old = [(1, 0.6), (2, 0.4)];
        assert_row(locked(&[(3, 0.75), (2, 0.25)], &old, &[2], 4), &[(3, 0.6), (2, 0.4)]);
        assert_row(locked(&[(3, 0.5), (4, 0.5)], &old, &[2], 4), &[(2, 0.4), (3, 0.3), (4, 0.3)]);
        // Also where it had none.
        assert_row(locked(&[(3, 0.75), (2, 0.25)], &[(1, 1.0)], &[2], 4), &[(3, 1.0)]);
        assert_row(locked(&[(3, 0.75), (4, 0.25)], &[(1, 1.0)], &[2], 4), &[(3, 0.75), (4, 0.25)]);
    }

    #[test]
    fn what_the_new_weights_leave_open_goes_as_before_or_to_the_joint_above() {
        assert_row(locked(&[(2, 1.0)], &[(1, 0.75), (2, 0.25)], &[2], 4), &[(1, 0.75), (2, 0.25)]);
        assert_row(locked(&[(2, 1.0)], &[], &[2], 4), &[(1, 1.0)]);
        assert_row(locked(&[(2, 1.0)], &[], &[0, 1, 2], 4), &[(3, 1.0)]);
        assert_row(locked(&[(3, 1.0)], &[(2, 1.0)], &[2], 4), &[(2, 1.0)]);
    }

    #[test]
    fn fewer_joints_than_are_locked_are_refused() {
        let old = [(1, 0.4), (2, 0.3), (3, 0.3)];
        assert_eq!(locked(&[(4, 1.0)], &old, &[1, 2], 2), Err(NoRoom { vertex: 0, joints: vec![1, 2] }));
        assert_row(locked(&[(4, 0.6), (0, 0.4)], &old, &[1, 2], 3), &[(1, 0.4), (2, 0.3), (4, 0.3)]);
        assert_row(locked(&[(4, 1.0)], &old, &[1, 2, 3], 3), &[(1, 0.4), (2, 0.3), (3, 0.3)]);
    }
}
