//! A skin for a document: joint nodes, inverse bind matrices, joints and weights of every vertex.
//!
//! Everything is appended; what the sender's document holds stays where it is. The same input gives the same bytes.

use super::buffers::append_view;
use super::json::{items, push, text};
use super::kept_skin::KeptSkin;
use super::skin_weights::{Slots, WeightFormat};
use super::{Document, container, flatten, scene_document, skin_check};
use crate::formats::{Asset, SceneSkeleton, Source};
use crate::rig::{Rig, Skeleton};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::{DVec3, Vec3};
use serde_json::{Value, json};
use std::borrow::Cow;
use std::collections::BTreeSet;

/// How the skin is written.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodeOptions {
    /// Most joints per vertex; more than four make a second set, which three.js, Godot and Filament ignore.
    pub influences_max: usize,
    pub weights: WeightFormat,
    pub names: JointNames,
    /// The nodes that came with the skeleton, where it was given in a file of its own: they are written as they are, and its joints
    /// with them.
    pub nodes: Option<SceneSkeleton>,
    /// Goes to `asset.extras.rigsmith`: method, model digests and the like.
    pub provenance: Option<Value>,
}

impl Default for EncodeOptions {
    fn default() -> Self {
        Self {
            influences_max: 4,
            weights: WeightFormat::Float,
            names: JointNames::Plain,
            nodes: None,
            provenance: None,
        }
    }
}

/// How joints are named in the output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum JointNames {
    /// Plain ASCII, and different from every name in the document.
    #[default]
    Plain,
    /// As the skeleton has them: a sender's own names, which animations and scripts refer to.
    AsGiven,
}

/// Why no file could be written. The rig is at fault, or this program; never the sender.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EncodeError {
    #[error("the rig has weights for {rows} vertices, but the mesh has {vertices}")]
    RowCount { rows: usize, vertices: usize },
    #[error("vertex {vertex} has no usable weight")]
    NoWeight { vertex: usize },
    #[error("vertex {vertex} refers to joint {joint}, but the skeleton has {joints}")]
    UnknownJoint { vertex: usize, joint: u32, joints: usize },
    #[error("joint {joint} {problem}")]
    Skeleton { joint: usize, problem: &'static str },
    #[error("the skeleton has {joints} joints, but must have 1 to {limit}")]
    JointCount { joints: usize, limit: usize },
    #[error("the file would be larger than the 4 GiB that GLB can say")]
    TooLarge,
    #[error("the written file breaks {code} at {place}")]
    Invalid { code: &'static str, place: String },
}

impl EncodeError {
    /// The stable code that scripts match on.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Skeleton { .. } | Self::JointCount { .. } => "skeleton_invalid",
            Self::RowCount { .. } | Self::NoWeight { .. } | Self::UnknownJoint { .. } => "output_invalid",
            Self::TooLarge => "too_large",
            Self::Invalid { .. } => "output_invalid",
        }
    }
}

/// The uploaded file with `rig` in it, as GLB.
pub fn encode_glb(asset: &Asset, rig: &Rig, options: &EncodeOptions) -> Result<Vec<u8>, EncodeError> {
    let document = document(asset);
    let (json, binary) = with_skin(&document, asset, rig, options)?;
    container::join(json.to_string().as_bytes(), &binary, &document.other_chunks).ok_or(EncodeError::TooLarge)
}

/// The uploaded file with `rig` in it, as one JSON file that holds its buffer as a data URI.
pub fn encode_gltf(asset: &Asset, rig: &Rig, options: &EncodeOptions) -> Result<Vec<u8>, EncodeError> {
    let document = document(asset);
    let (mut json, binary) = with_skin(&document, asset, rig, options)?;
    let data = format!("data:application/octet-stream;base64,{}", STANDARD.encode(&binary));
    json["buffers"][0]["uri"] = json!(data);
    Ok(json.to_string().into_bytes())
}

/// Joint names as they stand in the output.
pub fn joint_names(asset: &Asset, skeleton: &Skeleton, names: JointNames) -> Vec<String> {
    let taken = || match &asset.source {
        Source::Gltf(document) => names_in(&document.json),
        Source::Scene(scene) => scene.nodes.iter().map(|node| node.name.clone()).collect(),
    };
    named(taken, skeleton, names)
}

fn named(taken: impl FnOnce() -> BTreeSet<String>, skeleton: &Skeleton, names: JointNames) -> Vec<String> {
    match names {
        JointNames::Plain => unique_names(taken(), skeleton),
        JointNames::AsGiven => skeleton.joints.iter().map(|joint| joint.name.clone()).collect(),
    }
}

