//! New weights for a skeleton that is there: what may not deform, what is locked, and how far a change reaches.

use super::program::{rigsmith, sample, stderr, succeeded};
use glam::DVec3;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// The sample, rigged: `rigged.glb` and `rigged.rig.json`.
fn rigged_sample(folder: &Path) {
    succeeded(&rigsmith(
        folder,
        &["rig", sample().to_str().expect("path"), "-o", "rigged.glb", "-o", "rigged.rig.json"],
    ));
}

fn read_json(folder: &Path, name: &str) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join(name)).expect(name)).expect("JSON")
}

fn joint_names(rig: &Value) -> Vec<String> {
    rig["joints"]
        .as_array()
        .expect("joints")
        .iter()
        .map(|joint| joint["name"].as_str().expect("name").to_owned())
        .collect()
}

/// Per vertex the weight of each joint, by name.
pub fn weights(rig: &Value) -> Vec<BTreeMap<String, f64>> {
    let names = joint_names(rig);
    let mut rows = Vec::new();
    for skin in rig["skins"].as_array().expect("skins") {
        let pairs = skin["joints"].as_array().expect("rows").iter().zip(skin["weights"].as_array().expect("rows"));
        rows.extend(pairs.map(|(joints, weights)| {
            let joints = joints
                .as_array()
                .expect("row")
                .iter()
                .map(|joint| names[joint.as_u64().expect("index") as usize].clone());
            joints.zip(weights.as_array().expect("row").iter().map(|weight| weight.as_f64().expect("weight"))).collect()
        }));
    }
    rows
}

fn difference(a: &BTreeMap<String, f64>, b: &BTreeMap<String, f64>) -> f64 {
    let of = |row: &BTreeMap<String, f64>, name: &str| row.get(name).copied().unwrap_or(0.0);
    a.keys().chain(b.keys()).map(|name| (of(a, name) - of(b, name)).abs()).fold(0.0, f64::max)
}

/// The JSON chunk of a GLB file.
pub fn glb_json(file: &[u8]) -> Value {
    let length = u32::from_le_bytes(file[12..16].try_into().expect("four bytes")) as usize;
    serde_json::from_slice(&file[20..20 + length]).expect("JSON chunk")
}

/// The same file with another JSON chunk.
pub fn with_json(file: &[u8], json: &Value) -> Vec<u8> {
    let length = u32::from_le_bytes(file[12..16].try_into().expect("four bytes")) as usize;
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let rest = &file[20 + length..];
    let mut edited = file[..8].to_vec();
    edited.extend(((20 + text.len() + rest.len()) as u32).to_le_bytes());
    edited.extend((text.len() as u32).to_le_bytes());
    edited.extend(b"JSON");
    edited.extend(text);
    edited.extend(rest);
    edited
}

