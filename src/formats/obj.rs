//! Wavefront OBJ: polygons with separate indices for positions, texture coordinates and normals.
//!
//! Read: `v` (with colours), `vt`, `vn`, `f`, `o`, `g`, `usemtl`, `mtllib`, continued lines, negative indices. Lines,
//! points and smoothing groups are left out; free-form surfaces are refused. Mesh rows are the file's vertices in file
//! order, used or not. Each object and group with faces becomes a node.
//!
//! A material library that was not sent is a finding, since the shape does not need it; a texture that a library names
//! and that was not sent is refused (see [`DecodeOptions::allow_missing_textures`]).

use super::mtl::{self, MaterialLibrary};
use super::obj_statements::{FORMAT, Statements, index_out_of_range};
use super::scene::linear_from_srgb;
use super::scene_builder::{Corner, NONE, SceneBuilder};
use super::siblings::{self, base_name};
use super::text::LogicalLines;
use super::textures::Textures;
use super::{Asset, DecodeError, DecodeOptions, Finding, Format, Limits, Place, Scene, Severity, Siblings};
use crate::mesh::Mesh;

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

impl Statements<'_> {
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
                parts: Vec::new(),
                severity: Severity::Info,
                message: format!("{} lines and points were left out", self.line_or_point_count),
                hint: String::new(),
            });
        }
        if let Some((line, word)) = &self.unknown {
            findings.push(Finding {
                code: "unknown_statement",
                parts: Vec::new(),
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
        parts: Vec::new(),
        severity: Severity::Warning,
        message: format!("the material library {name} was not sent; the mesh stays without its materials"),
        hint: format!("send {name} and its textures along, for example in one zip"),
    }
}
