//! Every way in which glTF can hold a mesh gives the same mesh (output checklist 18).

use super::fixtures::*;
use glam::{DMat4, DVec3};
use rigsmith::formats::{Asset, Contents, DecodeOptions, Limits, NoSiblings, Siblings, decode};
use serde_json::{Value, json};
use std::collections::BTreeMap;

fn read_files(name: &str, bytes: &[u8], siblings: &dyn Siblings) -> Asset {
    decode(name, bytes, siblings, &Limits::default(), &DecodeOptions::default()).expect("reads")
}

fn is_plain_body(asset: &Asset) {
    let expected = read(&plain().glb()).unwrap();
    assert_eq!(asset.mesh, expected.mesh);
}

fn one_primitive(builder: &mut Builder, primitive: Value) {
    let mesh = builder.push("meshes", json!({ "primitives": [primitive] }));
    builder.root(json!({ "mesh": mesh }));
}

#[test]
fn buffers_may_be_files_data_uris_or_the_binary_chunk() {
    let builder = plain();
    is_plain_body(&read_files("a.gltf", &builder.gltf(&builder.data_uri()), &NoSiblings));
    let files = BTreeMap::from([("in/my buffer.bin".to_owned(), builder.binary.clone())]);
    is_plain_body(&read_files("in/a.gltf", &builder.gltf("my%20buffer.bin"), &files));
    is_plain_body(&read_files("a.gltf", &builder.gltf("in/my buffer.bin"), &files));
}

#[test]
fn several_buffers_become_one() {
    let mut builder = plain();
    let second: Vec<u8> =
        builder.binary.split_off(builder.json["bufferViews"][2]["byteOffset"].as_u64().unwrap() as usize);
    builder.json["bufferViews"][2]["buffer"] = json!(1);
    builder.json["bufferViews"][2]["byteOffset"] = json!(0);
    builder.json["buffers"] = json!([
        { "byteLength": builder.binary.len(), "uri": builder.data_uri() }, { "byteLength": second.len(), "uri": "second.bin" },
    ]);
    let files = BTreeMap::from([("second.bin".to_owned(), second)]);
    let asset = read_files("a.gltf", builder.json.to_string().as_bytes(), &files);
    is_plain_body(&asset);
    let (json, _) = open(&encoded("several_buffers", &asset));
    assert_eq!(json["buffers"].as_array().unwrap().len(), 1);
}

#[test]
fn texture_files_are_embedded_unchanged() {
    let mut builder = plain();
    builder.push("images", json!({ "uri": "textures/skin.png" }));
    builder.push("textures", json!({ "source": 0 }));
    let files = BTreeMap::from([("textures/skin.png".to_owned(), pixel())]);
    let asset = read_files("a.gltf", &builder.gltf(&builder.data_uri()), &files);
    let (json, binary) = open(&encoded("embedded", &asset));
    assert_eq!(json["images"][0]["name"], "skin");
    assert_eq!(json["images"][0]["mimeType"], "image/png");
    let view = &json["bufferViews"][json["images"][0]["bufferView"].as_u64().unwrap() as usize];
    let start = view["byteOffset"].as_u64().unwrap() as usize;
    assert_eq!(binary[start..start + view["byteLength"].as_u64().unwrap() as usize], pixel());
}

#[test]
fn a_missing_texture_is_left_out_when_allowed() {
    let mut builder = plain();
    builder.push("images", json!({ "uri": "gone.png" }));
    builder.push("textures", json!({ "source": 0 }));
    let surface = json!({ "baseColorTexture": { "index": 0 }, "metallicFactor": 0.5 });
    builder.push("materials", json!({ "pbrMetallicRoughness": surface }));
    let options = DecodeOptions { allow_missing_textures: true, ..DecodeOptions::default() };
    let sent = builder.gltf(&builder.data_uri());
    let asset = decode("a.gltf", &sent, &NoSiblings, &Limits::default(), &options).unwrap();
    assert!(codes(&asset).contains(&"missing_texture"));
    let (json, _) = open(&encoded("missing_texture", &asset));
    assert_eq!(json["materials"][0], json!({ "pbrMetallicRoughness": { "metallicFactor": 0.5 } }));
}

