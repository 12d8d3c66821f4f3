//! The skeleton that a GLB file holds, without its mesh: for a sender who has a skeleton of their own.
//!
//! All joints of the skins that are in use, at their places in the rest pose (world space, as every viewer shows them); a joint
//! hangs from the nearest joint above it.

use super::existing_rig::{self, OldJoints};
use super::json::{items, parse, text};
use super::node_graph::{self, NodeGraph};
use super::{container, document};
use crate::formats::old_rig::{GraphNode, skeleton_of};
use crate::formats::rig_json::RigFileError;
use crate::formats::scene::SceneSkeleton;
use crate::formats::skeleton_nodes::{FileNode, about_joints};
use crate::formats::{DecodeError, Limits};
use crate::rig::Skeleton;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

/// Whether these bytes are a GLB file.
pub fn is_glb(bytes: &[u8]) -> bool {
    container::is_glb(bytes)
}

/// Reads the skeleton of a GLB file, and the nodes above, between and under its joints.
pub fn read_skeleton(bytes: &[u8], limits: &Limits) -> Result<(Skeleton, SceneSkeleton), RigFileError> {
    let unreadable = |error: DecodeError| RigFileError::Unreadable { problem: error.to_string() };
    let json = container::split(bytes).and_then(|container| parse(container.json, limits)).map_err(unreadable)?;
    document::check(&json).map_err(unreadable)?;
    let graph = NodeGraph::new(&json, limits).map_err(unreadable)?;
    let rig = existing_rig::find(&json).map_err(unreadable)?;
    let OldJoints { skins, joints } = rig.unwrap_or_default();
    let (skeleton, joint_nodes) = joints_of(&json, &graph, &joints)?;
    let mut order = Vec::new();
    for skin in skins {
        let of_skin = existing_rig::joints_of(&json, skin).map_err(unreadable)?;
        let joints = of_skin.iter().filter_map(|node| joint_nodes.iter().position(|joint| joint == node));
        order.extend(joints);
    }
    let mut listed = BTreeSet::new();
    order.retain(|joint| listed.insert(*joint));
    let nodes = about_joints(file_nodes(&json, &graph, &skeleton, &joint_nodes)?, order, &skeleton)?;
    Ok((skeleton, nodes))
}

/// The nodes of a document, parents first.
fn file_nodes(
    json: &Value,
    graph: &NodeGraph,
    skeleton: &Skeleton,
    joint_nodes: &[usize],
) -> Result<Vec<FileNode>, RigFileError> {
    let place: BTreeMap<usize, usize> = graph.order.iter().enumerate().map(|(at, &node)| (node, at)).collect();
    let joint_of: BTreeMap<usize, usize> = joint_nodes.iter().enumerate().map(|(joint, &node)| (node, joint)).collect();
    let file_node = |&index: &usize| {
        let node = &items(json, "nodes")[index];
        let joint = joint_of.get(&index).copied();
        let own = text(node, "name");
        let name = joint.map_or(own, |joint| &skeleton.joints[joint].name).to_owned();
        if joint.is_some() && !graph.world[index].inverse().is_finite() {
            return Err(RigFileError::Scale { name, problem: "its scale is zero".to_owned() });
        }
        let parts =
            node_graph::parts(node, index).map_err(|error| RigFileError::Unreadable { problem: error.to_string() })?;
        let parent = graph.parents[index].and_then(|parent| place.get(&parent).copied());
        Ok(FileNode { name, parent, parts, joint, has_mesh: node.get("mesh").is_some() })
    };
    graph.order.iter().map(file_node).collect()
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
