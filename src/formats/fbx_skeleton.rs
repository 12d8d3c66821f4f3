//! Bones, clusters and weights of an FBX file.
//!
//! Joints are the bones that a skin of the file names; in a file without a skin, all its bones. They keep name, order, parent and
//! orientation. The unit of the file is in their translations, not in a scale above them: engines expect joints of scale one.

use super::fbx::FORMAT;
use super::old_rig::{GraphNode, OldRig, row_of, skeleton_of};
use super::rig_json::RigFileError;
use super::scene::{SHEARED, SceneSkeleton, SkeletonNode, parts_of};
use super::skeleton_nodes::{FileNode, about_joints};
use super::{DecodeError, Limits, Place};
use crate::rig::{Influence, Skeleton};
use glam::{DMat4, DQuat, DVec3};
use std::collections::{BTreeMap, BTreeSet};

/// A vertex that its skin moves by no more than this part of the mesh's size is at rest.
const AT_REST: f64 = 1e-5;

/// The nodes of a file and the joints among them.
pub(super) struct FbxSkeleton {
    /// Index in `scene.nodes` of each of `nodes`.
    of: Vec<u32>,
    parents: Vec<Option<usize>>,
    /// World transforms without the file's unit.
    world: Vec<DMat4>,
    names: Vec<String>,
    joints: Vec<usize>,
    pub(super) skeleton: Skeleton,
    /// Node (as `of` counts) of each joint of `skeleton`.
    joint_nodes: Vec<usize>,
}

impl FbxSkeleton {
    /// `None` without bones.
    pub(super) fn read(scene: &ufbx::Scene) -> Result<Option<Self>, RigFileError> {
        let joint_ids = joint_ids(scene);
        if joint_ids.is_empty() {
            return Ok(None);
        }
        // Nodes come with parents before children. One that only carries a mesh is written with the mesh.
        let nodes: Vec<&ufbx::Node> = scene.nodes.into_iter().collect();
        let mut holds = vec![false; nodes.len()];
        for (at, node) in nodes.iter().enumerate().rev() {
            holds[at] |= joint_ids.contains(&id(node)) || (node.mesh.is_none() && !node.is_root);
            if let Some(parent) = node.parent.as_ref().filter(|_| holds[at]) {
                holds[parent.element.typed_id as usize] = true;
            }
        }
        let kept: Vec<usize> = (0..nodes.len()).filter(|&at| holds[at] && !nodes[at].is_root).collect();
        let index_of: BTreeMap<u32, usize> =
            kept.iter().enumerate().map(|(index, &at)| (id(nodes[at]), index)).collect();
        let unit = unit(scene);
        let world: Vec<DMat4> = kept
            .iter()
            .map(|&at| matrix(&nodes[at].node_to_world) * DMat4::from_scale(DVec3::splat(unit.recip())))
            .collect();
        let parents: Vec<Option<usize>> = kept
            .iter()
            .map(|&at| nodes[at].parent.as_ref().and_then(|parent| index_of.get(&id(parent)).copied()))
            .collect();
        let names: Vec<String> = kept.iter().map(|&at| nodes[at].element.name.to_string()).collect();
        let of: Vec<u32> = kept.iter().map(|&at| id(nodes[at])).collect();
        let joints: Vec<usize> = (0..of.len()).filter(|&index| joint_ids.contains(&of[index])).collect();
        let graph: Vec<GraphNode> = (0..of.len())
            .map(|index| GraphNode {
                name: &names[index],
                parent: parents[index],
                position: world[index].w_axis.truncate(),
                is_joint: joint_ids.contains(&of[index]),
            })
            .collect();
        let (skeleton, joint_nodes) = skeleton_of(&graph)?;
        Ok(Some(Self { of, parents, world, names, joints, skeleton, joint_nodes }))
    }

