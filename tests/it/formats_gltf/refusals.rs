//! What is refused, by which code, and that nothing hostile panics.

use super::fixtures::*;
use super::{existing_rigs, reading, unchanged};
use rigsmith::formats::{DecodeError, DecodeOptions, ExistingRigPolicy, Limits, NoSiblings, decode};
use serde_json::{Value, json};

/// The refusal of the plain fixture after `change`; it must say what to do next.
fn refusal(change: impl FnOnce(&mut Value)) -> DecodeError {
    let mut builder = plain();
    change(&mut builder.json);
    refused(&builder.glb())
}

fn refused(bytes: &[u8]) -> DecodeError {
    let error = read(bytes).expect_err("accepted");
    assert!(!error.hint().is_empty() && !error.to_string().is_empty());
    error
}

#[test]
fn every_prefix_of_a_valid_glb_decodes_or_is_refused_without_panic() {
    let sent = plain().glb();
    for length in 0..sent.len() {
        let error = read(&sent[..length]).expect_err("a prefix is accepted");
        assert!(["unreadable_mesh", "unsupported_media_type"].contains(&error.code()), "{length}: {error}");
    }
}

#[test]
fn every_changed_byte_of_a_valid_glb_decodes_or_is_refused_without_panic() {
    let mut builder = plain();
    builder.json["nodes"][0]["scale"] = json!([-1, 2, 3]);
    let sent = builder.glb();
    for position in 0..sent.len() {
        for value in [0, b'9', b'"', b'}', 0xff] {
            let mut changed = sent.clone();
            changed[position] = value;
            if let Ok(asset) = read(&changed) {
                // What is accepted can be written, too.
                let rig = simple_rig(&asset);
                rigsmith::formats::gltf::encode_glb(&asset, &rig, &Default::default()).expect("writes");
            }
        }
    }
}

/// Pointers to every value of a document.
fn pointers(json: &Value, at: &str, found: &mut Vec<String>) {
    found.push(at.to_owned());
    match json {
        Value::Object(members) => {
            members.iter().for_each(|(key, value)| pointers(value, &format!("{at}/{key}"), found))
        }
        Value::Array(list) => {
            list.iter().enumerate().for_each(|(i, value)| pointers(value, &format!("{at}/{i}"), found))
        }
        _ => {}
    }
}

#[test]
fn every_value_replaced_by_any_other_kind_decodes_or_is_refused_without_panic() {
    let strange = [
        json!(null),
        json!(true),
        json!(-1),
        json!(0),
        json!(1),
        json!(5),
        json!(5121),
        json!(0.5),
        json!(1e300),
        json!(u64::MAX),
        json!("x"),
        json!("SCALAR"),
        json!([]),
        json!([0]),
        json!([1, 1, 1]),
        json!([{}]),
        json!({}),
    ];
    let options = DecodeOptions {
        existing_rig: ExistingRigPolicy::Replace,
        allow_missing_textures: true,
        ..DecodeOptions::default()
    };
    for fixture in [
        existing_rigs::rigged_fixture().glb(),
        reading::quantised().glb(),
        reading::compressed(),
        unchanged::rich().glb(),
    ] {
        let (json, binary) = open(&fixture);
        let mut all = Vec::new();
        pointers(&json, "", &mut all);
        for pointer in &all {
            for value in &strange {
                let mut changed = json.clone();
                *changed.pointer_mut(pointer).unwrap() = value.clone();
                let sent = glb(&changed, &binary);
                if let Ok(asset) = decode("a.glb", &sent, &NoSiblings, &Limits::default(), &options) {
                    let rig = simple_rig(&asset);
                    let written = rigsmith::formats::gltf::encode_glb(&asset, &rig, &Default::default());
                    let written = written.unwrap_or_else(|error| panic!("{pointer} = {value}: {error}"));
                    // Our own output is read again, as rigged.
                    assert!(
                        decode("a.glb", &written, &NoSiblings, &Limits::default(), &options).is_ok(),
                        "{pointer} = {value}"
                    );
                }
            }
        }
    }
}

