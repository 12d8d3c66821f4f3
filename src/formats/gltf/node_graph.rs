//! The node graph of an uploaded document: checked, placed in world space, and cut down to the scene that is shown.

use super::FORMAT;
use super::json::{items, malformed, member_reference, numbers, reference};
use crate::formats::{DecodeError, Limits, Place, scene};
use glam::{DMat4, DQuat, DVec3};
use serde_json::Value;

/// Node graph in index order of the document. A forest: every node has at most one parent.
#[derive(Debug)]
pub(super) struct NodeGraph {
    pub(super) parents: Vec<Option<usize>>,
    /// Node indices, every parent before its children.
    pub(super) order: Vec<usize>,
    /// World transforms of the rest pose.
    pub(super) world: Vec<DMat4>,
    /// Nodes of each scene, itself included: `scenes[s][n]`. A document without scenes has one made of all roots.
    scenes: Vec<Vec<bool>>,
    /// The scene that is rigged.
    pub(super) scene: usize,
}

impl NodeGraph {
    pub(super) fn new(json: &Value, limits: &Limits) -> Result<Self, DecodeError> {
        let nodes = items(json, "nodes");
        check_count("nodes", nodes.len(), limits.nodes_max)?;
        let parents = parents(nodes)?;
        let order = parents_first(&parents)?;
        let mut world = vec![DMat4::IDENTITY; nodes.len()];
        for &node in &order {
            let local = local_transform(&nodes[node], node)?;
            world[node] = match parents[node] {
                Some(parent) => world[parent] * local,
                None => local,
            };
            if !world[node].is_finite() {
                return Err(non_finite(node));
            }
        }
        let scenes = scenes(json, &parents, &order)?;
        let scene = member_reference(json, "scene", "scene", scenes.len(), "the document")?.unwrap_or(0);
        Ok(Self { parents, order, world, scenes, scene })
    }

    pub(super) fn is_shown(&self, node: usize) -> bool {
        self.scenes.get(self.scene).is_some_and(|nodes| nodes[node])
    }

    /// Indices of the scenes that a node is in.
    pub(super) fn scenes_of(&self, node: usize) -> Vec<usize> {
        (0..self.scenes.len()).filter(|&scene| self.scenes[scene][node]).collect()
    }

    pub(super) fn is_root(&self, node: usize) -> bool {
        self.parents[node].is_none()
    }
}

pub(super) fn check_count(what: &'static str, found: usize, limit: usize) -> Result<(), DecodeError> {
    if found > limit {
        return Err(DecodeError::TooMany { what, found: found as u64, limit: limit as u64 });
    }
    Ok(())
}

fn non_finite(node: usize) -> DecodeError {
    let place = Place::Element(format!("node {node}"));
    DecodeError::NonFinite { format: FORMAT, place, what: "transform", value: f64::INFINITY }
}

fn parents(nodes: &[Value]) -> Result<Vec<Option<usize>>, DecodeError> {
    let mut parents = vec![None; nodes.len()];
    for (parent, node) in nodes.iter().enumerate() {
        let place = format!("node {parent}");
        for child in items(node, "children") {
            let child = reference(child, "node", nodes.len(), &place)?;
            if let Some(other) = parents[child].replace(parent) {
                return Err(malformed(format!("node {child}"), format!("it is a child of nodes {other} and {parent}")));
            }
        }
    }
    Ok(parents)
}

/// Node indices with every parent before its children. What cannot be reached from a root is on a cycle.
fn parents_first(parents: &[Option<usize>]) -> Result<Vec<usize>, DecodeError> {
    let mut children = vec![Vec::new(); parents.len()];
    for (node, parent) in parents.iter().enumerate() {
        if let Some(parent) = *parent {
            children[parent].push(node);
        }
    }
    let mut order: Vec<usize> = (0..parents.len()).filter(|&node| parents[node].is_none()).collect();
    let mut next = 0;
    // Each node enters the order once, so the loop ends.
    while let Some(&node) = order.get(next) {
        order.extend_from_slice(&children[node]);
        next += 1;
    }
    if order.len() < parents.len() {
        let mut is_placed = vec![false; parents.len()];
        order.iter().for_each(|&node| is_placed[node] = true);
        let node = is_placed.iter().position(|placed| !placed).unwrap_or(0);
        return Err(DecodeError::CyclicNodes { format: FORMAT, node });
    }
    Ok(order)
}

fn local_transform(node: &Value, index: usize) -> Result<DMat4, DecodeError> {
    if let Some(columns) = numbers::<16>(node, "matrix", &format!("node {index}"))? {
        return Ok(DMat4::from_cols_array(&columns));
    }
    let (scale, rotation, translation) = written_parts(node, index)?;
    if rotation == DQuat::IDENTITY && rotation.is_finite() {
        // Exact, so that a chain of untouched nodes leaves positions untouched.
        let axes = DMat4::from_diagonal(scale.extend(1.0));
        return Ok(DMat4::from_cols(axes.x_axis, axes.y_axis, axes.z_axis, translation.extend(1.0)));
    }
    let matrix = DMat4::from_scale_rotation_translation(scale, rotation, translation);
    if matrix.is_finite() { Ok(matrix) } else { Err(non_finite(index)) }
}

/// Scale, rotation and translation of a node. `None` where it has a matrix that is not made of them.
pub(super) fn parts(node: &Value, index: usize) -> Result<Option<(DVec3, DQuat, DVec3)>, DecodeError> {
    match node.get("matrix") {
        Some(_) => Ok(scene::parts_of(&local_transform(node, index)?)),
        None => written_parts(node, index).map(Some),
    }
}

/// Scale, rotation and translation of a node without a matrix.
fn written_parts(node: &Value, index: usize) -> Result<(DVec3, DQuat, DVec3), DecodeError> {
    let place = format!("node {index}");
    let translation = numbers::<3>(node, "translation", &place)?.unwrap_or([0.0; 3]);
    let rotation = numbers::<4>(node, "rotation", &place)?.unwrap_or([0.0, 0.0, 0.0, 1.0]);
    let scale = numbers::<3>(node, "scale", &place)?.unwrap_or([1.0; 3]);
    let rotation = match rotation {
        [0.0, 0.0, 0.0, 1.0] => DQuat::IDENTITY,
        other => {
            let quaternion = DQuat::from_array(other);
            if quaternion.length_squared() > 0.0 { quaternion.normalize() } else { DQuat::IDENTITY }
        }
    };
    Ok((DVec3::from_array(scale), rotation, DVec3::from_array(translation)))
}

/// Which nodes each scene holds.
fn scenes(json: &Value, parents: &[Option<usize>], order: &[usize]) -> Result<Vec<Vec<bool>>, DecodeError> {
    let with_descendants = |mut is_in: Vec<bool>| {
        for &node in order {
            is_in[node] |= parents[node].is_some_and(|parent| is_in[parent]);
        }
        is_in
    };
    let listed = items(json, "scenes");
    if listed.is_empty() {
        return Ok(vec![vec![true; parents.len()]]);
    }
    // Each scene costs a flag per node.
    check_count("scenes", listed.len(), 1024)?;
    let mut scenes = Vec::with_capacity(listed.len());
    for (index, scene) in listed.iter().enumerate() {
        let place = format!("scene {index}");
        let mut is_in = vec![false; parents.len()];
        for root in items(scene, "nodes") {
            let root = reference(root, "node", parents.len(), &place)?;
            if parents[root].is_some() {
                return Err(malformed(place, format!("node {root} is no root")));
            }
            is_in[root] = true;
        }
        scenes.push(with_descendants(is_in));
    }
    Ok(scenes)
}
