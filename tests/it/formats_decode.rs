//! Decoding of OBJ, PLY, STL, FBX and zip archives: what is read, and that everything else is refused by name.
//! All fixtures are written by the code below.

use flate2::Compression;
use flate2::write::DeflateEncoder;
use rigsmith::formats::{
    Alpha, Asset, DecodeError, DecodeOptions, ExistingRigPolicy, Format, ImageType, Limits, NoSiblings, Place, Scene,
    Siblings, Source, decode, decode_as,
};
use std::collections::BTreeMap;
use std::io::Write;

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

/// The smallest thing that passes for a PNG: textures are never decoded.
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n and some pixels";

const TETRAHEDRON_OBJ: &[u8] = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";

/// The same shape: corners and faces of a tetrahedron.
const CORNERS: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
const FACES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];

fn binary_stl() -> Vec<u8> {
    let mut bytes = vec![b' '; 80];
    bytes.extend((FACES.len() as u32).to_le_bytes());
    for face in FACES {
        bytes.extend([0; 12]);
        for corner in face {
            bytes.extend(CORNERS[corner as usize].iter().flat_map(|value| value.to_le_bytes()));
        }
        bytes.extend([0; 2]);
    }
    bytes
}

fn ascii_stl() -> Vec<u8> {
    let mut text = String::from("solid tetra hedron\n");
    for face in FACES {
        text += "facet normal 0 0 0\n outer loop\n";
        for [x, y, z] in face.map(|corner| CORNERS[corner as usize]) {
            text += &format!("  vertex {x} {y} {z}\n");
        }
        text += " endloop\nendfacet\n";
    }
    (text + "endsolid\n").into_bytes()
}

fn ascii_ply() -> Vec<u8> {
    let mut text = String::from("ply\nformat ascii 1.0\ncomment made by a test\nelement vertex 4\n");
    text += "property float x\nproperty float y\nproperty float z\nelement face 4\n";
    text += "property list uchar int vertex_indices\nend_header\n";
    for [x, y, z] in CORNERS {
        text += &format!("{x} {y} {z}\n");
    }
    for [a, b, c] in FACES {
        text += &format!("3 {a} {b} {c}\n");
    }
    text.into_bytes()
}

/// Vertices with normals, colours, texture coordinates and a property that nobody knows; a quad and two triangles.
fn binary_ply(big_endian: bool) -> Vec<u8> {
    let encoding = if big_endian { "binary_big_endian" } else { "binary_little_endian" };
    let mut bytes = format!(
        "ply\nformat {encoding} 1.0\nelement vertex 4\nproperty double x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\nproperty uchar red\nproperty uchar green\n\
         property uchar blue\nproperty float s\nproperty float t\nproperty list uchar short weird\n\
         element face 3\nproperty uchar flags\nproperty list uint8 uint vertex_index\n\
         element edge 1\nproperty int vertex1\nproperty int vertex2\nend_header\n"
    )
    .into_bytes();
    let f32_bytes = |value: f32| if big_endian { value.to_be_bytes() } else { value.to_le_bytes() };
    let u32_bytes = |value: u32| if big_endian { value.to_be_bytes() } else { value.to_le_bytes() };
    for (index, [x, y, z]) in
        [[0.0_f32, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]].iter().enumerate()
    {
        let x = f64::from(*x);
        bytes.extend(if big_endian { x.to_be_bytes() } else { x.to_le_bytes() });
        for value in [*y, *z, 0.0, 0.0, if index == 3 { 0.0 } else { 2.0 }] {
            bytes.extend(f32_bytes(value));
        }
        bytes.extend([255, 0, 51]);
        bytes.extend(f32_bytes(0.25));
        bytes.extend(f32_bytes(0.25));
        bytes.extend([2, 1, 2, 3, 4]);
    }
    for face in [&[0, 1, 2, 3][..], &[0, 1, 2], &[0, 2, 3]] {
        bytes.push(7);
        bytes.push(face.len() as u8);
        bytes.extend(face.iter().flat_map(|&index| u32_bytes(index)));
    }
    bytes.extend([0; 8]);
    bytes
}

