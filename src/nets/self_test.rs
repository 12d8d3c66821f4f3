//! Known answers: every network is run once on inputs of a closed formula, and must give the outputs that the export
//! recorded. It catches a runtime that computes wrongly on this machine, before a user's mesh meets it.
//!
//! The formula is `models/artifacts/README.md`'s: a bent 8 × 8 sheet, hashed joints and features. Computed in f64 and
//! rounded once to f32, so that every language gets the same bits.

use super::error::NetError;
use super::manifest::NetworkEntry;
use super::network::{Input, Network};
use crate::cancellation::Cancellation;
use crate::rig::heter_graph::{JOINT_CHANNELS, LINK_CHANNELS, LINKS, SIGHT};
use ndarray::{ArrayD, IxDyn};

const GRID: i64 = 8;
const VERTEX_COUNT: usize = (GRID * GRID) as usize;
const JOINT_COUNT: usize = 6;
/// Columns right and rows up on the grid, own vertex first.
const ONE_RING_STEPS: [(i64, i64); 7] = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1)];
/// The same and a little farther.
const MORE_BALL_STEPS: [(i64, i64); 4] = [(1, -1), (-1, 1), (2, 0), (-2, 0)];
/// Channels of one bone's features: start, end, inverse distance, leaf flag.
const BONE_CHANNELS: usize = 8;
const BONE_SLOTS: usize = 5;
/// Numbers of the hashed tensors, part of the formula.
const POSITIONS: u64 = 0;
const JOINTS: u64 = 3;
const PAIR_FEATURES: u64 = 4;
const BONE_FEATURES: u64 = 5;
const MEDIAL_OFFSETS: u64 = 6;
const JOINT_FEATURES: u64 = 7;
const LINK_FEATURES: u64 = 8;

enum Tensor {
    F32(ArrayD<f32>),
    I64(ArrayD<i64>),
}

/// Runs the known-answer test of `network`.
pub fn run(network: &Network, entry: &NetworkEntry) -> Result<(), NetError> {
    let failed = |what: String| NetError::SelfTest { network: network.name().to_owned(), what };
    let tensors = entry
        .inputs
        .iter()
        .map(|input| known(&input.name).ok_or_else(|| failed(format!("no known input {}", input.name))))
        .collect::<Result<Vec<Tensor>, _>>()?;
    let inputs: Vec<(&str, Input)> = entry
        .inputs
        .iter()
        .zip(&tensors)
        .map(|(input, tensor)| {
            let view = match tensor {
                Tensor::F32(array) => Input::F32(array.view()),
                Tensor::I64(array) => Input::I64(array.view()),
            };
            (input.name.as_str(), view)
        })
        .collect();
    let output = entry.outputs.first().ok_or_else(|| failed("the manifest names no output".into()))?;
    let got: Vec<f64> =
        network.run(&inputs, &output.name, &Cancellation::default())?.iter().map(|&value| f64::from(value)).collect();
    let expected = &entry.self_test;
    for (index, want) in expected.first.iter().enumerate() {
        let value = got.get(index).copied().unwrap_or(f64::NAN);
        within(value, *want, expected.tolerance).map_err(|what| failed(format!("output {index} {what}")))?;
    }
    let mean = got.iter().sum::<f64>() / got.len() as f64;
    let variance = got.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / got.len() as f64;
    within(mean, expected.mean, expected.tolerance).map_err(|what| failed(format!("mean {what}")))?;
    within(variance.sqrt(), expected.std, expected.tolerance).map_err(|what| failed(format!("deviation {what}")))
}

/// NaN is never within.
fn within(value: f64, expected: f64, tolerance: f64) -> Result<(), String> {
    if (value - expected).abs() <= tolerance {
        Ok(())
    } else {
        Err(format!("is {value}, not {expected} (tolerance {tolerance})"))
    }
}

