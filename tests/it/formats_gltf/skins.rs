//! Joints and weights as they stand in the file (output checklist 2 to 8, 10, 11, 17).

use super::fixtures::*;
use glam::DVec3;
use rigsmith::formats::gltf::{EncodeError, EncodeOptions, WeightFormat, encode_glb};
use rigsmith::formats::{
    Alpha, Asset, Contents, Format, Image, ImageType, Material, Part, Scene, SceneNode, ScenePrimitive, Source,
};
use rigsmith::mesh::Mesh;
use rigsmith::rig::{Influence, Joint, Rig};
use serde_json::{Value, json};

/// A rig with many joints, where every vertex has `influences` of them in falling and equal shares.
fn wide_rig(asset: &Asset, joints: usize, influences: usize) -> Rig {
    let mut rig = simple_rig(asset);
    rig.skeleton.joints = (0..joints)
        .map(|joint| Joint {
            name: format!("joint_{joint}"),
            parent: joint.checked_sub(1),
            position: DVec3::new(0.1, 0.01 * joint as f64, -0.3),
        })
        .collect();
    for (vertex, row) in rig.skin.rows.iter_mut().enumerate() {
        let share = |place: usize| 1.0 / (2 + place / 2) as f32;
        let sum: f32 = (0..influences).map(share).sum();
        *row = (0..influences)
            .map(|place| Influence { joint: ((vertex + place) % joints) as u32, weight: share(place) / sum })
            .collect();
    }
    rig
}

fn attribute<'a>(json: &'a Value, name: &str) -> &'a Value {
    let accessor = &json["meshes"][0]["primitives"][0]["attributes"][name];
    accessor.as_u64().map_or(&Value::Null, |accessor| &json["accessors"][accessor as usize])
}

#[test]
fn weights_descend_sum_to_one_and_name_each_joint_once() {
    let asset = read(&plain().glb()).unwrap();
    let mut rig = wide_rig(&asset, 40, 7);
    // Out of order, twice the same joint, zeros: the file is still in order.
    rig.skin.rows[5] =
        [(3, 0.25), (9, 0.0), (1, 0.25), (3, 0.5)].map(|(joint, weight)| Influence { joint, weight }).to_vec();
    let file = encode_glb(&asset, &rig, &EncodeOptions::default()).unwrap();
    keep("forty_joints", &file);
    for shown in posed(&file) {
        assert_eq!(shown.joints[5], [3, 1, 0, 0]);
        assert_eq!(shown.weights[5], [0.75, 0.25, 0.0, 0.0]);
        for (joints, weights) in shown.joints.iter().zip(&shown.weights) {
            assert!((weights.iter().sum::<f32>() - 1.0).abs() <= 8e-7);
            assert!(weights.is_sorted_by(|a, b| a >= b));
            assert!((0..4).all(|slot| weights[slot] > 0.0 || joints[slot] == 0));
        }
    }
    let (json, _) = open(&file);
    assert_eq!(attribute(&json, "JOINTS_0")["componentType"], 5121);
    assert_eq!(attribute(&json, "JOINTS_1"), &Value::Null);
}

#[test]
fn more_than_256_joints_are_numbered_in_shorts() {
    let asset = read(&plain().glb()).unwrap();
    for (joints, component) in [(256, 5121), (257, 5123)] {
        let file = encode_glb(&asset, &wide_rig(&asset, joints, 3), &EncodeOptions::default()).unwrap();
        keep(&format!("joints_{joints}"), &file);
        let (json, _) = open(&file);
        assert_eq!(attribute(&json, "JOINTS_0")["componentType"], component);
    }
}

#[test]
fn eight_influences_make_a_second_set_with_the_lighter_half() {
    let asset = read(&plain().glb()).unwrap();
    let options = EncodeOptions { influences_max: 8, ..EncodeOptions::default() };
    let file = encode_glb(&asset, &wide_rig(&asset, 20, 8), &options).unwrap();
    keep("eight_influences", &file);
    let gltf::Gltf { document, blob } = gltf::Gltf::from_slice(&file).unwrap();
    let primitive = document.meshes().next().unwrap().primitives().next().unwrap();
    let reader = primitive.reader(|_| blob.as_deref());
    let sets = [0, 1].map(|set| reader.read_weights(set).unwrap().into_f32().collect::<Vec<_>>());
    for (first, second) in sets[0].iter().zip(&sets[1]) {
        assert!(first[3] >= second[0] && second[0] > 0.0);
        assert!((first.iter().chain(second).sum::<f32>() - 1.0).abs() < 1e-6);
    }
}

