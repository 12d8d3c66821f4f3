//! Meshes made by code, y up and facing +z, for claims about parts that a given character does not have.

use glam::{DMat3, DVec3};
use rigsmith::mesh::Mesh;

/// A closed surface over rings of points from one end to the other; the ends are closed by fans.
fn lathe(rings: &[Vec<DVec3>]) -> Mesh {
    let around = rings[0].len() as u32;
    let mut positions: Vec<DVec3> = rings.iter().flatten().copied().collect();
    let at = |ring: u32, place: u32| ring * around + place % around;
    let mut triangles = Vec::new();
    for ring in 0..rings.len() as u32 - 1 {
        for place in 0..around {
            let [a, b, c, d] = [at(ring, place), at(ring, place + 1), at(ring + 1, place + 1), at(ring + 1, place)];
            triangles.extend([[a, c, b], [a, d, c]]);
        }
    }
    for (ring, is_first) in [(0, true), (rings.len() - 1, false)] {
        let middle = positions.len() as u32;
        positions.push(rings[ring].iter().sum::<DVec3>() / f64::from(around));
        for place in 0..around {
            let [a, b] = [at(ring as u32, place), at(ring as u32, place + 1)];
            triangles.push(if is_first { [a, b, middle] } else { [b, a, middle] });
        }
    }
    Mesh { positions, triangles }
}

/// A closed tube from `start` to `end`, whose radius goes from `radii[0]` to `radii[1]`.
pub fn tube(start: DVec3, end: DVec3, radii: [f64; 2], around: u32, along: u32) -> Mesh {
    let axis = (end - start).normalize();
    let (side, other) = axis.any_orthonormal_pair();
    let turn = DMat3::from_cols(side, axis, other);
    let ring = |step: u32| {
        let share = f64::from(step) / f64::from(along);
        let radius = radii[0] + share * (radii[1] - radii[0]);
        let point = |place: u32| {
            let angle = std::f64::consts::TAU * f64::from(place) / f64::from(around);
            start.lerp(end, share) + turn * DVec3::new(angle.cos() * radius, 0.0, angle.sin() * radius)
        };
        (0..around).map(point).collect()
    };
    lathe(&(0..=along).map(ring).collect::<Vec<_>>())
}

/// One mesh of several, and where the vertices of each begin.
pub fn joined(parts: &[Mesh]) -> (Mesh, Vec<usize>) {
    let (mut mesh, mut starts) = (Mesh::default(), Vec::new());
    for part in parts {
        let first = mesh.positions.len() as u32;
        starts.push(first as usize);
        mesh.positions.extend(&part.positions);
        mesh.triangles.extend(part.triangles.iter().map(|triangle| triangle.map(|corner| corner + first)));
    }
    (mesh, starts)
}
