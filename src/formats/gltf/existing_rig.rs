//! The skin that a file came with: found, evaluated, taken away.
//!
//! It is evaluated in the pose that the nodes' rest transforms give, not in the pose of the inverse bind matrices: that
//! is what every viewer shows when the file is opened, so the mesh does not jump when its old skin goes.

use super::accessors::Reader;
use super::bake::{Edit, Frame};
use super::buffers::items_mut_if_any;
use super::json::{index, items, malformed, member_reference, out_of_range, reference, remove};
use super::node_graph::NodeGraph;
use crate::formats::{DecodeError, Finding, Severity};
use glam::{DMat3, DMat4, DVec3};
use serde_json::Value;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

/// Extensions that describe the skeleton of the file and mean nothing without it.
const OF_THE_SKELETON: &[&str] = &[
    "VRM",
    "VRMC_vrm",
    "VRMC_springBone",
    "VRMC_springBone_extended_collider",
    "VRMC_node_constraint",
    "VRMC_vrm_animation",
];

/// A skin whose rest pose moves no vertex farther than this part of the mesh's size leaves the vertices as they are.
const AT_REST: f64 = 1e-5;

/// The skins in use and their joint nodes.
#[derive(Default)]
pub(super) struct OldJoints {
    pub(super) skins: BTreeSet<usize>,
    pub(super) joints: BTreeSet<usize>,
}

/// `None` when no mesh has a skin.
pub(super) fn find(json: &Value) -> Result<Option<OldJoints>, DecodeError> {
    let (nodes, skins) = (items(json, "nodes"), items(json, "skins"));
    let mut used = BTreeSet::new();
    for (number, node) in nodes.iter().enumerate() {
        let skin = member_reference(node, "skin", "skin", skins.len(), &format!("node {number}"))?;
        used.extend(skin.filter(|_| node.get("mesh").is_some()));
    }
    let mut joints = BTreeSet::new();
    for &skin in &used {
        joints.extend(joints_of(json, skin)?);
    }
    Ok((!used.is_empty()).then_some(OldJoints { skins: used, joints }))
}

/// The joint nodes of a skin, as it lists them.
pub(super) fn joints_of(json: &Value, skin: usize) -> Result<Vec<usize>, DecodeError> {
    let place = format!("skin {skin}");
    let nodes = items(json, "nodes").len();
    let listed = items(&items(json, "skins")[skin], "joints");
    // Every joint of a skin is another node.
    if listed.len() > nodes {
        return Err(malformed(place, format!("{} joints, but the file has {nodes} nodes", listed.len())));
    }
    listed.iter().map(|joint| reference(joint, "node", nodes, &place)).collect()
}

/// Joint matrices of the skins that were looked at.
#[derive(Default)]
pub(super) struct Evaluated(BTreeMap<usize, Vec<DMat4>>);

/// How each primitive of a skinned node comes to world space, and which of the frames that is.
pub(super) fn frames(
    edit: &Edit,
    graph: &NodeGraph,
    evaluated: &mut Evaluated,
    node: usize,
    mesh: usize,
) -> Result<(Vec<Frame>, Vec<usize>), DecodeError> {
    let world = graph.world[node];
    let primitives = items(&edit.json["meshes"][mesh], "primitives");
    let skins = items(edit.json, "skins").len();
    let json = &edit.json["nodes"][node];
    let Some(skin) = member_reference(json, "skin", "skin", skins, &format!("node {node}"))? else {
        return Ok((vec![Frame::One(world)], vec![0; primitives.len()]));
    };
    let matrices = match evaluated.0.entry(skin) {
        Entry::Occupied(known) => known.into_mut(),
        Entry::Vacant(new) => new.insert(joint_matrices(edit, graph, skin)?),
    };
    let mut frames = Vec::new();
    let mut frame_of = Vec::new();
    let mut known: BTreeMap<Vec<usize>, usize> = BTreeMap::new();
    for (number, primitive) in primitives.iter().enumerate() {
        let place = format!("mesh {mesh}, primitive {number}");
        let key = influence_accessors(edit.json, primitive, &place)?;
        let frame = match known.get(&key) {
            Some(&frame) => frame,
            None => {
                frames.push(if key.is_empty() {
                    Frame::One(world)
                } else {
                    blended(edit, matrices, primitive, &key, &place)?
                });
                known.insert(key, frames.len() - 1);
                frames.len() - 1
            }
        };
        frame_of.push(frame);
    }
    Ok((frames, frame_of))
}

