//! A skin over the joints that the file came with: nodes, names, order and orientations stay as they are; weights are new, and
//! so are the inverse bind matrices, since the mesh stands in world space now.

use super::bake::Edit;
use super::buffers::append_view;
use super::encode::EncodeError;
use super::existing_rig::{self, OldJoints};
use super::json::{index, items, items_mut, push};
use super::node_graph::NodeGraph;
use super::{Document, flatten, skeleton};
use crate::formats::old_rig::{OldRig, row_of};
use crate::formats::rig_json::RigFileError;
use crate::formats::{DecodeError, Limits, SceneSkeleton};
use crate::rig::{Influence, SkinWeights};
use glam::{DMat4, DQuat, DVec3};
use serde_json::{Map, Value, json};
use std::collections::BTreeSet;

/// The joints of a document that keeps them.
#[derive(Clone, Debug)]
pub(super) struct KeptSkin {
    /// `[N]`: node of each joint of the skin, in the order of the file.
    pub(super) nodes: Vec<usize>,
    /// `[J]`: place in `nodes` of each joint of the skeleton; `None` for one that no skin of the file names.
    pub(super) places: Vec<Option<u32>>,
    /// What else the skin of the file says: its name, its `skeleton`, its extras.
    pub(super) rest: Map<String, Value>,
}

/// Reads the old rig before it is taken away. `shown` as in [`super::decode`]: the vertices are theirs, in this order.
pub(super) fn read(
    edit: &Edit,
    graph: &NodeGraph,
    old: &OldJoints,
    shown: &[(usize, usize)],
) -> Result<(OldRig, KeptSkin), DecodeError> {
    let (skeleton, joint_nodes) = skeleton::joints_of(edit.json, graph, &old.joints)?;
    for (joint, &node) in skeleton.joints.iter().zip(&joint_nodes) {
        // Without an extent nothing can follow it.
        if !graph.world[node].inverse().is_finite() {
            let problem = "its scale is zero".to_owned();
            return Err(RigFileError::Scale { name: joint.name.clone(), problem }.into());
        }
    }
    let (mut nodes, mut listed) = (Vec::new(), BTreeSet::new());
    for &skin in &old.skins {
        nodes.extend(existing_rig::joints_of(edit.json, skin)?.into_iter().filter(|&node| listed.insert(node)));
    }
    let place = |node: &usize| nodes.iter().position(|other| other == node).map(|place| place as u32);
    let places: Vec<Option<u32>> = joint_nodes.iter().map(place).collect();
    let first = old.skins.first().and_then(|&skin| items(edit.json, "skins").get(skin)?.as_object());
    let mut rest = first.cloned().unwrap_or_default();
    rest.retain(|key, _| !matches!(key.as_str(), "joints" | "inverseBindMatrices"));

    let mut joint_of_node = vec![None; graph.parents.len()];
    for (joint, &node) in (0..).zip(&joint_nodes) {
        joint_of_node[node] = Some(joint);
    }
    let mut rows = Vec::new();
    for &(node, mesh) in shown {
        let joints: Vec<Option<u32>> = match edit.json["nodes"][node].get("skin").and_then(index) {
            Some(skin) => existing_rig::joints_of(edit.json, skin)?.iter().map(|&node| joint_of_node[node]).collect(),
            None => Vec::new(),
        };
        for (number, primitive) in items(&edit.json["meshes"][mesh], "primitives").iter().enumerate() {
            let place = format!("mesh {mesh}, primitive {number}");
            let influences = existing_rig::influences(edit, primitive, &place)?;
            rows.extend(influences.into_iter().map(|row| {
                let of_joint = |(slot, weight): (u32, f32)| {
                    let joint = joints.get(slot as usize).copied().flatten()?;
                    Some(Influence { joint, weight })
                };
                row_of(row.into_iter().filter_map(of_joint).collect())
            }));
        }
    }
    let deforms = places.iter().map(Option::is_some).collect();
    Ok((OldRig { skeleton, deforms, rows }, KeptSkin { nodes, places, rest }))
}

