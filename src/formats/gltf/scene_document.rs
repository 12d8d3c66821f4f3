//! A document from scratch, for uploads that are no glTF: OBJ, PLY, STL, FBX.

use super::buffers::append_view;
use super::json::push;
use super::kept_skin::KeptSkin;
use super::{Document, SkinnedPrimitive};
use crate::formats::{Alpha, Material, Scene, ScenePrimitive};
use crate::mesh::Mesh;
use serde_json::{Value, json};

/// Builds the document of `scene`, whose positions are rows of `mesh`.
pub(super) fn build(scene: &Scene, mesh: &Mesh) -> Document {
    let mut json = json!({ "asset": { "version": "2.0", "generator": super::GENERATOR }, "scene": 0 });
    json["scenes"] = json!([{ "nodes": (0..scene.nodes.len()).collect::<Vec<_>>() }]);
    json["nodes"] = json!([]);
    json["meshes"] = json!([]);
    let (mut binary, mut skinned) = (Vec::new(), Vec::new());
    let mut plain = PlainMaterials::default();
    for node in &scene.nodes {
        let mut primitives = Vec::with_capacity(node.primitives.len());
        let mesh_index = skinned_mesh_index(&json);
        for (index, primitive) in node.primitives.iter().enumerate() {
            primitives.push(primitive_json(&mut json, &mut binary, primitive, plain.of(primitive, scene), mesh));
            let rows = primitive.mesh_rows.clone();
            skinned.push(SkinnedPrimitive { node: mesh_index, mesh: mesh_index, primitive: index, rows });
        }
        push(&mut json, "meshes", with_name(json!({ "primitives": primitives }), &node.name));
        push(&mut json, "nodes", with_name(json!({ "mesh": mesh_index }), &node.name));
    }
    add_looks(&mut json, &mut binary, scene, &plain);
    let kept = scene.skeleton.as_ref().map(|skeleton| KeptSkin::of_nodes(&mut json, skeleton));
    Document { json, binary, other_chunks: Vec::new(), skinned, kept, scenes: vec![0] }
}

/// Node and mesh of a scene node have the same index.
fn skinned_mesh_index(json: &Value) -> usize {
    super::json::items(json, "meshes").len()
}

fn with_name(mut value: Value, name: &str) -> Value {
    if !name.is_empty() {
        value["name"] = json!(name);
    }
    value
}

/// Materials for primitives without texture coordinates: a texture that nothing places is no valid glTF.
#[derive(Default)]
struct PlainMaterials {
    /// Textured materials of the scene that such a primitive names; its own comes behind those of the scene, in this order.
    of: Vec<usize>,
}

impl PlainMaterials {
    /// The material that `primitive` is written with.
    fn of(&mut self, primitive: &ScenePrimitive, scene: &Scene) -> Option<usize> {
        let index = primitive.material?;
        let is_textured = scene.materials.get(index).is_some_and(Material::is_textured);
        if primitive.texture_coordinates.is_some() || !is_textured {
            return Some(index);
        }
        let place = self.of.iter().position(|other| *other == index).unwrap_or_else(|| {
            self.of.push(index);
            self.of.len() - 1
        });
        Some(scene.materials.len() + place)
    }
}

fn primitive_json(
    json: &mut Value,
    binary: &mut Vec<u8>,
    primitive: &ScenePrimitive,
    material: Option<usize>,
    mesh: &Mesh,
) -> Value {
    let row = |row: &u32| mesh.positions.get(*row as usize).map_or([0.0; 3], |point| point.as_vec3().to_array());
    let positions: Vec<[f32; 3]> = primitive.mesh_rows.iter().map(row).collect();
    let mut attributes = json!({ "POSITION": append_floats(json, binary, &positions, "VEC3") });
    let accessor = attributes["POSITION"].as_u64().unwrap_or_default() as usize;
    super::bake::set_bounds(&mut json["accessors"][accessor], positions.as_flattened(), 3);
    if let Some(normals) = &primitive.normals {
        attributes["NORMAL"] = json!(append_floats(json, binary, normals, "VEC3"));
    }
    if let Some(coordinates) = &primitive.texture_coordinates {
        attributes["TEXCOORD_0"] = json!(append_floats(json, binary, coordinates, "VEC2"));
    }
    if let Some(colors) = &primitive.colors {
        attributes["COLOR_0"] = json!(append_floats(json, binary, colors, "VEC4"));
    }
    let indices = primitive.triangles.as_flattened();
    // The largest short is kept for restarts.
    let (width, component) = if positions.len() < usize::from(u16::MAX) { (2, 5123) } else { (4, 5125) };
    let bytes: Vec<u8> = indices.iter().flat_map(|index| index.to_le_bytes().into_iter().take(width)).collect();
    let view = append_view(json, binary, &bytes);
    json["bufferViews"][view]["target"] = json!(34963);
    let accessor = json!({ "bufferView": view, "componentType": component, "count": indices.len(), "type": "SCALAR" });
    let indices = push(json, "accessors", accessor);
    let mut value = json!({ "attributes": attributes, "indices": indices });
    if let Some(material) = material {
        value["material"] = json!(material);
    }
    value
}

fn append_floats<const N: usize>(json: &mut Value, binary: &mut Vec<u8>, rows: &[[f32; N]], kind: &str) -> usize {
    let bytes: Vec<u8> = rows.as_flattened().iter().flat_map(|value| value.to_le_bytes()).collect();
    let view = append_view(json, binary, &bytes);
    json["bufferViews"][view]["target"] = json!(34962);
    push(json, "accessors", json!({ "bufferView": view, "componentType": 5126, "count": rows.len(), "type": kind }))
}

fn add_looks(json: &mut Value, binary: &mut Vec<u8>, scene: &Scene, plain: &PlainMaterials) {
    for material in &scene.materials {
        push(json, "materials", material_json(material));
    }
    for &textured in &plain.of {
        push(json, "materials", material_json(&scene.materials[textured].without_textures()));
    }
    for (index, image) in scene.images.iter().enumerate() {
        let view = append_view(json, binary, &image.bytes);
        let value = json!({ "bufferView": view, "mimeType": image.media_type.media_type() });
        push(json, "images", with_name(value, &image.name));
        push(json, "textures", json!({ "source": index }));
    }
}

fn material_json(material: &Material) -> Value {
    let mut surface = json!({
        "baseColorFactor": material.base_color.map(shortest),
        "metallicFactor": shortest(material.metallic),
        "roughnessFactor": shortest(material.roughness),
    });
    if let Some(texture) = material.base_color_texture {
        surface["baseColorTexture"] = json!({ "index": texture });
    }
    let mut value = with_name(json!({}), &material.name);
    value["pbrMetallicRoughness"] = surface;
    if let Some(texture) = material.normal_texture {
        value["normalTexture"] = json!({ "index": texture });
    }
    if let Some(texture) = material.emissive_texture {
        value["emissiveTexture"] = json!({ "index": texture });
    }
    if material.emissive != [0.0; 3] {
        value["emissiveFactor"] = json!(material.emissive.map(shortest));
    }
    if material.alpha == Alpha::Blend {
        value["alphaMode"] = json!("BLEND");
    }
    if material.double_sided {
        value["doubleSided"] = json!(true);
    }
    value
}

/// The double that is written with the fewest digits and still reads as this single.
fn shortest(value: f32) -> f64 {
    value.to_string().parse().unwrap_or_else(|_| f64::from(value))
}
