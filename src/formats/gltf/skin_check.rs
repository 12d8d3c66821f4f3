//! What must hold of every file that leaves: our own reading of the skin-related rules of the Khronos validator, by the
//! validator's codes, and the promises of the output that no validator knows.

use super::accessors::Reader;
use super::encode::EncodeError;
use super::json::{index, items};
use super::kept_skin;
use crate::formats::Limits;
use serde_json::Value;
use std::collections::BTreeMap;

/// Sums of float weights may differ from one by this much per weight that is not zero.
const SUM_TOLERANCE: f32 = 2e-7;

/// Checks every skinned node of a document whose one buffer is `binary`. Joints that were `kept` are as their sender made them:
/// turned, scaled, in any order.
pub(super) fn check(json: &Value, binary: &[u8], kept: bool) -> Result<(), EncodeError> {
    let limits = Limits::default();
    let checker = Checker { json, reader: Reader { json, binary, limits: &limits }, parents: parents(json) };
    let skins = items(json, "skins");
    for skin in 0..skins.len() {
        if kept { checker.kept_skin(skin)? } else { checker.skin(skin)? }
    }
    let mut checked: BTreeMap<(usize, usize), ()> = BTreeMap::new();
    for (number, node) in items(json, "nodes").iter().enumerate() {
        let Some(skin) = node.get("skin").and_then(index) else { continue };
        let place = format!("nodes/{number}");
        let Some(mesh) = node.get("mesh").and_then(index) else {
            return fault("NODE_SKIN_WITHOUT_MESH", place);
        };
        let joints = skins.get(skin).map_or(0, |skin| items(skin, "joints").len());
        checker.node(number, skin, &place)?;
        for (primitive, json) in items(&json["meshes"][mesh], "primitives").iter().enumerate() {
            let place = format!("meshes/{mesh}/primitives/{primitive}");
            let accessor = |name: &str| json["attributes"].get(name).and_then(index).unwrap_or(usize::MAX);
            // Shared attributes are looked at once.
            if checked.insert((accessor("JOINTS_0"), accessor("WEIGHTS_0")), ()).is_none() {
                checker.influences(json, joints, &place)?;
            }
        }
    }
    checker.animations()
}

fn fault<T>(code: &'static str, place: impl Into<String>) -> Result<T, EncodeError> {
    Err(EncodeError::Invalid { code, place: place.into() })
}

fn parents(json: &Value) -> Vec<Option<usize>> {
    let nodes = items(json, "nodes");
    let mut parents = vec![None; nodes.len()];
    for (parent, node) in nodes.iter().enumerate() {
        for child in items(node, "children").iter().filter_map(index) {
            if let Some(slot) = parents.get_mut(child) {
                *slot = Some(parent);
            }
        }
    }
    parents
}

struct Checker<'a> {
    json: &'a Value,
    reader: Reader<'a>,
    parents: Vec<Option<usize>>,
}

