//! What must hold for every upload: no panic, bounded memory, and a mesh that keeps its promises.

use rigsmith::formats::{Asset, DecodeOptions, ExistingRigPolicy, Format, Limits, Siblings, Source, decode_as};

/// Small enough that a limit is easily reached, and that one input is quickly done with.
pub const LIMITS: Limits = Limits {
    bytes_max: 1 << 20,
    vertices_max: 20_000,
    faces_max: 20_000,
    faces_without_a_word: 100,
    nodes_max: 100,
    depth_max: 16,
    materials_max: 50,
    unzip_ratio_max: 20,
    archive_entries_max: 50,
    fbx_memory_bytes_max: 32 << 20,
};

/// Every file that is asked for exists: the rest of the upload serves as material library, buffer and texture.
#[allow(dead_code, reason = "the zip target brings its own files")]
struct Rest<'a>(&'a [u8]);

impl Siblings for Rest<'_> {
    fn read(&self, name: &str) -> Option<Vec<u8>> {
        assert!(!name.is_empty() && !name.starts_with('/') && !name.split('/').any(|part| part == ".."), "{name:?}");
        Some(self.0.to_vec())
    }
}

/// Reads the upload up to its last `\0SIBLING\0` as `format`; what follows is every other file of it.
#[allow(dead_code, reason = "the zip target brings its own files")]
pub fn check(format: Format, bytes: &[u8]) {
    const MARK: &[u8] = b"\0SIBLING\0";
    let at = bytes.windows(MARK.len()).rposition(|window| window == MARK);
    let (main, rest) = at.map_or((bytes, bytes), |at| (&bytes[..at], &bytes[at + MARK.len()..]));
    let options = DecodeOptions { existing_rig: ExistingRigPolicy::Replace, allow_missing_textures: true, old_rig: true };
    match decode_as(format, "upload", main, &Rest(rest), &LIMITS, &options) {
        Ok(asset) => check_asset(&asset),
        Err(error) => assert!(!error.code().is_empty() && !error.hint().is_empty() && !error.to_string().is_empty()),
    }
}

/// The invariants that the rest of the program trusts.
pub fn check_asset(asset: &Asset) {
    let rows = asset.mesh.positions.len();
    assert!(rows <= LIMITS.vertices_max && asset.mesh.triangles.len() <= LIMITS.faces_max);
    assert!(!asset.mesh.triangles.is_empty());
    assert!(asset.mesh.positions.iter().all(|position| position.is_finite()));
    assert!(asset.mesh.triangles.iter().flatten().all(|&corner| (corner as usize) < rows));
    let mut next = 0;
    for part in &asset.parts {
        assert_eq!(part.vertices.start, next);
        next = part.vertices.end;
    }
    assert_eq!(next, rows);
    if let Source::Scene(scene) = &asset.source {
        let has_image = |image: Option<usize>| image.is_none_or(|image| image < scene.images.len());
        for material in &scene.materials {
            let textures = [material.base_color_texture, material.normal_texture, material.emissive_texture];
            assert!(textures.into_iter().all(has_image));
            let factors = material.base_color.iter().chain(&material.emissive);
            assert!(factors.chain([&material.metallic, &material.roughness]).all(|value| (0.0..=1.0).contains(value)));
        }
        for primitive in scene.nodes.iter().flat_map(|node| &node.primitives) {
            let splits = primitive.mesh_rows.len();
            assert!(primitive.mesh_rows.iter().all(|&row| (row as usize) < rows));
            assert!(primitive.material.is_none_or(|material| material < scene.materials.len()));
            assert!(primitive.triangles.iter().flatten().all(|&split| (split as usize) < splits));
            for normal in primitive.normals.iter().flatten() {
                let square: f32 = normal.iter().map(|value| value * value).sum();
                assert!((square - 1.0).abs() < 1e-3, "{normal:?}");
            }
            let numbers = primitive.texture_coordinates.iter().flatten().flatten();
            assert!(numbers.chain(primitive.colors.iter().flatten().flatten()).all(|value| value.is_finite()));
        }
    }
}
