//! Files that are rigged already: refused with the way out, or rigged anew without the mesh moving (checklist 17, 19).

use super::fixtures::*;
use glam::{DMat4, DVec3};
use rigsmith::formats::gltf::{EncodeOptions, JointNames, encode_glb, joint_names};
use rigsmith::formats::{Asset, DecodeError, ExistingRig};
use serde_json::json;
use std::path::Path;

/// The body with a skin of two joints below an armature, in a pose that is not the bind pose; a camera hangs on a joint.
pub fn rigged_fixture() -> Builder {
    let mut builder = Builder::new();
    let mesh = builder.body(&body());
    let joints_view = builder.view(&[0, 1, 0, 0].repeat(24));
    let joints = json!({ "bufferView": joints_view, "componentType": 5121, "count": 24, "type": "VEC4" });
    let joints = builder.push("accessors", joints);
    let weights = builder.floats(&[[0.75, 0.25, 0.0, 0.0]; 24]);
    let inverse = [DMat4::IDENTITY, DMat4::from_translation(DVec3::new(0.0, -1.0, 0.0))];
    let inverse = builder.floats(&inverse.map(|matrix| matrix.as_mat4().to_cols_array()));
    let attributes = &mut builder.json["meshes"][mesh]["primitives"][0]["attributes"];
    attributes["JOINTS_0"] = json!(joints);
    attributes["WEIGHTS_0"] = json!(weights);
    builder.root(json!({ "name": "Armature", "children": [1, 2] }));
    builder.push("nodes", json!({ "name": "Body", "mesh": mesh, "skin": 0, "scale": [100, 100, 100] }));
    builder.push("nodes", json!({ "name": "Hips", "children": [3] }));
    builder.push(
        "nodes",
        json!({ "name": "Spine", "translation": [0, 1, 0], "rotation": [0.6, 0, 0, 0.8], "children": [4, 5] }),
    );
    builder.push("nodes", json!({ "name": "Spine_end", "translation": [0, 1, 0] }));
    builder.push("nodes", json!({ "name": "Eye", "camera": 0 }));
    builder.push("cameras", json!({ "type": "perspective", "perspective": { "yfov": 1.0, "znear": 0.1 } }));
    builder.push("skins", json!({ "joints": [2, 3], "inverseBindMatrices": inverse }));
    let (times, turns) = (builder.floats(&[[0.0], [1.0]]), builder.floats(&[[0.0, 0.0, 0.0, 1.0]; 2]));
    let sampler = json!({ "input": times, "output": turns });
    let channel =
        |node: usize, sampler: usize| json!({ "sampler": sampler, "target": { "node": node, "path": "rotation" } });
    builder.push("animations", json!({ "samplers": [sampler], "channels": [channel(2, 0)] }));
    builder.push("animations", json!({ "samplers": [sampler, sampler], "channels": [channel(3, 0), channel(5, 1)] }));
    builder
}

#[test]
fn a_rigged_file_is_refused_with_the_way_out() {
    let error = read(&rigged_fixture().glb()).unwrap_err();
    assert_eq!(error, DecodeError::AlreadyRigged { skins: 1, joints: 2 });
    assert_eq!(error.code(), "already_rigged");
    assert!(error.hint().contains("replace"));
}

/// What the old skin shows, against what the asset holds.
fn does_not_jump(sent: &[u8], asset: &Asset) {
    let shown = posed(sent);
    let before: Vec<DVec3> = shown.iter().flat_map(|shown| shown.positions.iter().copied()).collect();
    let low = before.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = before.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    assert_eq!(before.len(), asset.mesh.positions.len());
    for (before, now) in before.iter().zip(&asset.mesh.positions) {
        assert!(before.distance(*now) <= 2e-5 * (high - low).max_element(), "{before} became {now}");
    }
}

#[test]
fn a_replaced_rig_leaves_nothing_but_the_mesh_where_it_was() {
    let sent = rigged_fixture().glb();
    let asset = replace(&sent);
    assert_eq!(asset.existing_rig, Some(ExistingRig { skins: 1, joints: 2 }));
    assert!(codes(&asset).contains(&"existing_rig_replaced"));
    does_not_jump(&sent, &asset);
    let file = encoded("replaced", &asset);
    let (json, binary) = open(&file);
    let names: Vec<&str> =
        json["nodes"].as_array().unwrap().iter().map(|node| node["name"].as_str().unwrap()).collect();
    // Joints above the camera stay for it; the end of the spine goes.
    assert_eq!(names, ["Armature", "Body", "Hips", "Spine", "Eye", "hips", "spine", "head"]);
    assert_eq!(json["skins"].as_array().unwrap().len(), 1);
    // Channels of old joints went, the camera's stayed, with the one sampler it needs.
    assert_eq!(json["animations"].as_array().unwrap().len(), 1);
    assert_eq!(
        json["animations"][0]["channels"],
        json!([{ "sampler": 0, "target": { "node": 4, "path": "rotation" } }])
    );
    assert_eq!(json["animations"][0]["samplers"].as_array().unwrap().len(), 1);
    // Body, indices, animation; joints, weights and matrices once, not twice.
    assert!(binary.len() <= 24 * 24 + 72 + 40 + 24 * 20 + 3 * 64, "{}", binary.len());
}

