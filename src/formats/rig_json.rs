//! `rigsmith.rig/1`: a rig as JSON, for scripts and for sending an edited skeleton back.
//!
//! ```text
//! {"format": "rigsmith.rig/1", "method": …,
//!  "joints": [{"name": …, "parent": null | index, "position": [x, y, z]} …],
//!  "nodes": […], "skin_order": […],
//!  "skins": [{"mesh": i, "primitive": j, "joints": [[…] …], "weights": [[…] …]} …],
//!  "report": {…}}
//! ```
//! Parents precede children; positions are in upload space. One skin per part of the asset, one row per vertex: file
//! vertices in file order, or for glTF a primitive's vertices in accessor order. `nodes` and `skin_order` are there for skeletons
//! that came with turned joints or further nodes ([`super::skeleton_nodes`]).

use super::gltf::{self, JointNames};
use super::skeleton_nodes::{self, NodeEntry};
use super::{Asset, SceneSkeleton};
use crate::rig::{Influence, Joint, Rig, Skeleton, SkinWeights};
use glam::DVec3;
use serde::ser::Serializer;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeSet;

pub const FORMAT: &str = "rigsmith.rig/1";

/// A rig file as it was read.
#[derive(Clone, Debug, PartialEq)]
pub struct RigFile {
    pub method: String,
    pub skeleton: Skeleton,
    /// How its joints are turned and what stands about them, where the file says so.
    pub nodes: Option<SceneSkeleton>,
    pub skins: Vec<PartSkin>,
    pub report: Value,
}

impl RigFile {
    /// The rig of a mesh whose parts are those of the file, in the same order.
    pub fn into_rig(self) -> Rig {
        let rows = self.skins.into_iter().flat_map(|skin| skin.weights.rows).collect();
        Rig { skeleton: self.skeleton, skin: SkinWeights { rows } }
    }
}

/// Skin weights of one part.
#[derive(Clone, Debug, PartialEq)]
pub struct PartSkin {
    pub mesh: usize,
    pub primitive: usize,
    pub weights: SkinWeights,
}

/// Most joints of a skeleton that is read: far above any character's, and far below what would exhaust a service.
pub const JOINTS_MAX: usize = 1_000;
/// What is wrong with a file is told in this many characters at most: it may quote the file.
const PROBLEM_CHARS_MAX: usize = 200;

/// Why a rig file cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RigFileError {
    #[error("this is no rig file: line {line}, column {column}: {problem}")]
    Json { line: usize, column: usize, problem: String },
    #[error("the format is {found:?}, expected {FORMAT:?}")]
    Format { found: String },
    #[error("the skeleton cannot be read: {problem}")]
    Unreadable { problem: String },
    #[error("there is no node above both of the joints {first:?} and {second:?}")]
    Apart { first: String, second: String },
    #[error("joint {name:?}: {problem}")]
    Scale { name: String, problem: String },
    #[error("the skeleton has no joints")]
    NoJoints,
    #[error("the skeleton has {found} joints, but at most {JOINTS_MAX} are taken")]
    TooManyJoints { found: usize },
    #[error("joint {joint} ({name:?}): {problem}")]
    Joint { joint: usize, name: String, problem: String },
    #[error("node {node}: {problem}")]
    Node { node: usize, problem: String },
    #[error("skin_order: joint {joint} stands there twice, or does not exist")]
    SkinOrder { joint: usize },
    #[error("skin {skin}, vertex {vertex}: {problem}")]
    Weights { skin: usize, vertex: usize, problem: String },
}

impl RigFileError {
    /// The stable code that scripts match on.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Json { .. } => "invalid_json",
            Self::Format { .. }
            | Self::Unreadable { .. }
            | Self::Apart { .. }
            | Self::Scale { .. }
            | Self::NoJoints
            | Self::TooManyJoints { .. }
            | Self::Joint { .. }
            | Self::Node { .. }
            | Self::SkinOrder { .. }
            | Self::Weights { .. } => "skeleton_invalid",
        }
    }

    /// What the sender can do about it, as one sentence without a full stop.
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Json { .. } => "send the rig.json of an earlier rig, edited",
            Self::Format { .. } => "convert the file to this format, or fetch rig.json again",
            Self::Unreadable { .. } => "send a GLB file with a skin, an FBX file with bones, or a rig.json",
            Self::Apart { .. } => "parent both to one node, such as an armature, and export again",
            Self::Scale { .. } => "apply the scale of the skeleton in a modelling program and export again",
            Self::NoJoints => "give at least a root joint",
            Self::TooManyJoints { .. } => "leave helper joints out",
            Self::Joint { .. } => {
                "list parents before their children, one root first, with unique names and finite positions"
            }
            Self::Node { .. } => {
                "list nodes with parents first, each joint once and below its parent, or leave `nodes` out: joints are then not turned"
            }
            Self::SkinOrder { .. } => "list each joint at most once, or leave `skin_order` out",
            Self::Weights { .. } => "give each vertex as many joints as weights, and at least one weight above zero",
        }
    }
}