/// World transform × inverse bind matrix of every joint.
fn joint_matrices(edit: &Edit, graph: &NodeGraph, skin: usize) -> Result<Vec<DMat4>, DecodeError> {
    let place = format!("skin {skin}");
    let joints = joints_of(edit.json, skin)?;
    let accessors = items(edit.json, "accessors").len();
    let json = &items(edit.json, "skins")[skin];
    let inverse_bind = match member_reference(json, "inverseBindMatrices", "accessor", accessors, &place)? {
        Some(accessor) => edit.reader().vectors::<16>(accessor)?,
        None => vec![DMat4::IDENTITY.as_mat4().to_cols_array(); joints.len()],
    };
    if inverse_bind.len() < joints.len() {
        let problem = format!("{} inverse bind matrices for {} joints", inverse_bind.len(), joints.len());
        return Err(malformed(place, problem));
    }
    let matrix =
        |(joint, inverse): (&usize, &[f32; 16])| graph.world[*joint] * DMat4::from_cols_array(&inverse.map(f64::from));
    let matrices: Vec<DMat4> = joints.iter().zip(&inverse_bind).map(matrix).collect();
    if matrices.is_empty() || !matrices.iter().all(DMat4::is_finite) {
        return Err(malformed(place, "no joints, or an inverse bind matrix that is not finite"));
    }
    Ok(matrices)
}

/// Accessors of `JOINTS_0, WEIGHTS_0, JOINTS_1, …` of a primitive, as far as both are there.
fn influence_accessors(json: &Value, primitive: &Value, place: &str) -> Result<Vec<usize>, DecodeError> {
    let accessors = items(json, "accessors").len();
    let attributes = &primitive["attributes"];
    let mut found = Vec::new();
    // Real files have two sets; the bound keeps a hostile one from costing much.
    for set in 0..16 {
        let part = |name: &str| member_reference(attributes, &format!("{name}_{set}"), "accessor", accessors, place);
        let (Some(joints), Some(weights)) = (part("JOINTS")?, part("WEIGHTS")?) else { break };
        found.extend([joints, weights]);
    }
    Ok(found)
}

/// Sets of four that are kept of a file's weights: eight joints per vertex are the most that is written, too.
const SETS_KEPT: usize = 2;

/// Joints (as the skin lists them) and weights of each vertex of a primitive, eight at most.
pub(super) fn influences(edit: &Edit, primitive: &Value, place: &str) -> Result<Vec<Vec<(u32, f32)>>, DecodeError> {
    let reader = edit.reader();
    let position = primitive["attributes"].get("POSITION").and_then(index);
    let count = reader.accessor(position.ok_or_else(|| malformed(place, "no POSITION"))?)?.count;
    let mut rows = vec![Vec::new(); count];
    for pair in influence_accessors(edit.json, primitive, place)?.chunks_exact(2).take(SETS_KEPT) {
        let (joints, weights) = joints_and_weights(&reader, pair, count, place)?;
        for ((row, joints), weights) in rows.iter_mut().zip(joints.as_chunks::<4>().0).zip(&weights) {
            let used = joints.iter().copied().zip(weights.iter().copied()).filter(|(_, weight)| *weight > 0.0);
            row.extend(used);
        }
    }
    Ok(rows)
}

/// One set: four joints and four weights for each of `count` vertices.
fn joints_and_weights(
    reader: &Reader,
    pair: &[usize],
    count: usize,
    place: &str,
) -> Result<(Vec<u32>, Vec<[f32; 4]>), DecodeError> {
    let (joints, weights) = (reader.accessor(pair[0])?, reader.vectors::<4>(pair[1])?);
    if joints.width != 4 || joints.count != count || weights.len() != count {
        return Err(malformed(place, "JOINTS and WEIGHTS are not four per vertex"));
    }
    Ok((reader.wholes(&joints)?, weights))
}