#[test]
fn a_file_keeps_its_skeleton_and_gets_new_weights() {
    let folder = tempfile::tempdir().expect("folder");
    rigged_sample(folder.path());
    // Turned joints and a node that is no joint, as an artist's file has them.
    let file = std::fs::read(folder.path().join("rigged.glb")).expect("file");
    let mut document = glb_json(&file);
    let joints: Vec<usize> = document["skins"][0]["joints"]
        .as_array()
        .expect("joints")
        .iter()
        .map(|joint| joint.as_u64().expect("index") as usize)
        .collect();
    for (turn, &joint) in joints.iter().enumerate() {
        document["nodes"][joint]["name"] = json!(format!("mixamorig:Bone.{turn}"));
    }
    let leaf = *joints.last().expect("a joint");
    document["nodes"][leaf]["rotation"] = json!([0.0, 0.6, 0.0, 0.8]);
    let helper = document["nodes"].as_array().expect("nodes").len();
    document["nodes"].as_array_mut().expect("nodes").push(json!({ "name": "Socket", "translation": [0, 0.1, 0] }));
    document["nodes"][leaf]["children"] = json!([helper]);
    let edited = with_json(&file, &document);
    std::fs::write(folder.path().join("mine.glb"), &edited).expect("writes");

    let arguments = ["skin", "mine.glb", "--skin-method", "geodesic_heat", "-o", "out.glb", "-o", "out.rig.json"];
    succeeded(&rigsmith(folder.path(), &[&arguments[..], &["--report", "report.json"]].concat()));
    let back = glb_json(&std::fs::read(folder.path().join("out.glb")).expect("file"));
    assert_eq!(back["skins"][0]["joints"], document["skins"][0]["joints"]);
    let nodes = |json: &Value| {
        json["nodes"]
            .as_array()
            .expect("nodes")
            .iter()
            .filter(|node| node.get("mesh").is_none())
            .cloned()
            .collect::<Vec<_>>()
    };
    assert_eq!(nodes(&back), nodes(&document));
    let report = read_json(folder.path(), "report.json");
    assert_eq!((&report["skeleton"]["given"], &report["method"]), (&json!(true), &json!("geodesic_heat")));
    let (before, after) =
        (weights(&read_json(folder.path(), "rigged.rig.json")), weights(&read_json(folder.path(), "out.rig.json")));
    assert_eq!(before.len(), after.len());
    assert_ne!(before, after);

    let bare = rigsmith(folder.path(), &["skin", sample().to_str().expect("path"), "-o", "none.glb"]);
    assert_eq!(bare.status.code(), Some(3), "{}", stderr(&bare));
    assert!(stderr(&bare).contains("no skeleton to keep") && stderr(&bare).contains("hint:"), "{}", stderr(&bare));
}

/// Transforms of nodes without a mesh, by name, and the name of the parent of each.
fn transforms(json: &Value) -> BTreeMap<String, (Option<String>, [Vec<f64>; 2])> {
    let nodes = json["nodes"].as_array().expect("nodes");
    let name = |node: &Value| node["name"].as_str().expect("a name").to_owned();
    let numbers = |value: &Value, absent: &[f64]| {
        value.as_array().map_or(absent.to_vec(), |numbers| numbers.iter().filter_map(Value::as_f64).collect())
    };
    let bare = nodes.iter().enumerate().filter(|(_, node)| node.get("mesh").is_none());
    bare.map(|(index, node)| {
        let is_child =
            |other: &&Value| other["children"].as_array().is_some_and(|children| children.contains(&json!(index)));
        let local = [numbers(&node["translation"], &[0.0; 3]), numbers(&node["rotation"], &[0.0, 0.0, 0.0, 1.0])];
        (name(node), (nodes.iter().find(is_child).map(name), local))
    })
    .collect()
}

/// Nodes without a mesh have the same names, parents, places and turns in both files.
pub fn assert_same_skeleton(wanted: &Value, found: &Value) {
    let (wanted, found) = (transforms(wanted), transforms(found));
    assert_eq!(wanted.keys().collect::<Vec<_>>(), found.keys().collect::<Vec<_>>());
    for (name, (parent, local)) in &wanted {
        assert_eq!(parent, &found[name].0, "{name}");
        let pairs = local.iter().flatten().zip(found[name].1.iter().flatten());
        assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() < 1e-6), "{name}: {local:?} became {:?}", found[name].1);
    }
}

/// The JSON chunk of a rigged file with its root turned about the vertical, what is below it turned back, and a socket under the
/// last joint: every joint stays where it was.
pub fn turned_with_socket(file: &[u8]) -> Value {
    let mut document = glb_json(file);
    let joint = |at: usize| document["skins"][0]["joints"][at].as_u64().expect("index") as usize;
    let (root, leaf) = (joint(0), joint(document["skins"][0]["joints"].as_array().expect("joints").len() - 1));
    let children = document["nodes"][root]["children"].clone();
    let half = std::f64::consts::FRAC_1_SQRT_2;
    document["nodes"][root]["rotation"] = json!([0.0, half, 0.0, half]);
    for child in children.as_array().expect("children") {
        let child = &mut document["nodes"][child.as_u64().expect("index") as usize];
        let [x, y, z] = [0, 1, 2].map(|axis| child["translation"][axis].as_f64().expect("a number"));
        (child["translation"], child["rotation"]) = (json!([-z, y, x]), json!([0.0, -half, 0.0, half]));
    }
    let socket = document["nodes"].as_array().expect("nodes").len();
    document["nodes"].as_array_mut().expect("nodes").push(json!({ "name": "Socket", "translation": [0, 0.1, 0] }));
    document["nodes"][leaf]["children"] = json!([socket]);
    document
}

