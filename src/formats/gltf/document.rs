//! What a document must be before anything is read from it: version, extensions, the shape of its meshes.

use super::FORMAT;
use super::json::{items, malformed, remove, text};
use crate::formats::DecodeError;
use serde_json::Value;

/// Extensions that a file may require, by the start of their names: those that are read here, and those that change
/// nothing but looks and are passed on.
const REQUIRED_ALLOWED: &[&str] = &[
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "EXT_meshopt_compression",
    "KHR_materials_",
    "VRMC_materials_",
    "KHR_texture_",
    "KHR_lights_punctual",
    "KHR_xmp",
    "KHR_node_visibility",
    "EXT_texture_",
    "EXT_materials_",
    "MSFT_texture_dds",
];

const DRACO: &str = "KHR_draco_mesh_compression";

pub(super) fn check(json: &Value) -> Result<(), DecodeError> {
    check_version(json)?;
    let refused = |name: &&str| !REQUIRED_ALLOWED.iter().any(|allowed| name.starts_with(allowed));
    if let Some(name) = items(json, "extensionsRequired").iter().filter_map(Value::as_str).find(refused) {
        return Err(DecodeError::UnsupportedExtension { name: name.into() });
    }
    for (number, mesh) in items(json, "meshes").iter().enumerate() {
        let primitives = items(mesh, "primitives");
        let is_primitive = |primitive: &Value| primitive.get("attributes").is_some_and(Value::is_object);
        if primitives.is_empty() || !primitives.iter().all(is_primitive) {
            return Err(malformed(format!("mesh {number}"), "it has no primitives, or one without attributes"));
        }
    }
    Ok(())
}

fn check_version(json: &Value) -> Result<(), DecodeError> {
    let Some(asset) = json.get("asset").filter(|asset| asset.is_object()) else {
        return Err(malformed("asset", "missing; this may be JSON, but no glTF"));
    };
    let version = text(asset, "version");
    let needed = match text(asset, "minVersion") {
        "" => version,
        least => least,
    };
    if version.starts_with("2.") && needed == "2.0" || version == "2.0" && needed.is_empty() {
        return Ok(());
    }
    Err(DecodeError::UnsupportedFeature { format: FORMAT, feature: format!("version {needed:?} of glTF") })
}

/// Draco data beside a plain copy of the geometry is dropped; alone it is refused.
pub(super) fn drop_draco(json: &mut Value) -> Result<(), DecodeError> {
    if !items(json, "extensionsUsed").iter().any(|name| name == DRACO) {
        return Ok(());
    }
    let has_bytes = |accessor: &Value| {
        let accessor = super::json::index(accessor).and_then(|accessor| items(json, "accessors").get(accessor));
        accessor.is_some_and(|accessor| accessor.get("bufferView").is_some())
    };
    let is_compressed = |primitive: &Value| primitive.get("extensions").is_some_and(|all| all.get(DRACO).is_some());
    for primitive in items(json, "meshes").iter().flat_map(|mesh| items(mesh, "primitives")) {
        let plain = primitive["attributes"].as_object().is_some_and(|all| all.values().all(has_bytes));
        if is_compressed(primitive) && !plain {
            return Err(DecodeError::UnsupportedExtension { name: DRACO.into() });
        }
    }
    for mesh in super::buffers::items_mut_if_any(json, "meshes") {
        for primitive in super::buffers::items_mut_if_any(mesh, "primitives") {
            remove_member_extension(primitive, DRACO);
        }
    }
    remove_extension(json, DRACO);
    Ok(())
}

fn remove_member_extension(object: &mut Value, name: &str) {
    if let Some(extensions) = object.get_mut("extensions") {
        remove(extensions, name);
        if extensions.as_object().is_some_and(serde_json::Map::is_empty) {
            remove(object, "extensions");
        }
    }
}

/// Takes an extension off the document's lists and its top level.
pub(super) fn remove_extension(json: &mut Value, name: &str) {
    remove_member_extension(json, name);
    for key in ["extensionsUsed", "extensionsRequired"] {
        if let Some(list) = json.get_mut(key).and_then(Value::as_array_mut) {
            list.retain(|listed| listed != name);
            if list.is_empty() {
                remove(json, key);
            }
        }
    }
}
