//! Faces turned to agree with their neighbours and to look outward, for a surface that may be open or inside out.
//!
//! | in     | shape              | unit                      |
//! |--------|--------------------|---------------------------|
//! | `mesh` | `[V, 3]`, `[F, 3]` | any space; welded         |
//!
//! Faces that share an edge with exactly one other face form patches. Within a patch all faces are turned alike; the
//! patch is turned so that the volume it encloses (an open one: with its rims joined to its centroid) is positive. A patch
//! that encloses next to nothing, a sheet, keeps the side that most of its area had.
//! Inner walls of hollow shells are turned outward too: bones belong inside a character, hollow or not.

use super::Mesh;
use glam::DVec3;

/// Share of a ball's volume (of the same area) below which a patch counts as a sheet.
const SHEET: f64 = 0.02;

/// The triangles of `mesh`, each with its corners in the order that looks outward. `[F]`
pub fn outward(mesh: &Mesh) -> Vec<[u32; 3]> {
    let neighbors = across_edges(&mesh.triangles);
    let mut turned: Vec<Option<bool>> = vec![None; mesh.triangles.len()];
    let mut triangles = mesh.triangles.clone();
    let mut patch = Vec::new();
    for seed in 0..mesh.triangles.len() {
        if turned[seed].is_some() {
            continue;
        }
        // Visits every face of the patch once.
        turned[seed] = Some(false);
        patch.clear();
        patch.push(seed);
        let mut at = 0;
        while at < patch.len() {
            let face = patch[at];
            at += 1;
            for &(other, same_way) in neighbors[face].iter().flatten() {
                let other = other as usize;
                if turned[other].is_none() {
                    turned[other] = turned[face].map(|turned| turned != same_way);
                    patch.push(other);
                }
            }
        }
        let flip = patch_is_inside_out(mesh, &patch, &turned);
        for &face in &patch {
            if turned[face].is_some_and(|turned| turned != flip) {
                triangles[face].swap(1, 2);
            }
        }
    }
    triangles
}

/// Whether a patch must be turned as a whole, beyond what makes its faces agree.
fn patch_is_inside_out(mesh: &Mesh, patch: &[usize], turned: &[Option<bool>]) -> bool {
    let (mut area, mut kept_area, mut centre) = (0.0, 0.0, DVec3::ZERO);
    for &face in patch {
        let face_area = 0.5 * mesh.area_normal(face).length();
        area += face_area;
        kept_area += if turned[face] == Some(false) { face_area } else { 0.0 };
        centre += mesh.corners(face).into_iter().sum::<DVec3>() / 3.0 * face_area;
    }
    if area <= 0.0 {
        return false;
    }
    centre /= area;
    let volume: f64 = patch
        .iter()
        .map(|&face| {
            let [a, b, c] = mesh.corners(face).map(|corner| corner - centre);
            let six_fold = a.dot(b.cross(c));
            if turned[face] == Some(true) { -six_fold } else { six_fold }
        })
        .sum::<f64>()
        / 6.0;
    let ball = area * (area / (36.0 * std::f64::consts::PI)).sqrt();
    if volume.abs() > SHEET * ball { volume < 0.0 } else { kept_area < 0.5 * area }
}

/// For each face and edge the one other face at that edge, and whether both run the same way along it. `[F, 3]`
fn across_edges(triangles: &[[u32; 3]]) -> Vec<[Option<(u32, bool)>; 3]> {
    let mut sides: Vec<(u32, u32, u32, u8, bool)> = Vec::with_capacity(triangles.len() * 3);
    for (face, corners) in (0u32..).zip(triangles) {
        for side in 0..3u8 {
            let (from, to) = (corners[usize::from(side)], corners[usize::from(side + 1) % 3]);
            sides.push((from.min(to), from.max(to), face, side, from < to));
        }
    }
    sides.sort_unstable();
    let mut neighbors = vec![[None; 3]; triangles.len()];
    for edge in sides.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        if let &[(.., first, first_side, first_way), (.., second, second_side, second_way)] = edge
            && first != second
        {
            let same_way = first_way == second_way;
            neighbors[first as usize][usize::from(first_side)] = Some((second, same_way));
            neighbors[second as usize][usize::from(second_side)] = Some((first, same_way));
        }
    }
    neighbors
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::adjacency::edge_statistics;

    fn octahedron(centre: DVec3, flipped: &[usize]) -> Mesh {
        let corners = [DVec3::X, DVec3::Y, DVec3::NEG_X, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
        let positions = corners.map(|corner| corner + centre).to_vec();
        let mut triangles: Vec<[u32; 3]> = (0..4).flat_map(|i| [[i, (i + 1) % 4, 4], [(i + 1) % 4, i, 5]]).collect();
        flipped.iter().for_each(|&face| triangles[face].swap(1, 2));
        Mesh { positions, triangles }
    }

    #[test]
    fn every_mixture_of_flipped_faces_comes_out_looking_outward() {
        for mask in 0..256usize {
            let flipped: Vec<usize> = (0..8).filter(|face| mask >> face & 1 == 1).collect();
            let mut mesh = octahedron(DVec3::new(5.0, -3.0, 2.0), &flipped);
            mesh.triangles = outward(&mesh);
            assert_eq!(edge_statistics(&mesh).inconsistent, 0);
            let centre = DVec3::new(5.0, -3.0, 2.0);
            assert!((0..8).all(|face| mesh.area_normal(face).dot(mesh.corners(face)[0] - centre) > 0.0), "{mask:b}");
        }
    }

    #[test]
    fn a_sheet_keeps_the_side_of_most_of_its_area() {
        let positions = vec![DVec3::ZERO, DVec3::X, DVec3::ONE - DVec3::Z, DVec3::Y, DVec3::new(2.0, 0.0, 0.0)];
        let mesh = Mesh { positions, triangles: vec![[0, 1, 2], [0, 2, 3], [1, 2, 4]] };
        assert_eq!(outward(&mesh), [[0, 1, 2], [0, 2, 3], [1, 4, 2]]);
    }

    #[test]
    fn degenerate_faces_and_no_faces_are_harmless() {
        assert_eq!(outward(&Mesh::default()), Vec::<[u32; 3]>::new());
        let mesh = Mesh { positions: vec![DVec3::ZERO; 3], triangles: vec![[0, 0, 0], [0, 1, 2], [0, 1, 2]] };
        assert_eq!(outward(&mesh).len(), 3);
    }
}