#[derive(Serialize)]
struct Written<'a> {
    format: &'static str,
    method: &'a str,
    joints: Vec<WrittenJoint<'a>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    nodes: Option<Vec<NodeEntry>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    skin_order: Option<Vec<usize>>,
    skins: Vec<WrittenSkin<'a>>,
    report: &'a Value,
}

#[derive(Serialize)]
struct WrittenJoint<'a> {
    name: &'a str,
    parent: Option<usize>,
    position: [f64; 3],
}

#[derive(Serialize)]
struct WrittenSkin<'a> {
    mesh: usize,
    primitive: usize,
    #[serde(serialize_with = "joint_rows")]
    joints: &'a [Vec<Influence>],
    #[serde(serialize_with = "weight_rows")]
    weights: &'a [Vec<Influence>],
}

fn joint_rows<S: Serializer>(rows: &&[Vec<Influence>], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(rows.iter().map(|row| row.iter().map(|influence| influence.joint).collect::<Vec<_>>()))
}

fn weight_rows<S: Serializer>(rows: &&[Vec<Influence>], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(rows.iter().map(|row| row.iter().map(|influence| influence.weight).collect::<Vec<_>>()))
}

/// Writes `rig`, whose rows are those of the asset's mesh. Joints have the names that they have in the glTF output; `nodes` are
/// those that came with the skeleton.
pub fn write(
    asset: &Asset,
    rig: &Rig,
    nodes: Option<&SceneSkeleton>,
    names: JointNames,
    method: &str,
    report: &Value,
) -> Vec<u8> {
    let (nodes, skin_order) = nodes.map(skeleton_nodes::entries).unzip();
    let names = gltf::joint_names(asset, &rig.skeleton, names);
    let joint =
        |(joint, name): (&Joint, _)| WrittenJoint { name, parent: joint.parent, position: joint.position.to_array() };
    let skins = asset.parts.iter().map(|part| {
        let rows = rig.skin.rows.get(part.vertices.clone()).unwrap_or_default();
        WrittenSkin { mesh: part.mesh, primitive: part.primitive, joints: rows, weights: rows }
    });
    let written = Written {
        format: FORMAT,
        method,
        joints: rig.skeleton.joints.iter().zip(names.iter().map(String::as_str)).map(joint).collect(),
        nodes,
        skin_order: skin_order.flatten(),
        skins: skins.collect(),
        report,
    };
    serde_json::to_vec(&written).expect("plain data always serializes")
}

/// A skeleton without a mesh, in the same layout: what [`read`] needs to give it back, and its weights where there are `rows`.
pub fn skeleton_json(skeleton: &Skeleton, nodes: Option<&SceneSkeleton>, rows: &[Vec<Influence>]) -> Value {
    let joint =
        |joint: &Joint| json!({ "name": joint.name, "parent": joint.parent, "position": joint.position.to_array() });
    let mut file = json!({ "format": FORMAT, "joints": skeleton.joints.iter().map(joint).collect::<Vec<_>>() });
    if let Some((nodes, skin_order)) = nodes.map(skeleton_nodes::entries) {
        file["nodes"] = json!(nodes);
        if let Some(skin_order) = skin_order {
            file["skin_order"] = json!(skin_order);
        }
    }
    if !rows.is_empty() {
        file["skins"] = json!([WrittenSkin { mesh: 0, primitive: 0, joints: rows, weights: rows }]);
    }
    file
}

#[derive(Deserialize)]
struct Read {
    format: String,
    #[serde(default)]
    method: String,
    joints: Vec<ReadJoint>,
    nodes: Option<Vec<NodeEntry>>,
    skin_order: Option<Vec<usize>>,
    #[serde(default)]
    skins: Vec<ReadSkin>,
    #[serde(default)]
    report: Value,
}

#[derive(Deserialize)]
pub(super) struct ReadJoint {
    pub(super) name: String,
    pub(super) parent: Option<usize>,
    pub(super) position: [f64; 3],
}

#[derive(Deserialize)]
struct ReadSkin {
    #[serde(default)]
    mesh: usize,
    #[serde(default)]
    primitive: usize,
    joints: Vec<Vec<u32>>,
    weights: Vec<Vec<f32>>,
}

