//! glTF files made by code, simple rigs for them, and an independent look at what comes out (the `gltf` crate).

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat4, DVec3, DVec4};
use rigsmith::formats::gltf::{EncodeOptions, encode_glb};
use rigsmith::formats::{Asset, DecodeError, DecodeOptions, ExistingRigPolicy, Limits, NoSiblings, decode};
use rigsmith::rig::{Influence, Joint, Rig, Skeleton, SkinWeights};
use serde_json::{Value, json};

/// One white pixel.
pub const PIXEL: &str = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR42mP4DwABAQEAHLCMmQAAAABJRU5ErkJggg==";

pub fn pixel() -> Vec<u8> {
    STANDARD.decode(PIXEL).unwrap()
}

/// A document under construction.
#[derive(Clone)]
pub struct Builder {
    pub json: Value,
    pub binary: Vec<u8>,
}

impl Builder {
    pub fn new() -> Self {
        let json = json!({
            "asset": { "version": "2.0", "generator": "fixture" }, "scene": 0, "scenes": [{ "nodes": [] }],
            "nodes": [], "meshes": [], "accessors": [], "bufferViews": [],
        });
        Self { json, binary: Vec::new() }
    }

    pub fn push(&mut self, list: &str, value: Value) -> usize {
        if self.json[list].is_null() {
            self.json[list] = json!([]);
        }
        let list = self.json[list].as_array_mut().unwrap();
        list.push(value);
        list.len() - 1
    }

    pub fn view(&mut self, bytes: &[u8]) -> usize {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        let view = json!({ "buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len() });
        self.binary.extend_from_slice(bytes);
        self.push("bufferViews", view)
    }

    pub fn floats<const N: usize>(&mut self, rows: &[[f32; N]]) -> usize {
        let view = self.view(&float_bytes(rows));
        let kind = ["", "SCALAR", "VEC2", "VEC3", "VEC4"].get(N).copied().unwrap_or("MAT4");
        let mut accessor = json!({ "bufferView": view, "componentType": 5126, "count": rows.len(), "type": kind });
        if N == 3 || N == 1 {
            let bound = |pick: fn(f32, f32) -> f32| -> Vec<f64> {
                (0..N).map(|c| f64::from(rows.iter().map(|row| row[c]).reduce(pick).unwrap())).collect()
            };
            accessor["min"] = json!(bound(f32::min));
            accessor["max"] = json!(bound(f32::max));
        }
        self.push("accessors", accessor)
    }

    pub fn shorts(&mut self, indices: &[u16]) -> usize {
        let bytes: Vec<u8> = indices.iter().flat_map(|index| index.to_le_bytes()).collect();
        let view = self.view(&bytes);
        self.push(
            "accessors",
            json!({ "bufferView": view, "componentType": 5123, "count": indices.len(), "type": "SCALAR" }),
        )
    }

    /// A mesh of one primitive: a body of positions, normals and indices.
    pub fn body(&mut self, body: &Body) -> usize {
        let position = self.floats(&body.positions);
        let normal = self.floats(&body.normals);
        let indices = self.shorts(&body.indices);
        let primitive = json!({ "attributes": { "POSITION": position, "NORMAL": normal }, "indices": indices });
        self.push("meshes", json!({ "primitives": [primitive] }))
    }

    /// A node at the root of the scene.
    pub fn root(&mut self, node: Value) -> usize {
        let node = self.push("nodes", node);
        self.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(json!(node));
        node
    }

    pub fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        json["buffers"] = json!([{ "byteLength": self.binary.len() }]);
        glb(&json, &self.binary)
    }

    pub fn gltf(&self, uri: &str) -> Vec<u8> {
        let mut json = self.json.clone();
        json["buffers"] = json!([{ "byteLength": self.binary.len(), "uri": uri }]);
        json.to_string().into_bytes()
    }

    pub fn data_uri(&self) -> String {
        format!("data:application/octet-stream;base64,{}", STANDARD.encode(&self.binary))
    }
}

pub fn float_bytes<const N: usize>(rows: &[[f32; N]]) -> Vec<u8> {
    rows.as_flattened().iter().flat_map(|value| value.to_le_bytes()).collect()
}

pub fn glb(json: &Value, binary: &[u8]) -> Vec<u8> {
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut binary = binary.to_vec();
    binary.resize(binary.len().next_multiple_of(4), 0);
    let mut file = b"glTF\x02\0\0\0".to_vec();
    file.extend(u32::to_le_bytes((28 + text.len() + binary.len()) as u32));
    for (kind, content) in [(b"JSON", text), (b"BIN\0", binary)] {
        file.extend(u32::to_le_bytes(content.len() as u32));
        file.extend(kind);
        file.extend(content);
    }
    file
}

/// JSON and binary chunk of a GLB file.
pub fn open(file: &[u8]) -> (Value, Vec<u8>) {
    let size = u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
    let json = serde_json::from_slice(&file[20..20 + size]).unwrap();
    (json, file.get(28 + size..).unwrap_or_default().to_vec())
}

/// Geometry of one primitive.
#[derive(Clone)]
pub struct Body {
    pub positions: Vec<[f32; 3]>,
    pub normals: Vec<[f32; 3]>,
    pub indices: Vec<u16>,
}

/// A closed box with slanted sides, so that no axis is like another; normals point outwards.
pub fn body() -> Body {
    let mut positions = Vec::new();
    let mut normals = Vec::new();
    let mut indices = Vec::new();
    let corner = |bits: usize| {
        let side = |bit: usize| if bits >> bit & 1 == 1 { 1.0 } else { -1.0 };
        DVec3::new(side(0) * 0.5, side(1) * (1.0 + 0.2 * side(0)), side(2) * 0.25)
    };
    for [a, b, c, d] in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] {
        let first = positions.len() as u16;
        let normal = (corner(b) - corner(a)).cross(corner(c) - corner(a)).normalize();
        for bits in [a, b, c, d] {
            positions.push(corner(bits).as_vec3().to_array());
            normals.push(normal.as_vec3().to_array());
        }
        indices.extend([0, 1, 2, 0, 2, 3].map(|corner| first + corner));
    }
    Body { positions, normals, indices }
}

