//! A skeleton that comes in a file of its own: its joints are turned as they were, and what hangs on them comes along.

use super::existing_rigs::rigged_fixture;
use super::fixtures::*;
use glam::{DMat4, DVec3};
use rigsmith::formats::gltf::{EncodeOptions, JointNames, encode_glb, read_skeleton};
use rigsmith::formats::{Asset, Limits, SceneSkeleton, rig_json};
use rigsmith::rig::{Influence, Rig, Skeleton, SkinWeights};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// The fixture's skeleton below an armature of half the size that lies on its back; the hips are given by a matrix, and the skin
/// lists its joints the other way round.
fn turned() -> Vec<u8> {
    let mut builder = rigged_fixture();
    builder.json["skins"][0]["joints"] = json!([3, 2]);
    let armature = &mut builder.json["nodes"][0];
    (armature["scale"], armature["rotation"]) = (json!([0.5, 0.5, 0.5]), json!([-0.6, 0, 0, 0.8]));
    builder.json["nodes"][2]["matrix"] = json!([0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0.5, 0, 0.25, 1]);
    // Has nothing to do with the joints, so that its shear harms nobody.
    builder.push("nodes", json!({ "name": "Lamp", "matrix": [1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] }));
    builder.json["scenes"][0]["nodes"].as_array_mut().expect("roots").push(json!(6));
    builder.glb()
}

fn halves(asset: &Asset, skeleton: &Skeleton) -> Rig {
    let row = vec![Influence { joint: 0, weight: 0.5 }, Influence { joint: 1, weight: 0.5 }];
    Rig { skeleton: skeleton.clone(), skin: SkinWeights { rows: vec![row; asset.mesh.positions.len()] } }
}

fn written(asset: &Asset, skeleton: &Skeleton, nodes: &SceneSkeleton) -> Vec<u8> {
    let options = EncodeOptions { names: JointNames::AsGiven, nodes: Some(nodes.clone()), ..EncodeOptions::default() };
    encode_glb(asset, &halves(asset, skeleton), &options).expect("written")
}

/// Name of the parent and world transform of each node, by name.
fn placed(file: &[u8]) -> BTreeMap<String, (Option<String>, DMat4)> {
    let document = gltf::Gltf::from_slice(file).expect("the gltf crate reads it").document;
    let name = |node: &gltf::Node| node.name().expect("a name").to_owned();
    let mut parents = BTreeMap::new();
    for node in document.nodes() {
        parents.extend(node.children().map(|child| (child.index(), name(&node))));
    }
    let world = world_transforms(&document);
    document.nodes().map(|node| (name(&node), (parents.get(&node.index()).cloned(), world[node.index()]))).collect()
}

fn names(json: &Value) -> Vec<&str> {
    json["nodes"].as_array().expect("nodes").iter().map(|node| node["name"].as_str().expect("a name")).collect()
}

fn joint_names(json: &Value) -> Vec<&str> {
    let joints = json["skins"][0]["joints"].as_array().expect("joints");
    joints.iter().map(|joint| names(json)[joint.as_u64().expect("index") as usize]).collect()
}

#[track_caller]
fn rests(file: &[u8], asset: &Asset) {
    let shown: Vec<DVec3> = posed(file).into_iter().flat_map(|shown| shown.positions).collect();
    assert_eq!(shown.len(), asset.mesh.positions.len());
    assert!(shown.iter().zip(&asset.mesh.positions).all(|(a, b)| a.distance(*b) < 1e-5), "the mesh jumps");
}

#[test]
fn joints_keep_their_orientations_their_order_and_what_is_above_and_under_them() {
    let sent = turned();
    let (skeleton, nodes) = read_skeleton(&sent, &Limits::default()).expect("reads");
    let asset = read(&plain().glb()).expect("reads");
    let file = written(&asset, &skeleton, &nodes);
    keep("separate-skeleton", &file);
    let (json, _) = open(&file);
    // Neither the mesh of the other file nor what has nothing to do with its joints; a camera leaves its node.
    assert_eq!(names(&json), ["Body", "Armature", "Hips", "Spine", "Spine_end", "Eye"]);
    assert_eq!(joint_names(&json), ["Spine", "Hips"]);
    let (before, after) = (placed(&sent), placed(&file));
    for name in ["Armature", "Hips", "Spine", "Spine_end", "Eye"] {
        let ((parent, world), (parent_after, world_after)) = (&before[name], &after[name]);
        assert_eq!(parent, parent_after, "{name}");
        assert!(world.abs_diff_eq(*world_after, 1e-6), "{name}: {world} became {world_after}");
    }
    assert!(after["Spine"].1.x_axis.truncate().distance(DVec3::X * 0.5) > 0.1, "the fixture's joints are turned");
    rests(&file, &asset);
}

