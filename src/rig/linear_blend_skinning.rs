//! Vertices that follow their joints: linear blend skinning [Magnenat-Thalmann et al. 1988].
//!
//! | in          | shape    | meaning                                    |
//! |-------------|----------|--------------------------------------------|
//! | `positions` | `[V, 3]` | bind pose, the skeleton's space            |
//! | `skin`      | `[V, ≤N]`| weights                                    |
//! | `rotations` | `[J]`    | joint-local                                |

use super::bind_pose::inverse_bind_matrices;
use super::forward_kinematics::joint_transforms;
use super::{Skeleton, SkinWeights};
use glam::{DAffine3, DQuat, DVec3};

/// Posed positions `[V, 3]`: `v' = Σ_j w_j G_j B_j⁻¹ v`, with G the joint's transform and B⁻¹ its inverse bind matrix.
pub fn posed_positions(
    positions: &[DVec3],
    skeleton: &Skeleton,
    skin: &SkinWeights,
    rotations: &[DQuat],
) -> Vec<DVec3> {
    let inverse_bind = inverse_bind_matrices(skeleton);
    let motions: Vec<DAffine3> = joint_transforms(skeleton, rotations)
        .into_iter()
        .zip(inverse_bind)
        .map(|(posed, bind)| posed * DAffine3::from_mat4(bind))
        .collect();
    let moved = positions.iter().zip(&skin.rows).map(|(&position, row)| {
        row.iter().map(|part| f64::from(part.weight) * motions[part.joint as usize].transform_point3(position)).sum()
    });
    moved.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::{Influence, Joint};
    use std::f64::consts::FRAC_PI_2;

    /// Root at (1, 0, 0), elbow at (1, 1, 0), hand at (1, 2, 0).
    fn arm() -> Skeleton {
        let joint = |index: usize| Joint {
            name: format!("joint_{index}"),
            parent: index.checked_sub(1),
            position: DVec3::new(1.0, index as f64, 0.0),
        };
        Skeleton { joints: (0..3).map(joint).collect() }
    }

    fn skin(rows: &[&[(u32, f32)]]) -> SkinWeights {
        let row = |row: &&[(u32, f32)]| row.iter().map(|&(joint, weight)| Influence { joint, weight }).collect();
        SkinWeights { rows: rows.iter().map(row).collect() }
    }

    #[test]
    fn the_bind_pose_moves_nothing() {
        let positions = [DVec3::new(0.3, 0.2, 0.1), DVec3::new(5.0, 1.5, 2.0)];
        let skin = skin(&[&[(0, 0.75), (2, 0.25)], &[(1, 1.0)]]);
        let posed = posed_positions(&positions, &arm(), &skin, &[DQuat::IDENTITY; 3]);
        assert!(posed.iter().zip(&positions).all(|(a, b)| a.distance(*b) < 1e-12));
    }

    #[test]
    fn a_bent_elbow_carries_the_hand_and_leaves_the_upper_arm() {
        let bent = [DQuat::IDENTITY, DQuat::from_rotation_z(-FRAC_PI_2), DQuat::IDENTITY];
        let positions = [DVec3::new(1.0, 0.5, 0.0), DVec3::new(1.0, 2.0, 0.0), DVec3::new(1.0, 2.0, 0.0)];
        let skin = skin(&[&[(0, 1.0)], &[(2, 1.0)], &[(1, 0.5), (0, 0.5)]]);
        let posed = posed_positions(&positions, &arm(), &skin, &bent);
        let expected = [positions[0], DVec3::new(2.0, 1.0, 0.0), DVec3::new(1.5, 1.5, 0.0)];
        assert!(posed.iter().zip(expected).all(|(a, b)| a.distance(b) < 1e-12), "{posed:?}");
    }
}
