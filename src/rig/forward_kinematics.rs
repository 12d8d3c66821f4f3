//! Where joints are when they are turned: each joint's transform is its parent's, moved along and turned.
//!
//! | in          | shape | meaning                                                            |
//! |-------------|-------|--------------------------------------------------------------------|
//! | `rotations` | `[J]` | joint-local, unit quaternions; the identity everywhere is the bind pose |

use super::Skeleton;
use super::bind_pose::local_translations;
use glam::{DAffine3, DQuat};

/// Joint space → model space, one per joint `[J]`: `G_j = G_parent · T(offset_j) · R_j`.
///
/// Joints beyond the end of `rotations` are not turned.
pub fn joint_transforms(skeleton: &Skeleton, rotations: &[DQuat]) -> Vec<DAffine3> {
    let mut transforms: Vec<DAffine3> = Vec::with_capacity(skeleton.joints.len());
    for (index, offset) in local_translations(skeleton).into_iter().enumerate() {
        let rotation = rotations.get(index).copied().unwrap_or(DQuat::IDENTITY);
        let local = DAffine3::from_rotation_translation(rotation, offset);
        transforms.push(skeleton.joints[index].parent.map_or(local, |parent| transforms[parent] * local));
    }
    transforms
}
