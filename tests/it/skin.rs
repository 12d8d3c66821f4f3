//! Weights for a skeleton that the sender has: the skeleton stays, every vertex is weighed, faults are named.

use super::metamorphic::{character, models};
use super::program::{rigsmith, sample, stderr, succeeded};
use glam::{DMat3, DVec3};
use rigsmith::cancellation::Cancellation;
use rigsmith::mesh::Mesh;
use rigsmith::pipelines::{RigOptions, Rigged, SkinMethod, Subject, Watch, skin};
use rigsmith::rig::{Joint, Skeleton};
use serde_json::{Value, json};

pub fn weighed(mesh: &Mesh, skeleton: &Skeleton, skin_method: SkinMethod) -> Rigged {
    let cancellation = Cancellation::default();
    let watch = Watch { cancellation: &cancellation, on_stage: &|_| {} };
    let options = RigOptions { skin_method, ..RigOptions::default() };
    let subject = Subject { mesh, to_upright: DMat3::IDENTITY };
    skin(subject, skeleton, models(), &options, watch).expect("weighed")
}

/// A chain of joints through these places.
pub fn chain(places: &[DVec3]) -> Skeleton {
    let joint = |(index, &position): (usize, &DVec3)| Joint {
        name: format!("joint {index}"),
        parent: index.checked_sub(1),
        position,
    };
    Skeleton { joints: places.iter().enumerate().map(joint).collect() }
}

fn size(mesh: &Mesh) -> (DVec3, f64) {
    let (low, high) = mesh.bounding_box().expect("has vertices");
    ((low + high) / 2.0, (high - low).max_element())
}

fn assert_sound(rigged: &Rigged, skeleton: &Skeleton, mesh: &Mesh) {
    assert_eq!(&rigged.rig.skeleton, skeleton, "the skeleton stays as it is");
    assert_eq!(rigged.rig.skin.rows.len(), mesh.positions.len());
    for row in &rigged.rig.skin.rows {
        let sum: f32 = row.iter().map(|influence| influence.weight).sum();
        assert!(!row.is_empty() && row.len() <= 4 && (sum - 1.0).abs() < 1e-5, "{row:?}");
        assert!(row.iter().all(|influence| (influence.joint as usize) < skeleton.joints.len()));
    }
}

#[test]
fn every_vertex_is_weighed_over_any_skeleton_that_is_a_tree() {
    let (middle, side) = size(character());
    let inside = [middle - DVec3::Y * side * 0.3, middle, middle + DVec3::Y * side * 0.3];
    let beside = [middle + DVec3::X * side, middle + DVec3::X * side * 1.2];
    let across = [middle - DVec3::splat(2.0 * side), middle + DVec3::splat(2.0 * side)];
    let far = [middle, middle + DVec3::Z * side * 1e6];
    for method in SkinMethod::ALL {
        for places in [&inside[..], &inside[..1], &beside, &across, &far, &[middle, middle, middle]] {
            assert_sound(&weighed(character(), &chain(places), method), &chain(places), character());
        }
        let rigged = weighed(character(), &chain(&far), method);
        assert_eq!(rigged.facts.joints_far_outside, [1]);
    }
}

#[test]
fn a_part_that_floats_beside_the_body_is_weighed_too() {
    let (middle, side) = size(character());
    let mut mesh = character().clone();
    let first = mesh.positions.len() as u32;
    let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
    mesh.positions.extend(corners.map(|corner| middle + DVec3::X * side * 0.9 + corner * side * 0.05));
    let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
    mesh.triangles.extend(faces.map(|face| face.map(|corner| first + corner)));
    let skeleton = chain(&[middle - DVec3::Y * side * 0.3, middle, middle + DVec3::Y * side * 0.3]);
    for method in SkinMethod::ALL {
        assert_sound(&weighed(&mesh, &skeleton, method), &skeleton, &mesh);
    }
}