#[test]
fn each_fault_has_its_code() {
    type Change = fn(&mut Value);
    let cases: &[(&str, &str, Change)] = &[
        ("version 1", "unreadable_mesh", |json| json["asset"]["version"] = json!("1.0")),
        ("no asset", "unreadable_mesh", |json| json["asset"] = Value::Null),
        ("nodes are no list", "unreadable_mesh", |json| json["nodes"] = json!({})),
        ("an accessor is no object", "unreadable_mesh", |json| json["accessors"][0] = json!(3)),
        ("mesh out of range", "unreadable_mesh", |json| json["nodes"][0]["mesh"] = json!(7)),
        ("negative mesh", "unreadable_mesh", |json| json["nodes"][0]["mesh"] = json!(-1)),
        ("mesh without primitives", "unreadable_mesh", |json| json["meshes"][0]["primitives"] = json!([])),
        ("primitive is no object", "unreadable_mesh", |json| json["meshes"][0]["primitives"][0] = json!("x")),
        ("attributes are no object", "unreadable_mesh", |json| {
            json["meshes"][0]["primitives"][0]["attributes"] = json!([1]);
        }),
        ("no positions", "unreadable_mesh", |json| json["meshes"][0]["primitives"][0]["attributes"] = json!({})),
        ("positions in planes", "unreadable_mesh", |json| json["accessors"][0]["type"] = json!("VEC2")),
        ("accessor out of range", "unreadable_mesh", |json| json["meshes"][0]["primitives"][0]["indices"] = json!(99)),
        ("view out of range", "unreadable_mesh", |json| json["accessors"][0]["bufferView"] = json!(99)),
        ("buffer out of range", "unreadable_mesh", |json| json["bufferViews"][0]["buffer"] = json!(1)),
        ("view beyond its buffer", "unreadable_mesh", |json| json["bufferViews"][0]["byteLength"] = json!(1 << 30)),
        ("offset overflows", "unreadable_mesh", |json| json["bufferViews"][0]["byteOffset"] = json!(u64::MAX)),
        ("accessor beyond its view", "unreadable_mesh", |json| json["accessors"][0]["count"] = json!(25)),
        ("ten billion vertices", "unreadable_mesh", |json| json["accessors"][0]["count"] = json!(10_000_000_000_u64)),
        ("ten billion zeros", "too_many_vertices", |json| {
            json["accessors"][0] = json!({ "componentType": 5126, "count": 10_000_000_000_u64, "type": "VEC3" });
        }),
        ("unknown component", "unreadable_mesh", |json| json["accessors"][0]["componentType"] = json!(5124)),
        ("unknown mode", "unreadable_mesh", |json| json["meshes"][0]["primitives"][0]["mode"] = json!(9)),
        ("indices of floats", "unreadable_mesh", |json| json["accessors"][2]["componentType"] = json!(5126)),
        ("index beyond the vertices", "unreadable_mesh", |json| json["accessors"][0]["count"] = json!(23)),
        ("stride too small", "unreadable_mesh", |json| json["bufferViews"][0]["byteStride"] = json!(4)),
        ("its own child", "unreadable_mesh", |json| json["nodes"][0]["children"] = json!([0])),
        ("two parents", "unreadable_mesh", |json| {
            json["nodes"] = json!([{ "mesh": 0 }, { "children": [0] }, { "children": [0] }]);
            json["scenes"] = json!([{ "nodes": [1, 2] }]);
        }),
        ("a cycle beside the scene", "unreadable_mesh", |json| {
            json["nodes"] = json!([{ "mesh": 0 }, { "children": [2] }, { "children": [1] }]);
        }),
        ("scene root with a parent", "unreadable_mesh", |json| {
            json["nodes"] = json!([{ "mesh": 0 }, { "children": [0] }]);
        }),
        ("scene out of range", "unreadable_mesh", |json| json["scene"] = json!(4)),
        ("a bent matrix", "unreadable_mesh", |json| json["nodes"][0]["matrix"] = json!([1, 2, 3])),
        ("infinite transform", "non_finite_vertices", |json| json["nodes"][0]["scale"] = json!([1e308, 1e308, 1e308])),
        ("no meshes in the scene", "no_geometry", |json| json["scenes"] = json!([{ "nodes": [] }])),
        ("points only", "no_geometry", |json| json["meshes"][0]["primitives"][0]["mode"] = json!(0)),
        ("no extent", "no_geometry", |json| json["nodes"][0]["scale"] = json!([0, 0, 0])),
        ("required Draco", "unsupported_extension", |json| {
            json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
        }),
        ("required unknown", "unsupported_extension", |json| json["extensionsRequired"] = json!(["VENDOR_shape"])),
        ("instancing", "unsupported_extension", |json| {
            json["nodes"][0]["extensions"] = json!({ "EXT_mesh_gpu_instancing": { "attributes": {} } });
        }),
        ("missing texture", "missing_resource", |json| json["images"] = json!([{ "uri": "skin.png" }])),
        ("texture of the web", "missing_resource", |json| json["images"] = json!([{ "uri": "https://host/skin.png" }])),
    ];
    for (name, code, change) in cases {
        let error = refusal(change);
        assert_eq!(error.code(), *code, "{name}: {error}");
    }
}

