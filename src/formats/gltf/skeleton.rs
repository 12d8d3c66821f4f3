//! The skeleton that a GLB file holds, without its mesh: for a sender who has a skeleton of their own.
//!
//! All joints of the skins that are in use, at their places in the rest pose (world space, as every viewer shows them); a joint
//! hangs from the nearest joint above it.

use super::json::{items, parse, text};
use super::node_graph::NodeGraph;
use super::{container, document, existing_rig};
use crate::formats::old_rig::{GraphNode, skeleton_of};
use crate::formats::rig_json::RigFileError;
use crate::formats::{DecodeError, Limits};
use crate::rig::Skeleton;
use serde_json::Value;
use std::collections::BTreeSet;

/// Whether these bytes are a GLB file.
pub fn is_glb(bytes: &[u8]) -> bool {
    container::is_glb(bytes)
}

/// Reads the skeleton of a GLB file.
pub fn read_skeleton(bytes: &[u8], limits: &Limits) -> Result<Skeleton, RigFileError> {
    let unreadable = |error: DecodeError| RigFileError::Unreadable { problem: error.to_string() };
    let json = container::split(bytes).and_then(|container| parse(container.json, limits)).map_err(unreadable)?;
    document::check(&json).map_err(unreadable)?;
    let graph = NodeGraph::new(&json, limits).map_err(unreadable)?;
    let rig = existing_rig::find(&json).map_err(unreadable)?;
    let joints = rig.map(|rig| rig.joints).unwrap_or_default();
    Ok(joints_of(&json, &graph, &joints)?.0)
}

/// `joints` (nodes) as a skeleton, and the node of each of its joints.
pub(super) fn joints_of(
    json: &Value,
    graph: &NodeGraph,
    joints: &BTreeSet<usize>,
) -> Result<(Skeleton, Vec<usize>), RigFileError> {
    let mut place = vec![0; graph.order.len()];
    for (at, &node) in graph.order.iter().enumerate() {
        place[node] = at;
    }
    let nodes = items(json, "nodes");
    let graph_nodes: Vec<GraphNode> = graph
        .order
        .iter()
        .map(|&node| GraphNode {
            name: text(&nodes[node], "name"),
            parent: graph.parents[node].map(|parent| place[parent]),
            position: graph.world[node].w_axis.truncate(),
            is_joint: joints.contains(&node),
        })
        .collect();
    let (skeleton, of) = skeleton_of(&graph_nodes)?;
    Ok((skeleton, of.into_iter().map(|at| graph.order[at]).collect()))
}