#[test]
fn a_skeleton_of_another_file_keeps_turned_joints_and_sockets() {
    let folder = tempfile::tempdir().expect("folder");
    rigged_sample(folder.path());
    let file = std::fs::read(folder.path().join("rigged.glb")).expect("file");
    let document = turned_with_socket(&file);
    std::fs::write(folder.path().join("mine.glb"), with_json(&file, &document)).expect("writes");

    let input = sample();
    let skin = |skeleton: &str, stem: &str| {
        let (glb, rig) = (format!("{stem}.glb"), format!("{stem}.rig.json"));
        let arguments = ["skin", input.to_str().expect("path"), "--skeleton", skeleton, "-o", &glb, "-o", &rig];
        succeeded(&rigsmith(folder.path(), &[&arguments[..], &["--skin-method", "geodesic_heat"]].concat()));
        std::fs::read(folder.path().join(glb)).expect("file")
    };
    let given = skin("mine.glb", "given");
    assert_same_skeleton(&document, &glb_json(&given));
    // Turned joints weigh as unturned ones in the same places.
    let plain = skin("rigged.glb", "plain");
    assert_ne!(given, plain);
    let rows = |stem: &str| weights(&read_json(folder.path(), &format!("{stem}.rig.json")));
    assert!(rows("given").iter().zip(&rows("plain")).all(|(a, b)| difference(a, b) < 1e-4));
    // The rig file holds all of it.
    assert_eq!(skin("given.rig.json", "again"), given);
}

#[test]
fn joints_that_must_not_deform_stay_without_weights() {
    let folder = tempfile::tempdir().expect("folder");
    rigged_sample(folder.path());
    let mut rig = read_json(folder.path(), "rigged.rig.json");
    let root = rig["joints"][0]["position"].clone();
    let leaf = rig["joints"].as_array().expect("joints").len() - 1;
    let place = rig["joints"][leaf]["position"].clone();
    let joints = rig["joints"].as_array_mut().expect("joints");
    joints.push(json!({ "name": "IK_hand", "parent": 0, "position": place }));
    joints.push(json!({ "name": "IK_pole", "parent": 0, "position": root }));
    let file = json!({ "format": rig["format"], "joints": rig["joints"] });
    std::fs::write(folder.path().join("mine.rig.json"), file.to_string()).expect("writes");
    let input = sample();
    let skin = |name: &str, more: &[&str]| {
        let arguments = ["skin", input.to_str().expect("path"), "--skeleton", "mine.rig.json", "-o", name];
        rigsmith(folder.path(), &[&arguments[..], &["--skin-method", "geodesic_heat"], more].concat())
    };
    succeeded(&skin("with.rig.json", &[]));
    succeeded(&skin("without.rig.json", &["--no-deform", "IK_*,root"]));
    let names = ["IK_hand", "IK_pole", "root"];
    let has = |file: &str| {
        let rows = weights(&read_json(folder.path(), file));
        names.map(|name| rows.iter().any(|row| row.contains_key(name)))
    };
    assert!(has("with.rig.json").contains(&true), "they would deform if they might");
    assert_eq!(has("without.rig.json"), [false; 3]);
    let rig = read_json(folder.path(), "without.rig.json");
    assert_eq!(rig["joints"], file["joints"], "the skeleton is whole");
    assert!(weights(&rig).iter().all(|row| (row.values().sum::<f64>() - 1.0).abs() < 1e-5));

    for (patterns, said) in [("FK_*", "\"FK_*\""), ("*", "every joint")] {
        let refused = skin("none.rig.json", &["--non-deforming", patterns]);
        assert_eq!(refused.status.code(), Some(3), "{}", stderr(&refused));
        let told = stderr(&refused);
        assert!(told.contains("skeleton_invalid") && told.contains(said) && told.contains("hint:"), "{told}");
    }
    let predicted = ["rig", input.to_str().expect("path"), "-o", "none.glb", "--non-deforming", "IK_*"];
    let refused = rigsmith(folder.path(), &predicted);
    assert!(refused.status.code() == Some(3) && stderr(&refused).contains("none was sent"), "{}", stderr(&refused));
}