/// The input of that name; `None` for a name that the formula does not know.
fn known(name: &str) -> Option<Tensor> {
    let pairs: Vec<[usize; 2]> = (0..JOINT_COUNT).flat_map(|i| (i + 1..JOINT_COUNT).map(move |j| [i, j])).collect();
    Some(match name {
        "positions" => Tensor::F32(sheet()),
        "one_ring" => Tensor::I64(grid_table(&ONE_RING_STEPS)),
        "geodesic_ball" => Tensor::I64(grid_table(&[&ONE_RING_STEPS[..], &MORE_BALL_STEPS[..]].concat())),
        "joints" => Tensor::F32(points(JOINTS, JOINT_COUNT, 1.0)),
        "medial_offsets" => Tensor::F32(points(MEDIAL_OFFSETS, VERTEX_COUNT, 0.1)),
        "pairs" => {
            let indices = pairs.iter().flatten().map(|&joint| joint as i64).collect();
            Tensor::I64(ArrayD::from_shape_vec(IxDyn(&[pairs.len(), 2]), indices).ok()?)
        }
        "pair_features" => Tensor::F32(array(&[pairs.len(), 2], uniform(PAIR_FEATURES, 2 * pairs.len()))),
        "bone_features" => Tensor::F32(bone_features()),
        "joint_features" => {
            let hashed = uniform(JOINT_FEATURES, JOINT_COUNT * JOINT_CHANNELS);
            Tensor::F32(array(&[JOINT_COUNT, JOINT_CHANNELS], hashed.into_iter().map(|u| u - 0.5)))
        }
        "joint_neighbours" => indices(&[JOINT_COUNT, 3], |at| match at[1] {
            0 => at[0],
            1 => at[0].saturating_sub(1),
            _ => (at[0] + 1).min(JOINT_COUNT - 1),
        }),
        "links" => indices(&[VERTEX_COUNT, LINKS], |at| (at[0] + at[1]) % JOINT_COUNT),
        "link_mask" => Tensor::F32(ArrayD::ones(IxDyn(&[VERTEX_COUNT, LINKS]))),
        "link_features" => {
            let hashed = uniform(LINK_FEATURES, VERTEX_COUNT * LINKS * LINK_CHANNELS);
            Tensor::F32(array(&[VERTEX_COUNT, LINKS, LINK_CHANNELS], hashed))
        }
        "joint_links" => indices(&[JOINT_COUNT, SIGHT], |at| (at[0] * SIGHT + at[1]) % (VERTEX_COUNT * LINKS)),
        "joint_mask" => Tensor::F32(ArrayD::ones(IxDyn(&[JOINT_COUNT]))),
        "bone_mask" => Tensor::F32(ArrayD::ones(IxDyn(&[VERTEX_COUNT, BONE_SLOTS]))),
        _ => return None,
    })
}

fn indices(shape: &[usize], index: impl Fn(ndarray::IxDyn) -> usize) -> Tensor {
    Tensor::I64(ArrayD::from_shape_fn(IxDyn(shape), |at| index(at) as i64))
}

/// SplitMix64 of (tensor, element), as numbers in [0, 1).
fn uniform(tensor: u64, count: usize) -> Vec<f64> {
    let number = |i: u64| {
        let mut z = (tensor << 40).wrapping_add(i).wrapping_add(0x9E37_79B9_7F4A_7C15);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^= z >> 31;
        (z >> 11) as f64 / (1u64 << 53) as f64
    };
    (0..count as u64).map(number).collect()
}

/// `[count, 3]`: x and z in −0.5 to 0.5, y in 0 to 1, times `scale`.
fn points(tensor: u64, count: usize, scale: f64) -> ArrayD<f32> {
    let place = |(i, u): (usize, f64)| scale * if i % 3 == 1 { u } else { u - 0.5 };
    array(&[count, 3], uniform(tensor, 3 * count).into_iter().enumerate().map(place))
}

fn array(shape: &[usize], values: impl IntoIterator<Item = f64>) -> ArrayD<f32> {
    let mut values = values.into_iter();
    ArrayD::from_shape_simple_fn(IxDyn(shape), || values.next().unwrap_or(f64::NAN) as f32)
}

/// Vertex v in column c = v mod 8 and row r = v div 8: x = 0.4 (c/7 − 0.5), y = 0.25 + 0.4 r/7, z = 0.8 (c/7 − 0.5)²,
/// each plus 0.02 (u − 0.5).
fn sheet() -> ArrayD<f32> {
    let noise = uniform(POSITIONS, 3 * VERTEX_COUNT);
    let last = (GRID - 1) as f64;
    let values = (0..3 * VERTEX_COUNT).map(|i| {
        let (row, column) = ((i / 3) / GRID as usize, (i / 3) % GRID as usize);
        let (across, up) = (column as f64 / last - 0.5, row as f64 / last);
        let place = [0.4 * across, 0.25 + 0.4 * up, 0.8 * (across * across)][i % 3];
        place + 0.02 * (noise[i] - 0.5)
    });
    array(&[VERTEX_COUNT, 3], values)
}

/// `[V, steps]`: the vertex so many columns right and rows up, held to the grid.
fn grid_table(steps: &[(i64, i64)]) -> ArrayD<i64> {
    ArrayD::from_shape_fn(IxDyn(&[VERTEX_COUNT, steps.len()]), |at| {
        let (row, column) = (at[0] as i64 / GRID, at[0] as i64 % GRID);
        let (right, up) = steps[at[1]];
        (row + up).clamp(0, GRID - 1) * GRID + (column + right).clamp(0, GRID - 1)
    })
}

/// Per bone: two points as the joints are placed, 1 / (0.05 + u), and 1 where u ≥ 0.5 else 0.
fn bone_features() -> ArrayD<f32> {
    let hashed = uniform(BONE_FEATURES, VERTEX_COUNT * BONE_SLOTS * BONE_CHANNELS);
    let value = |(i, u): (usize, f64)| match i % BONE_CHANNELS {
        1 | 4 => u,
        6 => 1.0 / (0.05 + u),
        7 => f64::from(u >= 0.5),
        _ => u - 0.5,
    };
    array(&[VERTEX_COUNT, BONE_SLOTS * BONE_CHANNELS], hashed.into_iter().enumerate().map(value))
}