// --- zip ---------------------------------------------------------------------------------------------------------

struct ZipEntry<'a> {
    name: &'a str,
    content: &'a [u8],
    flags: u16,
    /// What the directory declares, when that is a lie.
    declared_bytes: Option<u32>,
}

fn entry<'a>(name: &'a str, content: &'a [u8]) -> ZipEntry<'a> {
    ZipEntry { name, content, flags: 0, declared_bytes: None }
}

fn zip_of(entries: &[ZipEntry]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut directory = Vec::new();
    for entry in entries {
        let mut packer = DeflateEncoder::new(Vec::new(), Compression::best());
        packer.write_all(entry.content).expect("packs");
        let packed = packer.finish().expect("packs");
        let mut crc = flate2::Crc::new();
        crc.update(entry.content);
        let mut fields = Vec::new();
        fields.extend(20_u16.to_le_bytes());
        fields.extend(entry.flags.to_le_bytes());
        fields.extend(8_u16.to_le_bytes());
        fields.extend([0; 4]);
        fields.extend(crc.sum().to_le_bytes());
        fields.extend((packed.len() as u32).to_le_bytes());
        fields.extend(entry.declared_bytes.unwrap_or(entry.content.len() as u32).to_le_bytes());
        fields.extend((entry.name.len() as u16).to_le_bytes());
        fields.extend([0; 2]);
        directory.extend(b"PK\x01\x02\x14\0");
        directory.extend(&fields);
        directory.extend([0; 10]);
        directory.extend((bytes.len() as u32).to_le_bytes());
        directory.extend(entry.name.as_bytes());
        bytes.extend(b"PK\x03\x04");
        bytes.extend(&fields);
        bytes.extend(entry.name.as_bytes());
        bytes.extend(packed);
    }
    let start = bytes.len() as u32;
    let count = (entries.len() as u16).to_le_bytes();
    bytes.extend(&directory);
    bytes.extend(b"PK\x05\x06\0\0\0\0");
    bytes.extend(count);
    bytes.extend(count);
    bytes.extend((directory.len() as u32).to_le_bytes());
    bytes.extend(start.to_le_bytes());
    bytes.extend([0; 2]);
    bytes
}

// --- FBX ---------------------------------------------------------------------------------------------------------

