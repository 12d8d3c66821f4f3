//! Polygons into triangles, the same way each time.
//!
//! A convex polygon becomes a fan around its first corner; a concave one is cut by ear clipping [Meisters 1975, "Polygons
//! have ears"] in the plane of its Newell normal, always taking the first ear in corner order. A polygon without a plane
//! (all corners collinear), and a concave one of more than [`EAR_CLIPPING_CORNERS_MAX`] corners, becomes a fan too.

use glam::{DVec2, DVec3};

/// Ear clipping is quadratic; with 2,000,000 triangles per upload this bounds the work of a hostile file to seconds.
const EAR_CLIPPING_CORNERS_MAX: usize = 256;

/// Triangles over `corners` `[N, 3]`, as indices below N; N - 2 of them, none for N < 3. Orientation is kept.
pub(super) fn triangulate(corners: &[DVec3]) -> Vec<[usize; 3]> {
    let flat = match corners.len() {
        0..=2 => return Vec::new(),
        3 => return vec![[0, 1, 2]],
        4..=EAR_CLIPPING_CORNERS_MAX => project(corners),
        _ => None,
    };
    match flat {
        Some(flat) if !is_convex(&flat) => clip_ears(&flat),
        _ => fan(corners.len()),
    }
}

fn fan(corner_count: usize) -> Vec<[usize; 3]> {
    (2..corner_count).map(|last| [0, last - 1, last]).collect()
}

/// The corners seen along the Newell normal, counter-clockwise; `None` when the normal vanishes.
fn project(corners: &[DVec3]) -> Option<Vec<DVec2>> {
    let origin = corners[0];
    let mut normal = DVec3::ZERO;
    for (index, &corner) in corners.iter().enumerate() {
        let next = corners[(index + 1) % corners.len()];
        normal += (corner - origin).cross(next - origin);
    }
    let size = normal.abs();
    if !size.max_element().is_normal() {
        return None;
    }
    // Dropping the largest axis keeps the other two in the order that makes a positive normal counter-clockwise.
    let flatten = |point: DVec3| match (size.x >= size.y && size.x >= size.z, size.y >= size.z) {
        (true, _) => DVec2::new(point.y, point.z * normal.x.signum()),
        (false, true) => DVec2::new(point.z, point.x * normal.y.signum()),
        (false, false) => DVec2::new(point.x, point.y * normal.z.signum()),
    };
    Some(corners.iter().map(|&corner| flatten(corner - origin)).collect())
}

/// Twice the signed area of the triangle; positive is counter-clockwise.
fn turn(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b - a).perp_dot(c - a)
}

fn is_convex(flat: &[DVec2]) -> bool {
    let count = flat.len();
    (0..count).all(|index| turn(flat[index], flat[(index + 1) % count], flat[(index + 2) % count]) >= 0.0)
}

/// Cuts N - 2 ears. Where a self-intersecting outline has none, the first remaining corner is cut instead.
fn clip_ears(flat: &[DVec2]) -> Vec<[usize; 3]> {
    let mut remaining: Vec<usize> = (0..flat.len()).collect();
    let mut triangles = Vec::with_capacity(flat.len() - 2);
    let mut is_known_dull = vec![false; flat.len()];
    while remaining.len() > 3 {
        let count = remaining.len();
        let ear = (0..count)
            .find(|&at| {
                let corner = remaining[at];
                let dull = is_known_dull[corner] || !is_ear(flat, &remaining, at);
                is_known_dull[corner] = dull;
                !dull
            })
            .unwrap_or(0);
        let (before, after) = (remaining[(ear + count - 1) % count], remaining[(ear + 1) % count]);
        triangles.push([before, remaining[ear], after]);
        // Only the two neighbours of a cut corner can have become ears by it.
        is_known_dull[before] = false;
        is_known_dull[after] = false;
        remaining.remove(ear);
    }
    triangles.push([remaining[0], remaining[1], remaining[2]]);
    triangles
}

/// Whether the corner at `at` turns left and no other corner lies in its triangle.
fn is_ear(flat: &[DVec2], remaining: &[usize], at: usize) -> bool {
    let count = remaining.len();
    let [before, corner, after] = [(at + count - 1) % count, at, (at + 1) % count].map(|index| flat[remaining[index]]);
    if turn(before, corner, after) <= 0.0 {
        return false;
    }
    !remaining.iter().map(|&index| flat[index]).any(|point| {
        let is_own = point == before || point == corner || point == after;
        !is_own
            && turn(before, corner, point) >= 0.0
            && turn(corner, after, point) >= 0.0
            && turn(after, before, point) >= 0.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(corners: &[DVec3], triangles: &[[usize; 3]]) -> f64 {
        let signed = |t: &[usize; 3]| (corners[t[1]] - corners[t[0]]).cross(corners[t[2]] - corners[t[0]]).z / 2.0;
        assert!(triangles.iter().all(|triangle| signed(triangle) >= 0.0), "{triangles:?}");
        triangles.iter().map(signed).sum()
    }

    fn flat(points: &[[f64; 2]]) -> Vec<DVec3> {
        points.iter().map(|point| DVec3::new(point[0], point[1], 0.25)).collect()
    }

    #[test]
    fn a_convex_polygon_becomes_a_fan_around_its_first_corner() {
        let square = flat(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
        assert_eq!(triangulate(&square), [[0, 1, 2], [0, 2, 3]]);
    }

    #[test]
    fn triangles_of_a_concave_polygon_cover_it_exactly_once() {
        let arrow = flat(&[[0.0, 0.0], [2.0, 1.0], [0.0, 2.0], [1.0, 1.0]]);
        assert!((area(&arrow, &triangulate(&arrow)) - 1.0).abs() < 1e-12);
        let comb: Vec<[f64; 2]> = (0..40)
            .map(|tooth| [f64::from(tooth), if tooth % 2 == 0 { 0.5 } else { 3.0 }])
            .chain([[39.0, -1.0], [0.0, -1.0]])
            .rev()
            .collect();
        let comb = flat(&comb);
        let expected: f64 = (0..comb.len())
            .map(|index| comb[index].truncate().perp_dot(comb[(index + 1) % comb.len()].truncate()) / 2.0)
            .sum();
        let triangles = triangulate(&comb);
        assert_eq!(triangles.len(), comb.len() - 2);
        assert!((area(&comb, &triangles) - expected.abs()).abs() < 1e-9);
    }

    #[test]
    fn collinear_and_self_crossing_polygons_still_give_n_minus_two_triangles() {
        let line = flat(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0], [1.5, 0.0]]);
        assert_eq!(triangulate(&line).len(), 3);
        let bow_tie = flat(&[[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0], [0.2, 3.0]]);
        assert_eq!(triangulate(&bow_tie).len(), 3);
        let star: Vec<[f64; 2]> = (0..7).map(|i| f64::from(i * 3) * 0.8975979).map(|a| [a.cos(), a.sin()]).collect();
        assert_eq!(triangulate(&flat(&star)).len(), 5);
    }
}
