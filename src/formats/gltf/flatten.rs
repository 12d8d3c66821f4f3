//! Mesh nodes on their way to being skinned: meshes of their own, at the root of the scene, without a transform.
//!
//! A skinned mesh ignores its node's transform and its parents; viewers disagree about nodes that have some anyway.

use super::animations::{Channel, rewrite};
use super::buffers::items_mut_if_any;
use super::json::{index, items, items_mut, push, remove, text};
use super::node_graph::NodeGraph;
use crate::formats::{DecodeError, Finding, Limits, Severity};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};

/// Copies of mesh descriptions may take this part of an upload's bytes as text; parsed they take some forty times that.
const COPIED_PART: u64 = 8;

const TRANSFORM: &[&str] = &["matrix", "translation", "rotation", "scale"];

/// Gives every node of `shown` (node, mesh) a mesh that no other node uses; returns those meshes.
pub(super) fn own_meshes(
    json: &mut Value,
    shown: &[(usize, usize)],
    limits: &Limits,
) -> Result<Vec<usize>, DecodeError> {
    let shown_nodes: BTreeSet<usize> = shown.iter().map(|(node, _)| *node).collect();
    // Meshes that may be changed in place: the first shown user gets it, unless somebody else needs it as it is.
    let mut taken: BTreeSet<usize> = BTreeSet::new();
    for (number, node) in items(json, "nodes").iter().enumerate() {
        if !shown_nodes.contains(&number) {
            taken.extend(node.get("mesh").and_then(index));
        }
    }
    let mut own = Vec::with_capacity(shown.len());
    let mut lengths: BTreeMap<usize, u64> = BTreeMap::new();
    let mut copied = 0_u64;
    for &(node, mesh) in shown {
        if taken.insert(mesh) {
            own.push(mesh);
            continue;
        }
        copied += *lengths.entry(mesh).or_insert_with(|| json["meshes"][mesh].to_string().len() as u64);
        if copied > limits.bytes_max / COPIED_PART {
            let what = "the descriptions of shared meshes, copied for each node,".into();
            return Err(DecodeError::TooLarge { what, found: copied, limit: limits.bytes_max / COPIED_PART });
        }
        let copy = json["meshes"][mesh].clone();
        let copy = push(json, "meshes", copy);
        json["nodes"][node]["mesh"] = json!(copy);
        own.push(copy);
    }
    Ok(own)
}

/// Where mesh nodes went.
#[derive(Debug, Default)]
pub(super) struct Moved {
    /// The node that shows the mesh now, per node of `shown`.
    pub(super) nodes: Vec<usize>,
    pub(super) findings: Vec<Finding>,
}

/// Puts every shown mesh on a node at the root of its scenes, without a transform. Nodes of `kept` stay as and where they are.
pub(super) fn to_root(json: &mut Value, graph: &NodeGraph, shown: &[(usize, usize)], kept: &BTreeSet<usize>) -> Moved {
    let animated = animated_nodes(json);
    let mut nodes = Vec::with_capacity(shown.len());
    let mut split: BTreeMap<usize, usize> = BTreeMap::new();
    let mut moved: BTreeSet<usize> = BTreeSet::new();
    for &(node, _) in shown {
        let has_children = !items(&json["nodes"][node], "children").is_empty();
        let stays = graph.is_root(node)
            && is_untransformed(&json["nodes"][node])
            && !(has_children && animated.contains(&node))
            && !kept.contains(&node);
        let carries = kept.contains(&node)
            || ["children", "camera", "extensions"].iter().any(|key| json["nodes"][node].get(*key).is_some());
        let target = if stays || !carries { node } else { split_off(json, node) };
        if target == node {
            TRANSFORM.iter().for_each(|key| {
                remove(&mut json["nodes"][node], key);
            });
            detach(json, graph.parents[node], node);
            moved.insert(node);
        } else {
            split.insert(node, target);
        }
        show_in_scenes(json, &graph.scenes_of(node), target);
        nodes.push(target);
    }
    let findings = follow_up_animations(json, graph, &animated, &moved, &split);
    Moved { nodes, findings }
}

/// Nodes whose own transform is animated.
fn animated_nodes(json: &Value) -> BTreeSet<usize> {
    let channels = items(json, "animations").iter().flat_map(|animation| items(animation, "channels"));
    channels
        .filter_map(|channel| channel.get("target"))
        .filter(|target| text(target, "path") != "weights")
        .filter_map(|target| target.get("node").and_then(index))
        .collect()
}