#[test]
fn strips_fans_and_lists_without_indices_are_triangles() {
    let corners = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.5, 2.0, 0.0_f32]];
    for (mode, expected) in
        [(5, vec![[0, 1, 2], [1, 3, 2], [2, 3, 4]]), (6, vec![[1, 2, 0], [2, 3, 0], [3, 4, 0]]), (4, vec![[0, 1, 2]])]
    {
        for scale in [[1, 1, 1], [-1, 1, 1]] {
            let mut builder = Builder::new();
            let position = builder.floats(&corners);
            one_primitive(&mut builder, json!({ "attributes": { "POSITION": position }, "mode": mode }));
            builder.json["nodes"][0]["scale"] = json!(scale);
            let asset = read(&builder.glb()).unwrap();
            let flipped = |[a, b, c]: [u32; 3]| if scale[0] < 0 { [a, c, b] } else { [a, b, c] };
            let expected: Vec<[u32; 3]> = expected.iter().copied().map(flipped).collect();
            assert_eq!(asset.mesh.triangles, expected, "mode {mode}, scale {scale:?}");
            assert_eq!(posed(&encoded(&format!("mode_{mode}_{}", scale[0] + 1), &asset))[0].positions.len(), 5);
        }
    }
}

#[test]
fn sparse_positions_are_read_and_stay_sparse() {
    let mut builder = Builder::new();
    let body = body();
    let mut base = body.positions.clone();
    base[3] = [9.0, 9.0, 9.0];
    base[20] = [9.0, 9.0, 9.0];
    let position = builder.floats(&base);
    let indices_view = builder.view(&[3, 0, 20, 0]);
    let values_view = builder.view(&float_bytes(&[body.positions[3], body.positions[20]]));
    builder.json["accessors"][position]["sparse"] = json!({
        "count": 2, "indices": { "bufferView": indices_view, "componentType": 5123 }, "values": { "bufferView": values_view },
    });
    let indices = builder.shorts(&body.indices);
    one_primitive(&mut builder, json!({ "attributes": { "POSITION": position }, "indices": indices }));
    let asset = read(&builder.glb()).unwrap();
    is_plain_body(&asset);
    let (json, _) = open(&encoded("sparse", &asset));
    assert_eq!(json["accessors"][position]["sparse"]["count"], 2);
    // With a transform they become plain, and the sparse data goes.
    builder.json["nodes"][0]["translation"] = json!([1, 0, 0]);
    let (json, _) = open(&rigged("sparse_moved", &builder.glb()));
    assert!(json["accessors"].as_array().unwrap().iter().all(|accessor| accessor.get("sparse").is_none()));
}

/// The body with positions in normalized shorts, normals in normalized bytes and texture coordinates in shorts.
pub fn quantised() -> Builder {
    let mut builder = Builder::new();
    let body = body();
    let short = |value: f32| ((value / 2.0 * 32767.0).round() as i16).to_le_bytes();
    let positions: Vec<u8> =
        body.positions.iter().flat_map(|p| [short(p[0]), short(p[1]), short(p[2]), [0, 0]].concat()).collect();
    let normals: Vec<u8> =
        body.normals.iter().flat_map(|n| [n[0], n[1], n[2], 0.0].map(|v| (v * 127.0).round() as i8 as u8)).collect();
    let mut add = |bytes: &[u8], stride: usize, component: u32, kind: &str, normalized: bool| {
        let view = builder.view(bytes);
        builder.json["bufferViews"][view]["byteStride"] = json!(stride);
        builder.json["bufferViews"][view]["target"] = json!(34962);
        let accessor = json!({ "bufferView": view, "componentType": component, "count": 24, "type": kind, "normalized": normalized });
        builder.push("accessors", accessor)
    };
    let position = add(&positions, 8, 5122, "VEC3", true);
    let normal = add(&normals, 4, 5120, "VEC3", true);
    let coordinates = add(&[200, 0, 44, 1].repeat(24), 4, 5123, "VEC2", false);
    builder.json["accessors"][position]["min"] = json!([-8192, -19660, -4096]);
    builder.json["accessors"][position]["max"] = json!([8192, 19660, 4096]);
    let indices = builder.shorts(&body.indices);
    let attributes = json!({ "POSITION": position, "NORMAL": normal, "TEXCOORD_0": coordinates });
    one_primitive(&mut builder, json!({ "attributes": attributes, "indices": indices }));
    builder.json["nodes"][0]["scale"] = json!([2, 2, 2]);
    builder.json["extensionsUsed"] = json!(["KHR_mesh_quantization"]);
    builder.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    builder
}

