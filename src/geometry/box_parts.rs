//! Which boxes a character is made of, when it is made of boxes: the models of block games, robots of crates, toys.
//!
//! | in       | shape              | unit       |
//! |----------|--------------------|------------|
//! | `mesh`   | `[V, 3]`, `[F, 3]` | normalised |
//! | `welded` | `[V]`              | [`crate::mesh::weld`] of the same mesh |
//!
//! Out: the parts, and to which of them each vertex belongs. A part is a set of faces that hang together over edges. Boxes that
//! stand corner to corner share places but no edge of two faces, so they stay apart; the faces of one box, which exporters
//! give vertices of their own, meet in edges of two faces, so they stay together.
//!
//! A part is a box when nearly all of its area faces along three axes that are square to each other: whole boxes, boxes with a
//! side left out, and single sheets. Their edges may be split, their position and rotation are free.

use crate::mesh::Mesh;
use crate::mesh::adjacency::DisjointSets;
use crate::mesh::weld::Welded;
use glam::{DMat3, DVec3};
use std::collections::HashMap;

/// More faces than this are no character of boxes, and not looked at.
const FACES_MAX: usize = 20_000;
/// With more parts than this, what moves together is no longer told by who touches whom.
pub const PARTS_MAX: usize = 128;
/// This share of the surface must belong to boxes. Of 295 organic training rigs none has half of it, of 181 box models all but one have all.
const BOX_AREA_SHARE: f64 = 0.7;
/// This share of a part's area must face along three axes.
const FLAT_AREA_SHARE: f64 = 0.97;
/// Normals within ten degrees of each other are one axis.
const SAME_AXIS: f64 = 0.985;
/// Axes whose cosine is below this are square to each other.
const SQUARE: f64 = 0.2;
/// A part with more directions than this is round.
const AXES_MAX: usize = 8;
/// Least half extent, in longest sides: a sheet has a volume too, so that its size can be compared.
const HALF_EXTENT_MIN: f64 = 1e-4;

/// A box around one part, along the part's own axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoxPart {
    pub centre: DVec3,
    /// Columns: three unit axes, square to each other.
    pub axes: DMat3,
    /// Half of the extent along each axis; above zero.
    pub half: DVec3,
}

impl BoxPart {
    pub fn volume(&self) -> f64 {
        8.0 * self.half.element_product()
    }

    /// Distance from `point` to the box; 0 inside.
    pub fn distance(&self, point: DVec3) -> f64 {
        let local = self.axes.transpose() * (point - self.centre);
        (local.abs() - self.half).max(DVec3::ZERO).length()
    }

    /// The point at `share` of the way from the centre to the sides, each of it -1 to 1.
    pub fn at(&self, share: DVec3) -> DVec3 {
        self.centre + self.axes * (self.half * share)
    }
}

/// The parts of a character made of boxes.
#[derive(Clone, Debug, PartialEq)]
pub struct BoxParts {
    /// In the order of their first faces; 2 to [`PARTS_MAX`].
    pub parts: Vec<BoxPart>,
    /// `[V]`: the part of each vertex of `mesh`; for one without a face that has an area, the nearest part.
    pub part_of_vertex: Vec<u32>,
    /// `[F]`: the same for each face.
    pub part_of_face: Vec<u32>,
}

