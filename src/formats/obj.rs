//! Wavefront OBJ: polygons with separate indices for positions, texture coordinates and normals.
//!
//! Read: `v` (with colours), `vt`, `vn`, `f`, `o`, `g`, `usemtl`, `mtllib`, continued lines, negative indices. Lines,
//! points and smoothing groups are left out; free-form surfaces are refused. Mesh rows are the file's vertices in file
//! order, used or not. Each object and group with faces becomes a node.
//!
//! A material library that was not sent is a finding, since the shape does not need it; a texture that a library names
//! and that was not sent is refused (see [`DecodeOptions::allow_missing_textures`]).

use super::mtl::{self, MaterialLibrary};
use super::scene::linear_from_srgb;
use super::scene_builder::{Attributes, Corner, NONE, SceneBuilder};
use super::siblings::{self, base_name};
use super::soundness::{check_counts, check_position};
use super::text::{LogicalLines, next_number, quoted, words};
use super::textures::Textures;
use super::{Asset, DecodeError, DecodeOptions, Finding, Format, Limits, Place, Scene, Severity, Siblings};
use crate::mesh::Mesh;
use glam::{DVec3, Vec3};
use std::collections::HashMap;

const FORMAT: &str = "OBJ";

/// Statements that are known and of no use here.
const IGNORED: &[&[u8]] =
    &[b"s", b"vp", b"mg", b"lod", b"bevel", b"c_interp", b"d_interp", b"shadow_obj", b"trace_obj"];

/// Statements that build free-form curves and surfaces.
const FREE_FORM: &[&[u8]] =
    &[b"cstype", b"deg", b"bmat", b"curv", b"curv2", b"surf", b"parm", b"trim", b"hole", b"end"];

/// Reads an OBJ file, its material libraries and their textures.
pub fn decode(
    file_name: &str,
    bytes: &[u8],
    siblings: &dyn Siblings,
    limits: &Limits,
    options: &DecodeOptions,
) -> Result<Asset, DecodeError> {
    let mut statements = Statements::new(limits);
    for (line, text) in LogicalLines::new(bytes) {
        statements.read(line, &text)?;
    }
    statements.finish(file_name, siblings, options)
}

/// Everything a file says, with indices made absolute but not yet checked: a face may precede its vertices.
struct Statements<'a> {
    limits: &'a Limits,
    positions: Vec<DVec3>,
    attributes: Attributes,
    /// Position, texture coordinate and normal of each corner, 0-based.
    corners: Vec<[u32; 3]>,
    polygons: Vec<Polygon>,
    triangle_count: u64,
    nodes: Interner,
    materials: Interner,
    libraries: Vec<String>,
    object: Option<String>,
    group: Option<String>,
    node: Option<u32>,
    material: u32,
    line_or_point_count: usize,
    free_form: bool,
    unknown: Option<(usize, String)>,
}

struct Polygon {
    line: u32,
    corner_count: u32,
    node: u32,
    /// Or [`NONE`].
    material: u32,
}

/// Names in order of first use.
#[derive(Default)]
struct Interner {
    names: Vec<String>,
    index_of: HashMap<String, u32>,
}

impl Interner {
    fn index(&mut self, name: String, what: &'static str, limit: usize) -> Result<u32, DecodeError> {
        if let Some(&index) = self.index_of.get(&name) {
            return Ok(index);
        }
        if self.names.len() >= limit {
            return Err(DecodeError::TooMany { what, found: limit as u64 + 1, limit: limit as u64 });
        }
        self.names.push(name.clone());
        self.index_of.insert(name, self.names.len() as u32 - 1);
        Ok(self.names.len() as u32 - 1)
    }
}

impl<'a> Statements<'a> {
    fn new(limits: &'a Limits) -> Self {
        Self {
            limits,
            positions: Vec::new(),
            attributes: Attributes::default(),
            corners: Vec::new(),
            polygons: Vec::new(),
            triangle_count: 0,
            nodes: Interner::default(),
            materials: Interner::default(),
            libraries: Vec::new(),
            object: None,
            group: None,
            node: None,
            material: NONE,
            line_or_point_count: 0,
            free_form: false,
            unknown: None,
        }
    }