/// One body on one node without a transform.
pub fn plain() -> Builder {
    let mut builder = Builder::new();
    let mesh = builder.body(&body());
    builder.root(json!({ "name": "Body", "mesh": mesh }));
    builder
}

pub fn read(bytes: &[u8]) -> Result<Asset, DecodeError> {
    decode("character.glb", bytes, &NoSiblings, &Limits::default(), &DecodeOptions::default())
}

pub fn replace(bytes: &[u8]) -> Asset {
    let options = DecodeOptions { existing_rig: ExistingRigPolicy::Replace, ..DecodeOptions::default() };
    decode("character.glb", bytes, &NoSiblings, &Limits::default(), &options).expect("reads")
}

/// Three joints up the middle of the mesh's box; each vertex follows the two nearest.
pub fn simple_rig(asset: &Asset) -> Rig {
    let points = &asset.mesh.positions;
    let low = points.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = points.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    let middle = (low + high) / 2.0;
    let at = |part: f64| DVec3::new(middle.x, low.y + part * (high.y - low.y), middle.z);
    let joints = [("hips", None, at(0.2)), ("spine", Some(0), at(0.5)), ("head", Some(1), at(0.9))];
    let joints: Vec<Joint> =
        joints.into_iter().map(|(name, parent, position)| Joint { name: name.into(), parent, position }).collect();
    let size = (high - low).max_element();
    let row = |point: &DVec3| {
        let mut near: Vec<(f64, u32)> =
            joints.iter().enumerate().map(|(j, joint)| (joint.position.distance(*point) / size, j as u32)).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let share: Vec<f64> = near[..2].iter().map(|(distance, _)| 1.0 / (distance + 0.05)).collect();
        let sum: f64 = share.iter().sum();
        let pairs = near[..2].iter().zip(share);
        pairs.map(|((_, joint), share)| Influence { joint: *joint, weight: (share / sum) as f32 }).collect()
    };
    let rows = points.iter().map(row).collect();
    Rig { skeleton: Skeleton { joints }, skin: SkinWeights { rows } }
}