/// The boxes of `mesh`; `None` when it is not made of boxes, or of one alone.
pub fn box_parts(mesh: &Mesh, welded: &Welded) -> Option<BoxParts> {
    let face_count = mesh.triangles.len();
    if face_count > FACES_MAX {
        return None;
    }
    let normals: Vec<DVec3> = (0..face_count).map(|face| mesh.area_normal(face)).collect();
    let set_of_face = joined_faces(mesh, welded);
    let mut faces_of_set: Vec<Vec<usize>> = Vec::new();
    let mut number_of_set: HashMap<u32, usize> = HashMap::new();
    for face in (0..face_count).filter(|&face| normals[face].length() > 0.0) {
        let number = *number_of_set.entry(set_of_face[face]).or_insert_with(|| {
            faces_of_set.push(Vec::new());
            faces_of_set.len() - 1
        });
        faces_of_set[number].push(face);
    }
    if !(2..=PARTS_MAX).contains(&faces_of_set.len()) {
        return None;
    }
    let (mut area, mut box_area) = (0.0, 0.0);
    let mut parts = Vec::with_capacity(faces_of_set.len());
    for faces in &faces_of_set {
        let own_area: f64 = faces.iter().map(|&face| normals[face].length()).sum();
        let axes = main_axes(faces, &normals);
        area += own_area;
        if axes.are_a_box {
            box_area += own_area;
        }
        let corners = faces.iter().flat_map(|&face| mesh.corners(face));
        parts.push(bounding(corners, axes.frame));
    }
    if box_area < BOX_AREA_SHARE * area {
        return None;
    }
    let mut part_of_face = vec![None; face_count];
    let mut part_of_vertex = vec![None; mesh.positions.len()];
    for (part, faces) in faces_of_set.iter().enumerate() {
        for &face in faces {
            part_of_face[face] = Some(part as u32);
            for corner in mesh.triangles[face] {
                part_of_vertex[corner as usize].get_or_insert(part as u32);
            }
        }
    }
    let nearest = |point: DVec3| {
        let distance = |part: &usize| parts[*part].distance(point);
        (0..parts.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0) as u32
    };
    let of_vertex = |(vertex, part): (usize, Option<u32>)| part.unwrap_or_else(|| nearest(mesh.positions[vertex]));
    let of_face = |(face, part): (usize, Option<u32>)| part.unwrap_or_else(|| nearest(mesh.corners(face)[0]));
    Some(BoxParts {
        part_of_vertex: part_of_vertex.into_iter().enumerate().map(of_vertex).collect(),
        part_of_face: part_of_face.into_iter().enumerate().map(of_face).collect(),
        parts,
    })
}

/// For each face the least face that it hangs together with: over an edge of the upload, or over an edge of places that
/// exactly two faces have.
fn joined_faces(mesh: &Mesh, welded: &Welded) -> Vec<u32> {
    let mut sets = DisjointSets::new(mesh.triangles.len());
    let mut first_at_edge: HashMap<(u32, u32), u32> = HashMap::new();
    let mut faces_at_places: HashMap<(u32, u32), (u32, u32, usize)> = HashMap::new();
    for (face, corners) in mesh.triangles.iter().enumerate() {
        let face = face as u32;
        let places = corners.map(|corner| welded.vertex_of_original[corner as usize]);
        for (from, to) in [(0, 1), (1, 2), (2, 0)] {
            let other = *first_at_edge.entry(ordered(corners[from], corners[to])).or_insert(face);
            sets.join(other, face);
            if let (Some(from), Some(to)) = (places[from], places[to])
                && from != to
            {
                let (_, last, count) = faces_at_places.entry(ordered(from, to)).or_insert((face, face, 0));
                *last = face;
                *count += 1;
            }
        }
    }
    for (first, last, _) in faces_at_places.into_values().filter(|(_, _, count)| *count == 2) {
        sets.join(first, last);
    }
    (0..mesh.triangles.len() as u32).map(|face| sets.find(face)).collect()
}

fn ordered(a: u32, b: u32) -> (u32, u32) {
    (a.min(b), a.max(b))
}

struct MainAxes {
    /// The axis with the largest area first.
    frame: DMat3,
    are_a_box: bool,
}

/// Three axes that most area of `faces` faces along, either way.
fn main_axes(faces: &[usize], normals: &[DVec3]) -> MainAxes {
    let mut by_area = faces.to_vec();
    by_area.sort_by(|&a, &b| normals[b].length().total_cmp(&normals[a].length()).then(a.cmp(&b)));
    let mut axes: Vec<(DVec3, f64)> = Vec::new();
    let (mut area, mut beyond) = (0.0, 0.0);
    for face in by_area {
        let own = normals[face].length();
        let direction = normals[face] / own;
        area += own;
        match axes.iter().position(|(axis, _)| axis.dot(direction).abs() > SAME_AXIS) {
            Some(axis) => axes[axis].1 += own,
            None if axes.len() < AXES_MAX => axes.push((direction, own)),
            None => beyond += own,
        }
    }
    axes.sort_by(|a, b| b.1.total_cmp(&a.1));
    axes.truncate(3);
    let flat: f64 = axes.iter().map(|(_, sum)| sum).sum();
    let is_square = |a: usize, b: usize| a >= axes.len() || b >= axes.len() || axes[a].0.dot(axes[b].0).abs() < SQUARE;
    let are_a_box =
        beyond == 0.0 && flat >= FLAT_AREA_SHARE * area && is_square(0, 1) && is_square(1, 2) && is_square(0, 2);
    let first = axes.first().map_or(DVec3::Y, |(axis, _)| *axis);
    let second = axes.iter().skip(1).map(|(axis, _)| axis.reject_from_normalized(first));
    let second = second.map(DVec3::normalize_or_zero).find(|axis| *axis != DVec3::ZERO);
    let second = second.unwrap_or_else(|| first.any_orthonormal_vector());
    MainAxes { frame: DMat3::from_cols(first, second, first.cross(second)), are_a_box }
}