    fn read(&mut self, line: usize, text: &[u8]) -> Result<(), DecodeError> {
        let mut words = words(text).take_while(|word| !word.starts_with(b"#"));
        let Some(keyword) = words.next() else { return Ok(()) };
        match keyword {
            b"v" => self.vertex(line, words),
            b"vt" => self.texture_coordinate(line, words),
            b"vn" => self.normal(line, words),
            b"f" | b"fo" => self.face(line, words),
            b"o" => {
                (self.object, self.group, self.node) = (Some(rest(text)), None, None);
                Ok(())
            }
            b"g" => {
                (self.group, self.node) = (Some(rest(text)), None);
                Ok(())
            }
            b"usemtl" => {
                self.material = self.materials.index(rest(text), "materials", self.limits.materials_max)?;
                Ok(())
            }
            b"mtllib" => self.add_libraries(rest(text)),
            b"l" | b"p" => {
                self.line_or_point_count += 1;
                Ok(())
            }
            other => {
                self.free_form |= FREE_FORM.contains(&other);
                if !IGNORED.contains(&other) && !FREE_FORM.contains(&other) && self.unknown.is_none() {
                    self.unknown = Some((line, quoted(other)));
                }
                Ok(())
            }
        }
    }

    fn vertex<'w>(&mut self, line: usize, mut words: impl Iterator<Item = &'w [u8]>) -> Result<(), DecodeError> {
        check_counts(self.positions.len() as u64 + 1, 0, self.limits)?;
        let mut numbers = [0.0; 3];
        for number in &mut numbers {
            *number = next_number(&mut words, FORMAT, || Place::Line(line))?;
        }
        let position = DVec3::from_array(numbers);
        check_position(position, FORMAT, || Place::Line(line))?;
        // Three more numbers are a colour; a single one is a weight, which polygons do not use.
        let mut more = [0.0; 3];
        let mut more_count = 0;
        for (slot, word) in more.iter_mut().zip(words) {
            *slot = next_number(&mut std::iter::once(word), FORMAT, || Place::Line(line))?;
            more_count += 1;
        }
        if more_count == 3 {
            self.attributes.colors.resize(self.positions.len(), [1.0; 4]);
            let [red, green, blue] = more.map(|value| value as f32);
            self.attributes.colors.push([red, green, blue, 1.0]);
        }
        self.positions.push(position);
        Ok(())
    }

    fn texture_coordinate<'w>(
        &mut self,
        line: usize,
        mut words: impl Iterator<Item = &'w [u8]>,
    ) -> Result<(), DecodeError> {
        let u = next_number(&mut words, FORMAT, || Place::Line(line))?;
        let v = match words.next() {
            Some(word) => next_number(&mut std::iter::once(word), FORMAT, || Place::Line(line))?,
            None => 0.0,
        };
        // OBJ counts v from the bottom of the image, glTF from its top.
        self.attributes.texture_coordinates.push([u as f32, (1.0 - v) as f32]);
        Ok(())
    }

    fn normal<'w>(&mut self, line: usize, mut words: impl Iterator<Item = &'w [u8]>) -> Result<(), DecodeError> {
        let mut numbers = [0.0; 3];
        for number in &mut numbers {
            *number = next_number(&mut words, FORMAT, || Place::Line(line))? as f32;
        }
        self.attributes.normals.push(Vec3::from_array(numbers));
        Ok(())
    }

    fn face<'w>(&mut self, line: usize, words: impl Iterator<Item = &'w [u8]>) -> Result<(), DecodeError> {
        let first = self.corners.len();
        for word in words {
            let corner = self.corner(line, word)?;
            self.corners.push(corner);
        }
        let corner_count = self.corners.len() - first;
        if corner_count < 3 {
            self.corners.truncate(first);
            self.line_or_point_count += 1;
            return Ok(());
        }
        self.triangle_count += corner_count as u64 - 2;
        check_counts(0, self.triangle_count, self.limits)?;
        let node = self.current_node()?;
        let (line, corner_count) = (line as u32, corner_count as u32);
        self.polygons.push(Polygon { line, corner_count, node, material: self.material });
        Ok(())
    }

    /// `position/texture/normal`, the latter two optional, 1-based or negative from the end.
    fn corner(&self, line: usize, word: &[u8]) -> Result<[u32; 3], DecodeError> {
        let counts = [self.positions.len(), self.attributes.texture_coordinates.len(), self.attributes.normals.len()];
        let malformed = || DecodeError::Malformed {
            format: FORMAT,
            place: Place::Line(line),
            problem: format!("{} is not a face corner", quoted(word)),
        };
        let mut corner = [NONE; 3];
        for (which, part) in word.split(|&byte| byte == b'/').enumerate() {
            let slot = corner.get_mut(which).ok_or_else(malformed)?;
            if part.is_empty() && which > 0 {
                continue;
            }
            let index: i64 = std::str::from_utf8(part).ok().and_then(|part| part.parse().ok()).ok_or_else(malformed)?;
            let absolute = if index < 0 { counts[which] as i64 + index } else { index - 1 };
            *slot = u32::try_from(absolute)
                .ok()
                .filter(|&absolute| absolute != NONE)
                .ok_or_else(|| index_out_of_range(line, which, index, counts[which]))?;
        }
        Ok(corner)
    }

    fn current_node(&mut self) -> Result<u32, DecodeError> {
        if let Some(node) = self.node {
            return Ok(node);
        }
        let name = match (&self.object, &self.group) {
            (Some(object), Some(group)) if object != group => format!("{object}_{group}"),
            (Some(name), _) | (None, Some(name)) => name.clone(),
            (None, None) => String::new(),
        };
        let node = self.nodes.index(name, "nodes", self.limits.nodes_max)?;
        self.node = Some(node);
        Ok(node)
    }

    fn add_libraries(&mut self, names: String) -> Result<(), DecodeError> {
        if !self.libraries.contains(&names) {
            let (found, limit) = (self.libraries.len() as u64 + 1, self.limits.materials_max as u64);
            if found > limit {
                return Err(DecodeError::TooMany { what: "material libraries", found, limit });
            }
            self.libraries.push(names);
        }
        Ok(())
    }

    fn finish(
        mut self,
        file_name: &str,
        siblings: &dyn Siblings,
        options: &DecodeOptions,
    ) -> Result<Asset, DecodeError> {
        self.refuse_what_is_no_polygon_mesh()?;
        self.finish_colors();
        let mut builder = SceneBuilder::new(self.limits);
        let own_name = base_name(file_name).rsplit_once('.').map_or(file_name, |(stem, _)| stem);
        for name in &self.nodes.names {
            builder.add_node(if name.is_empty() { own_name.to_owned() } else { name.clone() })?;
        }
        self.add_polygons(&mut builder)?;
        let (triangles, mut scene, mut findings) = builder.finish(&self.attributes, &self.positions);
        findings.extend(self.findings());
        self.add_materials(&mut scene, &mut findings, siblings, options)?;
        let mesh = Mesh { positions: self.positions, triangles };
        Ok(Asset::from_scene(Format::Obj, own_name, mesh, scene, findings))
    }

    fn refuse_what_is_no_polygon_mesh(&self) -> Result<(), DecodeError> {
        if !self.polygons.is_empty() {
            return Ok(());
        }
        match &self.unknown {
            _ if self.free_form => {
                let feature = "a free-form surface without polygons".into();
                Err(DecodeError::UnsupportedFeature { format: FORMAT, feature })
            }
            _ if self.line_or_point_count > 0 => Err(DecodeError::NoTriangles { vertices: self.positions.len() }),
            Some((line, word)) if self.positions.is_empty() => Err(DecodeError::Malformed {
                format: FORMAT,
                place: Place::Line(*line),
                problem: format!("{word} is not an OBJ statement"),
            }),
            _ => Ok(()),
        }
    }

    /// Colours of all rows, linear. Files write 0 to 1 or 0 to 255; one value above 1 tells.
    fn finish_colors(&mut self) {
        let colors = &mut self.attributes.colors;
        if colors.is_empty() {
            return;
        }
        let scale = if colors.iter().flatten().any(|&value| value > 1.0) { 1.0 / 255.0 } else { 1.0 };
        for color in colors.iter_mut() {
            for value in &mut color[..3] {
                *value = linear_from_srgb(*value * scale);
            }
        }
        colors.resize(self.positions.len(), [1.0; 4]);
    }

    fn add_polygons(&self, builder: &mut SceneBuilder) -> Result<(), DecodeError> {
        let counts = [self.positions.len(), self.attributes.texture_coordinates.len(), self.attributes.normals.len()];
        let has_colors = !self.attributes.colors.is_empty();
        let mut first = 0;
        let mut corners = Vec::new();
        for polygon in &self.polygons {
            let last = first + polygon.corner_count as usize;
            corners.clear();
            for corner in &self.corners[first..last] {
                for (which, &index) in corner.iter().enumerate().filter(|(_, index)| **index != NONE) {
                    if index as usize >= counts[which] {
                        let shown = i64::from(index) + 1;
                        return Err(index_out_of_range(polygon.line as usize, which, shown, counts[which]));
                    }
                }
                let [mesh_row, texture_coordinate, normal] = *corner;
                let color = if has_colors { mesh_row } else { NONE };
                corners.push(Corner { mesh_row, normal, texture_coordinate, color });
            }
            first = last;
            let material = (polygon.material != NONE).then_some(polygon.material as usize);
            builder.add_polygon(polygon.node as usize, material, &corners, &self.positions)?;
        }
        Ok(())
    }

    fn findings(&self) -> Vec<Finding> {
        let mut findings = Vec::new();
        if self.line_or_point_count > 0 {
            findings.push(Finding {
                code: "lines_and_points",
                severity: Severity::Info,
                message: format!("{} lines and points were left out", self.line_or_point_count),
                hint: String::new(),
            });
        }
        if let Some((line, word)) = &self.unknown {
            findings.push(Finding {
                code: "unknown_statement",
                severity: Severity::Info,
                message: format!("line {line}: {word} is not a known OBJ statement and was left out"),
                hint: String::new(),
            });
        }
        findings
    }

    /// Materials in the order of first use, whether or not a library defines them.
    fn add_materials(
        &self,
        scene: &mut Scene,
        findings: &mut Vec<Finding>,
        siblings: &dyn Siblings,
        options: &DecodeOptions,
    ) -> Result<(), DecodeError> {
        let mut textures = Textures::new(siblings, options, self.limits);
        let mut defined = MaterialLibrary::default();
        for line in &self.libraries {
            self.read_libraries(line, siblings, &mut defined, findings)?;
        }
        for name in &self.materials.names {
            scene.materials.push(defined.material(name, &mut textures)?);
        }
        (scene.images, *findings) = textures.finish(std::mem::take(findings));
        Ok(())
    }
}

