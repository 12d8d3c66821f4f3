//! Meshes that cannot be worked on, and limits.

use super::*;

#[test]
fn a_point_cloud_is_refused_as_one() {
    assert_eq!(refusal("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"), DecodeError::PointCloud { points: 3 });
    let ply = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
               end_header\n0 0 0\n1 1 1\n";
    assert_eq!(refusal("a.ply", ply.as_bytes()), DecodeError::PointCloud { points: 2 });
    assert_eq!(DecodeError::PointCloud { points: 2 }.code(), "no_geometry");
}

#[test]
fn a_file_without_triangles_is_refused() {
    assert_eq!(refusal("a.obj", b"v 0 0 0\nv 1 0 0\nl 1 2\n"), DecodeError::NoTriangles { vertices: 2 });
    assert_eq!(refusal("a.obj", b"# nothing\n"), DecodeError::NoTriangles { vertices: 0 });
    assert_eq!(refusal("a.stl", b"solid x facet\nendsolid\n").code(), "no_geometry");
    let mut none = vec![0; 80];
    none.extend([0; 4]);
    assert_eq!(refusal("a.stl", &none), DecodeError::NoTriangles { vertices: 0 });
    assert_eq!(refusal("a.obj", b"v 0 0 0\nv 1 0 0\ncstype bezier\nsurf 0 1 0 1 1 2\nend\n").code(), "unreadable_mesh");
}

#[test]
fn a_mesh_without_extent_or_area_is_refused() {
    let point = refusal("a.obj", b"v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n");
    assert_eq!(point, DecodeError::ZeroExtent { longest_side: 0.0 });
    let far = refusal("a.obj", b"v 1e9 0 0\nv 1000000001 0 0\nv 1e9 1 0\nf 1 2 3\n");
    assert!(matches!(far, DecodeError::ZeroExtent { .. }), "{far:?}");
    let line = refusal("a.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n");
    assert_eq!(line, DecodeError::AllDegenerate { faces: 1 });
    // A vertex that no face uses does not give the mesh an extent.
    assert_eq!(refusal("a.obj", b"v 5 5 5\nv 1 1 1\nv 1 1 1\nv 1 1 1\nf 2 3 4\n").code(), "no_geometry");
}

#[test]
fn a_tiny_or_distant_mesh_that_single_precision_can_hold_is_read() {
    accept("a.obj", b"v 0 0 0\nv 1e-15 0 0\nv 0 1e-15 0\nf 1 2 3\n");
    let asset = accept("a.obj", b"v 5000 0 0\nv 5001 0 0\nv 5000 1 0\nf 1 2 3\n");
    assert!(codes(&asset).contains(&"far_from_origin"));
}

#[test]
fn degenerate_faces_and_duplicate_vertices_are_kept_and_told() {
    let asset = accept("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 0\nf 1 2 3\nf 1 1 2\nf 4 2 3\n");
    assert_eq!((asset.mesh.positions.len(), asset.mesh.triangles.len()), (4, 3));
    assert!(codes(&asset).contains(&"degenerate_faces"));
}

#[test]
fn declared_sizes_beyond_the_file_are_refused_before_memory_is_spent() {
    let mut stl = binary_stl();
    stl[80..84].copy_from_slice(&200_000_000_u32.to_le_bytes());
    let error = refusal("a.stl", &stl);
    assert!(matches!(error, DecodeError::Truncated { needed: 10_000_000_084, .. }), "{error:?}");
    for (from, to) in [("vertex 4", "vertex 10000000000"), ("face 4", "face 10000000000")] {
        for sample in [ascii_ply(), binary_ply(false)] {
            let text: Vec<u8> = sample;
            let at = text.windows(from.len()).position(|window| window == from.as_bytes());
            let Some(at) = at else { continue };
            let declared = [&text[..at], to.as_bytes(), &text[at + from.len()..]].concat();
            let code = refusal("a.ply", &declared).code();
            assert!(["unreadable_mesh", "too_many_vertices"].contains(&code), "{code}");
        }
    }
    let list = String::from_utf8(ascii_ply())
        .expect("text")
        .replace("uchar int", "uint int")
        .replace("3 0 2 1", "4000000000 0 2 1");
    assert_eq!(refusal("a.ply", list.as_bytes()).code(), "unreadable_mesh");
    let nothing = "ply\nformat ascii 1.0\nelement air 10000000000\nend_header\n";
    assert_eq!(refusal("a.ply", nothing.as_bytes()), DecodeError::NoTriangles { vertices: 0 });
    let fbx = String::from_utf8(ascii_fbx("", "")).expect("text").replace("*15", "*10000000000");
    let _ = read("a.fbx", fbx.as_bytes());
}

#[test]
fn each_limit_refuses_with_its_own_code() {
    let default = Limits::default();
    let refused = |name: &str, bytes: &[u8], limits: Limits| {
        let error = decode(name, bytes, &NoSiblings, &limits, &DecodeOptions::default()).expect_err("refused");
        assert!(error.limit().is_some(), "{error:?}");
        error.code()
    };
    for (name, bytes) in samples() {
        assert_eq!(refused(name, &bytes, Limits { bytes_max: 10, ..default }), "too_large", "{name}");
        assert_eq!(refused(name, &bytes, Limits { vertices_max: 3, ..default }), "too_many_vertices", "{name}");
        assert_eq!(refused(name, &bytes, Limits { faces_max: 1, ..default }), "too_many_faces", "{name}");
    }
    let groups = b"v 0 0 0\nv 1 0 0\nv 0 1 0\ng a\nf 1 2 3\ng b\nf 1 2 3\n";
    assert_eq!(refused("a.obj", groups, Limits { nodes_max: 1, ..default }), "too_large");
    let materials = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nusemtl b\nf 1 2 3\n";
    assert_eq!(refused("a.obj", materials, Limits { materials_max: 1, ..default }), "too_large");
}

#[test]
fn a_big_mesh_is_read_with_a_word() {
    let limits = Limits { faces_without_a_word: 3, ..Limits::default() };
    let asset = decode("a.obj", TETRAHEDRON_OBJ, &NoSiblings, &limits, &DecodeOptions::default()).expect("reads");
    assert_eq!(codes(&asset), ["many_faces"]);
}