impl Checker<'_> {
    fn skin(&self, number: usize) -> Result<(), EncodeError> {
        let place = format!("skins/{number}");
        let skin = &items(self.json, "skins")[number];
        let joints: Vec<usize> = items(skin, "joints").iter().filter_map(index).collect();
        let skeleton = skin.get("skeleton").and_then(index);
        let Some(skeleton) = skeleton.filter(|root| joints.first() == Some(root)) else {
            return fault("SKIN_SKELETON_INVALID", place);
        };
        let accessor = skin.get("inverseBindMatrices").and_then(index);
        let matrices = accessor.and_then(|accessor| self.reader.vectors::<16>(accessor).ok());
        let Some(matrices) = matrices.filter(|matrices| matrices.len() == joints.len()) else {
            return fault("INVALID_IBM_ACCESSOR_COUNT", place);
        };
        let mut rest: BTreeMap<usize, [f64; 3]> = BTreeMap::new();
        for (joint, matrix) in joints.iter().zip(&matrices) {
            let parent = self.parents.get(*joint).copied().flatten();
            let above = match parent {
                None if *joint == skeleton => [0.0; 3],
                Some(parent) if rest.contains_key(&parent) => rest[&parent],
                _ => return fault("SKIN_NO_COMMON_ROOT", place),
            };
            let node = &self.json["nodes"][*joint];
            if ["mesh", "matrix", "rotation", "scale", "camera"].iter().any(|key| node.get(*key).is_some()) {
                return fault("JOINT_NOT_PLAIN", format!("nodes/{joint}"));
            }
            let translation = super::json::numbers::<3>(node, "translation", "").ok().flatten().unwrap_or_default();
            let here = [0, 1, 2].map(|axis| above[axis] + translation[axis]);
            rest.insert(*joint, here);
            let upper = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
            let is_inverse = (0..3)
                .all(|axis| (f64::from(matrix[12 + axis]) + here[axis]).abs() <= 1e-6 * here[axis].abs().max(1.0));
            if matrix[..12] != upper || matrix[15] != 1.0 || !is_inverse {
                return fault("ACCESSOR_INVALID_IBM", place);
            }
        }
        Ok(())
    }

    fn kept_skin(&self, number: usize) -> Result<(), EncodeError> {
        let place = format!("skins/{number}");
        let skin = &items(self.json, "skins")[number];
        let joints: Vec<usize> = items(skin, "joints").iter().filter_map(index).collect();
        let accessor = skin.get("inverseBindMatrices").and_then(index);
        let matrices = accessor.and_then(|accessor| self.reader.vectors::<16>(accessor).ok());
        match matrices.filter(|matrices| !joints.is_empty() && matrices.len() == joints.len()) {
            None => fault("INVALID_IBM_ACCESSOR_COUNT", place),
            Some(matrices) if kept_skin::are_inverses(self.json, &joints, &matrices) => Ok(()),
            Some(_) => fault("ACCESSOR_INVALID_IBM", place),
        }
    }

    fn node(&self, number: usize, skin: usize, place: &str) -> Result<(), EncodeError> {
        let node = &self.json["nodes"][number];
        if ["matrix", "translation", "rotation", "scale"].iter().any(|key| node.get(*key).is_some()) {
            return fault("NODE_SKINNED_MESH_LOCAL_TRANSFORMS", place);
        }
        if self.parents.get(number).copied().flatten().is_some() {
            return fault("NODE_SKINNED_MESH_NON_ROOT", place);
        }
        let joints = items(self.json, "skins").get(skin).map_or(&[][..], |skin| items(skin, "joints"));
        let root = joints.first().and_then(index).map(|joint| self.root_of(joint));
        let shows = |scene: &Value, node: usize| items(scene, "nodes").iter().any(|root| index(root) == Some(node));
        let scenes = items(self.json, "scenes");
        let mut shown = scenes.iter().filter(|scene| shows(scene, number)).peekable();
        let is_together = shown.peek().is_some() && shown.all(|scene| root.is_some_and(|root| shows(scene, root)));
        if is_together { Ok(()) } else { fault("NODE_SKIN_NO_SCENE", place) }
    }

    fn root_of(&self, joint: usize) -> usize {
        let above = |&node: &usize| self.parents.get(node).copied().flatten();
        // No way up passes a node twice; the bound is for documents that are no forest.
        std::iter::successors(Some(joint), above).take(self.parents.len()).last().unwrap_or(joint)
    }

    /// Joints and weights of one primitive.
    fn influences(&self, primitive: &Value, joint_count: usize, place: &str) -> Result<(), EncodeError> {
        let attributes = &primitive["attributes"];
        let sets = |start: &str| {
            attributes.as_object().map_or(0, |all| all.keys().filter(|name| name.starts_with(start)).count())
        };
        if sets("JOINTS_") == 0 || sets("JOINTS_") != sets("WEIGHTS_") {
            return fault("MESH_PRIMITIVE_JOINTS_WEIGHTS_MISMATCH", place);
        }
        let accessor = |name: &str| attributes.get(name).and_then(index);
        let position = accessor("POSITION").and_then(|position| self.reader.accessor(position).ok());
        let vertices = position.map_or(0, |position| position.count);
        let mut rows: Vec<Vec<(u32, f32)>> = vec![Vec::new(); vertices];
        for set in 0..sets("JOINTS_") {
            let joints = accessor(&format!("JOINTS_{set}")).and_then(|joints| self.reader.accessor(joints).ok());
            let weights = accessor(&format!("WEIGHTS_{set}")).and_then(|weights| self.reader.accessor(weights).ok());
            let (Some(joints), Some(weights)) = (joints, weights) else {
                return fault("MESH_PRIMITIVE_JOINTS_WEIGHTS_MISMATCH", place);
            };
            if [&joints, &weights].iter().any(|accessor| accessor.count != vertices || accessor.width != 4) {
                return fault("MESH_PRIMITIVE_UNEQUAL_ACCESSOR_COUNT", place);
            }
            let (Ok(joints), Ok(weights)) = (self.reader.wholes(&joints), self.reader.floats(&weights)) else {
                return fault("MESH_PRIMITIVE_ATTRIBUTES_ACCESSOR_INVALID_FORMAT", place);
            };
            for (row, (joints, weights)) in rows.iter_mut().zip(joints.chunks_exact(4).zip(weights.chunks_exact(4))) {
                row.extend(joints.iter().copied().zip(weights.iter().copied()));
            }
        }
        for (vertex, row) in rows.iter().enumerate() {
            if let Err(code) = check_row(row, joint_count) {
                return fault(code, format!("{place}/vertex {vertex}"));
            }
        }
        Ok(())
    }

    fn animations(&self) -> Result<(), EncodeError> {
        for (number, animation) in items(self.json, "animations").iter().enumerate() {
            for channel in items(animation, "channels") {
                let target = &channel["target"];
                let node = target.get("node").and_then(index).and_then(|node| items(self.json, "nodes").get(node));
                let is_skinned = node.is_some_and(|node| node.get("skin").is_some());
                if is_skinned && target["path"] != "weights" {
                    return fault("ANIMATION_CHANNEL_TARGET_NODE_SKIN", format!("animations/{number}"));
                }
            }
        }
        Ok(())
    }
}

