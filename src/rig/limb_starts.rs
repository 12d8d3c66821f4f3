//! Legs that hang on a joint of the middle get a joint of their own to turn by.
//!
//! In: a predicted skeleton of a symmetric character and its mirror plane, normalised frame. Where a bone leads from the middle down to
//! the joint of a limb, the limb could only bend there: turning its start turns the other limb too. So a joint is put beside the
//! middle one, above the limb, where that is inside the body. Ours.

use super::Skeleton;
use super::spanning_tree::Tree;
use crate::geometry::symmetry_plane::SymmetryPlane;
use glam::DVec3;

/// Joints nearer to the plane than this are of the middle, those farther than [`LATERAL`] of a side, in longest sides.
const MIDDLE: f64 = 0.02;
const LATERAL: f64 = 0.03;
/// A limb starts this much lower than the joint that it hangs on.
const DROP: f64 = 0.13;

/// The skeleton with a start for each limb that has none.
pub fn with_limb_starts(skeleton: Skeleton, plane: &SymmetryPlane, is_inside: impl Fn(DVec3) -> bool) -> Skeleton {
    let children = skeleton.children();
    let mut positions = skeleton.positions();
    let mut parents: Vec<Option<usize>> = skeleton.joints.iter().map(|joint| joint.parent).collect();
    for joint in 0..skeleton.joints.len() {
        let Some(parent) = parents[joint] else { continue };
        let (limb, middle) = (positions[joint], positions[parent]);
        let (aside, off) = (plane.signed_distance(limb), plane.signed_distance(middle));
        let start = middle + plane.normal * (aside - off);
        let hangs = off.abs() < MIDDLE && aside.abs() > LATERAL && middle.y - limb.y > DROP;
        if hangs && !children[joint].is_empty() && is_inside(start) {
            parents[joint] = Some(positions.len());
            positions.push(start);
            parents.push(Some(parent));
        }
    }
    if positions.len() == skeleton.joints.len() {
        return skeleton;
    }
    let keys = vec![0.0; positions.len()];
    Skeleton::from_tree(&positions, &Tree { root: 0, parents, keys }).0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::Joint;

    /// Pelvis, and per side knee and foot; an arm that leaves the pelvis level.
    fn figure() -> Skeleton {
        let places = [
            (None, [0.0, 0.5, 0.0]),
            (Some(0), [0.08, 0.3, 0.0]),
            (Some(0), [-0.08, 0.3, 0.0]),
            (Some(0), [0.3, 0.5, 0.0]),
            (Some(1), [0.08, 0.0, 0.0]),
            (Some(2), [-0.08, 0.0, 0.0]),
        ];
        let joint = |(index, (parent, place)): (usize, (Option<usize>, [f64; 3]))| Joint {
            name: format!("joint_{index}"),
            parent,
            position: place.into(),
        };
        Skeleton { joints: places.into_iter().enumerate().map(joint).collect() }
    }

    #[test]
    fn legs_start_beside_the_pelvis_where_that_is_inside() {
        let plane = SymmetryPlane { normal: DVec3::X, offset: 0.0, score: 1.0 };
        let made = with_limb_starts(figure(), &plane, |_| true);
        assert_eq!(made.joints.len(), 8);
        let knee = made.joints.iter().find(|joint| joint.position == DVec3::new(0.08, 0.3, 0.0)).expect("a knee");
        let start = &made.joints[knee.parent.expect("a start")];
        assert_eq!((start.position, start.parent), (DVec3::new(0.08, 0.5, 0.0), Some(0)));
        assert_eq!(with_limb_starts(figure(), &plane, |_| false), figure());
        assert_eq!(with_limb_starts(made.clone(), &plane, |_| true), made, "nothing hangs any more");
    }
}
