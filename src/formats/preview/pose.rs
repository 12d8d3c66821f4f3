//! A pose that tells whether a rig works: an arm or a wing raised and a leg lifted with its knee bent, or, where there
//! are neither, the longest chain curled.
//!
//! All positions are in the character's own axes: x to its left, y up, z to its front.

use crate::rig::Skeleton;
use glam::{DQuat, DVec3};
use std::collections::BTreeMap;

const RAISE_DEGREES: f64 = 60.0;
const HIP_DEGREES: f64 = 55.0;
const KNEE_DEGREES: f64 = 75.0;
const CURL_DEGREES: f64 = 70.0;
/// A limb reaches at least this share of the skeleton's largest extent.
const LIMB_SHARE: f64 = 0.15;

/// A chain of joints from where it leaves the trunk to its tip.
struct Limb {
    joints: Vec<usize>,
    /// From its first joint to its last.
    reach: DVec3,
}

/// A rotation per joint, about the joint and in the axes of the character, to be applied on top of its parent's. `[J]`
pub fn telling_pose(joints: &[DVec3], skeleton: &Skeleton) -> Vec<DQuat> {
    let mut rotations = vec![DQuat::IDENTITY; joints.len()];
    let limbs = limbs(joints, skeleton);
    let sideways = |limb: &&Limb| limb.reach.x.abs() > 0.5 * limb.reach.length();
    let downwards = |limb: &&Limb| -limb.reach.y > 0.6 * limb.reach.length() && limb.joints.len() >= 3;
    let longest = |a: &&Limb, b: &&Limb| a.reach.length().total_cmp(&b.reach.length());

    let arm = limbs.iter().filter(sideways).max_by(longest);
    if let Some(first) = arm.and_then(|arm| arm.joints.first()) {
        let outwards = arm.map_or(1.0, |arm| arm.reach.x.signum());
        rotations[*first] = DQuat::from_rotation_z(outwards * RAISE_DEGREES.to_radians());
    }
    // The leg on the other side than the arm, where there is a choice, so that both are seen.
    let arm_side = arm.map_or(0.0, |arm| arm.reach.x.signum());
    let reachable = |limb: &&Limb| joints[limb.joints[0]].x * arm_side <= 1e-6;
    let legs: Vec<&Limb> = limbs.iter().filter(downwards).collect();
    let leg = legs.iter().copied().filter(|leg| reachable(leg)).max_by(|a, b| longest(a, b));
    if let Some(leg) = leg.or(legs.first().copied()) {
        rotations[leg.joints[0]] = DQuat::from_rotation_x(-HIP_DEGREES.to_radians());
        rotations[leg.joints[knee(leg, joints)]] = DQuat::from_rotation_x(KNEE_DEGREES.to_radians());
    }
    if arm.is_none() && legs.is_empty() {
        curl(&mut rotations, joints, skeleton);
    }
    rotations
}

/// All limbs: from every tip up to where another branch of a limb's length leaves the skeleton, so that fingers belong
/// to their arm and an arm does not take the spine with it. Of the tips of one limb, the farthest counts.
fn limbs(joints: &[DVec3], skeleton: &Skeleton) -> Vec<Limb> {
    let low = joints.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = joints.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    let least = LIMB_SHARE * (high - low).max_element();

    // Length of the longest path from a joint's parent through the joint to a tip; children come after parents.
    let mut branch = vec![0.0_f64; joints.len()];
    let mut below = vec![0.0_f64; joints.len()];
    let mut large_branches = vec![0_usize; joints.len()];
    for (index, joint) in skeleton.joints.iter().enumerate().rev() {
        let Some(parent) = joint.parent else { continue };
        branch[index] = below[index] + joints[index].distance(joints[parent]);
        below[parent] = below[parent].max(branch[index]);
        large_branches[parent] += usize::from(branch[index] >= least);
    }

    let mut limbs: BTreeMap<usize, Limb> = BTreeMap::new();
    for tip in (0..joints.len()).filter(|&joint| below[joint] == 0.0) {
        let mut chain = vec![tip];
        let mut first = tip;
        while let Some(parent) = skeleton.joints[first].parent {
            if skeleton.joints[parent].parent.is_none() || large_branches[parent] > 1 {
                break;
            }
            chain.push(parent);
            first = parent;
        }
        chain.reverse();
        if starts_with_a_girdle(&chain, joints) {
            chain.remove(0);
        }
        let reach = joints[tip] - joints[chain[0]];
        let farther = limbs.get(&first).is_none_or(|other| reach.length() > other.reach.length());
        if reach.length() >= least && chain.len() >= 2 && farther {
            limbs.insert(first, Limb { joints: chain, reach });
        }
    }
    limbs.into_values().collect()
}

