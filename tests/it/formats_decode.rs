//! Decoding of OBJ, PLY, STL, FBX and zip archives: what is read, and that everything else is refused by name.
//! All fixtures are written by code, in [`samples`].

mod archives;
mod fbx;
mod fbx_skeletons;
mod materials;
mod obj;
mod ply_and_stl;
mod refusals;
mod samples;

use rigsmith::formats::{
    Alpha, Asset, DecodeError, DecodeOptions, ExistingRigPolicy, Format, ImageType, Limits, NoSiblings, Place, Scene,
    Siblings, Source, decode, decode_as,
};
use samples::*;
use std::collections::BTreeMap;

type Files = BTreeMap<String, Vec<u8>>;

fn read(name: &str, bytes: &[u8]) -> Result<Asset, DecodeError> {
    read_with(name, bytes, &NoSiblings)
}

fn read_with(name: &str, bytes: &[u8], siblings: &dyn Siblings) -> Result<Asset, DecodeError> {
    decode(name, bytes, siblings, &Limits::default(), &DecodeOptions::default())
}

fn accept(name: &str, bytes: &[u8]) -> Asset {
    read(name, bytes).unwrap_or_else(|error| panic!("{name} is refused: {error}"))
}

/// The refusal of an upload, which must say what to do next.
fn refusal(name: &str, bytes: &[u8]) -> DecodeError {
    let error = read(name, bytes).err().unwrap_or_else(|| panic!("{name} is accepted"));
    assert!(!error.hint().is_empty() && !error.to_string().is_empty());
    error
}

fn scene(asset: &Asset) -> &Scene {
    match &asset.source {
        Source::Scene(scene) => scene,
        Source::Gltf(_) => panic!("expected a scene"),
    }
}

fn codes(asset: &Asset) -> Vec<&'static str> {
    asset.findings.iter().map(|finding| finding.code).collect()
}

fn files<const N: usize>(files: [(&str, &[u8]); N]) -> Files {
    files.into_iter().map(|(name, bytes)| (name.to_owned(), bytes.to_vec())).collect()
}

#[test]
fn every_sample_is_read_and_its_scene_is_consistent() {
    for (name, bytes) in samples() {
        let asset = accept(name, &bytes);
        let rows = asset.mesh.positions.len();
        assert_eq!(asset.parts.first().map(|part| part.vertices.start), Some(0), "{name}");
        assert_eq!(asset.parts.last().map(|part| part.vertices.end), Some(rows), "{name}");
        let mut scene_triangles = 0;
        for node in &scene(&asset).nodes {
            assert!(!node.name.is_empty() && !node.primitives.is_empty(), "{name}");
            for primitive in &node.primitives {
                let splits = primitive.mesh_rows.len();
                assert!(primitive.mesh_rows.iter().all(|&row| (row as usize) < rows), "{name}");
                assert!(primitive.mesh_rows.is_sorted(), "{name}: file order is kept");
                assert!(primitive.triangles.iter().flatten().all(|&split| (split as usize) < splits), "{name}");
                assert!(primitive.normals.as_ref().is_none_or(|normals| normals.len() == splits), "{name}");
                assert!(primitive.texture_coordinates.as_ref().is_none_or(|uvs| uvs.len() == splits), "{name}");
                assert!(primitive.colors.as_ref().is_none_or(|colors| colors.len() == splits), "{name}");
                for normal in primitive.normals.iter().flatten() {
                    let length = normal.iter().map(|value| value * value).sum::<f32>().sqrt();
                    assert!((length - 1.0).abs() < 1e-6, "{name}: {normal:?}");
                }
                scene_triangles += primitive.triangles.len();
            }
        }
        assert_eq!(scene_triangles, asset.mesh.triangles.len(), "{name}");
    }
}

#[test]
fn reading_twice_gives_the_same() {
    for (name, bytes) in samples() {
        assert_eq!(format!("{:?}", accept(name, &bytes)), format!("{:?}", accept(name, &bytes)), "{name}");
    }
}