impl Statements<'_> {
    /// Reads the libraries that one `mtllib` line names. A name may hold blanks, and a line may hold several names, so
    /// the whole line is tried first.
    fn read_libraries(
        &self,
        line: &str,
        siblings: &dyn Siblings,
        defined: &mut MaterialLibrary,
        findings: &mut Vec<Finding>,
    ) -> Result<(), DecodeError> {
        let used = &self.materials.names;
        if let Some(bytes) = siblings::find(siblings, "", line) {
            return mtl::read(&bytes, line, used, defined, self.limits);
        }
        let mut missing = Vec::new();
        let mut names = 0;
        for name in line.split_whitespace() {
            names += 1;
            match siblings::find(siblings, "", name) {
                Some(bytes) => mtl::read(&bytes, name, used, defined, self.limits)?,
                None => missing.push(name),
            }
        }
        let missing = if missing.len() == names { vec![line] } else { missing };
        findings.extend(missing.into_iter().map(missing_library));
        Ok(())
    }
}

fn missing_library(name: &str) -> Finding {
    Finding {
        code: "missing_material_library",
        severity: Severity::Warning,
        message: format!("the material library {name} was not sent; the mesh stays without its materials"),
        hint: format!("send {name} and its textures along, for example in one zip"),
    }
}

/// The rest of a line after its keyword, without surrounding blanks.
fn rest(text: &[u8]) -> String {
    let text = text.trim_ascii();
    let keyword = text.iter().position(u8::is_ascii_whitespace).unwrap_or(text.len());
    String::from_utf8_lossy(text[keyword..].trim_ascii()).into_owned()
}

fn index_out_of_range(line: usize, which: usize, index: i64, count: usize) -> DecodeError {
    let what = ["vertex", "texture coordinate", "normal"][which];
    DecodeError::IndexOutOfRange { format: FORMAT, place: Place::Line(line), what, index, count }
}