fn document(asset: &Asset) -> Cow<'_, Document> {
    match &asset.source {
        Source::Gltf(document) => Cow::Borrowed(document),
        Source::Scene(scene) => Cow::Owned(scene_document::build(scene, &asset.mesh)),
    }
}

fn with_skin(
    document: &Document,
    asset: &Asset,
    rig: &Rig,
    options: &EncodeOptions,
) -> Result<(Value, Vec<u8>), EncodeError> {
    check_skeleton(&rig.skeleton)?;
    let vertices = asset.mesh.positions.len();
    if rig.skin.rows.len() != vertices {
        return Err(EncodeError::RowCount { rows: rig.skin.rows.len(), vertices });
    }
    let (mut json, mut binary) = (document.json.clone(), document.binary.clone());
    let own = options.nodes.as_ref().filter(|_| document.kept.is_none());
    let own = own.map(|nodes| KeptSkin::of_nodes(&mut json, nodes));
    let kept = document.kept.as_ref().or(own.as_ref());
    let (skin, slots) = match kept {
        None => {
            let skin = add_skin(&mut json, &mut binary, document, &rig.skeleton, options.names);
            (skin, Slots::new(&rig.skin, rig.skeleton.joints.len(), options)?)
        }
        Some(kept) => {
            let skin = kept.add(&mut json, &mut binary, document)?;
            (skin, Slots::new(&kept.in_places(&rig.skin)?, kept.nodes.len(), options)?)
        }
    };
    add_weights(&mut json, &mut binary, document, &slots);
    for primitive in &document.skinned {
        json["nodes"][primitive.node]["skin"] = json!(skin);
    }
    sign(&mut json, options);
    // The buffer's length is the chunk's.
    binary.resize(binary.len().next_multiple_of(4), 0);
    super::buffers::set_buffer_length(&mut json, binary.len());
    skin_check::check(&json, &binary, kept.is_some())?;
    Ok((json, binary))
}

fn check_skeleton(skeleton: &Skeleton) -> Result<(), EncodeError> {
    let joints = skeleton.joints.len();
    let limit = usize::from(u16::MAX);
    if joints == 0 || joints > limit {
        return Err(EncodeError::JointCount { joints, limit });
    }
    for (joint, described) in skeleton.joints.iter().enumerate() {
        let problem = match described.parent {
            None if joint > 0 => "has no parent, but is not the root",
            Some(parent) if parent >= joint => "comes before its parent",
            _ if !described.position.as_vec3().is_finite() => "has a position that is not finite",
            _ => continue,
        };
        return Err(EncodeError::Skeleton { joint, problem });
    }
    Ok(())
}

/// Appends joint nodes, inverse bind matrices and the skin; returns the skin's index.
fn add_skin(
    json: &mut Value,
    binary: &mut Vec<u8>,
    document: &Document,
    skeleton: &Skeleton,
    names: JointNames,
) -> usize {
    let names = named(|| names_in(json), skeleton, names);
    let first = items(json, "nodes").len();
    let mut rest: Vec<DVec3> = Vec::with_capacity(skeleton.joints.len());
    let mut matrices = Vec::with_capacity(skeleton.joints.len() * 64);
    for (joint, name) in skeleton.joints.iter().zip(&names) {
        // Places that single precision holds, and differences in double: inverse bind matrices are then exact inverses.
        let place = joint.position.as_vec3().as_dvec3();
        let parent = joint.parent.map_or(DVec3::ZERO, |parent| rest[parent]);
        rest.push(place);
        push(json, "nodes", json!({ "name": name, "translation": (place - parent).to_array() }));
        matrices.extend(inverse_bind_matrix(place).iter().flat_map(|value| value.to_le_bytes()));
    }
    for (index, joint) in skeleton.joints.iter().enumerate() {
        if let Some(parent) = joint.parent {
            super::json::items_mut(&mut json["nodes"][first + parent], "children").push(json!(first + index));
        }
    }
    flatten::show_in_scenes(json, &document.scenes, first);
    let view = append_view(json, binary, &matrices);
    let count = skeleton.joints.len();
    let accessor = json!({ "bufferView": view, "componentType": 5126, "count": count, "type": "MAT4" });
    let accessor = push(json, "accessors", accessor);
    let joints: Vec<usize> = (first..first + count).collect();
    push(json, "skins", json!({ "inverseBindMatrices": accessor, "joints": joints, "skeleton": first }))
}

