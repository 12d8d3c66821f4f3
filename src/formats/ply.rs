//! PLY [Turk 1994], ASCII and binary of both byte orders: vertices and polygons with any further properties.
//!
//! Mesh rows are the file's vertices in file order. Per vertex, normals, colours and texture coordinates are kept; the
//! scene has one node of one primitive with the same vertices. Declared counts are compared with the bytes that are
//! there before anything is allocated for them. Triangle strips are refused by name.

use super::ply_header::{Element, FORMAT, Header, Kind, Property, Reader};
use super::polygon::triangulate;
use super::scene::linear_from_srgb;
use super::siblings::base_name;
use super::soundness::{check_counts, check_position};
use super::{
    Asset, DecodeError, DecodeOptions, Finding, Format, Limits, Place, Scene, SceneNode, ScenePrimitive, Severity,
    Siblings,
};
use crate::mesh::Mesh;
use glam::{DVec3, Vec3};

/// Reads a PLY file.
pub fn decode(
    file_name: &str,
    bytes: &[u8],
    _siblings: &dyn Siblings,
    limits: &Limits,
    _options: &DecodeOptions,
) -> Result<Asset, DecodeError> {
    let (header, data_start) = Header::read(bytes)?;
    let mut reader = Reader::new(bytes, data_start, header.encoding, header.line_count);
    let mut contents = Contents::default();
    for element in &header.elements {
        reader.check_declared(element)?;
        match element.name.as_str() {
            "vertex" if contents.positions.is_empty() => contents.read_vertices(element, &mut reader, limits)?,
            "face" => contents.read_faces(element, &mut reader, limits)?,
            "tristrips" => {
                let feature = "geometry as triangle strips".into();
                return Err(DecodeError::UnsupportedFeature { format: FORMAT, feature });
            }
            _ => skip(element, &mut reader)?,
        }
    }
    let own_name = base_name(file_name).rsplit_once('.').map_or(file_name, |(stem, _)| stem);
    contents.into_asset(own_name)
}

fn skip(element: &Element, reader: &mut Reader) -> Result<(), DecodeError> {
    if element.properties.is_empty() {
        return Ok(());
    }
    for _ in 0..element.count {
        for property in &element.properties {
            reader.skip(property)?;
        }
    }
    Ok(())
}

#[derive(Default)]
struct Contents {
    positions: Vec<DVec3>,
    normals: Option<Vec<[f32; 3]>>,
    texture_coordinates: Option<Vec<[f32; 2]>>,
    colors: Option<Vec<[f32; 4]>>,
    /// Corners of all polygons, one after another, and how many each has.
    corners: Vec<u32>,
    corner_counts: Vec<u32>,
    degenerate_polygons: usize,
    has_face_coordinates: bool,
}

/// Where a vertex property goes: one of twelve slots, by the names that programs write.
fn vertex_slot(name: &str) -> Option<usize> {
    const NAMES: [&[&str]; 12] = [
        &["x"],
        &["y"],
        &["z"],
        &["nx", "normal_x"],
        &["ny", "normal_y"],
        &["nz", "normal_z"],
        &["red", "r", "diffuse_red"],
        &["green", "g", "diffuse_green"],
        &["blue", "b", "diffuse_blue"],
        &["alpha", "a", "diffuse_alpha"],
        &["s", "u", "texture_u", "texture_s"],
        &["t", "v", "texture_v", "texture_t"],
    ];
    NAMES.iter().position(|names| names.contains(&name))
}

/// What divides a stored colour so that it lies between 0 and 1.
fn color_scale(kind: Kind) -> f64 {
    match kind {
        Kind::U8 | Kind::I8 => 255.0,
        Kind::U16 | Kind::I16 => 65_535.0,
        Kind::U32 | Kind::I32 => f64::from(u32::MAX),
        Kind::F32 | Kind::F64 => 1.0,
    }
}

impl Contents {
    fn read_vertices(&mut self, element: &Element, reader: &mut Reader, limits: &Limits) -> Result<(), DecodeError> {
        check_counts(element.count, 0, limits)?;
        let mut scales = [1.0; 12];
        let mut has = [false; 12];
        let slots: Vec<Option<usize>> = element
            .properties
            .iter()
            .map(|property| {
                let slot = vertex_slot(&property.name).filter(|_| property.list_count.is_none())?;
                has[slot] = true;
                scales[slot] = if (6..10).contains(&slot) { color_scale(property.kind) } else { 1.0 };
                Some(slot)
            })
            .collect();
        if !has[..3].iter().all(|has| *has) {
            let problem = "the element vertex lacks x, y or z".into();
            return Err(DecodeError::Malformed { format: FORMAT, place: Place::Element("header".into()), problem });
        }
        let [has_normals, has_colors, has_coordinates] =
            [3..6, 6..9, 10..12].map(|slots| has[slots].iter().all(|has| *has));
        self.normals = has_normals.then(Vec::new);
        self.colors = has_colors.then(Vec::new);
        self.texture_coordinates = has_coordinates.then(Vec::new);
        for _ in 0..element.count {
            let place = reader.place();
            let mut row = [0.0; 12];
            row[9] = scales[9];
            for (property, slot) in element.properties.iter().zip(&slots) {
                match slot {
                    Some(slot) => row[*slot] = reader.scalar(property.kind)?,
                    None => reader.skip(property)?,
                }
            }
            self.push_vertex(&row, &scales, place)?;
        }
        Ok(())
    }