#[test]
fn whole_number_weights_sum_exactly() {
    let asset = read(&plain().glb()).unwrap();
    for (weights, component, whole, name) in
        [(WeightFormat::U16, 5123, 65535_u32, "weights_u16"), (WeightFormat::U8, 5121, 255, "weights_u8")]
    {
        let options = EncodeOptions { weights, ..EncodeOptions::default() };
        let file = encode_glb(&asset, &wide_rig(&asset, 9, 4), &options).unwrap();
        keep(name, &file);
        let (json, binary) = open(&file);
        let accessor = attribute(&json, "WEIGHTS_0");
        assert_eq!(accessor["componentType"], component);
        assert_eq!(accessor["normalized"], true);
        let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let start = view["byteOffset"].as_u64().unwrap() as usize;
        let bytes = &binary[start..start + view["byteLength"].as_u64().unwrap() as usize];
        let width = if whole > 255 { 2 } else { 1 };
        let values: Vec<u32> =
            bytes.chunks(width).map(|v| v.iter().rev().fold(0, |s, b| s << 8 | u32::from(*b))).collect();
        assert!(values.chunks(4).all(|row| row.iter().sum::<u32>() == whole && row.is_sorted_by(|a, b| a >= b)));
    }
}

#[test]
fn joints_have_translations_only_and_the_rest_pose_is_the_bind_pose() {
    let asset = read(&plain().glb()).unwrap();
    let rig = wide_rig(&asset, 100, 2);
    let (json, binary) = open(&encode_glb(&asset, &rig, &EncodeOptions::default()).unwrap());
    let skin = &json["skins"][0];
    assert_eq!(skin["skeleton"], skin["joints"][0]);
    let accessor = &json["accessors"][skin["inverseBindMatrices"].as_u64().unwrap() as usize];
    let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
    assert!(view.get("byteStride").is_none() && view.get("target").is_none());
    let start = view["byteOffset"].as_u64().unwrap() as usize;
    let mut place = DVec3::ZERO;
    for (number, joint) in skin["joints"].as_array().unwrap().iter().enumerate() {
        let node = json["nodes"][joint.as_u64().unwrap() as usize].as_object().unwrap();
        assert!(node.keys().all(|key| ["name", "translation", "children"].contains(&key.as_str())));
        place += DVec3::from_array([0, 1, 2].map(|axis| node["translation"][axis].as_f64().unwrap()));
        let at = start + 64 * number + 48;
        let inverse: Vec<f32> =
            binary[at..at + 12].as_chunks::<4>().0.iter().map(|four| f32::from_le_bytes(*four)).collect();
        assert!((0..3).all(|axis| (f64::from(inverse[axis]) + place[axis]).abs() < 1e-6));
        assert!(place.distance(rig.skeleton.joints[number].position) < 1e-6);
    }
}

#[test]
fn a_rig_that_does_not_fit_the_mesh_is_not_written() {
    let asset = read(&plain().glb()).unwrap();
    let fault = |change: fn(&mut Rig)| {
        let mut rig = simple_rig(&asset);
        change(&mut rig);
        encode_glb(&asset, &rig, &EncodeOptions::default()).unwrap_err()
    };
    assert_eq!(fault(|rig| rig.skin.rows.truncate(3)), EncodeError::RowCount { rows: 3, vertices: 24 });
    assert_eq!(fault(|rig| rig.skin.rows[7].clear()), EncodeError::NoWeight { vertex: 7 });
    assert_eq!(
        fault(|rig| rig.skin.rows[7][0].joint = 3),
        EncodeError::UnknownJoint { vertex: 7, joint: 3, joints: 3 }
    );
    assert_eq!(fault(|rig| rig.skeleton.joints.clear()), EncodeError::JointCount { joints: 0, limit: 65535 });
    assert_eq!(fault(|rig| rig.skeleton.joints[1].parent = Some(2)).code(), "skeleton_invalid");
    assert_eq!(fault(|rig| rig.skeleton.joints[1].parent = None).code(), "skeleton_invalid");
    assert_eq!(fault(|rig| rig.skeleton.joints[1].position.x = f64::NAN).code(), "skeleton_invalid");
}

