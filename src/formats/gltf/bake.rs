//! World transforms go into the vertices: positions, normals (inverse transpose), tangents and morph target deltas.
//!
//! A skinned mesh ignores its node's transform, so what the node did must be in the vertices. Accessors that only the
//! baked mesh uses are overwritten where they lie; shared, sparse or quantised ones get new accessors.

use super::accessors::{Component, Reader};
use super::buffers::append_view;
use super::json::{index, items, malformed, number, push, remove, text};
use super::layout_check::Layouts;
use crate::formats::soundness::check_position;
use crate::formats::{DecodeError, Limits, Place};
use glam::{DMat3, DMat4, DVec3};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// How one primitive's vertices come to world space.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Frame {
    One(DMat4),
    /// One transform per vertex: the skin that the file came with, in its rest pose.
    PerVertex(Vec<DMat4>),
}

impl Frame {
    fn at(&self, vertex: usize) -> DMat4 {
        match self {
            Self::One(matrix) => *matrix,
            Self::PerVertex(matrices) => matrices.get(vertex).copied().unwrap_or(DMat4::IDENTITY),
        }
    }

    fn is_identity(&self) -> bool {
        *self == Self::One(DMat4::IDENTITY)
    }

    /// True when directions come out as they went in, up to a positive factor.
    fn keeps_directions(&self) -> bool {
        let Self::One(matrix) = self else { return false };
        let linear = DMat3::from_mat4(*matrix);
        let scale = linear.x_axis.x;
        scale > 0.0 && linear == DMat3::from_diagonal(DVec3::splat(scale))
    }

    /// True when deltas come out exactly as they went in.
    fn keeps_deltas(&self) -> bool {
        matches!(self, Self::One(matrix) if DMat3::from_mat4(*matrix) == DMat3::IDENTITY)
    }

    /// Mirrored as a whole; a skin that mirrors some vertices only has no winding of its own.
    fn mirrors(&self) -> bool {
        match self {
            Self::One(matrix) => matrix.determinant() < 0.0,
            Self::PerVertex(matrices) => {
                !matrices.is_empty() && matrices.iter().all(|matrix| matrix.determinant() < 0.0)
            }
        }
    }
}

/// What an accessor is to a primitive, with what its change depends on. In the order of baking: deltas depend on bases
/// as they were.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Role {
    /// Accessor of the base normals, if any.
    NormalDelta(Option<usize>),
    /// Accessor of the base tangents, if any.
    TangentDelta(Option<usize>),
    PositionDelta,
    Position,
    Normal,
    Tangent,
    /// Quantised values that only become floats.
    Plain,
}

/// Where in a primitive a reference stands.
#[derive(Clone, Debug)]
struct Slot {
    primitive: usize,
    target: Option<usize>,
    name: String,
}

/// A document being changed.
pub(super) struct Edit<'a> {
    pub(super) json: &'a mut Value,
    pub(super) binary: &'a mut Vec<u8>,
    pub(super) limits: &'a Limits,
    pub(super) layouts: Layouts,
}

impl<'a> Edit<'a> {
    /// Meshes that several nodes show must have been made several before.
    pub(super) fn new(json: &'a mut Value, binary: &'a mut Vec<u8>, limits: &'a Limits) -> Self {
        let layouts = Layouts::new(json, binary, limits);
        Self { json, binary, limits, layouts }
    }

