//! OBJ: what is read, and where errors are.

use super::*;

#[test]
fn obj_vertices_stay_in_file_order_with_unused_ones_and_any_line_ends() {
    let text = "# comment\r\nv 9 9 9\r\nv 0 0 0 # at the origin\r\nv 1e0 0 0\r\nv \\\r\n 0 1 0\r\n\
                f -3 -2 \\\n-1\r\ns off\r\n";
    let asset = accept("a.obj", text.as_bytes());
    assert_eq!(asset.mesh.positions.len(), 4);
    assert_eq!(asset.mesh.positions[3].to_array(), [0.0, 1.0, 0.0]);
    assert_eq!(asset.mesh.triangles, [[1, 2, 3]]);
    assert_eq!(codes(&asset), ["unused_vertices"]);
    let old_mac = String::from_utf8_lossy(TETRAHEDRON_OBJ).replace('\n', "\r");
    assert_eq!(accept("a.obj", old_mac.as_bytes()).mesh, accept("a.obj", TETRAHEDRON_OBJ).mesh);
}

#[test]
fn obj_corners_split_where_attributes_differ_and_remember_their_vertex() {
    let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 2\n\
                f 1/1/1 2/2/1 3/3/1\nf 1/2/1 3/3/1 4/4/1\n";
    let asset = accept("a.obj", text.as_bytes());
    let primitive = &scene(&asset).nodes[0].primitives[0];
    assert_eq!(primitive.mesh_rows, [0, 0, 1, 2, 3], "vertex 1 is split, vertex 3 is shared");
    assert_eq!(primitive.triangles, [[0, 2, 3], [1, 3, 4]]);
    assert_eq!(primitive.normals.as_ref().expect("normals")[0], [0.0, 0.0, 1.0]);
    let uvs = primitive.texture_coordinates.as_ref().expect("texture coordinates");
    assert_eq!(uvs[0], [0.0, 1.0], "the origin moves from below to above");
    assert_eq!(asset.mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
}

#[test]
fn obj_objects_and_groups_become_nodes_and_materials_become_primitives() {
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\no body\nusemtl skin\nf 1 2 3\nusemtl cloth\nf 1 2 4\n\
                g sleeve left\nf 1 3 4\no hat\nusemtl skin\nf 2 3 4\ng\no body\nf 4 3 2\n";
    let asset = accept("a.obj", text.as_bytes());
    let nodes: Vec<(&str, usize)> =
        scene(&asset).nodes.iter().map(|node| (node.name.as_str(), node.primitives.len())).collect();
    assert_eq!(nodes, [("body", 2), ("body_sleeve left", 1), ("hat", 1)]);
    let materials: Vec<&str> = scene(&asset).materials.iter().map(|material| material.name.as_str()).collect();
    assert_eq!(materials, ["skin", "cloth"]);
    assert_eq!(asset.mesh.triangles[4], [3, 2, 1], "faces stay in file order across nodes");
    assert_eq!(asset.parts.len(), 1);
}

#[test]
fn obj_polygons_are_cut_without_overlap() {
    let text = "v 0 0 0\nv 2 1 0\nv 0 2 0\nv 1 1 0\nf 1 2 3 4\n";
    let asset = accept("a.obj", text.as_bytes());
    let area: f64 = asset
        .mesh
        .triangles
        .iter()
        .map(|triangle| {
            let [a, b, c] = triangle.map(|corner| asset.mesh.positions[corner as usize]);
            (b - a).cross(c - a).z / 2.0
        })
        .inspect(|area| assert!(*area > 0.0))
        .sum();
    assert!((area - 1.0).abs() < 1e-12);
}

#[test]
fn obj_vertex_colors_are_linear_and_may_count_to_255() {
    let unit = accept("a.obj", b"v 0 0 0 1 0 0.2\nv 1 0 0 1 0 0.2\nv 0 1 0 1 0 0.2\nf 1 2 3\n");
    let bytes = accept("a.obj", b"v 0 0 0 255 0 51\nv 1 0 0 255 0 51\nv 0 1 0 255 0 51\nf 1 2 3\n");
    for asset in [unit, bytes] {
        let color = scene(&asset).nodes[0].primitives[0].colors.as_ref().expect("colours")[0];
        assert!((color[0] - 1.0).abs() < 1e-6 && color[1] == 0.0 && (color[2] - 0.033_104_8).abs() < 1e-6, "{color:?}");
    }
}

#[test]
fn obj_normals_of_no_length_or_number_are_repaired() {
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 0\nvn nan nan nan\nvn 0 0 1\nf 1//1 2//2 3//3\n";
    let asset = accept("a.obj", text.as_bytes());
    let normals = scene(&asset).nodes[0].primitives[0].normals.as_ref().expect("normals");
    assert_eq!(normals, &[[0.0, 0.0, 1.0]; 3]);
    assert!(codes(&asset).contains(&"repaired_normals"));
}

#[test]
fn obj_errors_name_their_line() {
    let cases: [(&str, DecodeError); 5] = [
        (
            "v 0 0 0\nv 1 0 zero\n",
            DecodeError::Malformed { format: "OBJ", place: Place::Line(2), problem: "\"zero\" is not a number".into() },
        ),
        (
            "v 0 0\n",
            DecodeError::Malformed {
                format: "OBJ",
                place: Place::Line(1),
                problem: "a number is missing at the end of the line".into(),
            },
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\n\nf 1 2 4\n",
            DecodeError::IndexOutOfRange { format: "OBJ", place: Place::Line(5), what: "vertex", index: 4, count: 3 },
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n",
            DecodeError::IndexOutOfRange { format: "OBJ", place: Place::Line(4), what: "vertex", index: -4, count: 3 },
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1//1 2//1 3//1\n",
            DecodeError::IndexOutOfRange { format: "OBJ", place: Place::Line(4), what: "normal", index: 1, count: 0 },
        ),
    ];
    for (text, expected) in cases {
        assert_eq!(refusal("a.obj", text.as_bytes()), expected, "{text}");
    }
    for corner in ["0", "1/2/3/4", "x", "99999999999999999999", "9223372036854775807", "4294967296", ""] {
        let text = format!("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 {corner}\n");
        assert!(read("a.obj", text.as_bytes()).is_err(), "{corner}");
    }
}

#[test]
fn positions_that_are_not_usable_numbers_are_refused_in_every_format() {
    for value in ["nan", "NaN", "inf", "-Infinity", "-1.#IND", "1e300", "1e999"] {
        let obj = format!("v 0 0 0\nv 1 0 0\nv 0 {value} 0\nf 1 2 3\n");
        assert_eq!(refusal("a.obj", obj.as_bytes()).code(), "non_finite_vertices", "{value}");
        let stl = String::from_utf8(ascii_stl()).expect("text").replacen("vertex 0 0", &format!("vertex 0 {value}"), 1);
        assert_eq!(refusal("a.stl", stl.as_bytes()).code(), "non_finite_vertices", "{value}");
        let ply = String::from_utf8(ascii_ply()).expect("text").replace("\n1 0 0\n", &format!("\n{value} 0 0\n"));
        assert_eq!(refusal("a.ply", ply.as_bytes()).code(), "non_finite_vertices", "{value}");
    }
    let mut stl = binary_stl();
    stl[96..100].copy_from_slice(&f32::NAN.to_le_bytes());
    assert_eq!(refusal("a.stl", &stl).code(), "non_finite_vertices");
    let fbx = String::from_utf8(ascii_fbx("", "")).expect("text").replace("a: 0,0,0,100", "a: 0,1e300,0,100");
    assert_eq!(refusal("a.fbx", fbx.as_bytes()).code(), "non_finite_vertices");
}