#[test]
fn refusals_name_the_extension_or_the_file() {
    let error = refusal(|json| json["extensionsRequired"] = json!(["VENDOR_shape"]));
    assert_eq!(error, DecodeError::UnsupportedExtension { name: "VENDOR_shape".into() });
    let sent = plain().gltf("../body%20one.bin");
    let error = decode("a.gltf", &sent, &NoSiblings, &Limits::default(), &DecodeOptions::default()).unwrap_err();
    assert_eq!(error, DecodeError::MissingResource { name: "../body one.bin".into() });
}

#[test]
fn a_damaged_or_short_buffer_is_refused() {
    let read =
        |uri: &str| decode("a.gltf", &plain().gltf(uri), &NoSiblings, &Limits::default(), &DecodeOptions::default());
    assert!(matches!(read("data:;base64,???").unwrap_err(), DecodeError::Malformed { .. }));
    assert!(matches!(read("data:;base64,AAAA").unwrap_err(), DecodeError::Truncated { .. }));
}

#[test]
fn positions_that_are_no_numbers_are_refused() {
    for bad in [f32::NAN, f32::INFINITY, 1e30] {
        let mut builder = plain();
        builder.binary[24..28].copy_from_slice(&bad.to_le_bytes());
        assert_eq!(refused(&builder.glb()).code(), "non_finite_vertices", "{bad}");
    }
}

#[test]
fn limits_are_checked_on_what_is_declared() {
    let sent = plain().glb();
    let with = |limits: Limits| decode("a.glb", &sent, &NoSiblings, &limits, &DecodeOptions::default()).unwrap_err();
    assert_eq!(with(Limits { vertices_max: 23, ..Limits::default() }).code(), "too_many_vertices");
    assert_eq!(with(Limits { faces_max: 11, ..Limits::default() }).code(), "too_many_faces");
    assert_eq!(with(Limits { nodes_max: 0, ..Limits::default() }).code(), "too_large");
    // Thousands of nodes on one mesh.
    let mut builder = plain();
    (0..4000).for_each(|_| {
        builder.root(json!({ "mesh": 0 }));
    });
    let limits = Limits { vertices_max: 50_000, ..Limits::default() };
    let error = decode("a.glb", &builder.glb(), &NoSiblings, &limits, &DecodeOptions::default()).unwrap_err();
    assert_eq!(error.code(), "too_many_vertices");
}

#[test]
fn deep_and_endless_json_is_refused_before_it_is_parsed() {
    let deep = format!("{{\"asset\":{}1{}}}", "[".repeat(100_000), "]".repeat(100_000));
    assert!(matches!(refused(deep.as_bytes()), DecodeError::TooDeep { .. }));
    let wide = format!("{{\"asset\":[{}0]}}", "0,".repeat(2_000_001));
    assert!(matches!(refused(wide.as_bytes()), DecodeError::TooMany { .. }));
}

#[test]
fn a_chain_of_nodes_may_be_as_long_as_the_limit_of_nodes() {
    let mut builder = plain();
    let mut above = builder.root(json!({ "translation": [0, 0.001, 0] }));
    for _ in 0..4000 {
        let node = builder.push("nodes", json!({ "translation": [0, 0.001, 0] }));
        builder.json["nodes"][above]["children"] = json!([node]);
        above = node;
    }
    builder.json["nodes"][above]["mesh"] = json!(0);
    let asset = read(&builder.glb()).unwrap();
    assert!((asset.mesh.positions[24].y - asset.mesh.positions[0].y - 4.001).abs() < 1e-4);
}

#[test]
fn a_wrong_glb_header_is_refused() {
    let sent = plain().glb();
    for (at, value) in [(4, 1), (8, 5), (16, b'X'), (20, b'[')] {
        let mut changed = sent.clone();
        changed[at] = value;
        assert_eq!(refused(&changed).code(), "unreadable_mesh");
    }
}
