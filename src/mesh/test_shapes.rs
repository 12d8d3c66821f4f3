//! Families of surfaces for tests: closed, open, overlapping. Faces look outward.

use super::Mesh;
use super::weld::weld;
use glam::DVec3;
use std::f64::consts::{PI, TAU};

/// A grid of `u` × `v` quads over the unit square, each two triangles; coincident vertices welded.
fn grid(u: u32, v: u32, place: impl Fn(f64, f64) -> DVec3) -> Mesh {
    let mut mesh = Mesh::default();
    for row in 0..=v {
        for column in 0..=u {
            // Exactly the same place at both ends of a round.
            let (s, t) = (f64::from(column % u) / f64::from(u), f64::from(row) / f64::from(v));
            mesh.positions.push(place(if column == u { 1.0 } else { s }, t));
        }
    }
    for (row, column) in (0..v).flat_map(|row| (0..u).map(move |column| (row, column))) {
        let a = row * (u + 1) + column;
        let (b, c, d) = (a + 1, a + u + 2, a + u + 1);
        mesh.triangles.extend([[a, b, c], [a, c, d]]);
    }
    weld(&mesh).mesh
}

/// Closed.
pub fn sphere(centre: DVec3, radius: f64, around: u32) -> Mesh {
    grid(around, around / 2, |s, t| {
        let (angle, height) = (TAU * s, -(PI * t).cos());
        centre + DVec3::new((PI * t).sin() * angle.cos(), height, -(PI * t).sin() * angle.sin()) * radius
    })
}

/// Closed, around the y axis.
pub fn torus(ring: f64, thickness: f64, around: u32) -> Mesh {
    grid(around, around / 2, |s, t| {
        let (angle, turn) = (TAU * s, -TAU * t);
        let out = ring - thickness * turn.cos();
        DVec3::new(out * angle.cos(), thickness * turn.sin(), -out * angle.sin())
    })
}

/// Open at both ends, from y = 0 to `height`.
pub fn tube(centre: DVec3, radius: f64, height: f64, around: u32, along: u32) -> Mesh {
    grid(around, along, |s, t| centre + DVec3::new(radius * (TAU * s).cos(), height * t, -radius * (TAU * s).sin()))
}

/// Closed, with eight vertices.
pub fn cuboid(centre: DVec3, half: DVec3) -> Mesh {
    let corner = |index: u32| {
        let side = |axis: u32| if index >> axis & 1 == 1 { 1.0 } else { -1.0 };
        centre + half * DVec3::new(side(0), side(1), side(2))
    };
    let sides = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let triangles = sides.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Mesh { positions: (0..8).map(corner).collect(), triangles }
}

/// Several parts as one mesh; vertices stay apart.
pub fn joined(parts: &[Mesh]) -> Mesh {
    let mut all = Mesh::default();
    for part in parts {
        let offset = all.positions.len() as u32;
        all.positions.extend(&part.positions);
        all.triangles.extend(part.triangles.iter().map(|face| face.map(|corner| corner + offset)));
    }
    all
}

/// Shapes that must be survived: nothing, one triangle, one place, a line, faces on one edge, far away and huge.
pub fn degenerate() -> Vec<Mesh> {
    let triangle = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
    let fan: Vec<DVec3> = (0..7).map(|i| DVec3::new(f64::from(i % 3), f64::from(i / 2), f64::from(i))).collect();
    vec![
        Mesh::default(),
        Mesh { positions: triangle.clone(), triangles: vec![] },
        Mesh { positions: triangle.clone(), triangles: vec![[0, 1, 2]] },
        Mesh { positions: vec![DVec3::ONE; 3], triangles: vec![[0, 1, 2]] },
        Mesh { positions: vec![DVec3::ZERO, DVec3::X, DVec3::X * 2.0], triangles: vec![[0, 1, 2], [0, 0, 1]] },
        Mesh { positions: fan, triangles: (2..7).map(|tip| [0, 1, tip]).collect() },
        Mesh {
            positions: triangle.iter().map(|p| *p * 1e150 + DVec3::splat(1e151)).collect(),
            triangles: vec![[0, 1, 2]],
        },
        Mesh { positions: triangle.iter().map(|p| *p * 1e-150).collect(), triangles: vec![[0, 1, 2]] },
    ]
}

/// Volume enclosed by faces that look outward.
pub fn volume(mesh: &Mesh) -> f64 {
    (0..mesh.triangles.len())
        .map(|face| {
            let [a, b, c] = mesh.corners(face);
            a.dot(b.cross(c)) / 6.0
        })
        .sum()
}
