//! STL, binary and ASCII: facets without shared vertices.
//!
//! Mesh rows are three per facet, in file order. Facet normals and the colours that some programs hide in binary files
//! are not read: normals follow from the corners. Each `solid` of an ASCII file becomes a node.

use super::siblings::base_name;
use super::soundness::{check_counts, check_position};
use super::text::{LogicalLines, next_number, quoted, words};
use super::{
    Asset, DecodeError, DecodeOptions, Finding, Format, Limits, Place, Scene, SceneNode, ScenePrimitive, Severity,
    Siblings,
};
use crate::mesh::Mesh;
use glam::{DVec3, Vec3};

const FORMAT: &str = "STL";

/// Header and facet count of a binary file.
const HEADER_BYTES: usize = 84;
/// Normal, three corners, attribute.
const FACET_BYTES: usize = 50;
/// Where an ASCII file must have shown its first `facet`.
const ASCII_HEAD_BYTES: usize = 4096;

/// Reads an STL file.
pub fn decode(
    file_name: &str,
    bytes: &[u8],
    _siblings: &dyn Siblings,
    limits: &Limits,
    _options: &DecodeOptions,
) -> Result<Asset, DecodeError> {
    let own_name = base_name(file_name).rsplit_once('.').map_or(file_name, |(stem, _)| stem);
    let (solids, findings) = if is_ascii(bytes) { read_ascii(bytes, limits)? } else { read_binary(bytes, limits)? };
    let mut positions = Vec::new();
    let mut scene = Scene::default();
    for (name, corners) in solids {
        let rows: Vec<u32> = (positions.len() as u32..(positions.len() + corners.len()) as u32).collect();
        let triangles = (0..corners.len() as u32 / 3).map(|facet| [3 * facet, 3 * facet + 1, 3 * facet + 2]).collect();
        positions.extend(corners);
        if !rows.is_empty() {
            let primitive = ScenePrimitive { mesh_rows: rows, triangles, ..ScenePrimitive::default() };
            let name = if name.is_empty() { own_name.to_owned() } else { name };
            scene.nodes.push(SceneNode { name, primitives: vec![primitive] });
        }
    }
    let facet_count = positions.len() as u32 / 3;
    let triangles = (0..facet_count).map(|facet| [3 * facet, 3 * facet + 1, 3 * facet + 2]).collect();
    Ok(Asset::from_scene(Format::Stl, own_name, Mesh { positions, triangles }, scene, findings))
}

/// Name and corners `[3 F, 3]` of each solid.
type Solids = Vec<(String, Vec<DVec3>)>;

/// `solid` alone does not tell: the free header of binary files may begin so too. Their length tells then.
fn is_ascii(bytes: &[u8]) -> bool {
    let head = bytes[..bytes.len().min(ASCII_HEAD_BYTES)].to_ascii_lowercase();
    let is_exact_binary = declared_facets(bytes).is_some_and(|facets| bytes.len() as u64 == binary_bytes(facets));
    head.trim_ascii_start().starts_with(b"solid") && !is_exact_binary && !head.contains(&0)
}

fn declared_facets(bytes: &[u8]) -> Option<u32> {
    let count = bytes.get(HEADER_BYTES - 4..HEADER_BYTES)?;
    Some(u32::from_le_bytes(count.try_into().ok()?))
}

fn binary_bytes(facets: u32) -> u64 {
    HEADER_BYTES as u64 + FACET_BYTES as u64 * u64::from(facets)
}

fn read_binary(bytes: &[u8], limits: &Limits) -> Result<(Solids, Vec<Finding>), DecodeError> {
    let available = bytes.len() as u64;
    let truncated =
        |what: &str, needed| DecodeError::Truncated { format: FORMAT, what: what.into(), needed, available };
    let facets = declared_facets(bytes).ok_or_else(|| truncated("the header", HEADER_BYTES as u64))?;
    let needed = binary_bytes(facets);
    if needed > available {
        return Err(truncated(&format!("the file with its {facets} facets"), needed));
    }
    check_counts(3 * u64::from(facets), u64::from(facets), limits)?;
    let mut corners = Vec::with_capacity(3 * facets as usize);
    for (index, facet) in bytes[HEADER_BYTES..].chunks_exact(FACET_BYTES).take(facets as usize).enumerate() {
        for corner in facet[12..48].chunks_exact(12) {
            let value = |axis: usize| {
                f32::from_le_bytes([corner[4 * axis], corner[4 * axis + 1], corner[4 * axis + 2], corner[4 * axis + 3]])
            };
            let position = Vec3::new(value(0), value(1), value(2)).as_dvec3();
            check_position(position, FORMAT, || Place::Element(format!("facet {index}")))?;
            corners.push(position);
        }
    }
    let mut findings = Vec::new();
    if available > needed {
        findings.push(Finding {
            code: "trailing_bytes",
            parts: Vec::new(),
            severity: Severity::Warning,
            message: format!(
                "{} bytes after the last of the {facets} declared facets were left out",
                available - needed
            ),
            hint: "export again if facets are missing".into(),
        });
    }
    Ok((vec![(String::new(), corners)], findings))
}

fn read_ascii(bytes: &[u8], limits: &Limits) -> Result<(Solids, Vec<Finding>), DecodeError> {
    let malformed =
        |line: usize, problem: String| DecodeError::Malformed { format: FORMAT, place: Place::Line(line), problem };
    let mut solids: Solids = Vec::new();
    let mut corner_count = 0;
    // Corners read of the facet that is open, `None` between facets.
    let mut open_facet: Option<usize> = None;
    let mut is_open = false;
    let mut last_line = 1;
    for (line, text) in LogicalLines::new(bytes) {
        last_line = line;
        let mut words = words(&text);
        let Some(keyword) = words.next() else { continue };
        match (keyword.to_ascii_lowercase().as_slice(), open_facet) {
            (b"solid", None) if !is_open => {
                let (found, limit) = (solids.len() as u64 + 1, limits.nodes_max as u64);
                if found > limit {
                    return Err(DecodeError::TooMany { what: "nodes", found, limit });
                }
                let name: Vec<_> = words.map(String::from_utf8_lossy).collect();
                solids.push((name.join(" "), Vec::new()));
                is_open = true;
            }
            (b"endsolid", None) if is_open => is_open = false,
            (b"facet", None) if is_open => open_facet = Some(0),
            (b"vertex", Some(count)) if count < 3 => {
                corner_count += 1;
                check_counts(corner_count, corner_count / 3, limits)?;
                let mut position = [0.0; 3];
                for value in &mut position {
                    *value = next_number(&mut words, FORMAT, || Place::Line(line))?;
                }
                let position = DVec3::from_array(position);
                check_position(position, FORMAT, || Place::Line(line))?;
                if let Some((_, corners)) = solids.last_mut() {
                    corners.push(position);
                }
                open_facet = Some(count + 1);
            }
            (b"endfacet", Some(3)) => open_facet = None,
            (b"outer" | b"endloop", Some(_)) => {}
            // An end without a beginning is noise.
            (b"color" | b"endsolid", None) => {}
            (other, _) => return Err(malformed(line, format!("{} is not expected here", quoted(other)))),
        }
    }
    if is_open {
        return Err(malformed(last_line, "the file ends before endsolid".into()));
    }
    Ok((solids, Vec::new()))
}