/// Decodes, rigs simply, encodes; the result also lies in `target/tmp/gltf/` for the validator.
pub fn rigged(name: &str, bytes: &[u8]) -> Vec<u8> {
    let asset = read(bytes).unwrap_or_else(|error| panic!("{name} is refused: {error}"));
    encoded(name, &asset)
}

pub fn encoded(name: &str, asset: &Asset) -> Vec<u8> {
    let rig = simple_rig(asset);
    let file = encode_glb(asset, &rig, &EncodeOptions::default()).unwrap_or_else(|error| panic!("{name}: {error}"));
    keep(name, &file);
    file
}

pub fn keep(name: &str, file: &[u8]) {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("gltf");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join(format!("{name}.glb")), file).unwrap();
}

/// World transforms of all nodes, by the `gltf` crate.
pub fn world_transforms(document: &gltf::Document) -> Vec<DMat4> {
    let mut world = vec![DMat4::IDENTITY; document.nodes().count()];
    let mut open: Vec<(gltf::Node, DMat4)> = Vec::new();
    for scene in document.scenes() {
        open.extend(scene.nodes().map(|node| (node, DMat4::IDENTITY)));
    }
    while let Some((node, above)) = open.pop() {
        let columns = node.transform().matrix().map(|column| DVec4::from_array(column.map(f64::from)));
        let here = above * DMat4::from_cols(columns[0], columns[1], columns[2], columns[3]);
        world[node.index()] = here;
        open.extend(node.children().map(|child| (child, here)));
    }
    world
}

/// One skinned primitive as a viewer shows it in the rest pose.
pub struct Shown {
    pub positions: Vec<DVec3>,
    pub normals: Vec<DVec3>,
    pub indices: Vec<u32>,
    pub joints: Vec<[u16; 4]>,
    pub weights: Vec<[f32; 4]>,
}

/// Every skinned primitive, posed by its skin at rest. Morph targets are left alone.
pub fn posed(file: &[u8]) -> Vec<Shown> {
    posed_with(file, |_| DMat4::IDENTITY)
}

/// `bend` turns each joint's world transform, by its place in the skin.
pub fn posed_with(file: &[u8], bend: impl Fn(usize) -> DMat4) -> Vec<Shown> {
    let gltf::Gltf { document, blob } = gltf::Gltf::from_slice(file).expect("the gltf crate reads the output");
    let blob = blob.unwrap_or_default();
    let world = world_transforms(&document);
    let mut shown = Vec::new();
    for node in document.nodes() {
        let (Some(mesh), Some(skin)) = (node.mesh(), node.skin()) else { continue };
        let reader = skin.reader(|_| Some(&blob));
        let inverse: Vec<DMat4> = reader
            .read_inverse_bind_matrices()
            .expect("inverse bind matrices")
            .map(|m| DMat4::from_cols_array_2d(&m.map(|column| column.map(f64::from))))
            .collect();
        let matrices: Vec<DMat4> = skin
            .joints()
            .enumerate()
            .map(|(place, joint)| bend(place) * world[joint.index()] * inverse[place])
            .collect();
        for primitive in mesh.primitives() {
            let reader = primitive.reader(|_| Some(&blob));
            let joints: Vec<[u16; 4]> = reader.read_joints(0).expect("joints").into_u16().collect();
            let weights: Vec<[f32; 4]> = reader.read_weights(0).expect("weights").into_f32().collect();
            let pose = |(vertex, point): (usize, [f32; 3])| {
                let point = DVec3::from_array(point.map(f64::from));
                let parts = joints[vertex].iter().zip(weights[vertex]);
                parts.map(|(j, w)| matrices[usize::from(*j)].transform_point3(point) * f64::from(w)).sum::<DVec3>()
            };
            let positions: Vec<DVec3> = reader.read_positions().expect("positions").enumerate().map(pose).collect();
            let normals = reader.read_normals().into_iter().flatten();
            let normals = normals.map(|normal| DVec3::from_array(normal.map(f64::from))).collect();
            let indices = match reader.read_indices() {
                Some(indices) => indices.into_u32().collect(),
                None => (0..positions.len() as u32).collect(),
            };
            shown.push(Shown { positions, normals, indices, joints, weights });
        }
    }
    shown
}

pub fn codes(asset: &Asset) -> Vec<&'static str> {
    asset.findings.iter().map(|finding| finding.code).collect()
}
