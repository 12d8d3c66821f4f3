//! The file that was sent, plus a skin, nothing else changed (output checklist 16 to 18, 22 to 24).

use super::fixtures::*;
use rigsmith::formats::gltf::{EncodeOptions, encode_glb, encode_gltf};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

/// A file with something of everything that must come through.
pub fn rich() -> Builder {
    let mut builder = plain();
    let image = builder.view(&pixel());
    builder.push("images", json!({ "bufferView": image, "mimeType": "image/png", "name": "skin" }));
    builder.push("images", json!({ "uri": format!("data:image/png;base64,{PIXEL}") }));
    builder.push("samplers", json!({ "wrapS": 33071 }));
    builder.push("textures", json!({ "source": 0, "sampler": 0 }));
    builder.push("textures", json!({ "source": 1 }));
    let coordinates = builder.floats(&[[0.25, 0.75]; 24]);
    builder.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(coordinates);
    builder.push(
        "materials",
        json!({
            "name": "Häut", "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "roughnessFactor": 0.30000000000000004 },
            "extensions": { "KHR_materials_unlit": {}, "VENDOR_unknown": { "keep": [1, 2.5, null] } }, "extras": { "mine": "x" },
        }),
    );
    builder.push("cameras", json!({ "type": "perspective", "perspective": { "yfov": 1.0, "znear": 0.1 } }));
    builder
        .root(json!({ "name": "Camera", "camera": 0, "translation": [0, 1.0, 5], "extras": { "order": ["z", "a"] } }));
    builder.push("scenes", json!({ "name": "other", "nodes": [1] }));
    let deltas = builder.floats(&[[0.0, 0.1, 0.0]; 24]);
    let times = builder.floats(&[[0.0], [1.0]]);
    let weights = builder.floats(&[[0.0], [1.0]]);
    builder.json["meshes"][0]["primitives"][0]["targets"] = json!([{ "POSITION": deltas }]);
    builder.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    builder.json["meshes"][0]["weights"] = json!([0.5]);
    builder.json["meshes"][0]["extras"] = json!({ "targetNames": ["smile"] });
    builder.push(
        "animations",
        json!({
            "name": "talk", "samplers": [{ "input": times, "output": weights }],
            "channels": [{ "sampler": 0, "target": { "node": 0, "path": "weights" } }],
        }),
    );
    builder.json["extensionsUsed"] = json!(["KHR_materials_unlit", "VENDOR_unknown"]);
    builder.json["extensions"] = json!({ "VENDOR_unknown": { "root": true } });
    builder.json["extras"] = json!("text");
    builder
}

/// Takes out of an output what the skin brought in. `before` tells how long the lists were.
fn without_skin(mut json: Value, before: &Value) -> Value {
    for list in ["nodes", "accessors", "bufferViews"] {
        let count = before[list].as_array().unwrap().len();
        json[list].as_array_mut().unwrap().truncate(count);
    }
    let nodes = before["nodes"].as_array().unwrap().len();
    for scene in json["scenes"].as_array_mut().unwrap() {
        scene["nodes"].as_array_mut().unwrap().retain(|node| node.as_u64().unwrap() < nodes as u64);
    }
    for mesh in json["meshes"].as_array_mut().unwrap() {
        for primitive in mesh["primitives"].as_array_mut().unwrap() {
            let attributes = primitive["attributes"].as_object_mut().unwrap();
            assert!(attributes.shift_remove("JOINTS_0").is_some() && attributes.shift_remove("WEIGHTS_0").is_some());
        }
    }
    for node in json["nodes"].as_array_mut().unwrap() {
        node.as_object_mut().unwrap().shift_remove("skin");
    }
    let object = json.as_object_mut().unwrap();
    object.shift_remove("skins");
    object["asset"] = before["asset"].clone();
    object["buffers"] = before["buffers"].clone();
    json
}

#[test]
fn a_file_comes_back_as_it_was_but_for_its_skin() {
    let sent = rich().glb();
    let (before, before_binary) = open(&sent);
    let (after, after_binary) = open(&rigged("rich", &sent));
    // Texts, so that the order of members and the spelling of numbers count too.
    assert_eq!(without_skin(after, &before).to_string(), before.to_string());
    assert_eq!(after_binary[..before_binary.len()], before_binary);
}

#[test]
fn the_generator_is_ours_and_the_senders_is_kept() {
    let asset = read(&rich().glb()).unwrap();
    let options = EncodeOptions { provenance: Some(json!({ "method": "rignet" })), ..EncodeOptions::default() };
    let (json, _) = open(&encode_glb(&asset, &simple_rig(&asset), &options).unwrap());
    assert!(json["asset"]["generator"].as_str().unwrap().starts_with("rigsmith "));
    assert_eq!(json["asset"]["extras"]["rigsmith"], json!({ "method": "rignet", "source_generator": "fixture" }));
}

