//! Materials and textures of an FBX file, as metallic-roughness materials.
//!
//! `ufbx` gives the classic Phong parameters and those of newer shaders under the same physically based names. A
//! textured base colour is white, as in material libraries; a fully transparent one is taken for opaque, since
//! exporters disagree which way transparency counts.

use super::scene::{Alpha, Image, Material};
use super::siblings::base_name;
use super::textures::Textures;
use super::{DecodeError, DecodeOptions, Finding, Limits, Siblings};
use std::collections::HashMap;
use ufbx::{MaterialMap, TextureType};

/// Materials in order of first use.
pub(super) struct Materials<'a> {
    textures: Textures<'a>,
    materials_max: usize,
    materials: Vec<Material>,
    /// By the file's element id.
    index_of: HashMap<u32, usize>,
}

impl<'a> Materials<'a> {
    pub(super) fn new(siblings: &'a dyn Siblings, options: &DecodeOptions, limits: &Limits) -> Self {
        let options = DecodeOptions { allow_missing_textures: true, ..*options };
        Self {
            textures: Textures::new(siblings, &options, limits),
            materials_max: limits.materials_max,
            materials: Vec::new(),
            index_of: HashMap::new(),
        }
    }

    /// The material in slot `slot` of a placed mesh; instances may bring their own.
    pub(super) fn index(
        &mut self,
        node: &ufbx::Node,
        mesh: &ufbx::Mesh,
        slot: usize,
    ) -> Result<Option<usize>, DecodeError> {
        let Some(material) = node.materials.get(slot).or_else(|| mesh.materials.get(slot)) else {
            return Ok(None);
        };
        if let Some(&known) = self.index_of.get(&material.element.element_id) {
            return Ok(Some(known));
        }
        let (found, limit) = (self.materials.len() as u64 + 1, self.materials_max as u64);
        if found > limit {
            return Err(DecodeError::TooMany { what: "materials", found, limit });
        }
        let converted = self.convert(material)?;
        self.materials.push(converted);
        self.index_of.insert(material.element.element_id, self.materials.len() - 1);
        Ok(Some(self.materials.len() - 1))
    }

    fn convert(&mut self, material: &ufbx::Material) -> Result<Material, DecodeError> {
        let pbr = &material.pbr;
        let base_color_texture = self.texture(&pbr.base_color)?;
        let normal_texture = self.texture(&pbr.normal_map)?;
        let emissive_texture = self.texture(&pbr.emission_color)?;
        let factor = scalar(&pbr.base_factor).unwrap_or(1.0);
        let base = rgb(&pbr.base_color).unwrap_or([1.0; 3]).map(|value| value * factor);
        let opacity = scalar(&pbr.opacity).filter(|opacity| *opacity > 0.0).unwrap_or(1.0);
        let glow = scalar(&pbr.emission_factor).unwrap_or(1.0);
        let emissive = rgb(&pbr.emission_color).unwrap_or([0.0; 3]).map(|value| (value * glow).clamp(0.0, 1.0));
        let [red, green, blue] = if base_color_texture.is_some() { [1.0; 3] } else { base };
        Ok(Material {
            name: material.element.name.to_string(),
            base_color: [red, green, blue, opacity],
            base_color_texture,
            normal_texture,
            metallic: scalar(&pbr.metalness).unwrap_or(0.0),
            roughness: scalar(&pbr.roughness).unwrap_or(1.0),
            emissive: if emissive_texture.is_some() { [1.0; 3] } else { emissive },
            emissive_texture,
            alpha: if opacity < 1.0 { Alpha::Blend } else { Alpha::Opaque },
            double_sided: true,
        })
    }

    fn texture(&mut self, map: &MaterialMap) -> Result<Option<usize>, DecodeError> {
        let Some(texture) = map.texture.as_deref().filter(|_| map.texture_enabled) else { return Ok(None) };
        // A layered texture stands for the files below it; the first one is the base.
        let texture = match texture.type_ {
            TextureType::File => texture,
            _ => texture.file_textures.first().map_or(texture, |file| file),
        };
        let names = [&texture.relative_filename, &texture.filename, &texture.absolute_filename];
        let Some(name) = names.into_iter().map(|name| name.as_ref()).find(|name: &&str| !name.is_empty()) else {
            return Ok(None);
        };
        let content: &[u8] = match &texture.video {
            Some(video) if texture.content.is_empty() => &video.content,
            _ => &texture.content,
        };
        if content.is_empty() { self.textures.load("", name) } else { self.textures.embedded(base_name(name), content) }
    }

    /// Materials, images, and the findings appended to `findings`.
    pub(super) fn finish(self, findings: Vec<Finding>) -> (Vec<Material>, Vec<Image>, Vec<Finding>) {
        let (images, findings) = self.textures.finish(findings);
        (self.materials, images, findings)
    }
}

/// A value between 0 and 1.
fn scalar(map: &MaterialMap) -> Option<f32> {
    let value = map.value_vec4.x as f32;
    (map.has_value && value.is_finite()).then(|| value.clamp(0.0, 1.0))
}

fn rgb(map: &MaterialMap) -> Option<[f32; 3]> {
    let value = [map.value_vec4.x as f32, map.value_vec4.y as f32, map.value_vec4.z as f32];
    let is_usable = map.has_value && value.iter().all(|value| value.is_finite());
    is_usable.then(|| value.map(|value| value.clamp(0.0, 1.0)))
}