    /// The nodes as they are written.
    pub(super) fn scene_skeleton(&self) -> Result<SceneSkeleton, RigFileError> {
        let nodes = (0..self.of.len()).map(|index| {
            let name = self.names[index].clone();
            match self.parts(index) {
                Some((scale, rotation, translation)) => {
                    Ok(SkeletonNode { name, parent: self.parents[index], translation, rotation, scale })
                }
                None => Err(RigFileError::Scale { name, problem: SHEARED.to_owned() }),
            }
        });
        Ok(SceneSkeleton {
            nodes: nodes.collect::<Result<_, _>>()?,
            joints: self.joints.clone(),
            places: self.places(),
        })
    }

    /// Scale, rotation and translation of a node, relative to its parent; `None` where they do not say its transform, or where
    /// nothing could follow it.
    fn parts(&self, index: usize) -> Option<(DVec3, DQuat, DVec3)> {
        let above = self.parents[index].map_or(DMat4::IDENTITY, |parent| self.world[parent]);
        let local = above.inverse() * self.world[index];
        parts_of(&local).filter(|_| self.world[index].inverse().is_finite())
    }

    /// Those of the nodes that stand above, between or under joints.
    fn nodes_about_joints(&self) -> Result<SceneSkeleton, RigFileError> {
        let joint_of: BTreeMap<usize, usize> =
            self.joint_nodes.iter().enumerate().map(|(joint, &node)| (node, joint)).collect();
        // A node that only carries a mesh is none of `of`, unless it holds others together.
        let nodes = (0..self.of.len()).map(|index| FileNode {
            name: self.names[index].clone(),
            parent: self.parents[index],
            parts: self.parts(index),
            joint: joint_of.get(&index).copied(),
            has_mesh: false,
        });
        let order = self.joints.iter().filter_map(|node| joint_of.get(node).copied()).collect();
        about_joints(nodes.collect(), order, &self.skeleton)
    }

    /// Place among the joints of the skin of each joint of the skeleton.
    fn places(&self) -> Vec<Option<u32>> {
        let place = |node| self.joints.iter().position(|joint| joint == node).map(|place| place as u32);
        self.joint_nodes.iter().map(place).collect()
    }

    /// The rig of the file, with the weights of all `parts` (nodes with a mesh), one after another.
    pub(super) fn old_rig(&self, parts: &[&ufbx::Mesh]) -> OldRig {
        let joint_of: BTreeMap<u32, u32> =
            (0..).zip(&self.joint_nodes).map(|(joint, &node)| (self.of[node], joint)).collect();
        let rows = parts.iter().flat_map(|mesh| {
            let mut rows: Vec<Vec<Influence>> = vec![Vec::new(); mesh.num_vertices];
            for (node, vertex, weight) in weights(mesh) {
                if let (Some(&joint), Some(row)) = (joint_of.get(&node), rows.get_mut(vertex as usize)) {
                    row.push(Influence { joint, weight: weight as f32 });
                }
            }
            rows.into_iter().map(row_of).collect::<Vec<_>>()
        });
        let deforms = self.places().iter().map(Option::is_some).collect();
        OldRig { skeleton: self.skeleton.clone(), deforms, rows: rows.collect() }
    }
}

/// Reads the skeleton of an FBX file, and the nodes about it, for a sender who has a skeleton of their own.
pub fn read_skeleton(bytes: &[u8], limits: &Limits) -> Result<(Skeleton, SceneSkeleton), RigFileError> {
    let unreadable = |problem: String| RigFileError::Unreadable { problem };
    let root = super::fbx::load(bytes, limits).map_err(|error| unreadable(error.to_string()))?;
    let (found, limit) = (root.nodes.count as u64, limits.nodes_max as u64);
    if found > limit {
        return Err(unreadable(DecodeError::TooMany { what: "nodes", found, limit }.to_string()));
    }
    let read = FbxSkeleton::read(&root)?.ok_or(RigFileError::NoJoints)?;
    let nodes = read.nodes_about_joints()?;
    Ok((read.skeleton, nodes))
}