#[test]
fn vertices_near_a_joint_follow_it() {
    let (middle, side) = size(character());
    let (low, high) = (middle - DVec3::Y * side * 0.4, middle + DVec3::Y * side * 0.4);
    let skeleton = chain(&[low, middle, high]);
    let rigged = weighed(character(), &skeleton, SkinMethod::GeodesicVoxel);
    let most = |wanted: fn(DVec3, DVec3, f64) -> bool, joint: u32| {
        let vertices = character().positions.iter().zip(&rigged.rig.skin.rows);
        let near: Vec<u32> = vertices.filter(|(v, _)| wanted(**v, middle, side)).map(|(_, row)| row[0].joint).collect();
        assert!(!near.is_empty());
        near.iter().filter(|first| **first == joint).count() as f64 / near.len() as f64
    };
    assert!(most(|vertex, middle, side| vertex.y < middle.y - 0.2 * side, 0) > 0.9);
    assert!(most(|vertex, middle, side| vertex.y > middle.y + 0.45 * side, 2) > 0.9);
}

#[test]
fn scale_and_place_of_mesh_and_skeleton_do_not_matter() {
    let (middle, side) = size(character());
    let skeleton = chain(&[middle - DVec3::Y * side * 0.3, middle, middle + DVec3::Y * side * 0.3]);
    let moved = |point: DVec3| point * 64.0 + DVec3::new(512.0, -128.0, 64.0);
    let mesh = Mesh {
        positions: character().positions.iter().map(|&point| moved(point)).collect(),
        triangles: character().triangles.clone(),
    };
    for method in SkinMethod::ALL {
        let (here, there) = (weighed(character(), &skeleton, method), weighed(&mesh, &skeleton.mapped(moved), method));
        let rows = here.rig.skin.rows.iter().zip(&there.rig.skin.rows);
        let same = rows.clone().filter(|(a, b)| a[0].joint == b[0].joint).count();
        assert!(same as f64 > 0.999 * here.rig.skin.rows.len() as f64, "{same} of {}", here.rig.skin.rows.len());
    }
}

/// A rig file with the sample's skeleton, its joints named as another program would.
fn skeleton_file(folder: &std::path::Path) -> Value {
    succeeded(&rigsmith(folder, &["rig", sample().to_str().expect("path"), "-o", "rigged.rig.json"]));
    let bytes = std::fs::read(folder.join("rigged.rig.json")).expect("rig.json");
    let mut file: Value = serde_json::from_slice(&bytes).expect("JSON");
    for (index, joint) in file["joints"].as_array_mut().expect("joints").iter_mut().enumerate() {
        joint["name"] = json!(format!("mixamorig:Bone.{index}"));
    }
    json!({ "format": file["format"], "joints": file["joints"] })
}

#[test]
fn the_program_gives_back_the_skeleton_that_it_was_given() {
    let folder = tempfile::tempdir().expect("folder");
    let file = skeleton_file(folder.path());
    std::fs::write(folder.path().join("mine.rig.json"), file.to_string()).expect("writes");
    let input = sample();
    let input = input.to_str().expect("path");
    for method in ["rignet", "geodesic_voxel", "geodesic_heat"] {
        let arguments = ["skin", input, "--skeleton", "mine.rig.json", "--skin-method", method];
        let outputs = ["-o", "out.glb", "-o", "out.rig.json", "-o", "out.txt", "--report", "report.json"];
        succeeded(&rigsmith(folder.path(), &[&arguments[..], &outputs].concat()));
        let read = |name: &str| std::fs::read(folder.path().join(name)).expect(name);
        let back: Value = serde_json::from_slice(&read("out.rig.json")).expect("JSON");
        assert_eq!(back["joints"], file["joints"]);
        assert_eq!(back["method"], method);
        let report: Value = serde_json::from_slice(&read("report.json")).expect("JSON");
        assert_eq!((&report["skeleton"]["given"], &report["skin"]["method"]), (&json!(true), &json!(method)));
        let glb = read("out.glb");
        let length = u32::from_le_bytes(glb[12..16].try_into().expect("four bytes")) as usize;
        let document: Value = serde_json::from_slice(&glb[20..20 + length]).expect("JSON chunk");
        let joints = document["skins"][0]["joints"].as_array().expect("joints");
        for (joint, given) in joints.iter().zip(file["joints"].as_array().expect("joints")) {
            assert_eq!(document["nodes"][joint.as_u64().expect("index") as usize]["name"], given["name"]);
        }
    }
}

