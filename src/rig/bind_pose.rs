//! The pose that weights are made for: joints at their places, unturned, scale one.
//!
//! Space: that of the skeleton. Joints are oriented as the model space is, so that the rest pose is the bind pose and local
//! transforms are translations.

use super::Skeleton;
use glam::{DMat4, DVec3};

/// Model space → joint space, one per joint `[J]`: the inverse of the joint's place in the bind pose.
pub fn inverse_bind_matrices(skeleton: &Skeleton) -> Vec<DMat4> {
    skeleton.joints.iter().map(|joint| DMat4::from_translation(-joint.position)).collect()
}

/// Each joint's place relative to its parent `[J]`; the root's in model space.
pub fn local_translations(skeleton: &Skeleton) -> Vec<DVec3> {
    let offset = |joint: &super::Joint| joint.parent.map_or(DVec3::ZERO, |parent| skeleton.joints[parent].position);
    skeleton.joints.iter().map(|joint| joint.position - offset(joint)).collect()
}