#[test]
fn a_rig_file_holds_them_and_its_positions_move_them() {
    let (skeleton, nodes) = read_skeleton(&turned(), &Limits::default()).expect("reads");
    let asset = read(&plain().glb()).expect("reads");
    let rig = halves(&asset, &skeleton);
    let text = rig_json::write(&asset, &rig, Some(&nodes), JointNames::AsGiven, "geodesic_heat", &json!({}));
    let mut json: Value = serde_json::from_slice(&text).expect("JSON");
    assert_eq!(json["skin_order"], json!([1, 0]));
    let back = rig_json::read(&text).expect("reads");
    assert_eq!((&back.skeleton, back.nodes.as_ref()), (&skeleton, Some(&nodes)));

    let lifted = skeleton.joints[1].position + DVec3::Y * 0.25;
    json["joints"][1]["position"] = json!(lifted.to_array());
    let edited = rig_json::read(json.to_string().as_bytes()).expect("reads");
    let (before, after) = (
        placed(&written(&asset, &skeleton, &nodes)),
        placed(&written(&asset, &edited.skeleton, edited.nodes.as_ref().expect("nodes"))),
    );
    assert!(before["Hips"].1.abs_diff_eq(after["Hips"].1, 1e-6));
    let moved = DMat4::from_translation(DVec3::Y * 0.25);
    // What hangs on a joint goes with it.
    for name in ["Spine", "Spine_end", "Eye"] {
        assert!((moved * before[name].1).abs_diff_eq(after[name].1, 1e-6), "{name}");
    }
    rests(&written(&asset, &edited.skeleton, edited.nodes.as_ref().expect("nodes")), &asset);
}

#[test]
fn each_fault_of_nodes_is_named() {
    let (skeleton, nodes) = read_skeleton(&turned(), &Limits::default()).expect("reads");
    let good = rig_json::skeleton_json(&skeleton, Some(&nodes), &[]);
    assert!(rig_json::read(good.to_string().as_bytes()).is_ok());
    type Change = fn(&mut Value);
    let cases: &[(&str, Change)] = &[
        ("node 1: its parent, node 4, does not come before it", |json| json["nodes"][1]["parent"] = json!(4)),
        ("node 1: joint 9 does not exist: there are 2", |json| json["nodes"][1]["joint"] = json!(9)),
        ("node 3: node 2 is joint 1 already", |json| json["nodes"][3]["joint"] = json!(1)),
        ("node 2: it does not hang from the parent of joint 1", |json| json["nodes"][2]["parent"] = json!(0)),
        ("node 3: no node is joint 1 (\"Spine\")", |json| {
            json["nodes"].as_array_mut().expect("nodes").truncate(2);
            json["nodes"].as_array_mut().expect("nodes").push(json!({ "name": "Socket", "parent": 1 }));
        }),
        ("node 0: its rotation is no quaternion", |json| json["nodes"][0]["rotation"] = json!([0, 0, 0, 2])),
        ("node 1: its scale, or one above it, is zero", |json| json["nodes"][1]["scale"] = json!([1, 0, 1])),
        ("node 3: its transform is not finite", |json| json["nodes"][3]["translation"] = json!([1e300, 0, 0])),
        ("node 10000: at most 10000 nodes", |json| json["nodes"] = vec![json!({ "name": "Socket" }); 10_001].into()),
        ("skin_order: joint 1 stands there twice", |json| json["skin_order"] = json!([1, 1])),
        ("skin_order: joint 2 stands there twice, or does not exist", |json| json["skin_order"] = json!([2])),
    ];
    for (message, change) in cases {
        let mut json = good.clone();
        change(&mut json);
        let error = rig_json::read(json.to_string().as_bytes()).expect_err(message);
        assert!(error.to_string().starts_with(message), "{error}");
        assert_eq!(error.code(), "skeleton_invalid");
        assert!(!error.hint().is_empty());
    }
}

#[test]
fn a_joint_without_an_extent_is_refused_by_name() {
    let mut builder = rigged_fixture();
    builder.json["nodes"][3]["scale"] = json!([0, 0, 0]);
    let error = read_skeleton(&builder.glb(), &Limits::default()).expect_err("refused");
    assert!(error.to_string().contains("\"Spine\"") && error.to_string().contains("zero"), "{error}");
    // A shear, which no node of the output could say.
    builder.json["nodes"][3] = json!({ "name": "Spine", "matrix": [1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] });
    let error = read_skeleton(&builder.glb(), &Limits::default()).expect_err("refused");
    assert!(error.to_string().contains("\"Spine\"") && error.to_string().contains("a rotation"), "{error}");
}
