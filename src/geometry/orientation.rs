//! Which way is up and which way a character faces, for formats that do not say.

use crate::mesh::Mesh;
use glam::{DMat3, DVec3};

/// Signed unit axes of upload space, and how far they can be trusted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orientation {
    /// One of ±x, ±y, ±z.
    pub up: DVec3,
    /// One of ±x, ±y, ±z, at a right angle to `up`.
    pub front: DVec3,
    /// 0 (a guess; +y and +z are kept) to 1.
    pub confidence: f64,
}

impl Orientation {
    /// What is assumed when nothing speaks for anything else, and what glTF prescribes.
    pub const DEFAULT: Self = Self { up: DVec3::Y, front: DVec3::Z, confidence: 0.0 };

    /// The rotation that takes `up` to +y and `front` to +z.
    pub fn rotation(&self) -> DMat3 {
        rotation_to_frame(self.up, self.front)
    }
}

/// A front that goes with `up` where none is known: +z, or as Blender has it, −y where z is up.
pub fn any_front(up: DVec3) -> DVec3 {
    if up.z.abs() > 0.5 { DVec3::NEG_Y * up.z.signum() } else { DVec3::Z }
}

/// The rotation that takes `up` to +y and `front` to +z (both unit length, at a right angle).
pub fn rotation_to_frame(up: DVec3, front: DVec3) -> DMat3 {
    DMat3::from_cols(up.cross(front), up, front).transpose()
}

/// Guesses the axes of `mesh` (upload space).
pub fn guess_orientation(_mesh: &Mesh) -> Orientation {
    Orientation::DEFAULT
}