#[test]
fn locked_joints_keep_their_weights_and_the_others_share_what_is_left() {
    let folder = tempfile::tempdir().expect("folder");
    rigged_sample(folder.path());
    let before = read_json(folder.path(), "rigged.rig.json");
    let old = weights(&before);
    let mut totals: BTreeMap<String, f64> = BTreeMap::new();
    old.iter().flatten().for_each(|(name, weight)| *totals.entry(name.clone()).or_default() += weight);
    let locked = totals.iter().max_by(|a, b| a.1.total_cmp(b.1)).expect("a joint").0.clone();
    let input = sample();
    let bare = input.to_str().expect("path");
    let heat = ["--skin-method", "geodesic_heat", "--locked-joints", &locked, "-o", "out.rig.json"];
    // The weights that there were come from the file, from the skeleton's file, or from the file for a skeleton that is sent.
    let sources: [&[&str]; 3] = [
        &["skin", "rigged.glb"],
        &["skin", bare, "--skeleton", "rigged.rig.json"],
        &["skin", "rigged.glb", "--existing-rig", "replace", "--skeleton", "joints.rig.json"],
    ];
    let joints = json!({ "format": before["format"], "joints": before["joints"] });
    std::fs::write(folder.path().join("joints.rig.json"), joints.to_string()).expect("writes");
    for source in sources {
        succeeded(&rigsmith(folder.path(), &[source, &heat].concat()));
        let new = weights(&read_json(folder.path(), "out.rig.json"));
        let of = |row: &BTreeMap<String, f64>| row.get(&locked).copied().unwrap_or(0.0);
        let most = old.iter().zip(&new).map(|(old, new)| (of(old) - of(new)).abs()).fold(0.0, f64::max);
        assert!(most < 1e-5, "{source:?}: {locked} changed by {most}");
        assert!(new.iter().all(|row| (row.values().sum::<f64>() - 1.0).abs() < 1e-5));
        let changed = old.iter().zip(&new).filter(|(old, new)| difference(old, new) > 0.01).count();
        assert!(changed > old.len() / 10, "{changed} of {} vertices have other weights", old.len());
    }

    let refusals: [(&[&str], &str); 4] = [
        (&["skin", "rigged.glb", "--lock", "Jaw*"], "\"Jaw*\""),
        (&["skin", bare, "--skeleton", "joints.rig.json", "--lock", &locked], "neither file nor skeleton"),
        (&["skin", "rigged.glb", "--lock", &locked, "--no-deform", &locked], "does not deform"),
        (&["skin", "rigged.glb", "--lock", &locked, "--max-influences", "1"], "max_influences is 1"),
    ];
    for (arguments, said) in refusals {
        let refused = rigsmith(folder.path(), &[arguments, &["-o", "none.glb"]].concat());
        let told = stderr(&refused);
        assert!(matches!(refused.status.code(), Some(3 | 4)), "{arguments:?}: {told}");
        assert!(told.contains(said) && told.contains("hint:"), "{arguments:?}: {told}");
    }
}