#[test]
fn moving_a_mesh_node_changes_only_that_node_and_its_vertices() {
    let mut builder = rich();
    builder.json["nodes"][0]["translation"] = json!([1.0, 2.0, 3.0]);
    builder.json["nodes"][0]["rotation"] = json!([0.0, 0.6, 0.0, 0.8]);
    let sent = builder.glb();
    let (before, before_binary) = open(&sent);
    let (after, after_binary) = open(&rigged("rich_moved", &sent));
    let mut after = without_skin(after, &before);
    let mut expected = before.clone();
    for key in ["translation", "rotation"] {
        expected["nodes"][0].as_object_mut().unwrap().shift_remove(key);
    }
    // Bounds follow the vertices: of the positions and of the morph deltas.
    for accessor in [0, 1, 4] {
        for key in ["min", "max"] {
            expected["accessors"][accessor][key] = after["accessors"][accessor][key].take();
            after["accessors"][accessor][key] = expected["accessors"][accessor][key].clone();
        }
    }
    assert_eq!(after.to_string(), expected.to_string());
    let image = |json: &Value, binary: &[u8]| {
        let view = &json["bufferViews"][json["images"][0]["bufferView"].as_u64().unwrap() as usize];
        let start = view["byteOffset"].as_u64().unwrap() as usize;
        Sha256::digest(&binary[start..start + view["byteLength"].as_u64().unwrap() as usize])
    };
    assert_eq!(image(&before, &before_binary), image(&after, &after_binary));
}

#[test]
fn the_same_request_gives_the_same_bytes() {
    let sent = rich().glb();
    assert_eq!(rigged("rich", &sent), rigged("rich", &sent));
}

#[test]
fn the_output_is_the_input_plus_weights_and_skeleton_and_one_percent() {
    let mut builder = Builder::new();
    let ring = |i: u16| [f32::from(i % 200).sin(), f32::from(i) * 0.01, f32::from(i % 200).cos()];
    let positions: Vec<[f32; 3]> = (0..20_000).map(ring).collect();
    let indices: Vec<u16> = (0..19_800).flat_map(|i| [i, i + 1, i + 200]).collect();
    let (position, indices) = (builder.floats(&positions), builder.shorts(&indices));
    let primitive = json!({ "attributes": { "POSITION": position }, "indices": indices });
    let mesh = builder.push("meshes", json!({ "primitives": [primitive] }));
    builder.root(json!({ "mesh": mesh, "scale": [2.0, 3.0, -4.0] }));
    let sent = builder.glb();
    let skin = positions.len() * (4 + 16) + 3 * 64 + 1500;
    let out = rigged("large", &sent).len();
    assert!(out as f64 <= 1.01 * sent.len() as f64 + skin as f64, "{} became {out}", sent.len());
}

#[test]
fn a_gltf_output_holds_everything_in_one_file() {
    let asset = read(&rich().glb()).unwrap();
    let rig = simple_rig(&asset);
    let text = encode_gltf(&asset, &rig, &EncodeOptions::default()).unwrap();
    gltf::Gltf::from_slice(&text).expect("the gltf crate reads it");
    let again: Value = serde_json::from_slice(&text).unwrap();
    let (glb, _) = open(&encode_glb(&asset, &rig, &EncodeOptions::default()).unwrap());
    assert_eq!(again["accessors"], glb["accessors"]);
    assert!(again["buffers"][0]["uri"].as_str().unwrap().starts_with("data:application/octet-stream;base64,"));
}

#[test]
fn further_chunks_of_a_glb_are_passed_on() {
    let mut sent = plain().glb();
    sent.extend(4_u32.to_le_bytes());
    sent.extend(b"XTRAabcd");
    let length = sent.len() as u32;
    sent[8..12].copy_from_slice(&length.to_le_bytes());
    assert!(rigged("further_chunk", &sent).ends_with(b"\x04\0\0\0XTRAabcd"));
}

#[test]
fn wrong_bounds_are_put_right() {
    let mut builder = plain();
    builder.json["accessors"][0]["min"] = json!([0, 0, 0]);
    builder.json["accessors"][0].as_object_mut().unwrap().remove("max");
    let (json, _) = open(&rigged("bounds", &builder.glb()));
    assert_eq!(json["accessors"][0]["min"], json!([-0.5, -1.2000000476837158, -0.25]));
    assert_eq!(json["accessors"][0]["max"], json!([0.5, 1.2000000476837158, 0.25]));
}
