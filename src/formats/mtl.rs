//! Wavefront material libraries (`.mtl`), approximated as metallic-roughness materials.
//!
//! - base colour: `Kd`, or white where there is a `map_Kd`: exporters write an arbitrary `Kd` beside a texture, often
//!   black or 0.8, and mean the texture alone.
//! - opacity: `d`, or 1 - `Tr`; 0 is taken for 1, since some exporters mean the opposite by either.
//! - roughness: `Pr`, else 1 - √(`Ns` / 1000), else 1; metallic: `Pm`, else 0; emission: `Ke`, `map_Ke`.
//! - normal map: `norm`, or `map_Bump` if its file name says that it holds normals; height maps are left out.

use super::scene::{Alpha, Material};
use super::text::{next_number, number, words};
use super::textures::Textures;
use super::{DecodeError, Limits, Place};
use std::collections::HashMap;

const FORMAT: &str = "MTL";

/// Materials of all libraries of a file, by name. A later definition of a name replaces an earlier one.
#[derive(Default)]
pub(super) struct MaterialLibrary {
    materials: HashMap<String, Definition>,
}

#[derive(Clone, Default)]
struct Definition {
    /// Of the library file, with which texture names are resolved.
    folder: String,
    diffuse: Option<[f32; 3]>,
    opacity: Option<f32>,
    specular_exponent: Option<f32>,
    roughness: Option<f32>,
    metallic: Option<f32>,
    emissive: Option<[f32; 3]>,
    diffuse_map: Option<String>,
    opacity_map: Option<String>,
    emissive_map: Option<String>,
    normal_map: Option<String>,
}

impl MaterialLibrary {
    /// The material `name` with its textures loaded; a plain one if no library defines it.
    pub(super) fn material(&self, name: &str, textures: &mut Textures) -> Result<Material, DecodeError> {
        let Some(definition) = self.materials.get(name) else {
            return Ok(Material { name: name.into(), ..Material::default() });
        };
        let mut load = |map: &Option<String>| match map {
            Some(map) => textures.load(&definition.folder, map),
            None => Ok(None),
        };
        let base_color_texture = load(&definition.diffuse_map)?;
        let emissive_texture = load(&definition.emissive_map)?;
        let normal_texture = load(&definition.normal_map)?;
        let unit = |value: f32| if value.is_finite() { value.clamp(0.0, 1.0) } else { 1.0 };
        let white = [1.0; 3];
        let [red, green, blue] =
            if base_color_texture.is_some() { white } else { definition.diffuse.unwrap_or(white).map(unit) };
        let opacity = definition.opacity.map(unit).filter(|opacity| *opacity > 0.0).unwrap_or(1.0);
        let has_holes = definition.opacity_map.is_some() && definition.opacity_map == definition.diffuse_map;
        let shine = unit(definition.specular_exponent.unwrap_or(0.0) / 1000.0);
        let emissive = definition.emissive.unwrap_or([0.0; 3]).map(unit);
        Ok(Material {
            name: name.into(),
            base_color: [red, green, blue, opacity],
            base_color_texture,
            normal_texture,
            metallic: unit(definition.metallic.unwrap_or(0.0)),
            roughness: definition.roughness.map_or(1.0 - shine.sqrt(), unit),
            emissive: if emissive_texture.is_some() { white } else { emissive },
            emissive_texture,
            alpha: if opacity < 1.0 || has_holes { Alpha::Blend } else { Alpha::Opaque },
            double_sided: true,
        })
    }
}

/// Reads one library. Only materials that are `used` are kept.
pub(super) fn read(
    bytes: &[u8],
    file_name: &str,
    used: &[String],
    library: &mut MaterialLibrary,
    limits: &Limits,
) -> Result<(), DecodeError> {
    let folder = file_name.rsplit_once(['/', '\\']).map_or("", |(folder, _)| folder);
    let is_used: HashMap<&str, ()> = used.iter().map(|name| (name.as_str(), ())).collect();
    let mut current: Option<String> = None;
    for (index, line) in bytes.split(|&byte| byte == b'\n').enumerate() {
        let mut words = words(line).take_while(|word| !word.starts_with(b"#"));
        let Some(keyword) = words.next() else { continue };
        if keyword.eq_ignore_ascii_case(b"newmtl") {
            let name = rest(line, keyword);
            current = is_used.contains_key(name.as_str()).then_some(name);
            if let Some(name) = &current {
                let found = library.materials.len() as u64 + 1;
                if found > limits.materials_max as u64 + 1 {
                    return Err(DecodeError::TooMany { what: "materials", found, limit: limits.materials_max as u64 });
                }
                library.materials.insert(name.clone(), Definition { folder: folder.into(), ..Definition::default() });
            }
        } else if let Some(definition) = current.as_ref().and_then(|name| library.materials.get_mut(name)) {
            definition.read(keyword, words, line, || Place::Element(format!("{file_name} line {}", index + 1)))?;
        }
    }
    Ok(())
}