#[test]
fn quantised_geometry_becomes_floats() {
    let asset = read(&quantised().glb()).unwrap();
    let expected = read(&plain().glb()).unwrap();
    for (a, b) in asset.mesh.positions.iter().zip(&expected.mesh.positions) {
        assert!(a.distance(*b) < 1e-4, "{a} {b}");
    }
    let file = encoded("quantised", &asset);
    let (json, _) = open(&file);
    assert!(json.get("extensionsRequired").is_none() && json.get("extensionsUsed").is_none());
    let attributes = &json["meshes"][0]["primitives"][0]["attributes"];
    for name in ["POSITION", "NORMAL", "TEXCOORD_0"] {
        let accessor = &json["accessors"][attributes[name].as_u64().unwrap() as usize];
        assert_eq!(accessor["componentType"], 5126, "{name}");
    }
    // The quantised bytes are gone: three accessors of floats, indices, joints, weights, inverse bind matrices.
    assert_eq!(json["bufferViews"].as_array().unwrap().len(), 7);
    let document = gltf::Gltf::from_slice(&file).unwrap();
    let primitive = document.meshes().next().unwrap().primitives().next().unwrap();
    let reader = primitive.reader(|_| document.blob.as_deref());
    assert!(reader.read_tex_coords(0).unwrap().into_f32().all(|pair| pair == [200.0, 300.0]));
}

pub fn compressed() -> Vec<u8> {
    meshopt_compressed("EXT_meshopt_compression")
}

/// The same file with every view compressed, as gltfpack writes it.
fn meshopt_compressed(extension: &str) -> Vec<u8> {
    let mut builder = plain();
    let plain_bytes = std::mem::take(&mut builder.binary);
    let views = builder.json["bufferViews"].as_array().unwrap().len();
    for index in 0..views {
        let view = builder.json["bufferViews"][index].clone();
        let start = view["byteOffset"].as_u64().unwrap() as usize;
        let bytes = &plain_bytes[start..start + view["byteLength"].as_u64().unwrap() as usize];
        let (compressed, mode, stride) = if index == 2 {
            let corners: Vec<u32> =
                bytes.as_chunks::<2>().0.iter().map(|two| u16::from_le_bytes(*two).into()).collect();
            (meshopt::encode_index_buffer(&corners, 24).unwrap(), "TRIANGLES", 2)
        } else {
            let rows: Vec<[u32; 3]> = bytes
                .as_chunks::<12>()
                .0
                .iter()
                .map(|row| [0, 4, 8].map(|at| u32::from_le_bytes(row[at..at + 4].try_into().unwrap())))
                .collect();
            (meshopt::encode_vertex_buffer(&rows).unwrap(), "ATTRIBUTES", 12)
        };
        builder.binary.resize(builder.binary.len().next_multiple_of(4), 0);
        let at = builder.binary.len();
        builder.binary.extend_from_slice(&compressed);
        let view = &mut builder.json["bufferViews"][index];
        view["buffer"] = json!(1);
        let count = view["byteLength"].as_u64().unwrap() / stride;
        view["extensions"][extension] = json!({
            "buffer": 0, "byteOffset": at, "byteLength": compressed.len(), "byteStride": stride, "count": count, "mode": mode,
        });
    }
    builder.json["buffers"] = json!([
        { "byteLength": builder.binary.len() },
        { "byteLength": plain_bytes.len(), "extensions": { extension: { "fallback": true } } },
    ]);
    builder.json["extensionsUsed"] = json!([extension]);
    builder.json["extensionsRequired"] = json!([extension]);
    glb(&builder.json, &builder.binary)
}

#[test]
fn meshopt_compressed_geometry_is_unpacked_and_the_packed_bytes_go() {
    let expected = read(&plain().glb()).unwrap();
    for extension in ["EXT_meshopt_compression", "KHR_meshopt_compression"] {
        let asset = read(&meshopt_compressed(extension)).unwrap();
        assert_eq!(asset.mesh.positions, expected.mesh.positions);
        // The codec may turn a triangle's corners around.
        let first_least = |triangle: &[u32; 3]| {
            let mut triangle = *triangle;
            let least = (0..3).min_by_key(|corner| triangle[*corner]).unwrap();
            triangle.rotate_left(least);
            triangle
        };
        let turned: Vec<_> = asset.mesh.triangles.iter().map(first_least).collect();
        assert_eq!(turned, expected.mesh.triangles.iter().map(first_least).collect::<Vec<_>>());
        let (json, binary) = open(&encoded("meshopt", &asset));
        assert!(json.get("extensionsRequired").is_none() && !json.to_string().contains("meshopt"));
        // The body's 24 vertices and 36 corners, 24 × (4 + 16) of skin and three matrices.
        assert!(binary.len() <= 24 * 24 + 72 + 24 * 20 + 3 * 64, "{}", binary.len());
    }
}

#[test]
fn damaged_meshopt_data_is_refused() {
    let mut file = meshopt_compressed("EXT_meshopt_compression");
    let end = file.len();
    file[end - 60..].fill(0x55);
    assert_eq!(read(&file).unwrap_err().code(), "unreadable_mesh");
}

