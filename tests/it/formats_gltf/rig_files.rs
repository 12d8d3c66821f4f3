//! `rig.json` and RigNet's text.

use super::fixtures::*;
use rigsmith::formats::gltf::JointNames;
use rigsmith::formats::{rig_json, rignet_text};
use serde_json::{Value, json};

#[test]
fn a_rig_file_has_the_fixed_layout() {
    let mut builder = plain();
    builder.root(json!({ "mesh": 0, "translation": [3, 0, 0] }));
    let asset = read(&builder.glb()).unwrap();
    let rig = simple_rig(&asset);
    let text = rig_json::write(&asset, &rig, None, JointNames::Plain, "rignet", &json!({ "joints": 3 }));
    let read: Value = serde_json::from_slice(&text).unwrap();
    let keys: Vec<&String> = read.as_object().unwrap().keys().collect();
    assert_eq!(keys, ["format", "method", "joints", "skins", "report"]);
    assert_eq!(read["format"], "rigsmith.rig/1");
    assert_eq!(read["joints"][0]["parent"], Value::Null);
    assert_eq!(read["joints"][2]["parent"], 1);
    assert_eq!(read["joints"][1]["position"], json!(rig.skeleton.joints[1].position.to_array()));
    // One skin per placed primitive, a row per vertex.
    assert_eq!(read["skins"].as_array().unwrap().len(), 2);
    let skin = &read["skins"][1];
    assert_eq!((&skin["mesh"], &skin["primitive"]), (&json!(0), &json!(0)));
    assert_eq!(skin["joints"].as_array().unwrap().len(), 24);
    assert_eq!(skin["joints"][0][0], json!(rig.skin.rows[24][0].joint));
    assert_eq!(skin["weights"][0][1].as_f64().unwrap() as f32, rig.skin.rows[24][1].weight);
}

#[test]
fn a_rig_file_is_read_as_it_was_written() {
    let asset = read(&plain().glb()).unwrap();
    let rig = simple_rig(&asset);
    let file =
        rig_json::read(&rig_json::write(&asset, &rig, None, JointNames::Plain, "rignet", &json!({ "a": 1 }))).unwrap();
    assert_eq!(file.method, "rignet");
    assert_eq!(file.skeleton, rig.skeleton);
    assert_eq!(file.skins[0].weights, rig.skin);
    assert_eq!(file.report, json!({ "a": 1 }));
}

#[test]
fn each_fault_of_a_rig_file_is_named() {
    let asset = read(&plain().glb()).unwrap();
    let good: Value = serde_json::from_slice(&rig_json::write(
        &asset,
        &simple_rig(&asset),
        None,
        JointNames::Plain,
        "rignet",
        &json!({}),
    ))
    .unwrap();
    type Change = fn(&mut Value);
    let cases: &[(&str, &str, Change)] = &[
        ("skeleton_invalid", "the format is \"other/1\"", |json| json["format"] = json!("other/1")),
        ("skeleton_invalid", "the skeleton has no joints", |json| json["joints"] = json!([])),
        ("skeleton_invalid", "joint 1 (\"spine\"): its parent, joint 7, does not exist: there are 3", |json| {
            json["joints"][1]["parent"] = json!(7);
        }),
        ("skeleton_invalid", "joint 1 (\"spine\"): its parent, joint 2, hangs below it", |json| {
            json["joints"][1]["parent"] = json!(2);
            json["joints"][2]["parent"] = json!(1);
        }),
        ("skeleton_invalid", "joint 1 (\"spine\"): its parent, joint 1, hangs below it", |json| {
            json["joints"][1]["parent"] = json!(1);
        }),
        ("skeleton_invalid", "joint 1 (\"spine\"): its parent, joint 2, does not come before", |json| {
            json["joints"][1]["parent"] = json!(2);
            json["joints"][2]["parent"] = json!(0);
        }),
        ("skeleton_invalid", "joint 0 (\"hips\"): its parent, joint 0, hangs below it", |json| {
            json["joints"][0]["parent"] = json!(0);
        }),
        ("skeleton_invalid", "joint 1 (\"\"): its name is empty", |json| json["joints"][1]["name"] = json!("")),
        ("skeleton_invalid", "joint 1 (\"spine\"): its position is not finite", |json| {
            json["joints"][1]["position"] = json!([1e300, 0, 0]);
        }),
        ("skeleton_invalid", "the skeleton has 1001 joints", |json| {
            let joint = json["joints"][1].clone();
            json["joints"] = vec![joint; 1001].into();
        }),
        ("skeleton_invalid", "joint 2 (\"head\"): only the first", |json| json["joints"][2]["parent"] = Value::Null),
        ("skeleton_invalid", "joint 1 (\"hips\"): another joint", |json| json["joints"][1]["name"] = json!("hips")),
        ("skeleton_invalid", "skin 0, vertex 3: joint 9", |json| json["skins"][0]["joints"][3][0] = json!(9)),
        ("skeleton_invalid", "skin 0, vertex 4: 1 joints", |json| json["skins"][0]["joints"][4] = json!([1])),
        ("skeleton_invalid", "skin 0, vertex 5: the weight -1", |json| json["skins"][0]["weights"][5][0] = json!(-1)),
        ("skeleton_invalid", "skin 0, vertex 6: no weight", |json| json["skins"][0]["weights"][6] = json!([0, 0])),
        ("invalid_json", "this is no rig file", |json| json["joints"][0]["position"] = json!([1, 2])),
    ];
    for (code, message, change) in cases {
        let mut json = good.clone();
        change(&mut json);
        let error = rig_json::read(json.to_string().as_bytes()).expect_err(message);
        assert!(error.to_string().starts_with(message), "{error}");
        assert_eq!(error.code(), *code);
        assert!(!error.hint().is_empty());
    }
}

#[test]
fn rignet_text_lists_joints_root_weights_and_hierarchy() {
    let asset = read(&plain().glb()).unwrap();
    let mut rig = simple_rig(&asset);
    // A branch, so that breadth first differs from the order of joints.
    rig.skeleton.joints[2].parent = Some(0);
    rig.skeleton.joints.push(rigsmith::rig::Joint {
        name: "chest".into(),
        parent: Some(1),
        ..rig.skeleton.joints[1].clone()
    });
    rig.skeleton.joints[3].position.x = -1.0 / 3.0;
    let text = rignet_text::write(&asset, &rig);
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[3], "joints chest -0.33333333 0.00000000 0.00000000");
    assert_eq!(lines[4], "root hips");
    assert_eq!(lines[5].split(' ').take(2).collect::<Vec<_>>(), ["skin", "0"]);
    let weights: Vec<f64> = lines[5].split(' ').skip(3).step_by(2).map(|weight| weight.parse().unwrap()).collect();
    assert!((weights.iter().sum::<f64>() - 1.0).abs() < 2e-4);
    assert_eq!(lines[29..], ["hier hips spine", "hier hips head", "hier spine chest"]);
}