impl Definition {
    fn read<'w>(
        &mut self,
        keyword: &[u8],
        mut words: impl Iterator<Item = &'w [u8]>,
        line: &[u8],
        place: impl Fn() -> Place,
    ) -> Result<(), DecodeError> {
        let mut one = || next_number(&mut words, FORMAT, &place).map(|value| value as f32);
        let map = || Some(map_file(line, keyword)).filter(|name| !name.is_empty());
        match keyword.to_ascii_lowercase().as_slice() {
            b"kd" => self.diffuse = rgb(words, &place)?,
            b"ke" => self.emissive = rgb(words, &place)?,
            b"d" => self.opacity = Some(one()?),
            b"tr" => self.opacity = Some(1.0 - one()?),
            b"ns" => self.specular_exponent = Some(one()?),
            b"pr" => self.roughness = Some(one()?),
            b"pm" => self.metallic = Some(one()?),
            b"map_kd" => self.diffuse_map = map(),
            b"map_d" => self.opacity_map = map(),
            b"map_ke" => self.emissive_map = map(),
            b"norm" => self.normal_map = map(),
            b"map_bump" | b"bump" => {
                let normals = map().filter(|name| name.to_ascii_lowercase().contains("normal"));
                self.normal_map = normals.or(self.normal_map.take());
            }
            _ => {}
        }
        Ok(())
    }
}

/// Three numbers, or one that stands for all; `spectral` and `xyz` colours are not read.
fn rgb<'w>(
    mut words: impl Iterator<Item = &'w [u8]>,
    place: impl Fn() -> Place,
) -> Result<Option<[f32; 3]>, DecodeError> {
    let mut words = words.by_ref().peekable();
    if words.peek().is_some_and(|word| word.eq_ignore_ascii_case(b"spectral") || word.eq_ignore_ascii_case(b"xyz")) {
        return Ok(None);
    }
    let red = next_number(&mut words, FORMAT, &place)? as f32;
    if words.peek().is_none() {
        return Ok(Some([red; 3]));
    }
    let green = next_number(&mut words, FORMAT, &place)? as f32;
    let blue = next_number(&mut words, FORMAT, &place)? as f32;
    Ok(Some([red, green, blue]))
}

/// The file name of a map statement: what remains after its options. Names may hold blanks.
fn map_file(line: &[u8], keyword: &[u8]) -> String {
    let text = rest(line, keyword);
    let mut remaining = text.as_str();
    while let Some(option) = remaining.split_whitespace().next().filter(|word| word.starts_with('-')) {
        remaining = remaining[option.len()..].trim_start();
        let (least, most) = match option.to_ascii_lowercase().as_str() {
            "-o" | "-s" | "-t" => (1, 3),
            "-mm" => (2, 2),
            "-blendu" | "-blendv" | "-boost" | "-cc" | "-clamp" | "-texres" | "-bm" | "-imfchan" | "-type" => (1, 1),
            _ => break,
        };
        for argument in 0..most {
            let word = remaining.split_whitespace().next().unwrap_or_default();
            if argument >= least && number(word.as_bytes()).is_none() {
                break;
            }
            remaining = remaining[word.len()..].trim_start();
        }
    }
    remaining.trim_matches('"').to_owned()
}

/// The rest of a line after its keyword, without surrounding blanks.
fn rest(line: &[u8], keyword: &[u8]) -> String {
    let line = line.trim_ascii();
    String::from_utf8_lossy(line.get(keyword.len()..).unwrap_or_default().trim_ascii()).into_owned()
}