#[test]
fn every_prefix_of_a_valid_file_decodes_or_is_refused_without_panic() {
    for (name, bytes) in samples() {
        for length in 0..bytes.len() {
            if let Err(error) = read(name, &bytes[..length]) {
                assert!(!error.code().is_empty(), "{name} cut at {length}");
            }
        }
    }
}

#[test]
fn a_truncated_binary_or_counted_file_is_never_taken_for_whole() {
    for (name, bytes) in samples().into_iter().filter(|(name, _)| !name.ends_with(".obj") && !name.ends_with(".fbx")) {
        // The last byte of a text file may be a line end.
        for length in 0..bytes.len() - 1 {
            assert!(read(name, &bytes[..length]).is_err(), "{name} cut at {length} of {}", bytes.len());
        }
    }
}

#[test]
fn flipped_bits_never_cause_a_panic() {
    for (name, bytes) in samples() {
        for at in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[at] ^= 1 << (at % 8);
            let _ = read(name, &damaged);
        }
    }
}

#[test]
fn content_decides_before_the_name_does() {
    assert_eq!(accept("tetra.obj", &ascii_ply()).format, Format::Ply);
    assert_eq!(accept("tetra.glb", &binary_stl()).format, Format::Stl);
    assert_eq!(accept("upload", TETRAHEDRON_OBJ).format, Format::Obj);
    assert_eq!(accept("upload", &ascii_fbx("", "")).format, Format::Fbx);
    let mut solid_binary = binary_stl();
    solid_binary[..11].copy_from_slice(b"solid facet");
    assert_eq!(accept("tetra.stl", &solid_binary).mesh.triangles.len(), 4);
}

#[test]
fn other_formats_are_refused_by_name() {
    let cases: [(&str, &[u8], &str); 12] = [
        ("a.blend", b"BLENDER-v402REND", "a Blender 4.2 file"),
        ("a.blend", b"BLENDER17-01v0500REND", "a Blender 5.0 file"),
        ("a.obj", PNG, "a PNG image"),
        ("a.glb", b"%PDF-1.7 and so on", "a PDF document"),
        ("a.dae", b"<?xml version=\"1.0\"?>\n<COLLADA xmlns=\"x\">", "a Collada file"),
        ("a.usdc", b"PXR-USDC\0\0\0\0", "a USD file"),
        ("a.html", b"<!DOCTYPE html><p>404", "a web page"),
        ("a.gz", b"\x1f\x8b\x08\0\0\0", "a gzip file"),
        ("a.abc", b"Ogawa\xff\0\0", "an Alembic file"),
        ("a.xyz", b"hello there", "a text file named .xyz"),
        ("noname", b"\x01\x02\xff\xfe", "an unknown binary file"),
        ("a.mp4", b"\0\0\0\x18ftypmp42", "an MP4 or HEIF file"),
    ];
    for (name, bytes, expected) in cases {
        let error = refusal(name, bytes);
        assert_eq!(error, DecodeError::UnsupportedFormat { seen: expected.into() });
        assert_eq!(error.code(), "unsupported_media_type");
    }
}

#[test]
fn wrong_magic_under_a_known_extension_is_refused() {
    assert_eq!(refusal("a.ply", b"plx\nformat ascii 1.0\n").code(), "unreadable_mesh");
    assert_eq!(refusal("a.fbx", b"Kaydara XXX Binary  \0").code(), "unreadable_mesh");
    assert_eq!(refusal("a.obj", b"\x4c\x01\x03\0\0\0\0\0junk of an object file").code(), "unreadable_mesh");
    assert_eq!(refusal("a.stl", b"solidus").code(), "unreadable_mesh");
    assert_eq!(refusal("a.zip", b"PQ\x03\x04").code(), "unreadable_mesh");
}

#[test]
fn an_empty_file_is_refused_as_empty() {
    for name in ["a.obj", "a.ply", "a.stl", "a.fbx", "a.zip", "a.glb", "a"] {
        assert_eq!(refusal(name, b""), DecodeError::Empty);
    }
}