#[test]
fn without_a_camera_the_whole_old_skeleton_goes() {
    let mut builder = rigged_fixture();
    builder.json["nodes"][5].as_object_mut().unwrap().remove("camera");
    let (json, _) = open(&encoded("replaced_whole", &replace(&builder.glb())));
    let names: Vec<&str> =
        json["nodes"].as_array().unwrap().iter().map(|node| node["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["Body", "hips", "spine", "head"]);
    assert!(json.get("animations").is_none());
}

#[test]
fn nodes_stay_where_an_extension_may_number_them() {
    let mut builder = rigged_fixture();
    builder.json["extensionsUsed"] = json!(["VENDOR_numbers_nodes"]);
    builder.json["extensions"] = json!({ "VENDOR_numbers_nodes": { "node": 4 } });
    let (json, _) = open(&encoded("replaced_unknown_extension", &replace(&builder.glb())));
    assert_eq!(json["nodes"][4]["name"], "Spine_end");
    assert_eq!(json["skins"].as_array().unwrap().len(), 1);
}

#[test]
fn joints_are_named_unlike_any_node_or_mesh() {
    let mut builder = plain();
    builder.json["nodes"][0]["name"] = json!("hips");
    builder.json["meshes"][0]["name"] = json!("spine");
    let asset = read(&builder.glb()).unwrap();
    let mut rig = simple_rig(&asset);
    rig.skeleton.joints[2].name = "Kopf: é/x".into();
    assert_eq!(joint_names(&asset, &rig.skeleton, JointNames::Plain), ["hips_2", "spine_2", "Kopf____x"]);
    let given = joint_names(&asset, &rig.skeleton, JointNames::AsGiven);
    assert_eq!(given, ["hips", "spine", "Kopf: é/x"], "a sender's own names stay");
    let options = EncodeOptions { names: JointNames::AsGiven, ..EncodeOptions::default() };
    let (json, _) = open(&encode_glb(&asset, &rig, &options).unwrap());
    let nodes = json["nodes"].as_array().unwrap();
    assert_eq!(nodes[json["skins"][0]["joints"][2].as_u64().unwrap() as usize]["name"], "Kopf: é/x");
}

#[test]
fn faults_of_an_old_skin_are_named() {
    type Change = fn(&mut serde_json::Value);
    let cases: &[(&str, Change)] = &[
        ("joint out of range", |json| json["skins"][0]["joints"] = json!([2, 77])),
        ("fewer joints than the vertices use", |json| json["skins"][0]["joints"] = json!([2])),
        ("no joints", |json| json["skins"][0]["joints"] = json!([])),
        ("too few matrices", |json| json["skins"][0]["joints"] = json!([2, 3, 4])),
        ("skin out of range", |json| json["nodes"][1]["skin"] = json!(3)),
        ("joints of floats", |json| json["accessors"][3]["componentType"] = json!(5126)),
    ];
    for (name, change) in cases {
        let mut builder = rigged_fixture();
        change(&mut builder.json);
        let options = rigsmith::formats::DecodeOptions {
            existing_rig: rigsmith::formats::ExistingRigPolicy::Replace,
            ..Default::default()
        };
        let (limits, none) = (Default::default(), rigsmith::formats::NoSiblings);
        let error = rigsmith::formats::decode("a.glb", &builder.glb(), &none, &limits, &options).expect_err(name);
        assert_eq!(error.code(), "unreadable_mesh", "{name}: {error}");
    }
}

/// The shared sample characters; not in the repository.
pub fn samples() -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/samples");
    let Ok(entries) = std::fs::read_dir(&folder) else {
        eprintln!("skipped: {} is not there", folder.display());
        return Vec::new();
    };
    let mut samples: Vec<(String, Vec<u8>)> = entries
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "glb"))
        .map(|path| (path.file_stem().unwrap().to_string_lossy().into_owned(), std::fs::read(&path).unwrap()))
        .collect();
    samples.sort();
    samples
}

#[test]
fn the_sample_characters_come_back_with_one_skin_and_do_not_jump() {
    for (name, sent) in samples() {
        let is_rigged = name.ends_with("_rigged");
        assert_eq!(read(&sent).is_err(), is_rigged, "{name}");
        let asset = replace(&sent);
        if is_rigged {
            does_not_jump(&sent, &asset);
        }
        let file = encoded(&name, &asset);
        let (json, _) = open(&file);
        assert_eq!(json["skins"].as_array().unwrap().len(), 1);
        assert_eq!(json["skins"][0]["joints"].as_array().unwrap().len(), 3);
        let shown = posed(&file);
        let after = shown.iter().flat_map(|shown| shown.positions.iter());
        assert!(after.zip(&asset.mesh.positions).all(|(a, b)| a.distance(*b) < 1e-5 * b.length().max(1.0)), "{name}");
        let skin = asset.mesh.positions.len() * 20 + 3 * 64 + 2000;
        assert!(file.len() as f64 <= 1.01 * sent.len() as f64 + skin as f64, "{name}");
        let (before, _) = open(&sent);
        for list in ["materials", "textures", "samplers", "cameras"] {
            assert_eq!(json.get(list), before.get(list), "{name}");
        }
    }
}
