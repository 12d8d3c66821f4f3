//! Skin weights as vertex attributes: sets of four joints and four weights, heaviest first.

use super::encode::{EncodeError, EncodeOptions};
use crate::rig::{Influence, SkinWeights};

/// Number type of the weights in the file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WeightFormat {
    #[default]
    Float,
    /// Sums are exactly 65535.
    U16,
    /// Sums are exactly 255.
    U8,
}

impl WeightFormat {
    pub(super) fn component(self) -> u32 {
        match self {
            Self::Float => 5126,
            Self::U16 => 5123,
            Self::U8 => 5121,
        }
    }

    fn whole(self) -> Option<u32> {
        match self {
            Self::Float => None,
            Self::U16 => Some(65535),
            Self::U8 => Some(255),
        }
    }
}

const SET: usize = 4;

/// Cleaned rows `[V, 4 × sets]`: descending, each joint once, unused slots joint 0 with weight 0.
pub(super) struct Slots {
    pub(super) sets: usize,
    pub(super) weights: WeightFormat,
    joints: usize,
    rows: Vec<Vec<Influence>>,
}

impl Slots {
    pub(super) fn new(skin: &SkinWeights, joints: usize, options: &EncodeOptions) -> Result<Self, EncodeError> {
        let rows: Vec<Vec<Influence>> = skin
            .rows
            .iter()
            .enumerate()
            .map(|(vertex, row)| {
                if let Some(other) = row.iter().find(|influence| influence.joint as usize >= joints) {
                    return Err(EncodeError::UnknownJoint { vertex, joint: other.joint, joints });
                }
                cleaned(row, options).ok_or(EncodeError::NoWeight { vertex })
            })
            .collect::<Result<_, _>>()?;
        let longest = rows.iter().map(Vec::len).max().unwrap_or(0);
        Ok(Self { sets: longest.div_ceil(SET).max(1), weights: options.weights, joints, rows })
    }

    pub(super) fn joint_component(&self) -> u32 {
        if self.joints <= 256 { 5121 } else { 5123 }
    }

    pub(super) fn joint_bytes(&self, rows: &[u32], set: usize) -> Vec<u8> {
        let width = if self.joints <= 256 { 1 } else { 2 };
        let slots = rows.iter().flat_map(|&row| self.slots(row, set));
        slots.flat_map(|slot| slot.joint.to_le_bytes().into_iter().take(width)).collect()
    }

    pub(super) fn weight_bytes(&self, rows: &[u32], set: usize) -> Vec<u8> {
        let slots = rows.iter().flat_map(|&row| self.slots(row, set));
        match self.weights.whole() {
            None => slots.flat_map(|slot| slot.weight.to_le_bytes()).collect(),
            // Whole numbers below 2^24 are exact in single precision.
            Some(whole) => {
                let width = if whole > 255 { 2 } else { 1 };
                slots.flat_map(|slot| (slot.weight as u32).to_le_bytes().into_iter().take(width)).collect()
            }
        }
    }

    fn slots(&self, row: u32, set: usize) -> impl Iterator<Item = Influence> + '_ {
        let empty = Influence { joint: 0, weight: 0.0 };
        let row = self.rows.get(row as usize).map_or(&[][..], Vec::as_slice);
        (set * SET..(set + 1) * SET).map(move |slot| row.get(slot).copied().unwrap_or(empty))
    }
}

/// One row as it is written; whole-number formats hold whole numbers. `None` when nothing is left.
fn cleaned(row: &[Influence], options: &EncodeOptions) -> Option<Vec<Influence>> {
    let mut kept: Vec<Influence> = Vec::with_capacity(row.len());
    for influence in row.iter().filter(|influence| influence.weight > 0.0 && influence.weight.is_finite()) {
        match kept.iter_mut().find(|other| other.joint == influence.joint) {
            Some(other) => other.weight += influence.weight,
            None => kept.push(*influence),
        }
    }
    descend(&mut kept);
    kept.truncate(options.influences_max.max(1));
    let sum: f64 = kept.iter().map(|influence| f64::from(influence.weight)).sum();
    match options.weights.whole() {
        None => kept.iter_mut().for_each(|influence| influence.weight = (f64::from(influence.weight) / sum) as f32),
        Some(whole) => round_to_whole(&mut kept, sum, whole),
    }
    kept.retain(|influence| influence.weight > 0.0);
    (!kept.is_empty()).then_some(kept)
}

/// Largest remainders get what rounding down leaves, so that the sum is exact.
fn round_to_whole(row: &mut [Influence], sum: f64, whole: u32) {
    let exact: Vec<f64> = row.iter().map(|influence| f64::from(influence.weight) / sum * f64::from(whole)).collect();
    let mut rest = whole;
    for (influence, exact) in row.iter_mut().zip(&exact) {
        influence.weight = exact.floor() as f32;
        rest = rest.saturating_sub(exact.floor() as u32);
    }
    let mut by_remainder: Vec<usize> = (0..row.len()).collect();
    by_remainder.sort_by(|&a, &b| exact[b].fract().total_cmp(&exact[a].fract()).then(a.cmp(&b)));
    for slot in by_remainder.into_iter().cycle().take(if row.is_empty() { 0 } else { rest as usize }) {
        row[slot].weight += 1.0;
    }
    descend(row);
}

fn descend(row: &mut [Influence]) {
    row.sort_by(|a, b| b.weight.total_cmp(&a.weight).then(a.joint.cmp(&b.joint)));
}