/// Linear blend of the joint matrices per vertex.
fn blended(
    edit: &Edit,
    matrices: &[DMat4],
    primitive: &Value,
    influences: &[usize],
    place: &str,
) -> Result<Frame, DecodeError> {
    let reader = edit.reader();
    let position = primitive["attributes"].get("POSITION").and_then(index);
    let positions = reader.vectors::<3>(position.ok_or_else(|| malformed(place, "no POSITION"))?)?;
    let mut sums = vec![(DMat4::ZERO, 0.0); positions.len()];
    for pair in influences.chunks_exact(2) {
        let (joints, weights) = joints_and_weights(&reader, pair, positions.len(), place)?;
        for ((sum, joints), weights) in sums.iter_mut().zip(joints.as_chunks::<4>().0).zip(&weights) {
            for (&joint, &weight) in joints.iter().zip(weights).filter(|(_, weight)| **weight > 0.0) {
                let matrix = matrices.get(joint as usize);
                let matrix = matrix.ok_or_else(|| out_of_range(place, "joint", i64::from(joint), matrices.len()))?;
                sum.0 += *matrix * f64::from(weight);
                sum.1 += f64::from(weight);
            }
        }
    }
    // A vertex without weights follows the first joint, as viewers do.
    let blend = |(sum, total): (DMat4, f64)| if total > 0.0 { sum * total.recip() } else { matrices[0] };
    let frames: Vec<DMat4> = sums.into_iter().map(blend).collect();
    Ok(if is_at_rest(&frames, &positions) { Frame::One(DMat4::IDENTITY) } else { Frame::PerVertex(frames) })
}

/// True when rounding is all that the skin does to the mesh.
fn is_at_rest(frames: &[DMat4], positions: &[[f32; 3]]) -> bool {
    let points: Vec<DVec3> = positions.iter().map(|point| DVec3::from_array(point.map(f64::from))).collect();
    let low = points.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = points.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    let allowed = AT_REST * (high - low).max_element();
    frames.iter().zip(&points).all(|(frame, &point)| {
        let turned = DMat3::from_mat4(*frame) - DMat3::IDENTITY;
        let largest = [turned.x_axis, turned.y_axis, turned.z_axis].map(|axis| axis.abs().max_element());
        frame.transform_point3(point).distance(point) <= allowed && largest.into_iter().all(|part| part <= 1e-4)
    })
}

/// Takes skins and their attributes out of the document.
pub(super) fn strip(json: &mut Value) {
    remove(json, "skins");
    items_mut_if_any(json, "nodes").iter_mut().for_each(|node| {
        remove(node, "skin");
    });
    strip_influences(json);
}

/// Takes what describes the old skeleton out of the document. Its nodes go later, once the meshes that hang on them have moved
/// ([`removable_nodes`]).
pub(super) fn strip_descriptions(json: &mut Value) -> Vec<Finding> {
    let described: Vec<&str> =
        OF_THE_SKELETON.iter().copied().filter(|name| json["extensions"].get(*name).is_some()).collect();
    for name in OF_THE_SKELETON {
        super::document::remove_extension(json, name);
    }
    if described.is_empty() {
        return Vec::new();
    }
    vec![Finding {
        code: "skeleton_description_removed",
        parts: Vec::new(),
        severity: Severity::Warning,
        message: format!("{} described the old skeleton and went with it", described.join(", ")),
        hint: String::new(),
    }]
}

/// Removes every `JOINTS_n` and `WEIGHTS_n`.
pub(super) fn strip_influences(json: &mut Value) {
    for mesh in items_mut_if_any(json, "meshes") {
        for primitive in items_mut_if_any(mesh, "primitives") {
            if let Some(attributes) = primitive.get_mut("attributes").and_then(Value::as_object_mut) {
                attributes.retain(|name, _| !name.starts_with("JOINTS_") && !name.starts_with("WEIGHTS_"));
            }
        }
    }
}

/// Nodes that were only part of the old skeleton: joints, what hangs on joints and shows nothing, and the empty
/// holders above them. What keeps a child stays.
pub(super) fn removable_nodes(json: &Value, graph: &NodeGraph, joints: &BTreeSet<usize>) -> BTreeSet<usize> {
    let nodes = items(json, "nodes");
    let count = graph.parents.len();
    let mut is_in_skeleton = vec![false; count];
    for &node in &graph.order {
        let is_below = graph.parents[node].is_some_and(|parent| is_in_skeleton[parent]);
        is_in_skeleton[node] = is_below || joints.contains(&node);
    }
    let mut holds_skeleton = vec![false; count];
    let mut removable = BTreeSet::new();
    for &node in graph.order.iter().rev() {
        let json = &nodes[node];
        if let Some(parent) = graph.parents[node] {
            holds_skeleton[parent] |= holds_skeleton[node] || joints.contains(&node);
        }
        let shows_nothing = ["mesh", "camera", "extensions"].iter().all(|key| json.get(*key).is_none());
        let is_of_skeleton = is_in_skeleton[node] || (holds_skeleton[node] && json.get("extras").is_none());
        let mut children = items(json, "children").iter().filter_map(index);
        if shows_nothing && is_of_skeleton && children.all(|child| removable.contains(&child)) {
            removable.insert(node);
        }
    }
    removable
}
