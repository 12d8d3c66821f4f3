//! Writes a few small valid files per fuzz target to `fuzz/corpus/`, for the fuzzer to start from.

use base64::Engine;
use std::path::Path;

#[allow(dead_code, reason = "the decoding tests use all of it")]
#[path = "../tests/it/formats_decode/samples.rs"]
mod samples;

/// A triangle as glTF, with its buffer as a data URI or in a GLB.
fn triangle_gltf(uri: Option<String>) -> Vec<u8> {
    let uri = uri.map_or_else(String::new, |uri| format!(r#","uri":"{uri}""#));
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],
"nodes":[{{"mesh":0,"translation":[0,1,0],"scale":[1,-1,2],"children":[1]}},{{"mesh":0,"name":"b","rotation":[0,0,0,1]}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"NORMAL":0}},"indices":1,"mode":4,"material":0,
"targets":[{{"POSITION":0}}]}}],"weights":[0.5]}}],
"materials":[{{"pbrMetallicRoughness":{{"baseColorFactor":[1,0,0,1]}},"doubleSided":true}}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0],
"sparse":{{"count":1,"indices":{{"bufferView":1,"componentType":5123}},"values":{{"bufferView":0}}}}}},
{{"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"}}],
"bufferViews":[{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":8}}],
"animations":[],"extensionsUsed":["KHR_mesh_quantization"],
"buffers":[{{"byteLength":44{uri}}}]}}"#
    )
    .into_bytes()
}

fn triangle_buffer() -> Vec<u8> {
    let positions: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let mut buffer: Vec<u8> = positions.iter().flat_map(|value| value.to_le_bytes()).collect();
    buffer.extend([0_u16, 1, 2, 0].iter().flat_map(|value| value.to_le_bytes()));
    buffer
}

fn glb(mut json: Vec<u8>, buffer: &[u8]) -> Vec<u8> {
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF\x02\0\0\0".to_vec();
    bytes.extend((28 + json.len() as u32 + buffer.len() as u32).to_le_bytes());
    bytes.extend((json.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(json);
    bytes.extend((buffer.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(buffer);
    bytes
}

fn main() -> std::io::Result<()> {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus");
    let write = |target: &str, index: usize, bytes: &[u8]| {
        std::fs::create_dir_all(corpus.join(target))?;
        std::fs::write(corpus.join(target).join(format!("seed-{index}")), bytes)
    };
    for (index, (name, bytes)) in samples::samples().iter().enumerate() {
        let target = name.rsplit('.').next().unwrap_or_default();
        let skipped = if target == "zip" { 4 } else { 0 };
        write(target, index, &bytes[skipped..])?;
    }
    let library = b"\0SIBLING\0newmtl skin\nKd 1 0 0\nmap_Kd -s 1 1 a.png\nmap_Bump normal.png\nd 0.5\nNs 10\n";
    write("obj", 100, &[samples::TEXTURED_OBJ, library].concat())?;
    let buffer = triangle_buffer();
    let uri = format!("data:application/octet-stream;base64,{}", base64::prelude::BASE64_STANDARD.encode(&buffer));
    write("gltf", 0, &triangle_gltf(Some(uri)))?;
    write("gltf", 1, &[&triangle_gltf(Some("a.bin".into()))[..], b"\0SIBLING\0", &buffer].concat())?;
    write("glb", 0, &glb(triangle_gltf(None), &buffer))
}
