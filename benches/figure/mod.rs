//! The figure that benches measure: balls and tubes, with bones along them. Made here so that any size can be had.

use glam::DVec3;
use rigsmith::geometry::volumetric_geodesic::Segment;
use rigsmith::mesh::Mesh;
use rigsmith::mesh::weld::weld;
use std::f64::consts::{PI, TAU};

/// Ellipsoids of a standing figure: middle, half sides.
const PARTS: [([f64; 3], [f64; 3]); 8] = [
    ([0.0, 0.62, 0.0], [0.14, 0.2, 0.09]),
    ([0.0, 0.9, 0.01], [0.08, 0.1, 0.09]),
    ([0.3, 0.75, 0.0], [0.2, 0.045, 0.045]),
    ([-0.3, 0.75, 0.0], [0.2, 0.045, 0.045]),
    ([0.09, 0.25, 0.0], [0.065, 0.24, 0.07]),
    ([-0.09, 0.25, 0.0], [0.065, 0.24, 0.07]),
    ([0.09, 0.03, 0.05], [0.05, 0.03, 0.1]),
    ([-0.09, 0.03, 0.05], [0.05, 0.03, 0.1]),
];

/// The figure with `around` vertices around each part and half as many along it.
pub fn figure(around: u32) -> Mesh {
    let mut mesh = Mesh::default();
    let along = around / 2;
    for (middle, half) in PARTS {
        let offset = mesh.positions.len() as u32;
        for (row, column) in (0..=along).flat_map(|row| (0..=around).map(move |column| (row, column))) {
            let (angle, height) = (TAU * f64::from(column) / f64::from(around), PI * f64::from(row) / f64::from(along));
            let on_ball = DVec3::new(height.sin() * angle.cos(), -height.cos(), -height.sin() * angle.sin());
            mesh.positions.push(DVec3::from(middle) + on_ball * DVec3::from(half));
        }
        for (row, column) in (0..along).flat_map(|row| (0..around).map(move |column| (row, column))) {
            let a = offset + row * (around + 1) + column;
            let d = a + around + 1;
            mesh.triangles.extend([[a, a + 1, d + 1], [a, d + 1, d]]);
        }
    }
    weld(&mesh).mesh
}

/// Five bones along the longest axis of each part.
pub fn bones() -> Vec<Segment> {
    let of_part = |(middle, half): &([f64; 3], [f64; 3])| {
        let (middle, half) = (DVec3::from(*middle), DVec3::from(*half));
        let mut along = DVec3::ZERO;
        along[half.max_position()] = half.max_element() * 0.36;
        (-2..=2)
            .map(|step| (middle + along * (f64::from(step) - 0.5), middle + along * (f64::from(step) + 0.5)))
            .collect::<Vec<Segment>>()
    };
    PARTS.iter().flat_map(of_part).collect::<Vec<Segment>>()
}