    fn push_vertex(&mut self, row: &[f64; 12], scales: &[f64; 12], place: Place) -> Result<(), DecodeError> {
        let position = DVec3::new(row[0], row[1], row[2]);
        check_position(position, FORMAT, || place)?;
        self.positions.push(position);
        let finite = |value: f64| if (value as f32).is_finite() { value as f32 } else { 0.0 };
        if let Some(normals) = &mut self.normals {
            let normal = DVec3::new(row[3], row[4], row[5]).try_normalize().filter(|normal| normal.is_finite());
            // A zero row is replaced once the faces are known.
            normals.push(normal.unwrap_or(DVec3::ZERO).as_vec3().to_array());
        }
        if let Some(colors) = &mut self.colors {
            let [red, green, blue, alpha] = [6, 7, 8, 9].map(|slot| finite(row[slot] / scales[slot]).clamp(0.0, 1.0));
            colors.push([linear_from_srgb(red), linear_from_srgb(green), linear_from_srgb(blue), alpha]);
        }
        if let Some(coordinates) = &mut self.texture_coordinates {
            // PLY counts v from the bottom of the image, as OBJ does; glTF counts from its top.
            coordinates.push([finite(row[10]), finite(1.0 - row[11])]);
        }
        Ok(())
    }

    fn read_faces(&mut self, element: &Element, reader: &mut Reader, limits: &Limits) -> Result<(), DecodeError> {
        self.has_face_coordinates |= element.properties.iter().any(|property| property.name == "texcoord");
        let is_corners = |property: &Property| ["vertex_indices", "vertex_index"].contains(&property.name.as_str());
        let mut triangle_count = self.corner_counts.iter().map(|&count| u64::from(count) - 2).sum::<u64>();
        for _ in 0..element.count {
            for property in &element.properties {
                let Some(count_kind) = property.list_count.filter(|_| is_corners(property)) else {
                    reader.skip(property)?;
                    continue;
                };
                let corner_count = reader.list_count(count_kind, property.kind)?;
                if corner_count < 3 {
                    self.degenerate_polygons += 1;
                } else {
                    triangle_count += corner_count - 2;
                    check_counts(0, triangle_count, limits)?;
                    self.corner_counts.push(corner_count as u32);
                }
                for _ in 0..corner_count {
                    let index = reader.index(property.kind)?;
                    if corner_count >= 3 {
                        self.corners.push(index);
                    }
                }
            }
        }
        Ok(())
    }

    fn into_asset(mut self, name: &str) -> Result<Asset, DecodeError> {
        let triangles = self.triangles()?;
        let mut findings = Vec::new();
        if self.degenerate_polygons > 0 {
            findings.push(Finding {
                code: "faces_without_area",
                parts: Vec::new(),
                severity: Severity::Info,
                message: format!("{} faces of fewer than three corners were left out", self.degenerate_polygons),
                hint: String::new(),
            });
        }
        if self.has_face_coordinates {
            findings.push(Finding {
                code: "face_texture_coordinates",
                parts: Vec::new(),
                severity: Severity::Warning,
                message: "texture coordinates that faces carry were left out; only those of vertices are read".into(),
                hint: "send the mesh as OBJ with its material library, or as GLB".into(),
            });
        }
        self.repair_normals(&triangles);
        let mesh = Mesh { positions: self.positions, triangles };
        let primitive = ScenePrimitive {
            material: None,
            mesh_rows: (0..mesh.positions.len() as u32).collect(),
            normals: self.normals,
            texture_coordinates: self.texture_coordinates,
            colors: self.colors,
            triangles: mesh.triangles.clone(),
        };
        let node = SceneNode { name: name.into(), primitives: vec![primitive] };
        let scene = Scene { nodes: vec![node], ..Scene::default() };
        Ok(Asset::from_scene(Format::Ply, name, mesh, scene, findings))
    }

    fn triangles(&self) -> Result<Vec<[u32; 3]>, DecodeError> {
        let mut triangles = Vec::new();
        let mut first = 0;
        for (face, &count) in self.corner_counts.iter().enumerate() {
            let corners = &self.corners[first..first + count as usize];
            first += count as usize;
            let mut points = Vec::with_capacity(corners.len());
            for &corner in corners {
                points.push(*self.positions.get(corner as usize).ok_or_else(|| DecodeError::IndexOutOfRange {
                    format: FORMAT,
                    place: Place::Element(format!("face {face}")),
                    what: "vertex",
                    index: i64::from(corner),
                    count: self.positions.len(),
                })?);
            }
            triangles.extend(triangulate(&points).into_iter().map(|triangle| triangle.map(|corner| corners[corner])));
        }
        Ok(triangles)
    }

    /// Normals of no length become the mean of their triangles' normals by area.
    fn repair_normals(&mut self, triangles: &[[u32; 3]]) {
        let Some(normals) = self.normals.as_mut().filter(|normals| normals.contains(&[0.0; 3])) else { return };
        let mut sums = vec![DVec3::ZERO; normals.len()];
        for triangle in triangles {
            let [a, b, c] = triangle.map(|corner| self.positions[corner as usize]);
            for &corner in triangle {
                sums[corner as usize] += (b - a).cross(c - a);
            }
        }
        for (normal, sum) in normals.iter_mut().zip(sums).filter(|(normal, _)| **normal == [0.0; 3]) {
            let sum = sum.try_normalize().filter(|sum| sum.is_finite()).unwrap_or(DVec3::Y).as_vec3();
            *normal = if sum == Vec3::ZERO { Vec3::Y.to_array() } else { sum.to_array() };
        }
    }
}