#[test]
fn animations_of_a_mesh_node_are_dropped_and_those_of_its_morph_weights_kept() {
    let mut builder = plain();
    let deltas = builder.floats(&[[0.0, 0.1, 0.0]; 24]);
    builder.json["meshes"][0]["primitives"][0]["targets"] = json!([{ "POSITION": deltas }]);
    let (times, values) = (builder.floats(&[[0.0], [1.0]]), builder.floats(&[[0.0], [1.0]]));
    let moves = builder.floats(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]);
    let sampler = |output: usize| json!({ "input": times, "output": output });
    let channel = |sampler: usize, path: &str| json!({ "sampler": sampler, "target": { "node": 0, "path": path } });
    let channels = [channel(0, "translation"), channel(1, "weights")];
    builder.push("animations", json!({ "samplers": [sampler(moves), sampler(values)], "channels": channels }));
    builder.push("animations", json!({ "samplers": [sampler(moves)], "channels": [channel(0, "translation")] }));
    let asset = read(&builder.glb()).unwrap();
    assert!(codes(&asset).contains(&"animation_dropped"));
    let (json, _) = open(&encoded("animated", &asset));
    assert_eq!(json["animations"].as_array().unwrap().len(), 1);
    assert_eq!(json["animations"][0]["channels"], json!([channel(0, "weights")]));

    // With a child to be moved, the node keeps its animation and the mesh, with its weights, gets a node of its own.
    builder.json["nodes"][0]["children"] = json!([1]);
    builder.push("nodes", json!({ "name": "Hat" }));
    let asset = read(&builder.glb()).unwrap();
    assert!(codes(&asset).contains(&"animation_no_longer_moves_mesh"));
    let (json, _) = open(&encoded("animated_with_child", &asset));
    let targets: Vec<u64> = json["animations"][0]["channels"]
        .as_array()
        .unwrap()
        .iter()
        .map(|channel| channel["target"]["node"].as_u64().unwrap())
        .collect();
    assert_eq!(targets, [0, 2]);
}

/// Two triangles over a shared edge that is a seam: split vertices of one file vertex.
fn scene_asset() -> Asset {
    let positions =
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 2.0, 0.0], [0.0, 2.0, 0.5]].map(DVec3::from_array).to_vec();
    let triangles = vec![[0, 1, 2], [0, 2, 3]];
    let primitive = |rows: [u32; 3], material: usize| ScenePrimitive {
        material: Some(material),
        mesh_rows: rows.to_vec(),
        normals: Some(vec![[0.0, 0.0, 1.0]; 3]),
        texture_coordinates: Some(vec![[0.0, 0.5]; 3]),
        colors: (material == 1).then(|| vec![[1.0, 0.5, 0.25, 1.0]; 3]),
        triangles: vec![[0, 1, 2]],
    };
    let scene = Scene {
        nodes: vec![SceneNode {
            name: "hips".into(),
            primitives: vec![primitive([0, 1, 2], 0), primitive([0, 2, 3], 1)],
        }],
        materials: vec![
            Material { name: "skin".into(), base_color_texture: Some(0), alpha: Alpha::Blend, ..Material::default() },
            Material { emissive: [0.1, 0.0, 0.0], ..Material::default() },
        ],
        images: vec![Image { name: "skin.png".into(), media_type: ImageType::Png, bytes: pixel() }],
        skeleton: None,
    };
    let parts = vec![Part { name: "hips".into(), mesh: 0, primitive: 0, vertices: 0..4 }];
    let mesh = Mesh { positions, triangles };
    let source = Source::Scene(scene);
    Asset {
        format: Format::Obj,
        mesh,
        parts,
        axes: None,
        contents: Contents::default(),
        existing_rig: None,
        old_rig: None,
        findings: Vec::new(),
        source,
    }
}

#[test]
fn a_scene_becomes_a_glb_whose_seams_share_their_weights() {
    let asset = scene_asset();
    let file = encoded("scene", &asset);
    let (json, _) = open(&file);
    assert_eq!(json["nodes"][0]["name"], "hips");
    assert_eq!(json["nodes"][1]["name"], "hips_2");
    assert_eq!(json["materials"][0]["alphaMode"], "BLEND");
    let shown = posed(&file);
    for (primitive, rows) in [[0, 1, 2], [0, 2, 3]].iter().enumerate() {
        for (split, &row) in rows.iter().enumerate() {
            assert!(shown[primitive].positions[split].distance(asset.mesh.positions[row]) < 1e-6);
        }
    }
    assert_eq!((shown[0].joints[2], shown[0].weights[2]), (shown[1].joints[1], shown[1].weights[1]));
}

/// A material with a texture needs texture coordinates; a part that has none gets its plain twin.
#[test]
fn a_part_without_texture_coordinates_gets_no_texture() {
    let mut asset = scene_asset();
    let Source::Scene(scene) = &mut asset.source else { panic!("expected a scene") };
    scene.nodes[0].primitives[1].material = Some(0);
    scene.nodes[0].primitives[1].texture_coordinates = None;
    let (json, _) = open(&encoded("scene_without_coordinates", &asset));
    let material = |primitive: usize| {
        let index = json["meshes"][0]["primitives"][primitive]["material"].as_u64().expect("a material");
        &json["materials"][index as usize]
    };
    assert_eq!((&material(0)["name"], &material(1)["name"]), (&json!("skin"), &json!("skin")));
    assert!(material(0)["pbrMetallicRoughness"]["baseColorTexture"].is_object());
    assert!(material(1)["pbrMetallicRoughness"]["baseColorTexture"].is_null(), "{:#}", material(1));
}
