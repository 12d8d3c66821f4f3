//! A skeleton that a glTF file keeps: every node as it was, and only the weights new.

use super::existing_rigs::{rigged_fixture, samples};
use super::fixtures::*;
use glam::DVec3;
use rigsmith::formats::gltf::{EncodeOptions, JointNames, encode_glb};
use rigsmith::formats::{Asset, DecodeError, DecodeOptions, ExistingRigPolicy, Limits, NoSiblings, decode};
use rigsmith::rig::{Influence, Rig, SkinWeights};
use serde_json::{Value, json};

fn reskin(bytes: &[u8]) -> Result<Asset, DecodeError> {
    let options = DecodeOptions { existing_rig: ExistingRigPolicy::Reskin, ..DecodeOptions::default() };
    decode("character.glb", bytes, &NoSiblings, &Limits::default(), &options)
}

/// Every vertex follows the last joint alone.
fn reskinned(asset: &Asset) -> Vec<u8> {
    let old = asset.old_rig.as_ref().expect("a rig");
    let joint = old.skeleton.joints.len() as u32 - 1;
    let rows = vec![vec![Influence { joint, weight: 1.0 }]; asset.mesh.positions.len()];
    let rig = Rig { skeleton: old.skeleton.clone(), skin: SkinWeights { rows } };
    let options = EncodeOptions { names: JointNames::AsGiven, ..EncodeOptions::default() };
    encode_glb(asset, &rig, &options).expect("written")
}

/// Nodes as a tree walk sees them, but for those that carry a mesh: name, transform, joints below.
fn structure(json: &Value) -> Vec<Value> {
    let nodes = json["nodes"].as_array().expect("nodes");
    let carries_mesh = |index: &Value| nodes[index.as_u64().expect("index") as usize].get("mesh").is_some();
    let described = nodes.iter().filter(|node| node.get("mesh").is_none()).map(|node| {
        let mut node = node.clone();
        let children = node["children"].as_array().cloned().unwrap_or_default();
        node["children"] = children.into_iter().filter(|child| !carries_mesh(child)).collect();
        node
    });
    described.collect()
}

fn joint_names(json: &Value) -> Vec<Value> {
    let joints = json["skins"][0]["joints"].as_array().expect("joints");
    joints.iter().map(|joint| json["nodes"][joint.as_u64().expect("index") as usize]["name"].clone()).collect()
}

fn places(file: &[u8]) -> Vec<DVec3> {
    posed(file).into_iter().flat_map(|shown| shown.positions).collect()
}

#[track_caller]
fn assert_same_shape(sent: &[u8], back: &[u8]) {
    let (before, after) = (places(sent), places(back));
    let size = before.iter().map(|place| place.abs().max_element()).fold(0.0, f64::max);
    assert_eq!(before.len(), after.len());
    assert!(before.iter().zip(&after).all(|(a, b)| a.distance(*b) <= 4e-5 * size), "the mesh jumps");
}

#[test]
fn names_order_orientations_and_other_nodes_stay_and_the_mesh_does_not_jump() {
    let mut builder = rigged_fixture();
    builder.json["skins"][0]["name"] = json!("Body skin");
    builder.json["skins"][0]["joints"] = json!([3, 2]);
    builder.json["skins"][0]["skeleton"] = json!(2);
    let sent = builder.glb();
    let asset = reskin(&sent).expect("reads");
    let old = asset.old_rig.as_ref().expect("a rig");
    let names: Vec<&str> = old.skeleton.joints.iter().map(|joint| joint.name.as_str()).collect();
    assert_eq!((names, old.deforms.as_slice()), (vec!["Hips", "Spine"], &[true, true][..]));
    // The fixture's rows are .75 of the skin's first joint, which is the spine here.
    assert_eq!(old.rows[5], [Influence { joint: 1, weight: 0.75 }, Influence { joint: 0, weight: 0.25 }]);

    let back = reskinned(&asset);
    keep("reskinned", &back);
    let ((before, _), (after, _)) = (open(&sent), open(&back));
    assert_eq!(structure(&after), structure(&before));
    assert_eq!(joint_names(&after), ["Spine", "Hips"]);
    for key in ["name", "skeleton"] {
        assert_eq!(after["skins"][0][key], before["skins"][0][key]);
    }
    assert_eq!(after["animations"].as_array().map(Vec::len), Some(2), "clips of the joints stay");
    assert_same_shape(&sent, &back);
    let spine = posed(&back).iter().all(|shown| shown.joints.iter().all(|joints| joints[0] == 0));
    assert!(spine, "the last joint of the skeleton is the first of the skin");
}