/// Joints have no rotation and no scale in the rest pose, so the inverse is a translation. Column-major.
fn inverse_bind_matrix(rest: DVec3) -> [f32; 16] {
    // `0.0 -` rather than `-`: no negative zeros.
    let Vec3 { x, y, z } = (DVec3::ZERO - rest).as_vec3();
    [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, x, y, z, 1.0]
}

/// Names of a document's nodes and meshes.
fn names_in(json: &Value) -> BTreeSet<String> {
    let named = ["nodes", "meshes"].into_iter().flat_map(|list| items(json, list));
    named.map(|thing| text(thing, "name").to_owned()).collect()
}

fn unique_names(mut taken: BTreeSet<String>, skeleton: &Skeleton) -> Vec<String> {
    let mut names = Vec::with_capacity(skeleton.joints.len());
    for (index, joint) in skeleton.joints.iter().enumerate() {
        let plain = |c: char| if c.is_ascii_alphanumeric() || c == '_' { c } else { '_' };
        let wanted: String = joint.name.chars().map(plain).collect();
        let wanted = if wanted.is_empty() { format!("joint_{index}") } else { wanted };
        let mut name = wanted.clone();
        // At most as many turns as names are taken.
        for number in 2_usize.. {
            if taken.insert(name.clone()) {
                break;
            }
            name = format!("{wanted}_{number}");
        }
        names.push(name);
    }
    names
}

/// Appends `JOINTS_n` and `WEIGHTS_n` of every primitive. Primitives that share their vertices share these too.
fn add_weights(json: &mut Value, binary: &mut Vec<u8>, document: &Document, slots: &Slots) {
    struct Written {
        position: Value,
        set: usize,
        bytes: [(usize, usize); 2],
        accessors: [usize; 2],
    }
    let mut written: Vec<Written> = Vec::new();
    for primitive in &document.skinned {
        let position =
            json["meshes"][primitive.mesh]["primitives"][primitive.primitive]["attributes"]["POSITION"].clone();
        for set in 0..slots.sets {
            let joints = slots.joint_bytes(&primitive.rows, set);
            let weights = slots.weight_bytes(&primitive.rows, set);
            let is_same = |known: &&Written| {
                known.position == position
                    && known.set == set
                    && binary.get(known.bytes[0].0..known.bytes[0].1) == Some(joints.as_slice())
                    && binary.get(known.bytes[1].0..known.bytes[1].1) == Some(weights.as_slice())
            };
            let accessors = match written.iter().find(is_same) {
                Some(known) => known.accessors,
                None => {
                    let count = primitive.rows.len();
                    let mut append = |bytes: &[u8], component: u32, normalized: bool| {
                        let view = append_view(json, binary, bytes);
                        json["bufferViews"][view]["target"] = json!(34962);
                        let mut accessor =
                            json!({ "bufferView": view, "componentType": component, "count": count, "type": "VEC4" });
                        if normalized {
                            accessor["normalized"] = json!(true);
                        }
                        (push(json, "accessors", accessor), (binary.len() - bytes.len(), binary.len()))
                    };
                    let (joint_accessor, joint_range) = append(&joints, slots.joint_component(), false);
                    let weight_component = slots.weights.component();
                    let (weight_accessor, weight_range) = append(&weights, weight_component, weight_component != 5126);
                    let (position, accessors) = (position.clone(), [joint_accessor, weight_accessor]);
                    written.push(Written { position, set, bytes: [joint_range, weight_range], accessors });
                    accessors
                }
            };
            let attributes = &mut json["meshes"][primitive.mesh]["primitives"][primitive.primitive]["attributes"];
            attributes[format!("JOINTS_{set}")] = json!(accessors[0]);
            attributes[format!("WEIGHTS_{set}")] = json!(accessors[1]);
        }
    }
}

/// Writes who made the file, and keeps who made it before.
fn sign(json: &mut Value, options: &EncodeOptions) {
    let asset = &mut json["asset"];
    let before = text(asset, "generator").to_owned();
    asset["generator"] = json!(super::GENERATOR);
    let mut ours = match &options.provenance {
        Some(Value::Object(provenance)) => provenance.clone(),
        Some(other) => serde_json::Map::from_iter([("provenance".to_owned(), other.clone())]),
        None => serde_json::Map::new(),
    };
    if !before.is_empty() && before != super::GENERATOR {
        ours.insert("source_generator".into(), json!(before));
    }
    // Extras of the sender that are no object have no room for ours.
    let is_open = asset.get("extras").is_none_or(Value::is_object);
    if !ours.is_empty() && is_open {
        asset["extras"]["rigsmith"] = Value::Object(ours);
    }
}
