//! PLY and STL.

use super::*;

#[test]
fn ply_of_all_encodings_gives_the_same_mesh() {
    let [little, big] = [false, true].map(|big_endian| accept("a.ply", &binary_ply(big_endian)));
    assert_eq!(little.mesh, big.mesh);
    assert_eq!(scene(&little), scene(&big));
    assert_eq!(little.mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3]]);
    let primitive = &scene(&little).nodes[0].primitives[0];
    assert_eq!(primitive.mesh_rows, [0, 1, 2, 3]);
    assert_eq!(primitive.normals.as_ref().expect("normals")[3], [0.0, 0.0, 1.0], "a zero normal is repaired");
    assert_eq!(primitive.texture_coordinates.as_ref().expect("coordinates")[0], [0.25, 0.75]);
    let color = primitive.colors.as_ref().expect("colours")[0];
    assert!((color[2] - 0.033_104_8).abs() < 1e-6 && color[3] == 1.0, "{color:?}");
    let text = accept("a.ply", &ascii_ply());
    assert_eq!(text.mesh, accept("a.obj", TETRAHEDRON_OBJ).mesh);
}

#[test]
fn ply_refuses_what_its_header_cannot_mean() {
    let change = |from: &str, to: &str| {
        let text = String::from_utf8(ascii_ply()).expect("text");
        assert!(text.contains(from));
        refusal("a.ply", text.replacen(from, to, 1).as_bytes())
    };
    assert_eq!(change("float x", "quaternion x").code(), "unreadable_mesh");
    assert_eq!(change("format ascii 1.0\n", "").code(), "unreadable_mesh");
    assert_eq!(change("property float z\n", "").code(), "unreadable_mesh");
    assert_eq!(change("element vertex 4", "element vertex -4").code(), "unreadable_mesh");
    assert_eq!(change("list uchar int", "list float int").code(), "unreadable_mesh");
    assert_eq!(change("3 0 2 1", "3 0 2 9").code(), "unreadable_mesh");
    assert_eq!(change("3 0 2 1", "3 0 2 -1").code(), "unreadable_mesh");
    assert_eq!(change("3 0 2 1", "3 0 2 1.5").code(), "unreadable_mesh");
    assert_eq!(change("3 0 2 1", "-3 0 2 1").code(), "unreadable_mesh");
    assert_eq!(change("element face", "element tristrips").code(), "unreadable_mesh");
}

#[test]
fn ply_texture_coordinates_of_faces_are_left_out_with_a_word() {
    let text = String::from_utf8(ascii_ply()).expect("text");
    let text = text.replace("end_header", "property list uchar float texcoord\nend_header").replace("\n3 ", "\n3  ");
    let lines: Vec<String> =
        text.lines().map(|line| if line.starts_with("3  ") { format!("{line} 2 0 1") } else { line.into() }).collect();
    let asset = accept("a.ply", (lines.join("\n") + "\n").as_bytes());
    assert_eq!(codes(&asset), ["face_texture_coordinates"]);
    assert_eq!(asset.mesh, accept("a.ply", &ascii_ply()).mesh);
}

#[test]
fn stl_has_three_rows_per_facet_in_file_order() {
    for bytes in [binary_stl(), ascii_stl()] {
        let asset = accept("a.stl", &bytes);
        assert_eq!(asset.mesh.positions.len(), 12);
        let expected: Vec<[u32; 3]> = (0..4).map(|facet| [3 * facet, 3 * facet + 1, 3 * facet + 2]).collect();
        assert_eq!(asset.mesh.triangles, expected);
        assert_eq!(asset.mesh.positions[4].to_array(), [1.0, 0.0, 0.0]);
    }
    let two = [ascii_stl(), ascii_stl()].concat();
    let asset = accept("a.stl", &two);
    assert_eq!(scene(&asset).nodes.len(), 2);
    assert_eq!(scene(&asset).nodes[0].name, "tetra hedron");
    assert_eq!(scene(&asset).nodes[1].primitives[0].mesh_rows[0], 12);
}

#[test]
fn stl_with_bytes_after_its_facets_is_read_with_a_warning() {
    let bytes = [binary_stl(), vec![0; 10]].concat();
    assert!(codes(&accept("a.stl", &bytes)).contains(&"trailing_bytes"));
}