/// A square of two materials and one quad plus a triangle, in centimetres with z up, moved by 100 along z.
fn ascii_fbx(extra_objects: &str, extra_connections: &str) -> Vec<u8> {
    format!(
        r#"; FBX 7.4.0 project file
FBXHeaderExtension:  {{
	FBXHeaderVersion: 1003
	FBXVersion: 7400
}}
GlobalSettings:  {{
	Version: 1000
	Properties70:  {{
		P: "UpAxis", "int", "Integer", "",2
		P: "UpAxisSign", "int", "Integer", "",1
		P: "FrontAxis", "int", "Integer", "",1
		P: "FrontAxisSign", "int", "Integer", "",-1
		P: "CoordAxis", "int", "Integer", "",0
		P: "CoordAxisSign", "int", "Integer", "",1
		P: "UnitScaleFactor", "double", "Number", "",1
	}}
}}
Objects:  {{
	Geometry: 1000, "Geometry::Plane", "Mesh" {{
		Vertices: *15 {{
			a: 0,0,0,100,0,0,100,0,100,0,0,100,50,0,150
		}}
		PolygonVertexIndex: *7 {{
			a: 0,1,2,-4,3,2,-5
		}}
		LayerElementNormal: 0 {{
			MappingInformationType: "ByPolygonVertex"
			ReferenceInformationType: "Direct"
			Normals: *21 {{
				a: 0,-1,0,0,-1,0,0,-1,0,0,-1,0,0,-1,0,0,-1,0,0,-1,0
			}}
		}}
		LayerElementUV: 0 {{
			MappingInformationType: "ByPolygonVertex"
			ReferenceInformationType: "IndexToDirect"
			UV: *8 {{
				a: 0,0,1,0,1,1,0,1
			}}
			UVIndex: *7 {{
				a: 0,1,2,3,3,2,0
			}}
		}}
		LayerElementMaterial: 0 {{
			MappingInformationType: "ByPolygon"
			ReferenceInformationType: "IndexToDirect"
			Materials: *2 {{
				a: 0,1
			}}
		}}
		Layer: 0 {{
			LayerElement:  {{
				Type: "LayerElementNormal"
				TypedIndex: 0
			}}
			LayerElement:  {{
				Type: "LayerElementUV"
				TypedIndex: 0
			}}
			LayerElement:  {{
				Type: "LayerElementMaterial"
				TypedIndex: 0
			}}
		}}
	}}
	Model: 2000, "Model::Board", "Mesh" {{
		Version: 232
		Properties70:  {{
			P: "Lcl Translation", "Lcl Translation", "", "A",0,0,100
		}}
	}}
	Material: 3000, "Material::Red", "" {{
		Version: 102
		ShadingModel: "phong"
		Properties70:  {{
			P: "DiffuseColor", "Color", "", "A",1,0,0
		}}
	}}
	Material: 3001, "Material::Painted", "" {{
		Version: 102
		ShadingModel: "phong"
	}}
	Texture: 4000, "Texture::Paint", "" {{
		Type: "TextureVideoClip"
		FileName: "C:\somewhere\paint.png"
		RelativeFilename: "..\paint.png"
	}}
{extra_objects}}}
Connections:  {{
	C: "OO",2000,0
	C: "OO",1000,2000
	C: "OO",3000,2000
	C: "OO",3001,2000
	C: "OP",4000,3001, "DiffuseColor"
{extra_connections}}}
"#
    )
    .into_bytes()
}

// --- what every format gives --------------------------------------------------------------------------------------