/// Whether the chain's first bone is a collar bone or the like: much shorter than the next one.
fn starts_with_a_girdle(chain: &[usize], joints: &[DVec3]) -> bool {
    const GIRDLE_SHARE: f64 = 0.7;
    let [first, second, third, _, ..] = chain else { return false };
    joints[*first].distance(joints[*second]) < GIRDLE_SHARE * joints[*second].distance(joints[*third])
}

/// Which joint of a leg is its knee: the inner joint nearest to the middle of its length.
fn knee(leg: &Limb, joints: &[DVec3]) -> usize {
    let (start, end) = (joints[leg.joints[0]], joints[leg.joints[leg.joints.len() - 1]]);
    let middle = (start + end) / 2.0;
    let off = |inner: &usize| joints[leg.joints[*inner]].distance(middle);
    (1..leg.joints.len() - 1).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(1)
}

/// Curls the longest chain below the root about the sideways axis, the turn spread over its joints.
fn curl(rotations: &mut [DQuat], joints: &[DVec3], skeleton: &Skeleton) {
    let mut length = vec![0.0; joints.len()];
    for (index, joint) in skeleton.joints.iter().enumerate() {
        if let Some(parent) = joint.parent {
            length[index] = length[parent] + joints[index].distance(joints[parent]);
        }
    }
    let Some(tip) = (0..joints.len()).max_by(|&a, &b| length[a].total_cmp(&length[b])) else { return };
    let mut chain = Vec::new();
    let mut joint = tip;
    while let Some(parent) = skeleton.joints[joint].parent {
        chain.push(joint);
        joint = parent;
    }
    let turn = CURL_DEGREES.to_radians() / chain.len().max(1) as f64;
    for joint in chain {
        rotations[joint] = DQuat::from_rotation_x(turn);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::Joint;
    use crate::rig::forward_kinematics::joint_transforms;

    fn skeleton(joints: &[(Option<usize>, [f64; 3])]) -> (Vec<DVec3>, Skeleton) {
        let joint = |(index, &(parent, position)): (usize, &(Option<usize>, [f64; 3]))| Joint {
            name: format!("joint_{index}"),
            parent,
            position: DVec3::from_array(position),
        };
        let joints: Vec<Joint> = joints.iter().enumerate().map(joint).collect();
        (joints.iter().map(|joint| joint.position).collect(), Skeleton { joints })
    }

    /// Where the pose takes the joints.
    fn posed_joints(joints: &[DVec3], skeleton: Skeleton) -> Vec<DVec3> {
        let rotations = telling_pose(joints, &skeleton);
        joint_transforms(&skeleton, &rotations).iter().map(|transform| transform.translation).collect()
    }

    #[test]
    fn a_biped_raises_an_arm_and_lifts_a_knee() {
        let (joints, skeleton) = skeleton(&[
            (None, [0.0, 0.5, 0.0]),
            (Some(0), [0.0, 0.8, 0.0]),
            (Some(1), [0.0, 1.0, 0.0]),
            (Some(1), [0.1, 0.8, 0.0]),
            (Some(3), [0.3, 0.8, 0.0]),
            (Some(4), [0.5, 0.8, 0.0]),
            (Some(1), [-0.1, 0.8, 0.0]),
            (Some(6), [-0.3, 0.8, 0.0]),
            (Some(7), [-0.5, 0.8, 0.0]),
            (Some(0), [0.1, 0.5, 0.0]),
            (Some(9), [0.1, 0.25, 0.0]),
            (Some(10), [0.1, 0.0, 0.0]),
            (Some(0), [-0.1, 0.5, 0.0]),
            (Some(12), [-0.1, 0.25, 0.0]),
            (Some(13), [-0.1, 0.0, 0.0]),
        ]);
        let posed = posed_joints(&joints, skeleton);
        let raised = [5, 8].iter().filter(|&&hand| posed[hand].y > joints[hand].y + 0.2).count();
        let lifted = [10, 13].iter().filter(|&&knee| posed[knee].z > joints[knee].z + 0.1).count();
        assert_eq!((raised, lifted), (1, 1), "{posed:?}");
        assert_eq!(posed[2], joints[2], "the head stays");
    }

    #[test]
    fn a_snake_curls_and_keeps_its_root() {
        let (joints, skeleton) = skeleton(&[
            (None, [0.0, 0.1, -0.5]),
            (Some(0), [0.0, 0.1, 0.0]),
            (Some(1), [0.0, 0.1, 0.4]),
            (Some(2), [0.0, 0.1, 0.8]),
        ]);
        let posed = posed_joints(&joints, skeleton);
        assert_eq!(posed[..2], joints[..2]);
        assert!(posed[3].distance(joints[3]) > 0.1, "{posed:?}");
    }
}
