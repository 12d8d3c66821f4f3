//! The statements of an OBJ file, as they stand.

use super::scene_builder::{Attributes, NONE};
use super::soundness::{check_counts, check_position};
use super::text::{next_number, quoted, words};
use super::{DecodeError, Limits, Place};
use glam::{DVec3, Vec3};
use std::collections::HashMap;

pub(super) const FORMAT: &str = "OBJ";

/// Statements that are known and of no use here.
const IGNORED: &[&[u8]] =
    &[b"s", b"vp", b"mg", b"lod", b"bevel", b"c_interp", b"d_interp", b"shadow_obj", b"trace_obj"];

/// Statements that build free-form curves and surfaces.
const FREE_FORM: &[&[u8]] =
    &[b"cstype", b"deg", b"bmat", b"curv", b"curv2", b"surf", b"parm", b"trim", b"hole", b"end"];

/// Everything a file says, with indices made absolute but not yet checked: a face may precede its vertices.
pub(super) struct Statements<'a> {
    pub(super) limits: &'a Limits,
    pub(super) positions: Vec<DVec3>,
    pub(super) attributes: Attributes,
    /// Position, texture coordinate and normal of each corner, 0-based.
    pub(super) corners: Vec<[u32; 3]>,
    pub(super) polygons: Vec<Polygon>,
    pub(super) triangle_count: u64,
    pub(super) nodes: Interner,
    pub(super) materials: Interner,
    pub(super) libraries: Vec<String>,
    pub(super) object: Option<String>,
    pub(super) group: Option<String>,
    pub(super) node: Option<u32>,
    pub(super) material: u32,
    pub(super) line_or_point_count: usize,
    pub(super) free_form: bool,
    pub(super) unknown: Option<(usize, String)>,
}

pub(super) struct Polygon {
    pub(super) line: u32,
    pub(super) corner_count: u32,
    pub(super) node: u32,
    /// Or [`NONE`].
    pub(super) material: u32,
}

/// Names in order of first use.
#[derive(Default)]
pub(super) struct Interner {
    pub(super) names: Vec<String>,
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
    pub(super) fn new(limits: &'a Limits) -> Self {
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

    pub(super) fn read(&mut self, line: usize, text: &[u8]) -> Result<(), DecodeError> {
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
}

/// The rest of a line after its keyword, without surrounding blanks.
fn rest(text: &[u8]) -> String {
    let text = text.trim_ascii();
    let keyword = text.iter().position(u8::is_ascii_whitespace).unwrap_or(text.len());
    String::from_utf8_lossy(text[keyword..].trim_ascii()).into_owned()
}

pub(super) fn index_out_of_range(line: usize, which: usize, index: i64, count: usize) -> DecodeError {
    let what = ["vertex", "texture coordinate", "normal"][which];
    DecodeError::IndexOutOfRange { format: FORMAT, place: Place::Line(line), what, index, count }
}