/// One small valid file of each format.
fn samples() -> Vec<(&'static str, Vec<u8>)> {
    let zip = zip_of(&[entry("shape/tetra.obj", TETRAHEDRON_OBJ), entry("shape/readme.txt", b"a shape")]);
    vec![
        ("tetra.obj", TETRAHEDRON_OBJ.to_vec()),
        ("tetra.stl", binary_stl()),
        ("tetra.stl", ascii_stl()),
        ("tetra.ply", ascii_ply()),
        ("square.ply", binary_ply(false)),
        ("square.ply", binary_ply(true)),
        ("board.fbx", ascii_fbx("", "")),
        ("tetra.zip", zip),
    ]
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

// --- detection ----------------------------------------------------------------------------------------------------

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

// --- OBJ ----------------------------------------------------------------------------------------------------------

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

// --- materials and textures ---------------------------------------------------------------------------------------

const TEXTURED_OBJ: &[u8] = b"mtllib look.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl skin\nf 1/1 2/1 3/1\n";

#[test]
fn material_libraries_and_their_textures_are_read_from_the_upload() {
    let library = b"newmtl other\nmap_Kd missing.png\nnewmtl skin\nKd 0 0 0\nNs 250\nd 0.5\nKe 1 0 0\n\
                    map_Kd -s 1 1 1 -o 0 0 -clamp on tex dir\\skin 1.png\nnorm n.jpg\nmap_Bump height.png\r\n";
    let upload = files([("look.mtl", library), ("tex dir/skin 1.png", PNG), ("n.jpg", b"\xff\xd8\xff\xe0 jpeg")]);
    let asset = read_with("a.obj", TEXTURED_OBJ, &upload).expect("reads");
    let scene = scene(&asset);
    let material = &scene.materials[0];
    assert_eq!((material.name.as_str(), material.alpha), ("skin", Alpha::Blend));
    assert_eq!(material.base_color, [1.0, 1.0, 1.0, 0.5], "a texture is not darkened by Kd");
    assert_eq!((material.roughness, material.metallic, material.emissive), (0.5, 0.0, [1.0, 0.0, 0.0]));
    let image = |index: Option<usize>| &scene.images[index.expect("a texture")];
    assert_eq!(image(material.base_color_texture).bytes, PNG);
    assert_eq!(image(material.base_color_texture).name, "skin 1.png");
    assert_eq!(image(material.normal_texture).media_type, ImageType::Jpeg);
    assert_eq!(scene.images.len(), 2, "textures of unused materials are not asked for");
}

#[test]
fn a_missing_texture_is_refused_by_its_name_unless_allowed() {
    let upload = files([("look.mtl", b"newmtl skin\nmap_Kd C:\\art\\skin.png\n".as_slice())]);
    let error = read_with("a.obj", TEXTURED_OBJ, &upload).expect_err("refused");
    assert_eq!(error, DecodeError::MissingResource { name: "C:\\art\\skin.png".into() });
    assert_eq!(error.code(), "missing_resource");
    let options = DecodeOptions { allow_missing_textures: true, ..DecodeOptions::default() };
    let asset = decode("a.obj", TEXTURED_OBJ, &upload, &Limits::default(), &options).expect("allowed");
    assert!(codes(&asset).contains(&"missing_texture"));
}

#[test]
fn a_missing_material_library_is_a_finding() {
    let asset = accept("a.obj", TEXTURED_OBJ);
    assert!(codes(&asset).contains(&"missing_material_library"));
    assert_eq!(scene(&asset).materials[0].name, "skin");
}

#[test]
fn a_texture_that_gltf_cannot_hold_is_left_out_with_a_finding() {
    let upload = files([("look.mtl", b"newmtl skin\nmap_Kd a.tga\n".as_slice()), ("a.tga", b"\0\0\x02".as_slice())]);
    let asset = read_with("a.obj", TEXTURED_OBJ, &upload).expect("reads");
    assert!(codes(&asset).contains(&"texture_format"));
    assert_eq!(scene(&asset).materials[0].base_color_texture, None);
}

#[test]
fn siblings_count_towards_the_size_limit() {
    let upload =
        files([("look.mtl", b"newmtl skin\nmap_Kd a.png\n".as_slice()), ("a.png", &[PNG, &[0; 4000]].concat())]);
    let limits = Limits { bytes_max: 2000, ..Limits::default() };
    let error = decode("a.obj", TEXTURED_OBJ, &upload, &limits, &DecodeOptions::default()).expect_err("refused");
    assert_eq!(error.code(), "too_large");
}

// --- PLY and STL --------------------------------------------------------------------------------------------------

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

// --- FBX ----------------------------------------------------------------------------------------------------------

#[test]
fn fbx_is_placed_in_the_world_in_metres_with_y_up() {
    let asset = accept("board.fbx", &ascii_fbx("", ""));
    let axes = asset.axes.expect("axes are in the file");
    assert_eq!(format!("{axes:?}"), "Axes { up: PosY, front: PosZ }");
    let near = |row: usize, expected: [f64; 3]| {
        let distance = asset.mesh.positions[row].distance(expected.into());
        assert!(distance < 1e-9, "{:?} is not {expected:?}", asset.mesh.positions[row]);
    };
    near(0, [0.0, 1.0, 0.0]);
    near(1, [1.0, 1.0, 0.0]);
    near(4, [0.5, 2.5, 0.0]);
    assert_eq!(asset.mesh.triangles, [[0, 1, 2], [0, 2, 3], [3, 2, 4]]);
    assert!(asset.existing_rig.is_none());
    let node = &scene(&asset).nodes[0];
    assert_eq!((node.name.as_str(), node.primitives.len(), asset.parts.len()), ("Board", 2, 1));
    let normal = node.primitives[0].normals.as_ref().expect("normals")[0];
    assert!((normal[2] - 1.0).abs() < 1e-6, "{normal:?} faces the viewer");
    assert_eq!(scene(&asset).materials[0].base_color, [1.0, 0.0, 0.0, 1.0]);
    assert_eq!(node.primitives[0].texture_coordinates.as_ref().expect("coordinates")[0], [0.0, 1.0]);
    assert!(codes(&asset).contains(&"missing_texture"));
}

#[test]
fn fbx_takes_its_texture_from_the_upload() {
    let upload = files([("paint.png", PNG)]);
    let asset = read_with("board.fbx", &ascii_fbx("", ""), &upload).expect("reads");
    let scene = scene(&asset);
    assert_eq!(scene.images[scene.materials[1].base_color_texture.expect("a texture")].bytes, PNG);
}

#[test]
fn fbx_of_a_mirrored_node_keeps_its_outside() {
    let text = String::from_utf8(ascii_fbx("", "")).expect("text").replace(
        "P: \"Lcl Translation\", \"Lcl Translation\", \"\", \"A\",0,0,100",
        "P: \"Lcl Scaling\", \"Lcl Scaling\", \"\", \"A\",-1,1,1",
    );
    let asset = accept("board.fbx", text.as_bytes());
    let normal = |triangle: [u32; 3]| {
        let [a, b, c] = triangle.map(|corner| asset.mesh.positions[corner as usize]);
        (b - a).cross(c - a)
    };
    assert!(asset.mesh.triangles.iter().all(|&triangle| normal(triangle).z > 0.0));
    assert!(asset.mesh.positions[1].x < 0.0);
}

#[test]
fn an_fbx_with_bones_is_refused_unless_its_rig_is_to_be_replaced() {
    let bones = "\tNodeAttribute: 5000, \"NodeAttribute::Hip\", \"LimbNode\" {\n\t\tTypeFlags: \"Skeleton\"\n\t}\n\
                 \tModel: 5001, \"Model::Hip\", \"LimbNode\" {\n\t\tVersion: 232\n\t}\n\
                 \tDeformer: 6000, \"Deformer::Skin\", \"Skin\" {\n\t\tVersion: 101\n\t}\n\
                 \tDeformer: 6001, \"SubDeformer::Hip\", \"Cluster\" {\n\t\tVersion: 100\n\t\tIndexes: *1 {\n\t\t\ta: 0\n\t\t}\n\
                 \t\tWeights: *1 {\n\t\t\ta: 1\n\t\t}\n\t}\n";
    let connections = "\tC: \"OO\",5001,0\n\tC: \"OO\",5000,5001\n\tC: \"OO\",6000,1000\n\tC: \"OO\",6001,6000\n\
                       \tC: \"OO\",5001,6001\n";
    let bytes = ascii_fbx(bones, connections);
    assert_eq!(refusal("board.fbx", &bytes), DecodeError::AlreadyRigged { skins: 1, joints: 1 });
    let options = DecodeOptions { existing_rig: ExistingRigPolicy::Replace, ..DecodeOptions::default() };
    let asset = decode("board.fbx", &bytes, &NoSiblings, &Limits::default(), &options).expect("reads");
    assert_eq!(asset.existing_rig.map(|rig| (rig.skins, rig.joints)), Some((1, 1)));
}

#[test]
fn fbx_with_an_index_out_of_range_is_refused() {
    let text = String::from_utf8(ascii_fbx("", "")).expect("text").replace("a: 0,1,2,-4,3,2,-5", "a: 0,1,99,-4,3,2,-5");
    assert_eq!(refusal("board.fbx", text.as_bytes()).code(), "unreadable_mesh");
}

#[test]
fn fbx_nested_too_deeply_is_refused() {
    let mut text = String::from_utf8(ascii_fbx("", "")).expect("text");
    text += &"Deep: {\n".repeat(5000);
    text += &"}\n".repeat(5000);
    assert_eq!(refusal("board.fbx", text.as_bytes()).code(), "unreadable_mesh");
    let chain: String =
        (0..200).map(|i| format!("\tModel: {}, \"Model::n{i}\", \"Null\" {{\n\t}}\n", 7000 + i)).collect();
    let links: String =
        (0..200).map(|i| format!("\tC: \"OO\",{},{}\n", 7000 + i, if i == 0 { 0 } else { 6999 + i })).collect();
    let error = refusal("board.fbx", &ascii_fbx(&chain, &links));
    assert_eq!(error, DecodeError::TooDeep { format: "FBX", what: "the node graph", limit: 64 });
}

#[test]
fn fbx_memory_is_limited() {
    let limits = Limits { fbx_memory_bytes_max: 10_000, ..Limits::default() };
    let error = decode("board.fbx", &ascii_fbx("", ""), &NoSiblings, &limits, &DecodeOptions::default());
    assert_eq!(error.expect_err("refused").code(), "too_large");
}

// --- shapes that cannot be rigged ---------------------------------------------------------------------------------

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

// --- limits -------------------------------------------------------------------------------------------------------

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

// --- archives -----------------------------------------------------------------------------------------------------

#[test]
fn an_archive_gives_its_mesh_with_the_textures_beside_it() {
    let bytes = zip_of(&[
        entry("hero/hero.obj", TEXTURED_OBJ),
        entry("hero/look.mtl", b"newmtl skin\nmap_Kd Skin.PNG\n"),
        entry("hero/textures/skin.png", PNG),
        entry("__MACOSX/hero/._hero.obj", b"clutter"),
    ]);
    let asset = accept("upload.zip", &bytes);
    assert_eq!((asset.format, scene(&asset).images.len()), (Format::Obj, 1));
    assert_eq!(asset.parts[0].name, "hero");
    assert!(asset.findings.is_empty(), "{:?}", asset.findings);
}

#[test]
fn the_main_file_of_an_archive_is_chosen_the_same_way_each_time() {
    let ply = ascii_ply();
    let stl = binary_stl();
    let bytes = zip_of(&[
        entry("z/deep/a.obj", TETRAHEDRON_OBJ),
        entry("b.stl", &stl),
        entry("z/b.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        entry("z/a.obj", TETRAHEDRON_OBJ),
        entry("c.ply", &ply),
    ]);
    let asset = accept("upload.zip", &bytes);
    assert_eq!((asset.format, asset.mesh.triangles.len()), (Format::Obj, 4));
    let finding = asset.findings.iter().find(|finding| finding.code == "several_meshes").expect("told");
    assert!(finding.message.contains("z/a.obj was taken"), "{}", finding.message);
}

#[test]
fn a_zip_bomb_is_refused_before_it_is_unpacked() {
    let zeros = vec![b'\n'; 20 << 20];
    let honest = zip_of(&[entry("a.obj", TETRAHEDRON_OBJ), entry("unused.bin", &zeros)]);
    assert!(honest.len() < 100_000);
    assert_eq!(refusal("a.zip", &honest), DecodeError::ZipBomb { limit: 100 });
    let lying = ZipEntry { declared_bytes: Some(1000), ..entry("a.obj", &zeros) };
    assert_eq!(refusal("a.zip", &zip_of(&[lying])).code(), "zip_bomb");
    let limits = Limits { bytes_max: 1000, ..Limits::default() };
    let total = zip_of(&[entry("a.obj", &[TETRAHEDRON_OBJ, &zeros[..2000]].concat())]);
    let error = decode("a.zip", &total, &NoSiblings, &limits, &DecodeOptions::default()).expect_err("refused");
    assert_eq!(error.code(), "too_large");
    let huge = ZipEntry { declared_bytes: Some(u32::MAX - 1), ..entry("a.obj", TETRAHEDRON_OBJ) };
    assert_eq!(refusal("a.zip", &zip_of(&[huge])).code(), "zip_bomb");
}

#[test]
fn names_that_leave_the_archive_are_refused() {
    for name in ["../a.obj", "a/../../b.obj", "/etc/a.obj", "C:\\a.obj", "..\\a.obj", "a/..\\..\\b.obj"] {
        let bytes = zip_of(&[entry("a.obj", TETRAHEDRON_OBJ), entry(name, b"x")]);
        assert_eq!(refusal("a.zip", &bytes), DecodeError::UnsafePath { name: name.into() });
    }
}

#[test]
fn references_never_leave_the_upload() {
    for name in ["../secret.png", "/etc/passwd", "C:/secret.png", "a/../../secret.png"] {
        let upload = files([("look.mtl", format!("newmtl skin\nmap_Kd {name}\n").as_bytes())]);
        struct Watched(Files);
        impl Siblings for Watched {
            fn read(&self, name: &str) -> Option<Vec<u8>> {
                assert!(!name.contains("..") && !name.starts_with('/') && !name.contains(':'), "asked for {name}");
                self.0.read(name)
            }
        }
        let error = read_with("a.obj", TEXTURED_OBJ, &Watched(upload)).expect_err("refused");
        assert_eq!(error, DecodeError::MissingResource { name: name.into() });
    }
}

#[test]
fn archives_that_cannot_be_opened_say_why() {
    let encrypted = ZipEntry { flags: 1, ..entry("a.obj", TETRAHEDRON_OBJ) };
    assert_eq!(refusal("a.zip", &zip_of(&[encrypted])), DecodeError::EncryptedArchive { name: "a.obj".into() });
    let inner = zip_of(&[entry("a.obj", TETRAHEDRON_OBJ)]);
    let nested = zip_of(&[entry("inner.zip", &inner)]);
    assert_eq!(refusal("a.zip", &nested), DecodeError::NestedArchive { name: "inner.zip".into() });
    let disguised = zip_of(&[entry("inner.obj", &inner)]);
    assert_eq!(refusal("a.zip", &disguised), DecodeError::NestedArchive { name: "inner.obj".into() });
    let nothing = refusal("a.zip", &zip_of(&[entry("a.txt", b"x")]));
    assert_eq!(nothing, DecodeError::UnsupportedFormat { seen: "a zip archive of 1 file(s) (a.txt)".into() });
    let package = refusal("a.zip", &zip_of(&[entry("3D/3dmodel.model", b"x")]));
    assert_eq!(package, DecodeError::UnsupportedFormat { seen: "a 3MF package".into() });
    let many: Vec<String> = (0..5000).map(|index| format!("{index}.txt")).collect();
    let many: Vec<ZipEntry> = many.iter().map(|name| entry(name, b"")).collect();
    assert_eq!(refusal("a.zip", &zip_of(&many)).code(), "too_large");
}

#[test]
fn a_damaged_entry_is_refused_even_if_only_a_texture() {
    let mut bytes = zip_of(&[
        entry("hero.obj", TEXTURED_OBJ),
        entry("look.mtl", b"newmtl skin\nmap_Kd skin.png\n"),
        entry("skin.png", PNG),
    ]);
    let at = bytes.windows(8).position(|window| window == b"skin.png").expect("local header");
    bytes[at + 12] ^= 0x55;
    assert_eq!(refusal("a.zip", &bytes).code(), "unreadable_mesh");
}

#[test]
fn any_format_can_be_forced_on_any_bytes_without_panic() {
    let formats = [Format::Obj, Format::Ply, Format::Stl, Format::Fbx];
    for (_, bytes) in samples() {
        for format in formats {
            let _ = decode_as(format, "a", &bytes, &NoSiblings, &Limits::default(), &DecodeOptions::default());
        }
    }
}
