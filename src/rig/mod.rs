//! Skeletons and skin weights, and the steps from displaced points to a rig.
//!
//! | step                                  | file                                                              |
//! |---------------------------------------|-------------------------------------------------------------------|
//! | displaced points → joints             | [`detect_joints`], made of [`joint_clustering`], [`non_maximum_suppression`], [`symmetrize`]; [`joined_ends`] |
//! | joints → tree → skeleton, bones       | [`spanning_tree`], [`skeleton`], [`deforming`]                    |
//! | skeleton → one to animate             | [`hands`], [`finger_bones`] by [`hand_shape`], [`limb_starts`]                                        |
//! | boxes → skeleton, weights             | [`box_skeleton`], for characters made of them                     |
//! | bone distances → what the networks read | [`bone_features`], [`heter_graph`]                             |
//! | logits or distances → weights         | [`bone_weights`], [`distance_falloff`], [`heat_weights`], [`skin_weights`], [`mirror_weights`], [`locked_weights`] |
//! | rig → posed mesh, figures             | [`bind_pose`], [`forward_kinematics`], [`linear_blend_skinning`], [`quality`], [`verdict`] |

pub mod bind_pose;
mod bleed;
pub mod bone_features;
pub mod bone_weights;
pub mod box_skeleton;
mod cell_grid;
pub mod deforming;
pub mod detect_joints;
pub mod distance_falloff;
pub mod finger_bones;
pub mod forward_kinematics;
pub mod hand_shape;
pub mod hands;
pub mod heat_weights;
pub mod heter_graph;
pub mod joined_ends;
pub mod joint_clustering;
mod joint_levels;
pub mod limb_starts;
pub mod linear_blend_skinning;
pub mod locked_weights;
pub mod mirror_weights;
mod modes;
pub mod non_maximum_suppression;
pub mod quality;
mod range_of_motion;
pub mod skeleton;
pub mod skin_weights;
pub mod spanning_tree;
pub mod symmetrize;
pub mod verdict;

use glam::DVec3;

/// A joint of a skeleton: a point with a parent.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Unique within the skeleton, ASCII letters, digits and `_`.
    pub name: String,
    /// Index of the parent, below the joint's own index; `None` for the root alone.
    pub parent: Option<usize>,
    pub position: DVec3,
}

/// A joint tree in one space. Joint 0 is the root; parents precede children.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Skeleton {
    pub joints: Vec<Joint>,
}

/// Skin weights in rows of influences, one row per vertex `[V, ≤ N]`.
///
/// Within a row: each joint at most once, weights above zero, descending (ties by ascending joint), sum 1 within
/// rounding. No row is empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SkinWeights {
    pub rows: Vec<Vec<Influence>>,
}

/// The share of one joint in the motion of one vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Influence {
    pub joint: u32,
    pub weight: f32,
}

/// A skeleton and the skin weights of a mesh's vertices, both in the mesh's space.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rig {
    pub skeleton: Skeleton,
    pub skin: SkinWeights,
}