/// Reads a rig file. Fields that this version does not know are ignored.
pub fn read(bytes: &[u8]) -> Result<RigFile, RigFileError> {
    let read: Read = serde_json::from_slice(bytes).map_err(|error| RigFileError::Json {
        line: error.line(),
        column: error.column(),
        problem: shown(&error.to_string()),
    })?;
    if read.format != FORMAT {
        return Err(RigFileError::Format { found: shown(&read.format) });
    }
    let skeleton = skeleton(read.joints)?;
    let nodes = read.nodes.map(|nodes| skeleton_nodes::read(nodes, read.skin_order, &skeleton)).transpose()?;
    let joints = skeleton.joints.len();
    let skins = read.skins.into_iter().enumerate().map(|(index, skin)| part_skin(index, skin, joints));
    Ok(RigFile { method: read.method, skins: skins.collect::<Result<_, _>>()?, skeleton, nodes, report: read.report })
}

fn shown(text: &str) -> String {
    text.chars().take(PROBLEM_CHARS_MAX).collect()
}

/// The joints as a skeleton, if they are one tree.
pub(super) fn skeleton(read: Vec<ReadJoint>) -> Result<Skeleton, RigFileError> {
    if read.is_empty() {
        return Err(RigFileError::NoJoints);
    }
    if read.len() > JOINTS_MAX {
        return Err(RigFileError::TooManyJoints { found: read.len() });
    }
    let mut names = BTreeSet::new();
    for (index, joint) in read.iter().enumerate() {
        let problem = match joint.parent {
            None if index > 0 => "only the first joint may be without a parent, the root".to_owned(),
            Some(parent) if parent >= read.len() => {
                format!("its parent, joint {parent}, does not exist: there are {} joints", read.len())
            }
            Some(parent) if is_own_ancestor(&read, index) => {
                format!("its parent, joint {parent}, hangs below it: the joints form a cycle")
            }
            Some(parent) if parent >= index => format!("its parent, joint {parent}, does not come before it"),
            _ if joint.name.is_empty() => "its name is empty".to_owned(),
            _ if !names.insert(joint.name.as_str()) => "another joint has the same name".to_owned(),
            _ if joint.position.iter().any(|value| !(*value as f32).is_finite()) => {
                "its position is not finite in single precision".to_owned()
            }
            _ => continue,
        };
        return Err(RigFileError::Joint { joint: index, name: joint.name.clone(), problem });
    }
    let joint = |joint: ReadJoint| Joint {
        name: joint.name,
        parent: joint.parent,
        position: DVec3::from_array(joint.position),
    };
    Ok(Skeleton { joints: read.into_iter().map(joint).collect() })
}

/// Whether the way from parent to parent leads back to `joint`.
fn is_own_ancestor(joints: &[ReadJoint], joint: usize) -> bool {
    let mut at = joint;
    // A way without a cycle passes each joint once.
    for _ in 0..joints.len() {
        match joints.get(at).and_then(|joint| joint.parent) {
            Some(parent) if parent == joint => return true,
            Some(parent) => at = parent,
            None => return false,
        }
    }
    false
}

fn part_skin(index: usize, skin: ReadSkin, joint_count: usize) -> Result<PartSkin, RigFileError> {
    let fault = |vertex: usize, problem: String| RigFileError::Weights { skin: index, vertex, problem };
    let (joints, weights) = (skin.joints.len(), skin.weights.len());
    if joints != weights {
        return Err(fault(joints.min(weights), format!("{joints} rows of joints, but {weights} rows of weights")));
    }
    let mut rows = Vec::with_capacity(joints);
    for (vertex, (joints, weights)) in skin.joints.iter().zip(&skin.weights).enumerate() {
        if joints.len() != weights.len() {
            return Err(fault(vertex, format!("{} joints, but {} weights", joints.len(), weights.len())));
        }
        if let Some(joint) = joints.iter().find(|joint| **joint as usize >= joint_count) {
            return Err(fault(vertex, format!("joint {joint}, but the skeleton has {joint_count}")));
        }
        if let Some(weight) = weights.iter().find(|weight| !(weight.is_finite() && **weight >= 0.0)) {
            return Err(fault(vertex, format!("the weight {weight} is below zero or not finite")));
        }
        rows.push(row(joints, weights).ok_or_else(|| fault(vertex, "no weight is above zero".into()))?);
    }
    Ok(PartSkin { mesh: skin.mesh, primitive: skin.primitive, weights: SkinWeights { rows } })
}

/// Keeps the promises of [`SkinWeights`]: each joint once, descending, above zero.
fn row(joints: &[u32], weights: &[f32]) -> Option<Vec<Influence>> {
    let mut row: Vec<Influence> = Vec::with_capacity(joints.len());
    for (&joint, &weight) in joints.iter().zip(weights).filter(|(_, weight)| **weight > 0.0) {
        match row.iter_mut().find(|influence| influence.joint == joint) {
            Some(influence) => influence.weight += weight,
            None => row.push(Influence { joint, weight }),
        }
    }
    row.sort_by(|a, b| b.weight.total_cmp(&a.weight).then(a.joint.cmp(&b.joint)));
    (!row.is_empty()).then_some(row)
}