/// Rig to GLB, then the GLB's skeleton on the bare mesh: the same joints at the same places, within single precision.
#[test]
fn a_glb_gives_its_skeleton_too() {
    let folder = tempfile::tempdir().expect("folder");
    let input = sample();
    let input = input.to_str().expect("path");
    succeeded(&rigsmith(folder.path(), &["rig", input, "-o", "rigged.glb", "-o", "rigged.rig.json"]));
    succeeded(&rigsmith(folder.path(), &["skin", input, "--skeleton", "rigged.glb", "-o", "again.rig.json"]));
    let read = |name: &str| -> Value {
        serde_json::from_slice(&std::fs::read(folder.path().join(name)).expect(name)).expect("JSON")
    };
    let (first, again) = (read("rigged.rig.json"), read("again.rig.json"));
    let of = |rig: &Value| rig["joints"].as_array().expect("joints").clone();
    let place = |joint: &Value| -> DVec3 {
        let numbers: Vec<f64> = joint["position"].as_array().expect("place").iter().filter_map(Value::as_f64).collect();
        DVec3::from_slice(&numbers)
    };
    let parent = |rig: &Value, joint: &Value| joint["parent"].as_u64().map(|at| of(rig)[at as usize]["name"].clone());
    assert_eq!(of(&first).len(), of(&again).len());
    for joint in of(&first) {
        let same = of(&again).into_iter().find(|other| other["name"] == joint["name"]).expect("the same name");
        assert!(place(&joint).distance(place(&same)) < 1e-5);
        assert_eq!(parent(&first, &joint), parent(&again, &same));
    }
    let bare = rigsmith(folder.path(), &["skin", input, "--skeleton", input, "-o", "none.rig.json"]);
    assert_eq!(bare.status.code(), Some(3), "{}", stderr(&bare));
    assert!(stderr(&bare).contains("no joints"), "{}", stderr(&bare));
}

#[test]
fn a_rig_can_be_weighed_by_voxels() {
    let folder = tempfile::tempdir().expect("folder");
    let input = sample();
    let arguments = ["rig", input.to_str().expect("path"), "--skin-method", "geodesic_voxel", "-o", "out.rig.json"];
    succeeded(&rigsmith(folder.path(), &arguments));
    let bytes = std::fs::read(folder.path().join("out.rig.json")).expect("rig.json");
    let rig: Value = serde_json::from_slice(&bytes).expect("JSON");
    assert_eq!((&rig["method"], &rig["report"]["skin"]["method"]), (&json!("rignet"), &json!("geodesic_voxel")));
}

#[test]
fn a_faulty_skeleton_ends_with_3_its_code_and_the_joint() {
    let folder = tempfile::tempdir().expect("folder");
    let joint = |name: &str, parent: Value| json!({ "name": name, "parent": parent, "position": [0, 0, 0] });
    let input = sample();
    for (joints, word) in [
        (json!([]), "no joints"),
        (json!([joint("hips", json!(null)), joint("spine", json!(9))]), "spine"),
        (json!([joint("hips", json!(null)), joint("hips", json!(0))]), "same name"),
        (json!([joint("a", json!(null)), joint("b", json!(2)), joint("c", json!(1))]), "cycle"),
        (json!([joint("a", json!(null)), joint("b", json!(null))]), "the root"),
    ] {
        let file = json!({ "format": "rigsmith.rig/1", "joints": joints });
        std::fs::write(folder.path().join("mine.rig.json"), file.to_string()).expect("writes");
        let arguments = ["skin", input.to_str().expect("path"), "--skeleton", "mine.rig.json", "-o", "out.glb"];
        let output = rigsmith(folder.path(), &arguments);
        assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
        let said = stderr(&output);
        assert!(said.contains("skeleton_invalid") && said.contains(word) && said.contains("hint:"), "{said}");
        assert!(!folder.path().join("out.glb").exists());
    }
}