impl KeptSkin {
    /// Appends the nodes of a skeleton that is kept.
    pub(super) fn of_nodes(json: &mut Value, skeleton: &SceneSkeleton) -> Self {
        let first = items(json, "nodes").len();
        for node in &skeleton.nodes {
            let mut value = json!({ "translation": node.translation.to_array() });
            if !node.name.is_empty() {
                value["name"] = json!(node.name);
            }
            if node.rotation != DQuat::IDENTITY {
                value["rotation"] = json!(node.rotation.to_array());
            }
            if node.scale != DVec3::ONE {
                value["scale"] = json!(node.scale.to_array());
            }
            let index = push(json, "nodes", value);
            if let Some(parent) = node.parent {
                items_mut(&mut json["nodes"][first + parent], "children").push(json!(index));
            }
        }
        let nodes = skeleton.joints.iter().map(|joint| first + joint).collect();
        Self { nodes, places: skeleton.places.clone(), rest: Map::new() }
    }

    /// Weights over the skin's own list of joints.
    pub(super) fn in_places(&self, skin: &SkinWeights) -> Result<SkinWeights, EncodeError> {
        let in_place = |(vertex, row): (usize, &Vec<Influence>)| {
            let place = |influence: &Influence| match self.places.get(influence.joint as usize).copied().flatten() {
                Some(joint) => Ok(Influence { joint, ..*influence }),
                None => {
                    let joints = self.places.len();
                    Err(EncodeError::UnknownJoint { vertex, joint: influence.joint, joints })
                }
            };
            row.iter().map(place).collect()
        };
        Ok(SkinWeights { rows: skin.rows.iter().enumerate().map(in_place).collect::<Result<_, _>>()? })
    }

    /// Appends inverse bind matrices and the skin; returns the skin's index.
    pub(super) fn add(
        &self,
        json: &mut Value,
        binary: &mut Vec<u8>,
        document: &Document,
    ) -> Result<usize, EncodeError> {
        let graph = graph(json)?;
        let mut matrices = Vec::with_capacity(self.nodes.len() * 64);
        for &node in &self.nodes {
            let inverse = inverse_bind_matrix(graph.world[node]);
            matrices.extend(inverse.iter().flat_map(|value| value.to_le_bytes()));
        }
        for &node in &self.nodes {
            let mut root = node;
            // A forest: every step goes up.
            while let Some(parent) = graph.parents[root] {
                root = parent;
            }
            flatten::show_in_scenes(json, &document.scenes, root);
        }
        let view = append_view(json, binary, &matrices);
        let accessor = json!({ "bufferView": view, "componentType": 5126, "count": self.nodes.len(), "type": "MAT4" });
        let accessor = push(json, "accessors", accessor);
        let mut skin = self.rest.clone();
        // It may say where the skeleton stands, but only rightly: some files name a node that is not above every joint.
        let is_above = |top: usize| {
            self.nodes
                .iter()
                .all(|&node| std::iter::successors(Some(node), |&node| graph.parents[node]).any(|node| node == top))
        };
        if !skin.get("skeleton").and_then(index).is_some_and(is_above) {
            skin.remove("skeleton");
        }
        skin.insert("inverseBindMatrices".into(), json!(accessor));
        skin.insert("joints".into(), json!(self.nodes));
        Ok(push(json, "skins", Value::Object(skin)))
    }
}

/// Whether every matrix takes the world into its joint, where the joint's node is.
pub(super) fn are_inverses(json: &Value, joints: &[usize], matrices: &[[f32; 16]]) -> bool {
    let Ok(graph) = graph(json) else { return false };
    joints
        .iter()
        .zip(matrices)
        .all(|(&joint, matrix)| graph.world.get(joint).is_some_and(|world| inverse_bind_matrix(*world) == *matrix))
}

fn graph(json: &Value) -> Result<NodeGraph, EncodeError> {
    NodeGraph::new(json, &Limits::default())
        .map_err(|error| EncodeError::Invalid { code: "NODE_GRAPH", place: error.to_string() })
}

/// Column-major, affine to the bit.
fn inverse_bind_matrix(world: DMat4) -> [f32; 16] {
    let mut matrix = world.inverse().as_mat4().to_cols_array();
    for (at, value) in [(3, 0.0), (7, 0.0), (11, 0.0), (15, 1.0)] {
        matrix[at] = value;
    }
    // No negative zeros.
    matrix.map(|value| value + 0.0)
}