    pub(super) fn reader(&self) -> Reader<'_> {
        Reader { json: self.json, binary: self.binary, limits: self.limits }
    }

    /// Bakes one mesh. `frames[frame_of[p]]` is how primitive `p` comes to world space.
    pub(super) fn bake(&mut self, mesh: usize, frames: &[Frame], frame_of: &[usize]) -> Result<(), DecodeError> {
        let mut jobs: BTreeMap<(Role, usize, usize), Vec<Slot>> = BTreeMap::new();
        for (primitive, &frame) in frame_of.iter().enumerate() {
            for (role, accessor, slot) in self.attributes(mesh, primitive)? {
                jobs.entry((role, accessor, frame)).or_default().push(slot);
            }
        }
        for ((role, accessor, frame), slots) in jobs {
            self.bake_accessor(mesh, accessor, &role, &frames[frame], &slots)?;
        }
        for (primitive, &frame) in frame_of.iter().enumerate() {
            if frames[frame].mirrors() {
                super::triangles::flip(self, mesh, primitive)?;
            }
        }
        Ok(())
    }

    /// Everything of a primitive that a transform may change.
    fn attributes(&self, mesh: usize, primitive: usize) -> Result<Vec<(Role, usize, Slot)>, DecodeError> {
        let json = &self.json["meshes"][mesh]["primitives"][primitive];
        let count = items(self.json, "accessors").len();
        let place = format!("mesh {mesh}, primitive {primitive}");
        let base = |name: &str| json["attributes"].get(name).and_then(index);
        let mut found = Vec::new();
        let mut add = |role: Role, value: &Value, target: Option<usize>, name: &str| {
            let accessor = super::json::reference(value, "accessor", count, &place)?;
            found.push((role, accessor, Slot { primitive, target, name: name.to_owned() }));
            Ok::<(), DecodeError>(())
        };
        for (name, value) in json["attributes"].as_object().into_iter().flatten() {
            match name.as_str() {
                "POSITION" => add(Role::Position, value, None, name)?,
                "NORMAL" => add(Role::Normal, value, None, name)?,
                "TANGENT" => add(Role::Tangent, value, None, name)?,
                name if name.starts_with("TEXCOORD_") => add(Role::Plain, value, None, name)?,
                _ => {}
            }
        }
        for (target, attributes) in items(json, "targets").iter().enumerate() {
            for (name, value) in attributes.as_object().into_iter().flatten() {
                match name.as_str() {
                    "POSITION" => add(Role::PositionDelta, value, Some(target), name)?,
                    "NORMAL" => add(Role::NormalDelta(base("NORMAL")), value, Some(target), name)?,
                    "TANGENT" => add(Role::TangentDelta(base("TANGENT")), value, Some(target), name)?,
                    name if name.starts_with("TEXCOORD_") => add(Role::Plain, value, Some(target), name)?,
                    _ => {}
                }
            }
        }
        Ok(found)
    }

    fn bake_accessor(
        &mut self,
        mesh: usize,
        accessor: usize,
        role: &Role,
        frame: &Frame,
        slots: &[Slot],
    ) -> Result<(), DecodeError> {
        let reader = self.reader();
        let read = reader.accessor(accessor)?;
        let is_plain = match role {
            // Texture coordinates may be normalized bytes or shorts without any extension.
            Role::Plain => {
                read.component == Component::F32
                    || (read.normalized && matches!(read.component, Component::U8 | Component::U16))
            }
            _ => read.component == Component::F32,
        };
        let is_kept = match role {
            Role::Plain => true,
            Role::Position => frame.is_identity(),
            Role::Normal | Role::Tangent => frame.keeps_directions(),
            Role::PositionDelta | Role::NormalDelta(_) | Role::TangentDelta(_) => frame.keeps_deltas(),
        };
        let place = format!("mesh {mesh}, accessor {accessor}");
        if is_plain && is_kept {
            if *role == Role::Position {
                let floats = reader.floats(&read)?;
                check_positions(&floats, &place)?;
                set_bounds(&mut self.json["accessors"][accessor], &floats, read.width);
            }
            return Ok(());
        }
        let expected_width = match role {
            Role::Plain => 2,
            Role::Tangent => 4,
            _ => 3,
        };
        if read.width != expected_width {
            return Err(malformed(place, format!("its elements do not have {expected_width} components")));
        }
        let mut floats = reader.floats(&read)?;
        if !is_kept {
            self.transform(&mut floats, role, frame)?;
        }
        if matches!(role, Role::Position | Role::PositionDelta) {
            check_positions(&floats, &place)?;
        }
        let bytes: Vec<u8> = floats.iter().flat_map(|value| value.to_le_bytes()).collect();
        let needs_bounds = matches!(role, Role::Position | Role::PositionDelta);
        if read.component == Component::F32 && self.layouts.may_overwrite(accessor, &read, slots.len()) {
            let layout = read.layout.as_ref().expect("an accessor that may be overwritten has bytes");
            for (element, bytes) in bytes.chunks_exact(layout.element_bytes).enumerate() {
                self.binary[layout.element(element)].copy_from_slice(bytes);
            }
            let json = &mut self.json["accessors"][accessor];
            if needs_bounds || json.get("min").is_some() || json.get("max").is_some() {
                set_bounds(json, &floats, read.width);
            }
            return Ok(());
        }
        let new = self.append_accessor(accessor, &bytes, needs_bounds.then_some(&floats), read.width)?;
        self.layouts.move_users(accessor, new, slots.len());
        for slot in slots {
            let primitive = &mut self.json["meshes"][mesh]["primitives"][slot.primitive];
            let attributes = match slot.target {
                Some(target) => &mut primitive["targets"][target],
                None => &mut primitive["attributes"],
            };
            attributes[slot.name.as_str()] = json!(new);
        }
        Ok(())
    }

    /// A copy of an accessor's description over new bytes of floats.
    fn append_accessor(
        &mut self,
        like: usize,
        bytes: &[u8],
        bounds: Option<&Vec<f32>>,
        width: usize,
    ) -> Result<usize, DecodeError> {
        self.check_growth(bytes.len())?;
        let view = append_view(self.json, self.binary, bytes);
        self.json["bufferViews"][view]["target"] = json!(34962);
        let mut accessor = self.json["accessors"][like].clone();
        for key in ["sparse", "normalized", "byteOffset", "min", "max"] {
            remove(&mut accessor, key);
        }
        accessor["bufferView"] = json!(view);
        accessor["componentType"] = json!(5126);
        if let Some(floats) = bounds {
            set_bounds(&mut accessor, floats, width);
        }
        Ok(push(self.json, "accessors", accessor))
    }

    /// Many accessors over the same few bytes would otherwise unfold without bound.
    pub(super) fn check_growth(&self, bytes: usize) -> Result<(), DecodeError> {
        let (found, limit) = ((self.binary.len() + bytes) as u64, self.limits.bytes_max.saturating_mul(4));
        if found > limit {
            let what = "the geometry with its transforms applied".into();
            return Err(DecodeError::TooLarge { what, found, limit });
        }
        Ok(())
    }

    fn transform(&self, floats: &mut [f32], role: &Role, frame: &Frame) -> Result<(), DecodeError> {
        let reader = self.reader();
        let base_lengths = |base: &Option<usize>, by: &dyn Fn(DMat4) -> DMat3, width: usize| match base {
            None => Ok(Vec::new()),
            Some(base) => {
                let accessor = reader.accessor(*base)?;
                let floats = reader.floats(&accessor)?;
                let rows = floats.chunks_exact(width).enumerate();
                Ok::<_, DecodeError>(rows.map(|(row, value)| (by(frame.at(row)) * vector(value)).length()).collect())
            }
        };
        match role {
            Role::Position => rows(floats, 3, |row, value| frame.at(row).transform_point3(value)),
            Role::Normal => rows(floats, 3, |row, value| direction(normal_matrix(frame.at(row)) * value, value)),
            Role::Tangent => {
                rows(floats, 4, |row, value| direction(linear(frame.at(row)) * value, value));
                for (row, tangent) in floats.chunks_exact_mut(4).enumerate() {
                    if frame.at(row).determinant() < 0.0 {
                        tangent[3] = -tangent[3];
                    }
                }
            }
            Role::PositionDelta => rows(floats, 3, |row, value| linear(frame.at(row)) * value),
            // Scaled as the base was when it was made unit again: base + weight × delta keeps its direction.
            Role::NormalDelta(base) => {
                let lengths: Vec<f64> = base_lengths(base, &normal_matrix, 3)?;
                rows(floats, 3, |row, value| normal_matrix(frame.at(row)) * value / positive(lengths.get(row)));
            }
            Role::TangentDelta(base) => {
                let lengths: Vec<f64> = base_lengths(base, &linear, 4)?;
                rows(floats, 3, |row, value| linear(frame.at(row)) * value / positive(lengths.get(row)));
            }
            Role::Plain => {}
        }
        Ok(())
    }
}

