//! The skeleton that a GLB file holds, without its mesh: for a sender who has a skeleton of their own.
//!
//! All joints of the skins that are in use, at their places in the rest pose (world space, as every viewer shows them); a joint
//! hangs from the nearest joint above it.

use super::json::{items, parse, text};
use super::node_graph::NodeGraph;
use super::{container, document, existing_rig};
use crate::formats::rig_json::{self, ReadJoint, RigFileError};
use crate::formats::{DecodeError, Limits};
use crate::rig::Skeleton;

/// Whether these bytes are a GLB file.
pub fn is_glb(bytes: &[u8]) -> bool {
    container::is_glb(bytes)
}

/// Reads the skeleton of a GLB file.
pub fn read_skeleton(bytes: &[u8], limits: &Limits) -> Result<Skeleton, RigFileError> {
    let joints = joints(bytes, limits).map_err(|error| RigFileError::Glb { problem: error.to_string() })?;
    rig_json::skeleton(joints)
}

fn joints(bytes: &[u8], limits: &Limits) -> Result<Vec<ReadJoint>, DecodeError> {
    let json = parse(container::split(bytes)?.json, limits)?;
    document::check(&json)?;
    let graph = NodeGraph::new(&json, limits)?;
    let Some(rig) = existing_rig::find(&json)? else { return Ok(Vec::new()) };
    let nodes: Vec<usize> = graph.order.iter().copied().filter(|node| rig.joints.contains(node)).collect();
    let mut index_of = vec![None; graph.parents.len()];
    for (index, &node) in nodes.iter().enumerate() {
        index_of[node] = Some(index);
    }
    let joint_above = |node: usize| {
        // Parents form a forest, so the way up ends.
        let above = std::iter::successors(graph.parents[node], |&node| graph.parents[node]);
        above.into_iter().find_map(|node| index_of[node])
    };
    let joint = |&node: &usize| ReadJoint {
        name: text(&items(&json, "nodes")[node], "name").to_owned(),
        parent: joint_above(node),
        position: graph.world[node].w_axis.truncate().to_array(),
    };
    Ok(nodes.iter().map(joint).collect())
}
