//! Skin weights over joints in the form that engines take. RigNet [Xu et al. 2020], Section 4.3, and what glTF asks of a skin.
//!
//! In: weights over bones `[V, B]`. Out: rows of influences `[V, ≤ N]`, on the working mesh or on the vertices that were
//! sent. Every row that leaves this file is as [`SkinWeights`] promises: not empty, joints distinct, weights above zero and
//! descending, sum 1 within 2e-7 per influence.
//! # Departures from the published code
//! - A joint with several children keeps all the weights of the bones that leave it; theirs hands them to copies of the joint.
//! - Influences are capped; theirs are not.
//! - A vertex that no bone answers for follows its nearest bone, and is counted.

use super::bone_features::NEAREST_BONES;
use super::bone_weights::BoneWeights;
use super::skeleton::Bone;
use super::{Influence, SkinWeights};
use crate::geometry::transfer::Blend;
use rayon::prelude::*;

/// What is cut off a row of influences.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trim {
    /// Joints per vertex at most; the heaviest always stays.
    pub max_influences: usize,
    /// Weights below this share of the row are dropped.
    pub weight_min: f64,
}

impl Trim {
    /// Smaller weights are dropped unless another limit is asked for: no eye sees a thousandth of a motion, and tools show
    /// them as dirt.
    pub const WEIGHT_MIN: f64 = 1e-3;

    /// Four joints per vertex, which every engine takes.
    pub const USUAL: Self = Self { max_influences: 4, weight_min: Self::WEIGHT_MIN };
}

impl SkinWeights {
    /// Hands each bone's weight to its start joint. Also returns how many vertices had no weight and follow the nearest
    /// bone instead.
    ///
    /// `nearest` `[V, K]` is [`super::bone_features::BoneFeatures::nearest`].
    pub fn from_bones(weights: &BoneWeights, bones: &[Bone], nearest: &[u32], trim: Trim) -> (Self, usize) {
        let rows: Vec<(Vec<Influence>, bool)> = (0..weights.vertex_count())
            .into_par_iter()
            .map(|vertex| {
                let over_bones = weights.row(vertex).iter().zip(bones).filter(|(weight, _)| **weight > 0.0);
                let shares = over_bones.map(|(&weight, bone)| (bone.start_joint as u32, f64::from(weight))).collect();
                match influences(shares, trim) {
                    Some(row) => (row, false),
                    None => {
                        let bone = nearest.get(vertex * NEAREST_BONES).and_then(|&bone| bones.get(bone as usize));
                        (whole(bone.map_or(0, |bone| bone.start_joint as u32)), true)
                    }
                }
            })
            .collect();
        let filled = rows.iter().filter(|(_, filled)| *filled).count();
        (Self { rows: rows.into_iter().map(|(row, _)| row).collect() }, filled)
    }

    /// Weights for vertices that lie on this mesh's surface: each row blends three rows of this skin. `[V original]`
    pub fn transferred(&self, blends: &[Blend], trim: Trim) -> Self {
        let rows = blends.par_iter().map(|blend| {
            let parts = blend.iter().filter_map(|&(vertex, share)| Some((self.rows.get(vertex as usize)?, share)));
            let shares = parts.filter(|(_, share)| *share > 0.0).flat_map(|(row, share)| {
                row.iter().map(move |influence| (influence.joint, share * f64::from(influence.weight)))
            });
            influences(shares.collect(), trim)
                .or_else(|| self.rows.get(blend[0].0 as usize).cloned())
                .unwrap_or_else(|| whole(0))
        });
        Self { rows: rows.collect() }
    }

    /// The most influences that any vertex has.
    pub fn max_influences(&self) -> usize {
        self.rows.iter().map(Vec::len).max().unwrap_or(0)
    }
}

fn whole(joint: u32) -> Vec<Influence> {
    vec![Influence { joint, weight: 1.0 }]
}

/// A finished row from shares of joints, which may repeat: the heaviest that `trim` leaves, scaled to sum 1. `None` without
/// any weight.
fn influences(shares: Vec<(u32, f64)>, trim: Trim) -> Option<Vec<Influence>> {
    let mut shares = heaviest_first(shares);
    let count = kept_count(&shares, trim)?;
    shares.truncate(count);
    Some(scaled(&shares))
}

/// Shares with each joint once, descending; ties by ascending joint.
pub(super) fn heaviest_first(mut shares: Vec<(u32, f64)>) -> Vec<(u32, f64)> {
    shares.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    shares.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        if same {
            kept.1 += next.1;
        }
        same
    });
    shares.sort_by(|a, b| b.1.total_cmp(&a.1));
    shares
}

/// How many of the descending `shares` stay, at least one; `None` without any weight.
pub(super) fn kept_count(shares: &[(u32, f64)], trim: Trim) -> Option<usize> {
    let whole: f64 = shares.iter().map(|share| share.1).sum();
    let is_weight = whole.is_finite() && whole > 0.0;
    let kept = || shares.iter().take_while(|share| share.1 > 0.0 && share.1 >= trim.weight_min * whole).count();
    is_weight.then(|| kept().min(trim.max_influences).max(1))
}