/// Some files name a node as the skin's skeleton that is not above all of its joints.
#[test]
fn a_skeleton_node_that_is_none_is_not_repeated() {
    let mut builder = rigged_fixture();
    builder.json["skins"][0]["joints"] = json!([2, 3]);
    builder.json["skins"][0]["skeleton"] = json!(3);
    let asset = reskin(&builder.glb()).expect("reads");
    assert!(open(&reskinned(&asset)).0["skins"][0]["skeleton"].is_null());
}

#[test]
fn skins_of_several_trees_hang_from_what_is_above_them() {
    let mut builder = rigged_fixture();
    builder.push("nodes", json!({ "name": "Prop", "translation": [1, 0, 0] }));
    builder.json["nodes"][0]["children"] = json!([1, 2, 6]);
    builder.json["skins"][0]["joints"] = json!([2, 6]);
    let asset = reskin(&builder.glb()).expect("reads");
    let old = asset.old_rig.as_ref().expect("a rig");
    let joints: Vec<_> = old.skeleton.joints.iter().map(|joint| (joint.name.as_str(), joint.parent)).collect();
    assert_eq!(joints, [("Armature", None), ("Hips", Some(0)), ("Prop", Some(0))]);
    assert_eq!(old.deforms, [false, true, true]);
    assert_eq!(joint_names(&open(&reskinned(&asset)).0), ["Hips", "Prop"]);

    builder.json["nodes"][0]["children"] = json!([1, 2]);
    builder.json["scenes"][0]["nodes"].as_array_mut().expect("roots").push(json!(6));
    let error = reskin(&builder.glb()).expect_err("refused");
    assert_eq!(error.code(), "skeleton_invalid");
    assert!(
        ["\"Hips\"", "\"Prop\""].iter().all(|name| error.to_string().contains(name))
            && error.hint().contains("armature"),
        "{error}"
    );
}

#[test]
fn what_cannot_be_kept_is_refused_by_name() {
    let error = reskin(&plain().glb()).expect_err("refused");
    assert_eq!((error.clone(), error.code()), (DecodeError::NotRigged, "skeleton_invalid"));
    let mut builder = rigged_fixture();
    builder.json["nodes"][3]["scale"] = json!([0, 1, 1]);
    let error = reskin(&builder.glb()).expect_err("refused");
    assert!(error.to_string().contains("\"Spine\"") && error.hint().contains("scale"), "{error}");
    let mut builder = rigged_fixture();
    builder.json["nodes"][3]["name"] = json!("Hips");
    let error = reskin(&builder.glb()).expect_err("refused");
    assert!(error.to_string().contains("same name"), "{error}");
}

#[test]
fn the_sample_characters_keep_their_skeletons() {
    for (name, sent) in samples().into_iter().filter(|(name, _)| name.ends_with("_rigged")) {
        let asset = reskin(&sent).unwrap_or_else(|error| panic!("{name}: {error}"));
        let back = reskinned(&asset);
        keep(&format!("reskinned_{name}"), &back);
        let ((before, _), (after, _)) = (open(&sent), open(&back));
        assert_eq!(structure(&after), structure(&before), "{name}");
        assert_eq!(joint_names(&after), joint_names(&before), "{name}");
        assert_same_shape(&sent, &back);
        let old = asset.old_rig.expect("a rig");
        assert!(old.rows.iter().all(|row| !row.is_empty()), "{name}");
    }
}
