//! The nodes of a skeleton that comes in a file of its own: how its joints are turned, and what stands above, between and under
//! them. `rigsmith.rig/1` holds them as
//!
//! ```text
//! "nodes": [{"parent": null | index, "joint": index, "rotation": [x, y, z, w], "scale": [x, y, z]} |
//!           {"parent": null | index, "name": …, "translation": [x, y, z], "rotation": …, "scale": …} …],
//! "skin_order": [joint …]
//! ```
//! A file without `nodes` has joints that are not turned, and nothing else. Parents precede children; every joint is listed once.
//! Rotations (unit quaternions) and scales are relative to the parent, and identity where they are left out. The place of a joint is
//! its `position` alone, so one that is moved there takes along only its orientation. `skin_order` is the order of the joints in the
//! skin, where it is not that of `joints`.

use super::rig_json::RigFileError;
use super::scene::{SHEARED, SceneSkeleton, SkeletonNode};
use crate::rig::Skeleton;
use glam::{DMat4, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Most nodes of a skeleton that is read.
const NODES_MAX: usize = 10_000;
/// How far the length of a rotation may be from one ...
const UNIT: f64 = 1e-3;
/// ... and how far it is left as it is.
const UNIT_ENOUGH: f64 = 1e-6;

/// A node of a file, and what it is there.
pub(super) struct FileNode {
    pub(super) name: String,
    /// Index in the same list.
    pub(super) parent: Option<usize>,
    /// Scale, rotation and translation; `None` for a transform that is not made of them.
    pub(super) parts: Option<(DVec3, DQuat, DVec3)>,
    /// Index in the skeleton.
    pub(super) joint: Option<usize>,
    pub(super) has_mesh: bool,
}

/// A node as the file has it.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct NodeEntry {
    parent: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    joint: Option<usize>,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    name: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    translation: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    rotation: Option<[f64; 4]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    scale: Option<[f64; 3]>,
}

/// The nodes above, between and under the joints of a file; of those that carry a mesh only what holds joints together. `order`:
/// the joints in the order of the file's skin, to which those that it does not name are appended.
pub(super) fn about_joints(
    nodes: Vec<FileNode>,
    order: Vec<usize>,
    skeleton: &Skeleton,
) -> Result<SceneSkeleton, RigFileError> {
    let mut is_under = vec![false; nodes.len()];
    for (at, node) in nodes.iter().enumerate() {
        is_under[at] = node.joint.is_some() || node.parent.is_some_and(|parent| is_under[parent]);
    }
    let mut is_kept = vec![false; nodes.len()];
    for (at, node) in nodes.iter().enumerate().rev() {
        is_kept[at] |= is_under[at] && (node.joint.is_some() || !node.has_mesh);
        if let Some(parent) = node.parent.filter(|_| is_kept[at]) {
            is_kept[parent] = true;
        }
    }
    let mut index_of = vec![None; nodes.len()];
    let mut kept = Vec::new();
    let mut node_of_joint = Vec::new();
    for (at, node) in nodes.into_iter().enumerate().filter(|(at, _)| is_kept[*at]) {
        let FileNode { name, parent, parts, joint, .. } = node;
        let Some((scale, rotation, translation)) = parts else {
            return Err(RigFileError::Scale { name, problem: SHEARED.to_owned() });
        };
        index_of[at] = Some(kept.len());
        node_of_joint.extend(joint.map(|joint| (joint, kept.len())));
        let parent = parent.and_then(|parent| index_of[parent]);
        kept.push(SkeletonNode { name, parent, translation, rotation, scale });
    }
    if kept.len() > NODES_MAX {
        let problem = format!("there are {} nodes about its joints, but at most {NODES_MAX} are taken", kept.len());
        return Err(RigFileError::Unreadable { problem });
    }
    node_of_joint.sort_unstable();
    let node_of_joint: Vec<usize> = node_of_joint.into_iter().map(|(_, node)| node).collect();
    // To the bit what comes of it by way of a rig file, in which it is kept.
    let (entries, order) = entries(&arranged(kept, &node_of_joint, order));
    read(entries, order, skeleton)
}

/// `order` with the joints that it lacks behind those that it has.
fn arranged(nodes: Vec<SkeletonNode>, node_of_joint: &[usize], mut order: Vec<usize>) -> SceneSkeleton {
    let missing: Vec<usize> = (0..node_of_joint.len()).filter(|joint| !order.contains(joint)).collect();
    order.extend(missing);
    let place = |joint: usize| order.iter().position(|other| *other == joint).map(|place| place as u32);
    SceneSkeleton {
        nodes,
        places: (0..node_of_joint.len()).map(place).collect(),
        joints: order.into_iter().map(|joint| node_of_joint[joint]).collect(),
    }
}