/// The least box along `axes` around `points`.
fn bounding(points: impl Iterator<Item = DVec3>, axes: DMat3) -> BoxPart {
    let to_local = axes.transpose();
    let (low, high) = points
        .map(|point| to_local * point)
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high): (DVec3, DVec3), point| {
            (low.min(point), high.max(point))
        });
    let half = ((high - low) * 0.5).max(DVec3::splat(HALF_EXTENT_MIN));
    BoxPart { centre: axes * ((low + high) * 0.5), axes, half }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::{cuboid, joined, sphere};
    use crate::mesh::weld::weld;

    fn parts(mesh: &Mesh) -> Option<BoxParts> {
        box_parts(mesh, &weld(mesh))
    }

    fn boxes() -> Mesh {
        joined(&[
            cuboid(DVec3::new(0.0, 0.5, 0.0), DVec3::new(0.2, 0.3, 0.1)),
            cuboid(DVec3::new(0.0, 0.9, 0.0), DVec3::splat(0.1)),
        ])
    }

    #[test]
    fn boxes_are_told_apart_however_they_are_turned() {
        let turn = DMat3::from_rotation_z(0.4) * DMat3::from_rotation_x(0.7);
        for rotation in [DMat3::IDENTITY, turn] {
            let mut mesh = boxes();
            mesh.positions.iter_mut().for_each(|position| *position = rotation * *position);
            let found = parts(&mesh).expect("made of boxes");
            assert_eq!(found.parts.len(), 2);
            assert!((found.parts[0].volume() - 0.4 * 0.6 * 0.2).abs() < 1e-9);
            assert!(found.parts[1].centre.distance(rotation * DVec3::new(0.0, 0.9, 0.0)) < 1e-9);
            let tip = rotation * DVec3::new(0.0, 1.5, 0.0);
            assert!((found.parts[1].distance(tip) - 0.5).abs() < 1e-9);
            assert!(found.part_of_vertex.iter().enumerate().all(|(vertex, &part)| (vertex >= 8) == (part == 1)));
        }
    }

    #[test]
    fn vertices_of_their_own_for_each_side_do_not_tear_a_box_and_shared_corners_do_not_join_two() {
        let whole = boxes();
        let mut torn = Mesh::default();
        for face in &whole.triangles {
            let first = torn.positions.len() as u32;
            torn.positions.extend(face.map(|corner| whole.positions[corner as usize]));
            torn.triangles.push([first, first + 1, first + 2]);
        }
        assert_eq!(parts(&torn).expect("made of boxes").parts, parts(&whole).expect("made of boxes").parts);
        let corner_to_corner =
            joined(&[cuboid(DVec3::ZERO, DVec3::splat(0.5)), cuboid(DVec3::new(1.0, 0.0, 0.0), DVec3::splat(0.5))]);
        assert_eq!(parts(&corner_to_corner).expect("made of boxes").parts.len(), 2);
    }

    #[test]
    fn round_shapes_and_one_box_alone_are_not_made_of_boxes() {
        let ball = |x| sphere(DVec3::new(x, 0.0, 0.0), 0.5, 12);
        assert_eq!(parts(&joined(&[ball(0.0), ball(2.0)])), None);
        assert_eq!(parts(&cuboid(DVec3::ZERO, DVec3::ONE)), None);
        let with_a_ball = joined(&[boxes(), sphere(DVec3::new(0.0, 1.1, 0.0), 0.05, 12)]);
        assert_eq!(parts(&with_a_ball).expect("mostly boxes").parts.len(), 3);
        assert_eq!(parts(&Mesh::default()), None);
    }
}