fn is_untransformed(node: &Value) -> bool {
    let numbers = |key: &str| -> Option<Vec<f64>> { node.get(key)?.as_array()?.iter().map(Value::as_f64).collect() };
    let is = |key: &str, neutral: &[f64]| numbers(key).is_none_or(|numbers| numbers == neutral);
    let identity = glam::DMat4::IDENTITY.to_cols_array();
    is("matrix", &identity)
        && is("translation", &[0.0; 3])
        && is("rotation", &[0.0, 0.0, 0.0, 1.0])
        && is("scale", &[1.0; 3])
}

/// Moves the mesh of a node that carries more than its mesh to a new node; the old one stays for the rest.
fn split_off(json: &mut Value, node: usize) -> usize {
    let mut new = json!({});
    let old = &mut json["nodes"][node];
    let name = text(old, "name");
    if !name.is_empty() {
        new["name"] = json!(format!("{name}_mesh"));
    }
    for key in ["mesh", "weights"] {
        if let Some(value) = remove(old, key) {
            new[key] = value;
        }
    }
    push(json, "nodes", new)
}

fn detach(json: &mut Value, parent: Option<usize>, node: usize) {
    let Some(parent) = parent else { return };
    let parent = &mut json["nodes"][parent];
    items_mut(parent, "children").retain(|child| index(child) != Some(node));
    if items(parent, "children").is_empty() {
        remove(parent, "children");
    }
}

pub(super) fn show_in_scenes(json: &mut Value, scenes: &[usize], node: usize) {
    for &scene in scenes {
        if let Some(scene) = items_mut_if_any(json, "scenes").get_mut(scene) {
            let roots = items_mut(scene, "nodes");
            if !roots.iter().any(|root| index(root) == Some(node)) {
                roots.push(json!(node));
            }
        }
    }
}

/// A document without scenes shows nothing; the skin's joints must share a scene with the mesh.
pub(super) fn make_scene_if_none(json: &mut Value) {
    if !items(json, "scenes").is_empty() {
        return;
    }
    let mut is_child = vec![false; items(json, "nodes").len()];
    for child in items(json, "nodes").iter().flat_map(|node| items(node, "children")).filter_map(index) {
        is_child.get_mut(child).into_iter().for_each(|flag| *flag = true);
    }
    let roots: Vec<usize> = (0..is_child.len()).filter(|&node| !is_child[node]).collect();
    json["scenes"] = json!([{ "nodes": roots }]);
    json["scene"] = json!(0);
}

/// Channels that moved a mesh by its node can move it no longer.
fn follow_up_animations(
    json: &mut Value,
    graph: &NodeGraph,
    animated: &BTreeSet<usize>,
    moved: &BTreeSet<usize>,
    split: &BTreeMap<usize, usize>,
) -> Vec<Finding> {
    let dropped = rewrite(json, |node, path| match (path, split.get(&node)) {
        ("weights", Some(&target)) => Channel::Retarget(target),
        ("weights", None) => Channel::Keep,
        _ if moved.contains(&node) => Channel::Drop,
        _ => Channel::Keep,
    });
    let mut findings = Vec::new();
    if dropped > 0 {
        findings.push(Finding {
            code: "animation_dropped",
            parts: Vec::new(),
            severity: Severity::Warning,
            message: format!("{dropped} animation channel(s) moved a mesh as a whole and were dropped"),
            hint: "animate the skeleton's root joint instead".into(),
        });
    }
    let mut carriers: BTreeSet<usize> = split.keys().copied().collect();
    for &node in moved.iter().chain(split.keys()) {
        let mut above = graph.parents[node];
        // A forest: every step goes up.
        while let Some(parent) = above {
            carriers.insert(parent);
            above = graph.parents[parent];
        }
    }
    let names: Vec<String> =
        carriers.intersection(animated).map(|&node| super::bake::named(&json["nodes"][node], "node", node)).collect();
    if !names.is_empty() {
        findings.push(Finding {
            code: "animation_no_longer_moves_mesh",
            parts: Vec::new(),
            severity: Severity::Warning,
            message: format!("meshes no longer follow the animated node(s) {}", names.join(", ")),
            hint: "animate the skeleton instead".into(),
        });
    }
    findings
}