/// A row of sum 1 from descending shares above zero.
pub(super) fn scaled(shares: &[(u32, f64)]) -> Vec<Influence> {
    let kept: f64 = shares.iter().map(|share| share.1).sum();
    let mut row: Vec<Influence> =
        shares.iter().map(|&(joint, share)| Influence { joint, weight: (share / kept) as f32 }).collect();
    // The heaviest takes the rounding of the others, so that a sum in 32 bits is 1.
    let others: f64 = row[1..].iter().map(|influence| f64::from(influence.weight)).sum();
    row[0].weight = (1.0 - others) as f32;
    row.sort_by(|a, b| b.weight.total_cmp(&a.weight).then(a.joint.cmp(&b.joint)));
    row
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use proptest::prelude::*;

    fn bone(start_joint: usize, end_joint: usize) -> Bone {
        Bone { start: DVec3::ZERO, end: DVec3::ZERO, start_joint, end_joint }
    }

    fn keeps_promises(row: &[Influence], max_influences: usize) -> bool {
        let sum: f32 = row.iter().map(|influence| influence.weight).sum();
        let distinct: std::collections::BTreeSet<u32> = row.iter().map(|influence| influence.joint).collect();
        !row.is_empty()
            && row.len() <= max_influences.max(1)
            && distinct.len() == row.len()
            && row.iter().all(|influence| influence.weight > 0.0)
            && row.windows(2).all(|pair| pair[0].weight >= pair[1].weight)
            && (sum - 1.0).abs() <= 2e-7 * row.len() as f32
    }

    #[test]
    fn bones_that_leave_one_joint_are_added_up() {
        let weights = BoneWeights { bone_count: 3, values: vec![0.3, 0.3, 0.4] };
        let bones = [bone(0, 1), bone(0, 2), bone(2, 2)];
        let (skin, filled) = SkinWeights::from_bones(&weights, &bones, &[0; 5], Trim::USUAL);
        assert_eq!(filled, 0);
        assert_eq!(skin.rows[0].iter().map(|influence| influence.joint).collect::<Vec<_>>(), [0, 2]);
        assert!((skin.rows[0][0].weight - 0.6).abs() < 1e-6);
    }

    #[test]
    fn a_vertex_without_weights_follows_the_nearest_bone_and_is_counted() {
        let weights = BoneWeights { bone_count: 2, values: vec![0.0, 0.0, 1.0, 0.0] };
        let bones = [bone(0, 1), bone(1, 1)];
        let (skin, filled) = SkinWeights::from_bones(&weights, &bones, &[1, 0, 1, 1, 1, 0, 1, 0, 0, 0], Trim::USUAL);
        assert_eq!((skin.rows[0].as_slice(), filled), (whole(1).as_slice(), 1));
    }

    #[test]
    fn a_vertex_at_a_corner_takes_that_corners_row() {
        let skin = SkinWeights { rows: vec![whole(3), whole(5), whole(7)] };
        let there = skin.transferred(&[[(1, 1.0), (0, 0.0), (2, 0.0)], [(0, 0.25), (1, 0.75), (2, 0.0)]], Trim::USUAL);
        assert_eq!(there.rows[0], whole(5));
        assert_eq!(there.rows[1].iter().map(|i| (i.joint, i.weight)).collect::<Vec<_>>(), [(5, 0.75), (3, 0.25)]);
    }

    #[test]
    fn a_blend_of_nothing_takes_its_first_vertex() {
        let skin = SkinWeights { rows: vec![whole(3)] };
        assert_eq!(skin.transferred(&[[(0, 0.0), (0, 0.0), (0, 0.0)]], Trim::USUAL).rows[0], whole(3));
    }

    proptest! {
        #[test]
        fn every_row_is_what_engines_expect(
            shares in prop::collection::vec((0..9u32, 0.0..1.0f64), 1..30), max_influences in 0..9usize,
            weight_min in 0.0..0.6f64,
        ) {
            if let Some(row) = influences(shares, Trim { max_influences, weight_min }) {
                prop_assert!(keeps_promises(&row, max_influences), "{row:?}");
            }
        }

        #[test]
        fn transferred_rows_are_what_engines_expect(
            shares in prop::collection::vec(prop::collection::vec((0..9u32, 0.01..1.0f64), 1..9), 3), u in 0.0..1.0f64, v in 0.0..1.0f64,
        ) {
            let skin = SkinWeights { rows: shares.into_iter().filter_map(|row| influences(row, Trim { max_influences: 8, ..Trim::USUAL })).collect() };
            let blend = [(0, u * (1.0 - v)), (1, u * v), (2, 1.0 - u)];
            prop_assert!(keeps_promises(&skin.transferred(&[blend], Trim::USUAL).rows[0], 4));
        }
    }
}
