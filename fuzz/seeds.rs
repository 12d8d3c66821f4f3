//! Writes a few small valid files per fuzz target to `fuzz/corpus/`, for the fuzzer to start from.

use base64::Engine;
use std::path::Path;

#[allow(dead_code, reason = "the decoding tests use all of it")]
#[path = "../tests/it/formats_decode/samples.rs"]
mod samples;

/// Two joints with a socket between them.
const RIG_JSON: &[u8] = br#"{"format": "rigsmith.rig/1", "joints": [{"name": "hips", "parent": null, "position": [0, 1, 0]},
 {"name": "spine", "parent": 0, "position": [0, 2, 0]}], "nodes": [{"parent": null, "joint": 0, "rotation": [0.6, 0, 0, 0.8]},
 {"parent": 0, "name": "socket", "translation": [0, 1, 0], "scale": [2, 2, 2]}, {"parent": 1, "joint": 1}], "skin_order": [1, 0]}"#;
/// The same as a skin.
const SKINNED_GLTF: &[u8] =
    br#"{"asset": {"version": "2.0"}, "scenes": [{"nodes": [0, 1]}], "nodes": [{"mesh": 0, "skin": 0},
 {"name": "hips", "translation": [0, 1, 0], "rotation": [0.6, 0, 0, 0.8], "children": [2]},
 {"name": "socket", "translation": [0, 1, 0], "scale": [2, 2, 2], "children": [3]}, {"name": "spine"}],
 "meshes": [{"primitives": [{"attributes": {}}]}], "skins": [{"joints": [3, 1]}]}"#;

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
    let buffer = samples::triangle_buffer();
    let uri = format!("data:application/octet-stream;base64,{}", base64::prelude::BASE64_STANDARD.encode(&buffer));
    write("gltf", 0, &samples::triangle_gltf(Some(uri)))?;
    write("gltf", 1, &[&samples::triangle_gltf(Some("a.bin".into()))[..], b"\0SIBLING\0", &buffer].concat())?;
    write("glb", 0, &samples::glb(samples::triangle_gltf(None), &buffer))?;
    write("skeleton", 0, RIG_JSON)?;
    write("skeleton", 1, &samples::glb(SKINNED_GLTF.to_vec(), &buffer))
}
