//! Poses a rigged glTF file with this library's own linear blend skinning, for comparison with other programs.
//!
//! `pose FILE.glb OUT.pose.json…` (pairs) turns every joint by an angle of its own and writes what the file's vertices
//! should become, in the file's world space:
//!
//! ```json
//! { "height": 1.8,
//!   "joints": [{ "name": "hips", "node": 3, "rotation": [x, y, z, w], "in_world": [x, y, z, w] }, …],
//!   "primitives": [{ "mesh": 0, "primitive": 0, "rest": [[x, y, z], …], "positions": [[x, y, z], …] }, …] }
//! ```
//!
//! The rotation is local to the joint and comes after the joint's own rest rotation; `in_world` is the same turn in the axes of
//! the world at rest.

use glam::{DMat4, DQuat, DVec3};
use rigsmith::rig::linear_blend_skinning::posed_positions;
use rigsmith::rig::{Influence, Joint, Skeleton, SkinWeights};
use serde_json::{Value, json};
use std::error::Error;
use std::path::Path;

/// Largest turn of a joint. Wide enough that wrong bind matrices show, for chains of many joints as well.
const LARGEST_DEGREES: f64 = 40.0;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.is_empty() || !arguments.len().is_multiple_of(2) {
        return Err("usage: pose FILE.glb OUT.pose.json [FILE.glb OUT.pose.json]…".into());
    }
    for pair in arguments.chunks_exact(2) {
        let pose = pose(Path::new(&pair[0])).map_err(|error| format!("{}: {error}", pair[0]))?;
        std::fs::write(&pair[1], serde_json::to_vec(&pose)?)?;
    }
    Ok(())
}

fn pose(path: &Path) -> Result<Value, Box<dyn Error>> {
    let gltf = gltf::Gltf::from_slice(&std::fs::read(path)?)?;
    let buffers = buffers(&gltf, path)?;
    let skin = only(gltf.skins(), "skin")?;
    let (skeleton, orientations) = skeleton(&gltf, &skin, &buffers)?;
    let rotations: Vec<DQuat> = (0..skeleton.joints.len()).map(rotation).collect();
    // Our skinning turns joints about the axes of the world at rest; the file's about their own.
    let in_world: Vec<DQuat> =
        rotations.iter().zip(&orientations).map(|(&turn, &own)| own * turn * own.inverse()).collect();

    let mut primitives = Vec::new();
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for node in gltf.nodes() {
        let (Some(mesh), Some(_)) = (node.mesh(), node.skin()) else { continue };
        for primitive in mesh.primitives() {
            let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(Vec::as_slice));
            let rest: Vec<DVec3> = reader
                .read_positions()
                .ok_or("a primitive without positions")?
                .map(|p| DVec3::from(p.map(f64::from)))
                .collect();
            let joints = reader.read_joints(0).ok_or("a primitive without joints")?.into_u16();
            let weights = reader.read_weights(0).ok_or("a primitive without weights")?.into_f32();
            let rows = joints.zip(weights).map(|(joints, weights)| influences(joints, weights)).collect();
            let posed = posed_positions(&rest, &skeleton, &SkinWeights { rows }, &in_world);
            for position in &rest {
                (low, high) = (low.min(position.y), high.max(position.y));
            }
            primitives.push(json!({
                "mesh": mesh.index(), "primitive": primitive.index(),
                "rest": points(&rest), "positions": points(&posed),
            }));
        }
    }
    if primitives.is_empty() {
        return Err("no mesh of the file has a skin".into());
    }
    let joints = skin.joints().zip(rotations.iter().zip(&in_world)).map(|(joint, (own, in_world))| {
        json!({
            "name": joint.name(), "node": joint.index(),
            "rotation": own.to_array(), "in_world": in_world.to_array(),
        })
    });
    Ok(json!({ "height": high - low, "joints": joints.collect::<Vec<_>>(), "primitives": primitives }))
}

/// Every buffer's bytes: the GLB's own, or files beside it.
fn buffers(gltf: &gltf::Gltf, path: &Path) -> Result<Vec<Vec<u8>>, Box<dyn Error>> {
    gltf.buffers()
        .map(|buffer| match buffer.source() {
            gltf::buffer::Source::Bin => Ok(gltf.blob.clone().ok_or("a GLB without a binary chunk")?),
            gltf::buffer::Source::Uri(uri) => match uri.split_once(";base64,") {
                Some((_, text)) => {
                    use base64::Engine;
                    Ok(base64::engine::general_purpose::STANDARD.decode(text)?)
                }
                None => Ok(std::fs::read(path.with_file_name(uri))?),
            },
        })
        .collect()
}

fn only<T>(mut items: impl Iterator<Item = T>, what: &str) -> Result<T, String> {
    match (items.next(), items.next()) {
        (Some(item), None) => Ok(item),
        (None, _) => Err(format!("no {what}")),
        (Some(_), Some(_)) => Err(format!("more than one {what}")),
    }
}

/// The skin's joints as a skeleton, and their orientations at rest. Both come from the inverse bind matrices, so that they are
/// checked too.
fn skeleton(
    gltf: &gltf::Gltf,
    skin: &gltf::Skin,
    buffers: &[Vec<u8>],
) -> Result<(Skeleton, Vec<DQuat>), Box<dyn Error>> {
    let nodes: Vec<usize> = skin.joints().map(|joint| joint.index()).collect();
    let inverse_bind: Vec<DMat4> = skin
        .reader(|buffer| buffers.get(buffer.index()).map(Vec::as_slice))
        .read_inverse_bind_matrices()
        .ok_or("no inverse bind matrices")?
        .map(|columns| DMat4::from_cols_array_2d(&columns.map(|column| column.map(f64::from))))
        .collect();
    let (mut joints, mut orientations) = (Vec::new(), Vec::new());
    for (place, node) in skin.joints().enumerate() {
        let parent = gltf.nodes().find(|other| other.children().any(|child| child.index() == node.index()));
        let parent = parent.and_then(|parent| nodes.iter().position(|&index| index == parent.index()));
        if parent.is_some_and(|parent| parent >= place) {
            return Err("a joint precedes its parent".into());
        }
        let name = node.name().ok_or("a joint without a name")?.to_owned();
        let bind = inverse_bind.get(place).ok_or("too few inverse bind matrices")?.inverse();
        let (_, orientation, position) = bind.to_scale_rotation_translation();
        joints.push(Joint { name, parent, position });
        orientations.push(orientation);
    }
    Ok((Skeleton { joints }, orientations))
}

fn influences(joints: [u16; 4], weights: [f32; 4]) -> Vec<Influence> {
    joints
        .into_iter()
        .zip(weights)
        .filter(|&(_, weight)| weight > 0.0)
        .map(|(joint, weight)| Influence { joint: u32::from(joint), weight })
        .collect()
}

/// A turn of joint `index` that differs from its neighbours' in axis and angle.
fn rotation(index: usize) -> DQuat {
    let phase = index as f64 * 2.399_963; // the golden angle: no two joints alike
    let axis = DVec3::new(phase.sin(), (1.7 * phase).cos(), (0.6 + phase).sin()).normalize_or(DVec3::Z);
    DQuat::from_axis_angle(axis, (LARGEST_DEGREES * (0.5 + 0.5 * (1.3 * phase).sin())).to_radians())
}

fn points(points: &[DVec3]) -> Vec<[f64; 3]> {
    points.iter().map(|point| point.to_array()).collect()
}
