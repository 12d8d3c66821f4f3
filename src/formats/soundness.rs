//! What every decoded mesh is checked for, whatever file it came from. Past this point meshes are trusted.

use super::{DecodeError, Finding, Limits, Part, Place, Severity};
use crate::mesh::Mesh;
use glam::DVec3;

/// Largest coordinate: its square still fits single precision, which viewers compute in.
pub(super) const COORDINATE_MAX: f64 = 1e18;

/// Smallest longest side, for the same reason.
const LONGEST_SIDE_MIN: f64 = 1e-18;

/// Coordinates are written in single precision. Below this many steps of it along the longest side nothing is left of
/// the shape; below [`COARSE_STEPS`] it visibly suffers.
const STEPS_MIN: f64 = 64.0;
const COARSE_STEPS: f64 = 20_000.0;

/// Refuses a mesh that cannot be worked on; otherwise tells what is noteworthy about it.
pub(super) fn check(mesh: &Mesh, parts: &[Part], limits: &Limits) -> Result<Vec<Finding>, DecodeError> {
    check_counts(mesh.positions.len() as u64, mesh.triangles.len() as u64, limits)?;
    check_positions(mesh)?;
    if mesh.triangles.is_empty() {
        return Err(match mesh.positions.len() {
            0 => DecodeError::NoTriangles { vertices: 0 },
            points => DecodeError::PointCloud { points },
        });
    }
    let is_used = used_vertices(mesh)?;
    let mut findings = Vec::new();
    check_extent(mesh, &is_used, &mut findings)?;
    check_areas(mesh, parts, &mut findings)?;
    let unused: Vec<usize> = (0..is_used.len()).filter(|&vertex| !is_used[vertex]).collect();
    if !unused.is_empty() {
        findings.push(Finding {
            code: "unused_vertices",
            parts: labels(parts, unused.iter().copied()),
            severity: Severity::Info,
            message: format!("{} of {} vertices belong to no face", unused.len(), is_used.len()),
            hint: String::new(),
        });
    }
    if mesh.triangles.len() > limits.faces_without_a_word {
        findings.push(Finding {
            code: "many_faces",
            parts: Vec::new(),
            severity: Severity::Info,
            message: format!("the mesh has {} faces; it will take longer", mesh.triangles.len()),
            hint: format!("decimate below {} faces if that is too slow", limits.faces_without_a_word),
        });
    }
    Ok(findings)
}

/// For decoders that know what a file declares before they read it.
pub(super) fn check_counts(vertices: u64, faces: u64, limits: &Limits) -> Result<(), DecodeError> {
    if vertices > limits.vertices_max as u64 {
        return Err(DecodeError::TooManyVertices { found: vertices, limit: limits.vertices_max as u64 });
    }
    if faces > limits.faces_max as u64 {
        return Err(DecodeError::TooManyFaces { found: faces, limit: limits.faces_max as u64 });
    }
    Ok(())
}

/// `Err` unless every coordinate is finite and of usable size. `place` tells where the position stands.
pub(super) fn check_position(
    position: DVec3,
    format: &'static str,
    place: impl FnOnce() -> Place,
) -> Result<(), DecodeError> {
    match position.to_array().into_iter().find(|value| value.is_nan() || value.abs() > COORDINATE_MAX) {
        None => Ok(()),
        Some(value) => Err(DecodeError::NonFinite { format, place: place(), what: "coordinate", value }),
    }
}

fn check_positions(mesh: &Mesh) -> Result<(), DecodeError> {
    for (index, &position) in mesh.positions.iter().enumerate() {
        check_position(position, "mesh", || Place::Element(format!("vertex {index}")))?;
    }
    Ok(())
}

/// Which vertices a triangle uses `[V]`.
fn used_vertices(mesh: &Mesh) -> Result<Vec<bool>, DecodeError> {
    let mut is_used = vec![false; mesh.positions.len()];
    for (face, triangle) in mesh.triangles.iter().enumerate() {
        for &corner in triangle {
            *is_used.get_mut(corner as usize).ok_or_else(|| DecodeError::IndexOutOfRange {
                format: "mesh",
                place: Place::Element(format!("face {face}")),
                what: "vertex",
                index: i64::from(corner),
                count: mesh.positions.len(),
            })? = true;
        }
    }
    Ok(is_used)
}

fn check_extent(mesh: &Mesh, is_used: &[bool], findings: &mut Vec<Finding>) -> Result<(), DecodeError> {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for (&position, _) in mesh.positions.iter().zip(is_used).filter(|(_, used)| **used) {
        low = low.min(position);
        high = high.max(position);
    }
    let longest_side = (high - low).max_element();
    let step = low.abs().max(high.abs()).max_element() * f64::from(f32::EPSILON);
    if !(longest_side >= LONGEST_SIDE_MIN && longest_side >= STEPS_MIN * step) {
        return Err(DecodeError::ZeroExtent { longest_side });
    }
    if longest_side < COARSE_STEPS * step {
        findings.push(Finding {
            code: "far_from_origin",
            parts: Vec::new(),
            severity: Severity::Warning,
            message: format!(
                "the mesh is {longest_side} long but up to {} from the origin; single precision rounds it to {step:e}",
                low.abs().max(high.abs()).max_element()
            ),
            hint: "move the mesh to the origin and export again".into(),
        });
    }
    Ok(())
}

fn check_areas(mesh: &Mesh, parts: &[Part], findings: &mut Vec<Finding>) -> Result<(), DecodeError> {
    let is_degenerate = |triangle: &&[u32; 3]| {
        let [a, b, c] = triangle.map(|corner| mesh.positions[corner as usize]);
        let size = (b - a).abs().max((c - a).abs()).max_element();
        // Scaled first: the area of a tiny face would underflow.
        size == 0.0 || ((b - a) / size).cross((c - a) / size) == DVec3::ZERO
    };
    let faces = mesh.triangles.len();
    let degenerate: Vec<&[u32; 3]> = mesh.triangles.iter().filter(is_degenerate).collect();
    if degenerate.len() == faces {
        return Err(DecodeError::AllDegenerate { faces });
    }
    if !degenerate.is_empty() {
        findings.push(Finding {
            code: "degenerate_faces",
            parts: labels(parts, degenerate.iter().map(|corners| corners[0] as usize)),
            severity: Severity::Info,
            message: format!("{} of {faces} faces have no area", degenerate.len()),
            hint: String::new(),
        });
    }
    Ok(())
}

/// A finding names this many parts.
const PARTS_NAMED_MAX: usize = 20;

/// Labels of the parts that have any of `vertices`, in the order of the parts.
fn labels(parts: &[Part], vertices: impl Iterator<Item = usize>) -> Vec<String> {
    let mut has_any = vec![false; parts.len()];
    for vertex in vertices {
        let part = parts.partition_point(|part| part.vertices.end <= vertex);
        if let Some(has) = has_any.get_mut(part) {
            *has = true;
        }
    }
    let named = parts.iter().zip(has_any).filter(|(_, has)| *has);
    named.map(|(part, _)| part.label()).take(PARTS_NAMED_MAX).collect()
}
