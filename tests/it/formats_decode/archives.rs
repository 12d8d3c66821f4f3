//! Zip archives, and references between files.

use super::*;

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
fn an_archive_gives_a_gltf_its_buffer() {
    let json = triangle_gltf(Some("data/tri%20angle.bin".into()));
    let buffer = triangle_buffer();
    let bytes = zip_of(&[entry("model/data/tri angle.bin", &buffer), entry("model/scene.gltf", &json)]);
    let asset = accept("upload.zip", &bytes);
    assert_eq!((asset.format, asset.mesh.positions.len(), asset.parts.len()), (Format::Gltf, 6, 2));
    let error = refusal("upload.zip", &zip_of(&[entry("scene.gltf", &json)]));
    assert_eq!(error.code(), "missing_resource");
    assert!(error.to_string().contains("data/tri"), "{error}");
    let glb = glb(triangle_gltf(None), &buffer);
    assert_eq!(accept("upload.zip", &zip_of(&[entry("scene.glb", &glb)])).format, Format::Glb);
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
