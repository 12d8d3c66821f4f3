//! Material libraries and textures.

use super::*;

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
fn material_libraries_with_blanks_in_their_name_and_several_on_a_line_are_read() {
    let upload = files([("look.mtl", b"newmtl skin\nKd 1 0 0\n".as_slice())]);
    let of = |line: &str| String::from_utf8_lossy(TEXTURED_OBJ).replace("mtllib look.mtl", line).into_bytes();
    let asset = read_with("a.obj", &of("mtllib other.mtl look.mtl"), &upload).expect("reads");
    assert_eq!(scene(&asset).materials[0].base_color, [1.0, 0.0, 0.0, 1.0]);
    assert!(asset.findings.iter().any(|finding| finding.message.contains("library other.mtl was")));
    let asset = read_with("a.obj", &of("mtllib my look.mtl"), &files([("my look.mtl", b"newmtl skin\nKd 0 1 0\n")]));
    assert_eq!(scene(&asset.expect("reads")).materials[0].base_color, [0.0, 1.0, 0.0, 1.0]);
    let asset = accept("a.obj", &of("mtllib my look.mtl"));
    assert_eq!(codes(&asset), ["missing_material_library"], "one line, one finding");
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
