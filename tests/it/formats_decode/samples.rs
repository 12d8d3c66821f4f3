//! Small valid files of each format, written by code. The fuzz targets start from the same ones.

use flate2::Compression;
use flate2::write::{DeflateEncoder, ZlibEncoder};
use std::io::Write;

/// The smallest thing that passes for a PNG: textures are never decoded.
pub const PNG: &[u8] = b"\x89PNG\r\n\x1a\n and some pixels";

/// A triangle with a material library.
pub const TEXTURED_OBJ: &[u8] = b"mtllib look.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl skin\nf 1/1 2/1 3/1\n";

pub const TETRAHEDRON_OBJ: &[u8] = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";

/// The same shape: corners and faces of a tetrahedron.
pub const CORNERS: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
pub const FACES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];

pub fn binary_stl() -> Vec<u8> {
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

pub fn ascii_stl() -> Vec<u8> {
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

pub fn ascii_ply() -> Vec<u8> {
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
pub fn binary_ply(big_endian: bool) -> Vec<u8> {
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

pub struct ZipEntry<'a> {
    pub name: &'a str,
    pub content: &'a [u8],
    pub flags: u16,
    /// What the directory declares, when that is a lie.
    pub declared_bytes: Option<u32>,
}

pub fn entry<'a>(name: &'a str, content: &'a [u8]) -> ZipEntry<'a> {
    ZipEntry { name, content, flags: 0, declared_bytes: None }
}

pub fn zip_of(entries: &[ZipEntry]) -> Vec<u8> {
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

/// A square of two materials and one quad plus a triangle, in centimetres with z up, moved by 100 along z.
pub fn ascii_fbx(extra_objects: &str, extra_connections: &str) -> Vec<u8> {
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

/// One small valid file of each format.
pub fn samples() -> Vec<(&'static str, Vec<u8>)> {
    let zip = zip_of(&[entry("shape/tetra.obj", TETRAHEDRON_OBJ), entry("shape/readme.txt", b"a shape")]);
    vec![
        ("tetra.obj", TETRAHEDRON_OBJ.to_vec()),
        ("tetra.stl", binary_stl()),
        ("tetra.stl", ascii_stl()),
        ("tetra.ply", ascii_ply()),
        ("square.ply", binary_ply(false)),
        ("square.ply", binary_ply(true)),
        ("board.fbx", ascii_fbx("", "")),
        ("board.fbx", binary_fbx(&ascii_fbx("", ""))),
        ("tetra.zip", zip),
    ]
}

/// A binary FBX with the content of an ASCII one, as written by [`ascii_fbx`]: one statement or brace per line, arrays
/// as `Name: *count {` and `a: values`. Every other array is packed.
pub fn binary_fbx(ascii: &[u8]) -> Vec<u8> {
    let text = std::str::from_utf8(ascii).expect("text");
    let mut lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with(';'));
    let mut bytes = b"Kaydara FBX Binary  \0\x1a\0".to_vec();
    bytes.extend(7400_u32.to_le_bytes());
    while let Some(line) = lines.next() {
        write_fbx_node(line, &mut lines, &mut bytes);
    }
    bytes.extend([0; 13]);
    bytes
}

fn write_fbx_node<'a>(line: &str, lines: &mut impl Iterator<Item = &'a str>, bytes: &mut Vec<u8>) {
    let (name, rest) = line.split_once(':').expect("a statement");
    let start = bytes.len();
    bytes.extend([0; 12]);
    bytes.push(name.len() as u8);
    bytes.extend(name.as_bytes());
    let properties = bytes.len();
    let has_children = rest.ends_with('{');
    let rest = rest.trim_end_matches('{').trim();
    let mut count = 0_u32;
    if rest.starts_with('*') {
        let values = lines.next().and_then(|line| line.strip_prefix("a:")).expect("an array");
        lines.next().expect("the end of an array");
        write_fbx_array(name, values, bytes);
        count = 1;
    } else {
        for value in rest.split(',').map(str::trim).filter(|value| !value.is_empty()) {
            write_fbx_value(value, bytes);
            count += 1;
        }
    }
    let property_bytes = (bytes.len() - properties) as u32;
    if has_children && !rest.starts_with('*') {
        while let Some(line) = lines.next().filter(|line| *line != "}") {
            write_fbx_node(line, lines, bytes);
        }
        bytes.extend([0; 13]);
    }
    let end = bytes.len() as u32;
    for (at, value) in [end, count, property_bytes].into_iter().enumerate() {
        bytes[start + 4 * at..][..4].copy_from_slice(&value.to_le_bytes());
    }
}

fn write_fbx_array(name: &str, values: &str, bytes: &mut Vec<u8>) {
    let values: Vec<&str> = values.split(',').map(str::trim).collect();
    let is_integer = ["PolygonVertexIndex", "UVIndex", "Materials", "Indexes"].contains(&name);
    let raw: Vec<u8> = if is_integer {
        values.iter().flat_map(|value| value.parse::<i32>().expect("an integer").to_le_bytes()).collect()
    } else {
        values.iter().flat_map(|value| value.parse::<f64>().expect("a number").to_le_bytes()).collect()
    };
    bytes.push(if is_integer { b'i' } else { b'd' });
    bytes.extend((values.len() as u32).to_le_bytes());
    let content = if is_integer {
        raw
    } else {
        let mut packer = ZlibEncoder::new(Vec::new(), Compression::best());
        packer.write_all(&raw).expect("packs");
        packer.finish().expect("packs")
    };
    bytes.extend(u32::from(!is_integer).to_le_bytes());
    bytes.extend((content.len() as u32).to_le_bytes());
    bytes.extend(content);
}

fn write_fbx_value(value: &str, bytes: &mut Vec<u8>) {
    if let Some(text) = value.strip_prefix('"') {
        let text = text.trim_end_matches('"');
        // "Model::Board" is written the other way round, with a separator that text cannot hold.
        let text = match text.split_once("::") {
            Some((class, name)) => format!("{name}\0\x01{class}"),
            None => text.to_owned(),
        };
        bytes.push(b'S');
        bytes.extend((text.len() as u32).to_le_bytes());
        bytes.extend(text.as_bytes());
    } else if let Ok(integer) = value.parse::<i64>() {
        bytes.push(b'L');
        bytes.extend(integer.to_le_bytes());
    } else {
        bytes.push(b'D');
        bytes.extend(value.parse::<f64>().expect("a number").to_le_bytes());
    }
}

/// A triangle as glTF, with its buffer as a data URI or in a GLB.
pub fn triangle_gltf(uri: Option<String>) -> Vec<u8> {
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
"buffers":[{{"byteLength":44{uri}}}]}}"#
    )
    .into_bytes()
}

/// Positions and indices of [`triangle_gltf`].
pub fn triangle_buffer() -> Vec<u8> {
    let positions: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let mut buffer: Vec<u8> = positions.iter().flat_map(|value| value.to_le_bytes()).collect();
    buffer.extend([0_u16, 1, 2, 0].iter().flat_map(|value| value.to_le_bytes()));
    buffer
}

/// A GLB of two chunks.
pub fn glb(mut json: Vec<u8>, buffer: &[u8]) -> Vec<u8> {
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