fn linear(matrix: DMat4) -> DMat3 {
    DMat3::from_mat4(matrix)
}

/// Inverse transpose of the linear part, up to a positive factor that is its size to the fourth power over |det|: the
/// cofactor matrix with the determinant's sign, which exists for flat transforms too, divided by its longest column.
fn normal_matrix(matrix: DMat4) -> DMat3 {
    let linear = linear(matrix);
    let (a, b, c) = (linear.x_axis, linear.y_axis, linear.z_axis);
    let cofactors = DMat3::from_cols(b.cross(c), c.cross(a), a.cross(b));
    let longest =
        [cofactors.x_axis, cofactors.y_axis, cofactors.z_axis].map(DVec3::length).into_iter().fold(0.0, f64::max);
    let sign = if linear.determinant() < 0.0 { -1.0 } else { 1.0 };
    if longest > 0.0 { cofactors * (sign / longest) } else { DMat3::IDENTITY }
}

fn positive(length: Option<&f64>) -> f64 {
    length.copied().filter(|length| *length > 0.0).unwrap_or(1.0)
}

fn check_positions(floats: &[f32], place: &str) -> Result<(), DecodeError> {
    for (row, value) in floats.chunks_exact(3).enumerate() {
        check_position(vector(value), super::FORMAT, || Place::Element(format!("{place}, vertex {row}")))?;
    }
    Ok(())
}

