//! The architecture of RigNet's displacement, attention and skin networks against the reference, under the weight rule
//! of the golden folder: every weight is a hash of its place, so full-size networks need no weight files. The graphs
//! (`tests/golden/*_rule.onnx`, written by `models/golden.py`) take their weights as inputs.

use super::golden::{Case, cases, folder};
use ndarray::{ArrayD, IxDyn};
use rigsmith::cancellation::Cancellation;
use rigsmith::nets::locate::runtime_candidates;
use rigsmith::nets::network::{Input, Network};
use rigsmith::nets::runtime::Runtime;
use serde_json::Value;
use std::path::Path;

/// Errors of 32-bit sums in another order, as a share of the output's standard deviation.
const TOLERANCE: f64 = 0.01;

/// A tensor of a network's state: its index counts every entry, its name is the graph's input name.
struct RuleTensor {
    index: u64,
    name: String,
    shape: Vec<usize>,
    rule: String,
}

/// The tensors of one network in the golden folder's table.
fn rule_tensors(network: &str) -> Vec<RuleTensor> {
    let path = folder().join("weight_rule_tensors.json");
    let table: Value = serde_json::from_slice(&std::fs::read(path).expect("table reads")).expect("table is JSON");
    let rows = table[network].as_array().expect("network in the table");
    rows.iter()
        .map(|row| RuleTensor {
            index: row[0].as_u64().expect("index"),
            name: row[1].as_str().expect("name").to_owned(),
            shape: row[2].as_array().expect("shape").iter().map(|n| n.as_u64().expect("size") as usize).collect(),
            rule: row[3].as_str().expect("rule").to_owned(),
        })
        .collect()
}

impl RuleTensor {
    /// Element `i`: a SplitMix64 hash of (tensor, element), scaled as the rule says.
    fn values(&self) -> ArrayD<f32> {
        let fan_in = self.shape.get(1).copied().unwrap_or(1) as f64;
        let count = self.shape.iter().product::<usize>();
        let values = (0..count as u64)
            .map(|i| {
                let mut z = (self.index << 40).wrapping_add(i).wrapping_add(0x9E37_79B9_7F4A_7C15);
                z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
                z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
                z ^= z >> 31;
                let u = (z >> 11) as f64 / (1u64 << 53) as f64;
                let value = match self.rule.as_str() {
                    "(2u-1)*sqrt(3/fan_in)" => (2.0 * u - 1.0) * (3.0 / fan_in).sqrt(),
                    "(2u-1)*0.1" => (2.0 * u - 1.0) * 0.1,
                    "0.5+u" => 0.5 + u,
                    other => panic!("tensor {}: unknown rule {other}", self.name),
                };
                value as f32
            })
            .collect();
        ArrayD::from_shape_vec(IxDyn(&self.shape), values).expect("shape holds the values")
    }
}

/// Rows of neighbours, own vertex first, padded with it: `pairs` are (source, target), pooled at the target.
fn table(vertex_count: usize, pairs: impl Iterator<Item = (usize, usize)>) -> ArrayD<i64> {
    let mut rows: Vec<Vec<i64>> = (0..vertex_count as i64).map(|vertex| vec![vertex]).collect();
    for (source, target) in pairs {
        rows[target].push(source as i64);
    }
    let width = rows.iter().map(Vec::len).max().unwrap_or(1);
    ArrayD::from_shape_fn(IxDyn(&[vertex_count, width]), |at| rows[at[0]].get(at[1]).copied().unwrap_or(at[0] as i64))
}

fn pairs(case: &Case, name: &str) -> Vec<(usize, usize)> {
    case.ints(name).chunks_exact(2).map(|pair| (pair[0] as usize, pair[1] as usize)).collect()
}

fn f32_array(case: &Case, name: &str) -> ArrayD<f32> {
    ArrayD::from_shape_vec(IxDyn(case.shape(name)), case.f32s(name)).expect("shape holds the values")
}

/// Runs `graph` with the rule's weights of `network` on every case and compares its output with `golden`.
fn compare(graph: &str, network: &str, output: &str, golden: &str) {
    let cases = cases();
    if cases.is_empty() {
        return;
    }
    let runtime = Runtime::load(&runtime_candidates(None), 2).expect("ONNX Runtime loads (make ort)");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(graph);
    let net = Network::open(&runtime, graph, std::fs::read(path).expect("graph reads")).expect("graph opens");
    let wanted = net.input_names();
    let tensors: Vec<RuleTensor> = rule_tensors(network).into_iter().filter(|t| wanted.contains(&t.name)).collect();
    let weights: Vec<ArrayD<f32>> = tensors.iter().map(RuleTensor::values).collect();
    for case in cases {
        let vertex_count = case.shape("vertices")[0];
        let positions = f32_array(&case, "vertices");
        let features = f32_array(&case, "skin_features");
        let one_ring = table(vertex_count, pairs(&case, "tpl_edges").into_iter());
        let geodesic_ball = table(vertex_count, pairs(&case, "geo_edges_sampled").into_iter());
        let mut inputs: Vec<(&str, Input)> =
            tensors.iter().zip(&weights).map(|(t, w)| (t.name.as_str(), Input::F32(w.view()))).collect();
        inputs.push(("positions", Input::F32(positions.view())));
        inputs.push(("one_ring", Input::I64(one_ring.view())));
        inputs.push(("geodesic_ball", Input::I64(geodesic_ball.view())));
        inputs.push(("bone_features", Input::F32(features.view())));
        inputs.retain(|(name, _)| wanted.iter().any(|wanted| wanted == name));
        assert_eq!(inputs.len(), wanted.len(), "{graph} has inputs that nobody fills: {wanted:?}");
        let got = net.run(&inputs, output, &Cancellation::default()).expect("graph runs");
        let expected = case.f64s(golden);
        assert_eq!(got.len(), expected.len());
        let mean = expected.iter().sum::<f64>() / expected.len() as f64;
        let deviation =
            (expected.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / expected.len() as f64).sqrt();
        let worst = got.iter().zip(&expected).map(|(&got, &want)| (f64::from(got) - want).abs()).fold(0.0, f64::max);
        println!("{graph} {}: worst error {:.2e} of the standard deviation", case.id, worst / deviation);
        assert!(worst <= TOLERANCE * deviation, "{graph} {}: {worst} against {deviation}", case.id);
    }
}

#[test]
fn golden_displacement_network_equals_the_reference() {
    compare("rignet_displacement_rule.onnx", "joint", "displacement", "net_joint_displacement");
}

#[test]
fn golden_attention_network_equals_the_reference() {
    compare("rignet_attention_rule.onnx", "joint", "attention_logit", "net_attention_logit");
}

#[test]
fn golden_skin_network_equals_the_reference() {
    compare("rignet_skin_rule.onnx", "skin", "skin_logit", "net_skin_logit");
}