/// `nodes` and `skin_order` of the file.
pub(super) fn entries(skeleton: &SceneSkeleton) -> (Vec<NodeEntry>, Option<Vec<usize>>) {
    let mut joint_of_node = vec![None; skeleton.nodes.len()];
    let mut order = vec![0; skeleton.joints.len()];
    for (joint, place) in skeleton.places.iter().enumerate() {
        if let Some(place) = place {
            joint_of_node[skeleton.joints[*place as usize]] = Some(joint);
            order[*place as usize] = joint;
        }
    }
    let entry = |(node, joint): (&SkeletonNode, Option<usize>)| NodeEntry {
        parent: node.parent,
        joint,
        name: if joint.is_some() { String::new() } else { node.name.clone() },
        translation: joint.is_none().then(|| node.translation.to_array()),
        rotation: (node.rotation != DQuat::IDENTITY).then(|| node.rotation.to_array()),
        scale: (node.scale != DVec3::ONE).then(|| node.scale.to_array()),
    };
    let is_plain = order.iter().enumerate().all(|(at, joint)| at == *joint);
    (skeleton.nodes.iter().zip(joint_of_node).map(entry).collect(), (!is_plain).then_some(order))
}

/// What [`entries`] wrote, or somebody else.
pub(super) fn read(
    entries: Vec<NodeEntry>,
    order: Option<Vec<usize>>,
    skeleton: &Skeleton,
) -> Result<SceneSkeleton, RigFileError> {
    let fault = |node: usize, problem: String| RigFileError::Node { node, problem };
    if entries.len() > NODES_MAX {
        return Err(fault(NODES_MAX, format!("at most {NODES_MAX} nodes are taken")));
    }
    let joint_count = skeleton.joints.len();
    let mut node_of_joint: Vec<Option<usize>> = vec![None; joint_count];
    let mut nodes: Vec<SkeletonNode> = Vec::with_capacity(entries.len());
    let mut world: Vec<DMat4> = Vec::with_capacity(entries.len());
    // The nearest joint at or above each node.
    let mut joint_above: Vec<Option<usize>> = Vec::with_capacity(entries.len());
    for (index, entry) in entries.into_iter().enumerate() {
        if let Some(parent) = entry.parent.filter(|parent| *parent >= index) {
            return Err(fault(index, format!("its parent, node {parent}, does not come before it")));
        }
        let above = entry.parent.map_or(DMat4::IDENTITY, |parent| world[parent]);
        let joint_over = entry.parent.and_then(|parent| joint_above[parent]);
        let rotation = entry.rotation.map_or(DQuat::IDENTITY, DQuat::from_array);
        let scale = entry.scale.map_or(DVec3::ONE, DVec3::from_array);
        let off = (rotation.length() - 1.0).abs();
        if off.is_nan() || off > UNIT {
            return Err(fault(index, "its rotation is no quaternion [x, y, z, w] of length 1".to_owned()));
        }
        let rotation = if off > UNIT_ENOUGH { rotation.normalize() } else { rotation };
        let (name, translation) = match entry.joint {
            Some(joint) => {
                let Some(described) = skeleton.joints.get(joint) else {
                    return Err(fault(index, format!("joint {joint} does not exist: there are {joint_count}")));
                };
                if let Some(other) = node_of_joint[joint].replace(index) {
                    return Err(fault(index, format!("node {other} is joint {joint} already")));
                }
                if described.parent != joint_over {
                    return Err(fault(index, format!("it does not hang from the parent of joint {joint}")));
                }
                (described.name.clone(), above.inverse().transform_point3(described.position))
            }
            None => (entry.name, entry.translation.map_or(DVec3::ZERO, DVec3::from_array)),
        };
        let node = SkeletonNode { name, parent: entry.parent, translation, rotation, scale };
        let here = above * node.local();
        if !(here.is_finite() && node.local().as_mat4().is_finite()) {
            return Err(fault(index, "its transform is not finite in single precision".to_owned()));
        }
        // Without an extent nothing can follow it.
        if entry.joint.is_some() && !here.inverse().is_finite() {
            return Err(fault(index, "its scale, or one above it, is zero".to_owned()));
        }
        nodes.push(node);
        world.push(here);
        joint_above.push(entry.joint.or(joint_over));
    }
    if let Some(joint) = node_of_joint.iter().position(Option::is_none) {
        return Err(fault(nodes.len(), format!("no node is joint {joint} ({:?})", skeleton.joints[joint].name)));
    }
    let order = order.unwrap_or_default();
    let mut is_listed = vec![false; joint_count];
    for &joint in &order {
        if is_listed.get(joint) != Some(&false) {
            return Err(RigFileError::SkinOrder { joint });
        }
        is_listed[joint] = true;
    }
    Ok(arranged(nodes, &node_of_joint.into_iter().flatten().collect::<Vec<_>>(), order))
}