fn check_row(row: &[(u32, f32)], joint_count: usize) -> Result<(), &'static str> {
    let used = row.iter().filter(|(_, weight)| *weight != 0.0).count();
    let sum: f32 = row.iter().map(|(_, weight)| weight).sum();
    if row.iter().any(|(joint, _)| *joint as usize >= joint_count) {
        Err("ACCESSOR_JOINTS_INDEX_OOB")
    } else if row.iter().any(|(joint, weight)| *weight == 0.0 && *joint != 0) {
        Err("ACCESSOR_JOINTS_USED_ZERO_WEIGHT")
    } else if row.iter().any(|(_, weight)| weight.is_nan() || *weight < 0.0) {
        Err("ACCESSOR_WEIGHTS_NEGATIVE")
    } else if used == 0 || (sum - 1.0).abs() > SUM_TOLERANCE * used as f32 {
        Err("ACCESSOR_WEIGHTS_NON_NORMALIZED")
    } else if row.windows(2).any(|pair| pair[0].1 < pair[1].1) {
        Err("WEIGHTS_NOT_DESCENDING")
    } else if (1..used).any(|slot| row[..slot].iter().any(|(joint, _)| *joint == row[slot].0)) {
        Err("ACCESSOR_JOINTS_INDEX_DUPLICATE")
    } else {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// A triangle with a skin of two joints.
    fn skinned() -> (Value, Vec<u8>) {
        let mut binary: Vec<u8> = Vec::new();
        let mut add = |values: &[f32]| binary.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        add(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        add(&[0.75, 0.25, 0.0, 0.0].repeat(3));
        for height in [0.0, -2.0] {
            add(&[1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, height, 0.0, 1.0]);
        }
        binary.extend([0, 1, 0, 0].repeat(3));
        let view = |start: usize, length: usize| json!({ "buffer": 0, "byteOffset": start, "byteLength": length });
        let accessor = |view: usize, component: u32, count: usize, kind: &str| json!({ "bufferView": view, "componentType": component, "count": count, "type": kind });
        let json = json!({
            "scenes": [{ "nodes": [0, 1] }],
            "nodes": [{ "mesh": 0, "skin": 0 }, { "children": [2] }, { "translation": [0, 2, 0] }],
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0, "WEIGHTS_0": 1, "JOINTS_0": 3 } }] }],
            "skins": [{ "joints": [1, 2], "skeleton": 1, "inverseBindMatrices": 2 }],
            "accessors": [accessor(0, 5126, 3, "VEC3"), accessor(1, 5126, 3, "VEC4"), accessor(2, 5126, 2, "MAT4"),
                          accessor(3, 5121, 3, "VEC4")],
            "bufferViews": [view(0, 36), view(36, 48), view(84, 128), view(212, 12)],
        });
        (json, binary)
    }

    #[test]
    fn a_sound_skin_passes_and_each_fault_is_found_by_its_code() {
        let (json, binary) = skinned();
        assert_eq!(check(&json, &binary, false), Ok(()));
        type Change = fn(&mut Value, &mut Vec<u8>);
        let cases: &[(&str, Change)] = &[
            ("SKIN_SKELETON_INVALID", |json, _| json["skins"][0]["skeleton"] = json!(2)),
            ("INVALID_IBM_ACCESSOR_COUNT", |json, _| json["accessors"][2]["count"] = json!(1)),
            ("SKIN_NO_COMMON_ROOT", |json, _| json["nodes"][1] = json!({})),
            ("JOINT_NOT_PLAIN", |json, _| json["nodes"][2]["rotation"] = json!([0, 0, 0, 1])),
            ("ACCESSOR_INVALID_IBM", |json, _| json["nodes"][2]["translation"] = json!([0, 2.1, 0])),
            ("NODE_SKINNED_MESH_LOCAL_TRANSFORMS", |json, _| json["nodes"][0]["scale"] = json!([1, 1, 2])),
            ("NODE_SKINNED_MESH_NON_ROOT", |json, _| json["nodes"][2]["children"] = json!([0])),
            ("NODE_SKIN_NO_SCENE", |json, _| json["scenes"] = json!([{ "nodes": [0] }])),
            ("NODE_SKIN_WITHOUT_MESH", |json, _| json["nodes"][0] = json!({ "skin": 0 })),
            ("MESH_PRIMITIVE_JOINTS_WEIGHTS_MISMATCH", |json, _| {
                json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_1"] = json!(1);
            }),
            ("MESH_PRIMITIVE_UNEQUAL_ACCESSOR_COUNT", |json, _| json["accessors"][3]["count"] = json!(2)),
            ("ACCESSOR_JOINTS_INDEX_OOB", |_, binary| binary[213] = 2),
            ("ACCESSOR_JOINTS_USED_ZERO_WEIGHT", |_, binary| binary[214] = 1),
            ("ACCESSOR_JOINTS_INDEX_DUPLICATE", |_, binary| binary[213] = 0),
            ("ACCESSOR_WEIGHTS_NEGATIVE", |_, binary| binary[43] |= 0x80),
            ("ACCESSOR_WEIGHTS_NON_NORMALIZED", |_, binary| binary[38] = 0),
            ("WEIGHTS_NOT_DESCENDING", |_, binary| binary[36..44].rotate_left(4)),
            ("ANIMATION_CHANNEL_TARGET_NODE_SKIN", |json, _| {
                json["animations"] = json!([{ "channels": [{ "target": { "node": 0, "path": "scale" } }] }]);
            }),
        ];
        for (code, change) in cases {
            let (mut json, mut binary) = skinned();
            change(&mut json, &mut binary);
            match check(&json, &binary, false) {
                Err(EncodeError::Invalid { code: found, .. }) => assert_eq!(found, *code),
                other => panic!("{code}: {other:?}"),
            }
        }
    }
}