/// How the skin of a mesh moves each of its vertices to the world in the file's pose. `None` where it leaves the vertices where
/// the node puts them, or where there is no skin.
pub(super) fn posed(node: &ufbx::Node, mesh: &ufbx::Mesh) -> Result<Option<Vec<DMat4>>, DecodeError> {
    let plain = matrix(&node.geometry_to_world);
    let mut sums = vec![(DMat4::ZERO, 0.0); mesh.num_vertices];
    for cluster in clusters(mesh) {
        let to_world = matrix(&cluster.geometry_to_world);
        if !to_world.is_finite() {
            let place = Place::Element(format!("the skin of {:?}", node.element.name.to_string()));
            return Err(DecodeError::Malformed {
                format: FORMAT,
                place,
                problem: "a bind matrix is not finite".into(),
            });
        }
        for (&vertex, &weight) in cluster.vertices.iter().zip(cluster.weights.iter()) {
            if let Some(sum) = sums.get_mut(vertex as usize).filter(|_| weight.is_finite() && weight > 0.0) {
                sum.0 += to_world * weight;
                sum.1 += weight;
            }
        }
    }
    let frames: Vec<DMat4> =
        sums.into_iter().map(|(sum, total)| if total > 0.0 { sum * total.recip() } else { plain }).collect();
    let places = || mesh.vertices.iter().map(|vertex| DVec3::new(vertex.x, vertex.y, vertex.z));
    let world = || places().map(|place| plain.transform_point3(place));
    let low = world().fold(DVec3::INFINITY, DVec3::min);
    let high = world().fold(DVec3::NEG_INFINITY, DVec3::max);
    let allowed = AT_REST * (high - low).max_element();
    let is_at_rest = frames
        .iter()
        .zip(places())
        .zip(world())
        .all(|((frame, place), world)| frame.transform_point3(place).distance(world) <= allowed);
    Ok((!is_at_rest).then_some(frames))
}

/// Bones that a skin names; without any, all bones.
fn joint_ids(scene: &ufbx::Scene) -> BTreeSet<u32> {
    let clusters = scene.skin_deformers.into_iter().flat_map(|skin| skin.clusters.into_iter());
    let named: BTreeSet<u32> = clusters.filter_map(|cluster| cluster.bone_node.as_ref()).map(|node| id(node)).collect();
    if !named.is_empty() {
        return named;
    }
    scene.nodes.into_iter().filter(|node| node.bone.is_some()).map(id).collect()
}

fn clusters(mesh: &ufbx::Mesh) -> impl Iterator<Item = &ufbx::SkinCluster> {
    mesh.skin_deformers.into_iter().flat_map(|skin| skin.clusters.into_iter())
}

/// Bone node, vertex and weight of everything that the skin of a mesh says.
fn weights(mesh: &ufbx::Mesh) -> impl Iterator<Item = (u32, u32, f64)> {
    clusters(mesh).filter_map(|cluster| Some((id(cluster.bone_node.as_ref()?), cluster))).flat_map(|(node, cluster)| {
        cluster.vertices.iter().zip(cluster.weights.iter()).map(move |(&vertex, &weight)| (node, vertex, weight))
    })
}

fn id(node: &ufbx::Node) -> u32 {
    node.element.typed_id
}

/// Metres of the file's unit: the scale of the node above all.
fn unit(scene: &ufbx::Scene) -> f64 {
    let unit = matrix(&scene.root_node.node_to_world).x_axis.truncate().length();
    if unit.is_normal() { unit } else { 1.0 }
}

fn matrix(m: &ufbx::Matrix) -> DMat4 {
    DMat4::from_cols_array(&[
        m.m00, m.m10, m.m20, 0.0, m.m01, m.m11, m.m21, 0.0, m.m02, m.m12, m.m22, 0.0, m.m03, m.m13, m.m23, 1.0,
    ])
}
