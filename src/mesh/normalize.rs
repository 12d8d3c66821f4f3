//! Upload space to the normalised frame and back. RigNet [Xu et al. 2020], Section 3, "input".
//!
//! The normalised frame: y up, facing +z, longest side of the bounding box 1, x and z centred on the box, least y 0.
//!
//! | in          | shape    | unit                                          |
//! |-------------|----------|-----------------------------------------------|
//! | `positions` | `[V, 3]` | upload space                                  |
//! | `rotation`  | 3×3      | orthonormal: upload axes to the frame's axes  |
//!
//! # Departures from the paper
//! - The paper takes uploads to be upright and facing ±z; here a rotation, given or guessed, comes first.

use super::bounding_box;
use glam::{DMat3, DVec3};

/// `normalised = (rotation · upload − pivot) · scale`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Normalization {
    /// Upload axes to the axes of the normalised frame; orthonormal.
    pub rotation: DMat3,
    /// 1 / longest side of the rotated bounding box.
    pub scale: f64,
    /// Rotated space: middle x, least y, middle z of the bounding box.
    pub pivot: DVec3,
}

impl Normalization {
    /// `None` when the positions span no length (or one beyond floating point): there is nothing to rig.
    pub fn new(positions: &[DVec3], rotation: DMat3) -> Option<Self> {
        let rotated: Vec<DVec3> = positions.iter().map(|&position| rotation * position).collect();
        let (low, high) = bounding_box(&rotated)?;
        let scale = (high - low).max_element().recip();
        let middle = low * 0.5 + high * 0.5;
        let usable = scale.is_finite() && scale > 0.0 && middle.is_finite();
        usable.then_some(Self { rotation, scale, pivot: DVec3::new(middle.x, low.y, middle.z) })
    }

    /// Upload space to the normalised frame.
    pub fn apply(&self, upload: DVec3) -> DVec3 {
        (self.rotation * upload - self.pivot) * self.scale
    }

    /// The normalised frame to upload space.
    pub fn invert(&self, normalised: DVec3) -> DVec3 {
        self.rotation.transpose() * (normalised / self.scale + self.pivot)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = DVec3> {
        (-1e3..1e3f64, -1e3..1e3f64, -1e3..1e3f64).prop_map(DVec3::from)
    }

    proptest! {
        #[test]
        fn the_normalised_box_is_centred_grounded_and_one_long(
            points in prop::collection::vec(point(), 2..20), angle in 0.0..6.0f64,
        ) {
            let Some(frame) = Normalization::new(&points, DMat3::from_rotation_x(angle)) else { return Ok(()) };
            let moved: Vec<DVec3> = points.iter().map(|&p| frame.apply(p)).collect();
            let (low, high) = bounding_box(&moved).unwrap();
            prop_assert!(((high - low).max_element() - 1.0).abs() < 1e-9);
            prop_assert!((low.x + high.x).abs() < 1e-9 && (low.z + high.z).abs() < 1e-9 && low.y.abs() < 1e-9);
            for (&before, &after) in points.iter().zip(&moved) {
                prop_assert!((frame.invert(after) - before).length() < 1e-8);
            }
        }
    }

    #[test]
    fn nothing_one_place_and_unbounded_extents_have_no_frame() {
        assert_eq!(Normalization::new(&[], DMat3::IDENTITY), None);
        assert_eq!(Normalization::new(&[DVec3::ONE; 4], DMat3::IDENTITY), None);
        assert_eq!(Normalization::new(&[DVec3::splat(-1e308), DVec3::splat(1e308)], DMat3::IDENTITY), None);
    }
}