/// Unit length; a direction that the transform flattens to nothing stays as it was.
fn direction(transformed: DVec3, original: DVec3) -> DVec3 {
    transformed.try_normalize().unwrap_or(original)
}

fn vector(value: &[f32]) -> DVec3 {
    match *value {
        [x, y, z, ..] => DVec3::new(f64::from(x), f64::from(y), f64::from(z)),
        _ => DVec3::ZERO,
    }
}

/// Changes the first three components of every row.
fn rows(floats: &mut [f32], width: usize, change: impl Fn(usize, DVec3) -> DVec3) {
    for (row, value) in floats.chunks_exact_mut(width).enumerate() {
        let changed = change(row, vector(value)).as_vec3().to_array();
        value.iter_mut().zip(changed).for_each(|(value, changed)| *value = changed);
    }
}

/// Exact bounds `[width]` of rows. Bounds that are right already keep their spelling.
pub(super) fn set_bounds(accessor: &mut Value, floats: &[f32], width: usize) {
    let mut low = vec![f32::INFINITY; width];
    let mut high = vec![f32::NEG_INFINITY; width];
    for row in floats.chunks_exact(width) {
        for (component, &value) in row.iter().enumerate() {
            low[component] = low[component].min(value);
            high[component] = high[component].max(value);
        }
    }
    for (key, bounds) in [("min", low), ("max", high)] {
        let given: Option<Vec<f32>> = accessor
            .get(key)
            .and_then(Value::as_array)
            .and_then(|list| list.iter().map(|value| value.as_f64().map(|value| value as f32)).collect());
        if given.as_deref() != Some(&bounds) && !floats.is_empty() {
            accessor[key] = json!(bounds.iter().map(|&value| f64::from(value)).collect::<Vec<f64>>());
        }
    }
}

/// Turns quantised geometry of every mesh into floats, so that the extension can leave the document.
pub(super) fn dequantise(edit: &mut Edit) -> Result<(), DecodeError> {
    let has_extension = |list: &str| items(edit.json, list).iter().any(|name| name == "KHR_mesh_quantization");
    if has_extension("extensionsUsed") || has_extension("extensionsRequired") {
        for mesh in 0..items(edit.json, "meshes").len() {
            let primitives = items(&edit.json["meshes"][mesh], "primitives").len();
            edit.bake(mesh, &[Frame::One(DMat4::IDENTITY)], &vec![0; primitives])?;
        }
    }
    Ok(())
}

/// Drawing mode of a primitive.
pub(super) fn mode(primitive: &Value, place: &str) -> Result<u64, DecodeError> {
    match number(primitive, "mode", place)?.unwrap_or(4) {
        mode @ 0..=6 => Ok(mode),
        mode => Err(malformed(place, format!("unknown drawing mode {mode}"))),
    }
}

/// Name of a thing, for people.
pub(super) fn named(json: &Value, what: &str, number_of: usize) -> String {
    match text(json, "name") {
        "" => format!("{what} {number_of}"),
        name => name.to_owned(),
    }
}