#[test]
fn draco_data_beside_a_plain_copy_is_dropped() {
    let mut builder = plain();
    let packed = builder.view(b"packed");
    let extension = json!({ "KHR_draco_mesh_compression": { "bufferView": packed, "attributes": { "POSITION": 0 } } });
    builder.json["meshes"][0]["primitives"][0]["extensions"] = extension;
    builder.json["extensionsUsed"] = json!(["KHR_draco_mesh_compression"]);
    let asset = read(&builder.glb()).unwrap();
    is_plain_body(&asset);
    let (json, _) = open(&encoded("draco_copy", &asset));
    assert!(!json.to_string().contains("draco"));
}

#[test]
fn lines_and_points_of_a_skinned_mesh_get_weights_too() {
    let mut builder = plain();
    let position = builder.floats(&[[0.0, 2.0, 0.0], [0.0, 3.0, 0.0], [0.0, 4.0, 0.0]]);
    let primitives = builder.json["meshes"][0]["primitives"].as_array_mut().unwrap();
    primitives.push(json!({ "attributes": { "POSITION": position }, "mode": 3 }));
    primitives.push(json!({ "attributes": { "POSITION": position }, "mode": 0 }));
    let asset = read(&builder.glb()).unwrap();
    assert!(codes(&asset).contains(&"points_or_lines"));
    assert_eq!(asset.parts.len(), 3);
    assert_eq!(posed(&encoded("lines", &asset)).len(), 3);
}

#[test]
fn primitives_that_share_vertices_share_their_weights() {
    let mut builder = plain();
    let again = builder.json["meshes"][0]["primitives"][0].clone();
    builder.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(again);
    builder.json["nodes"][0]["scale"] = json!([1, 1, -1]);
    let file = rigged("shared_vertices", &builder.glb());
    let (json, _) = open(&file);
    let primitives = json["meshes"][0]["primitives"].as_array().unwrap();
    assert_eq!(primitives[0]["attributes"], primitives[1]["attributes"]);
    let shown = posed(&file);
    let low = shown[0].positions.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    assert!((low - DVec3::new(-0.5, -1.2, -0.25)).length() < 1e-6);
}

#[test]
fn a_posed_skin_moves_every_vertex_by_its_own_weights() {
    let asset = read(&plain().glb()).unwrap();
    let rig = simple_rig(&asset);
    let bend = |joint: usize| {
        DMat4::from_translation(DVec3::new(0.0, 0.0, joint as f64)) * DMat4::from_rotation_x(0.4 * joint as f64)
    };
    let shown = posed_with(&encoded("posed", &asset), bend);
    for ((shown, rest), row) in shown[0].positions.iter().zip(&asset.mesh.positions).zip(&rig.skin.rows) {
        let expected: DVec3 = row
            .iter()
            .map(|influence| bend(influence.joint as usize).transform_point3(*rest) * f64::from(influence.weight))
            .sum();
        assert!(shown.distance(expected) < 1e-5);
    }
}

#[test]
fn what_the_file_holds_is_counted_as_it_was_sent() {
    let mut builder = plain();
    let deltas = builder.floats(&[[0.0_f32; 3]; 24]);
    builder.json["meshes"][0]["primitives"][0]["targets"] = json!([{ "POSITION": deltas }, { "POSITION": deltas }]);
    builder.root(json!({ "name": "Twin", "mesh": 0, "translation": [2.0, 0.0, 0.0] }));
    let (time, values) = (builder.floats(&[[0.0_f32]]), builder.floats(&[[0.0_f32; 3]]));
    let sampler = json!({ "input": time, "output": values });
    let channel = json!({ "sampler": 0, "target": { "node": 0, "path": "translation" } });
    builder.push("animations", json!({ "samplers": [sampler], "channels": [channel] }));
    let asset = read(&builder.glb()).expect("reads");
    assert_eq!(asset.contents, Contents { meshes: 1, animations: 1, morph_targets: 2 }, "twins are one mesh");
    assert_eq!(asset.parts.len(), 2);
}

#[test]
fn a_finding_is_told_once_and_names_its_parts() {
    let mut builder = plain();
    let mut flat = body();
    flat.indices.extend([0, 0, 1]);
    let mesh = builder.body(&flat);
    let primitive = builder.json["meshes"][mesh]["primitives"][0].clone();
    builder.json["meshes"][mesh]["primitives"] = json!([primitive, primitive]);
    builder.root(json!({ "name": "Hat", "mesh": mesh }));
    let asset = read(&builder.glb()).expect("reads");
    let found: Vec<_> = asset.findings.iter().filter(|finding| finding.code == "degenerate_faces").collect();
    assert_eq!(found.len(), 1, "{:?}", asset.findings);
    assert_eq!(found[0].parts, ["Hat", "Hat, primitive 1"]);
}