/// Moves one joint of a chain in the GLB's JSON, the joints below it staying where they are, and makes weights anew: what changes
/// by more than 1 % is on the two bones that moved, or no farther from them than a limb is thick.
#[test]
fn moving_an_elbow_changes_weights_near_it_and_hardly_elsewhere() {
    let folder = tempfile::tempdir().expect("folder");
    rigged_sample(folder.path());
    let rig = read_json(folder.path(), "rigged.rig.json");
    let places: Vec<DVec3> = rig["joints"]
        .as_array()
        .expect("joints")
        .iter()
        .map(|joint| {
            DVec3::from_slice(
                &joint["position"].as_array().expect("place").iter().filter_map(Value::as_f64).collect::<Vec<_>>(),
            )
        })
        .collect();
    let parents: Vec<Option<usize>> = rig["joints"]
        .as_array()
        .expect("joints")
        .iter()
        .map(|joint| joint["parent"].as_u64().map(|parent| parent as usize))
        .collect();
    let mut children = vec![Vec::new(); parents.len()];
    for (joint, parent) in parents.iter().enumerate() {
        parent.iter().for_each(|&parent| children[parent].push(joint));
    }
    // A joint between two others, farthest out: an elbow.
    let between = (0..places.len()).filter(|&joint| parents[joint].is_some() && children[joint].len() == 1);
    let elbow = between.max_by(|&a, &b| places[a].x.total_cmp(&places[b].x)).expect("a chain");
    let (above, below) = (parents[elbow].expect("a parent"), children[elbow][0]);
    let height = {
        let mesh = super::metamorphic::character();
        let (low, high) = mesh.bounding_box().expect("has vertices");
        (high - low).y
    };
    let shift = (places[below] - places[above]).any_orthonormal_vector() * 0.03 * height;

    let file = std::fs::read(folder.path().join("rigged.glb")).expect("file");
    let mut document = glb_json(&file);
    let node = |document: &Value, joint: usize| document["skins"][0]["joints"][joint].as_u64().expect("index") as usize;
    for (joint, shift) in [(elbow, shift), (below, -shift)] {
        let node = node(&document, joint);
        for axis in 0..3 {
            let moved = document["nodes"][node]["translation"][axis].as_f64().expect("number") + shift[axis];
            document["nodes"][node]["translation"][axis] = json!(moved);
        }
    }
    std::fs::write(folder.path().join("edited.glb"), with_json(&file, &document)).expect("writes");

    let moved = [
        (places[above], places[elbow]),
        (places[elbow], places[below]),
        (places[above], places[elbow] + shift),
        (places[elbow] + shift, places[below]),
    ];
    let distance = |vertex: DVec3| {
        let to_segment = |&(start, end): &(DVec3, DVec3)| {
            let along = end - start;
            let share = ((vertex - start).dot(along) / along.length_squared()).clamp(0.0, 1.0);
            vertex.distance(start + along * share)
        };
        moved.iter().map(to_segment).fold(f64::INFINITY, f64::min)
    };
    let input = sample();
    let vertices = &super::metamorphic::character().positions;
    // Vertices whose weights change by more than 1 %, near the elbow and elsewhere; and the greatest change elsewhere.
    let changed = |method: &str| {
        let weighed = |skeleton: &str| {
            let arguments = ["skin", input.to_str().expect("path"), "--skeleton", skeleton, "--skin-method", method];
            succeeded(&rigsmith(folder.path(), &[&arguments[..], &["-o", "out.rig.json"]].concat()));
            weights(&read_json(folder.path(), "out.rig.json"))
        };
        let (before, after) = (weighed("rigged.glb"), weighed("edited.glb"));
        assert_eq!(before.len(), vertices.len());
        let change = |vertex: usize| difference(&before[vertex], &after[vertex]);
        let (near, far): (Vec<usize>, Vec<usize>) =
            (0..vertices.len()).partition(|&vertex| distance(vertices[vertex]) < NEAR * height);
        let count = |those: &[usize]| those.iter().filter(|&&vertex| change(vertex) > 0.01).count();
        (count(&near), count(&far), far.iter().map(|&vertex| change(vertex)).fold(0.0, f64::max))
    };
    // Of so many vertices one may change elsewhere: a fourth influence that comes or goes where the limb blends with the trunk.
    for (method, one_of) in [("geodesic_voxel", 1000), ("geodesic_heat", 500), ("heter_skin_net", 200)] {
        let (near, far, most) = changed(method);
        let told = format!("{method}: {near} near, {far} of {} elsewhere, at most {most:.3}", vertices.len());
        assert!(near > 100 && far * one_of <= vertices.len() && most < 0.1, "{told}");
    }
}

/// Of the height: what counts as near the elbow.
const NEAR: f64 = 0.15;
