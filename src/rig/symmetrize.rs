//! Left and right made alike about a given plane. RigNet [Xu et al. 2020], Section 4.1 ("symmetrization").
//!
//! | in       | shape    | unit                                       |
//! |----------|----------|--------------------------------------------|
//! | `points` | `[M, 3]` | normalised frame                           |
//! | `plane`  |          | unit normal and offset, same frame         |
//! | `band`   | scalar   | same unit; points this near lie on the plane |
//!
//! The negative side is the one that the plane's normal points away from. The published code calls it "left", although a
//! character that faces +z has its right hand there; sides are therefore named by sign.
//! # Departures from the paper
//! - Any plane; the published code knows only x = 0.
//! - The middle band and suppression come *before* mirroring ([`fold`]), so that no two joints coincide and no joint
//!   near the plane is lost with its twin; the published order is kept in [`symmetrize_joints`].

use crate::geometry::symmetry_plane::SymmetryPlane;
use glam::DVec3;

/// Joints this near to the plane lie on it (published value, normalised frame).
pub const MIDDLE_BAND: f64 = 0.02;

/// Where a joint lies with respect to the symmetry plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Side {
    /// Behind the plane's normal: x < 0 where the plane is x = 0.
    Negative,
    Middle,
    Positive,
}

/// Joints in the order negative, middle, positive; the positive ones are the images of the negative ones, in their order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SidedJoints {
    /// `[J, 3]`
    pub positions: Vec<DVec3>,
    /// `[J]`
    pub sides: Vec<Side>,
}

pub fn side_of(point: DVec3, plane: &SymmetryPlane, band: f64) -> Side {
    let distance = plane.signed_distance(point);
    if distance < -band {
        Side::Negative
    } else if distance > band {
        Side::Positive
    } else {
        Side::Middle
    }
}

/// The points, then their mirror images in the same order. `[2M, 3]`
pub fn with_images(points: &[DVec3], plane: &SymmetryPlane) -> Vec<DVec3> {
    points.iter().copied().chain(points.iter().map(|&point| plane.reflect(point))).collect()
}

/// The nearest point of the plane.
pub fn on_plane(point: DVec3, plane: &SymmetryPlane) -> DVec3 {
    point - plane.normal * plane.signed_distance(point)
}

/// Mirrors the negative side to the positive one, whose own joints are dropped; middle joints move onto the plane.
/// Within a side the input's order stays.
pub fn symmetrize_joints(joints: &[DVec3], plane: &SymmetryPlane, band: f64) -> SidedJoints {
    let on = |side| joints.iter().copied().filter(move |&joint| side_of(joint, plane, band) == side);
    let negative: Vec<DVec3> = on(Side::Negative).collect();
    let middle: Vec<DVec3> = on(Side::Middle).map(|joint| on_plane(joint, plane)).collect();
    let mut sided = SidedJoints::default();
    sided.extend(Side::Negative, negative.iter().copied());
    sided.extend(Side::Middle, middle);
    sided.extend(Side::Positive, negative.iter().map(|&joint| plane.reflect(joint)));
    sided
}

impl SidedJoints {
    fn extend(&mut self, side: Side, joints: impl IntoIterator<Item = DVec3>) {
        self.positions.extend(joints);
        self.sides.resize(self.positions.len(), side);
    }
}

/// Half of a mirrored point set: the indices of points that are not on the positive side, and where they are, those
/// within the band on the plane.
///
/// Suppression among these keeps joints apart after mirroring too: a negative joint is farther than `band` from the plane,
/// so farther than twice that from its image.
pub fn fold(points: &[DVec3], plane: &SymmetryPlane, band: f64) -> (Vec<usize>, Vec<DVec3>) {
    let halved = points.iter().enumerate().filter_map(|(index, &point)| match side_of(point, plane, band) {
        Side::Negative => Some((index, point)),
        Side::Middle => Some((index, on_plane(point, plane))),
        Side::Positive => None,
    });
    halved.unzip()
}

/// The mirror twin of every joint by rank: the k-th negative and the k-th positive one are twins; a middle joint, and one
/// without a twin, is its own. `[J]`
pub fn twins(sides: &[Side]) -> Vec<usize> {
    let of = |side| (0..sides.len()).filter(move |&joint| sides[joint] == side);
    let mut twin: Vec<usize> = (0..sides.len()).collect();
    for (negative, positive) in of(Side::Negative).zip(of(Side::Positive)) {
        twin[negative] = positive;
        twin[positive] = negative;
    }
    twin
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A slanted plane beside the origin.
    fn plane() -> SymmetryPlane {
        SymmetryPlane { normal: DVec3::new(0.6, 0.0, 0.8), offset: 0.1, score: 1.0 }
    }

    /// A point at a signed distance from the plane.
    fn at(distance: f64, height: f64) -> DVec3 {
        plane().normal * (plane().offset + distance) + DVec3::Y * height
    }

    #[test]
    fn the_negative_side_is_mirrored_and_the_middle_moves_onto_the_plane() {
        let joints = [at(0.2, 0.9), at(-0.01, 0.5), at(-0.3, 0.2), at(-0.4, 0.1)];
        let sided = symmetrize_joints(&joints, &plane(), MIDDLE_BAND);
        let expected = [joints[2], joints[3], at(0.0, 0.5), at(0.3, 0.2), at(0.4, 0.1)];
        assert!(sided.positions.iter().zip(expected).all(|(a, b)| a.distance(b) < 1e-12), "{sided:?}");
        use Side::{Middle, Negative, Positive};
        assert_eq!(sided.sides, [Negative, Negative, Middle, Positive, Positive]);
        assert_eq!(twins(&sided.sides), [3, 4, 2, 0, 1]);
    }

    #[test]
    fn symmetrizing_twice_changes_nothing() {
        let once = symmetrize_joints(&[at(-0.3, 0.2), at(0.015, 0.7), at(-0.021, 0.4)], &plane(), MIDDLE_BAND);
        let twice = symmetrize_joints(&once.positions, &plane(), MIDDLE_BAND);
        assert_eq!(once.sides, twice.sides);
        assert!(once.positions.iter().zip(&twice.positions).all(|(a, b)| a.distance(*b) < 1e-12));
    }

    #[test]
    fn folding_keeps_one_half_and_the_middle() {
        let (kept, positions) = fold(&[at(0.2, 0.0), at(0.01, 0.0), at(-0.2, 0.0)], &plane(), MIDDLE_BAND);
        assert_eq!(kept, [1, 2]);
        assert!(positions[0].distance(at(0.0, 0.0)) < 1e-12);
        assert_eq!(positions[1], at(-0.2, 0.0));
    }
}
