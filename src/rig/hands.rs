//! Hands of a predicted skeleton, and whether their fingers are worth keeping.
//!
//! | in         | space      | meaning                              |
//! |------------|------------|--------------------------------------|
//! | `skeleton` | normalised | y up                                 |
//! | `from_middle` |         | signed distance from the mirror plane |
//!
//! A hand is a joint away from the middle, with another such joint before it (the elbow), whose following joints are all nearer
//! together than it is to the elbow, on its side, and above the feet. The rule is ours. The networks find few fingers (recall on
//! validation rigs about a tenth): two ends in a hand are no fingers but a nuisance to whoever animates it. What has the shape of a
//! hand gets its fingers by that shape ([`super::finger_bones`]).

use super::Skeleton;
use glam::DVec3;

/// Joints nearer to the middle than this belong to the trunk, in longest sides.
pub(super) const MIDDLE: f64 = 0.03;
/// Hands are above this height: lower ends are feet.
pub(super) const FEET_HEIGHT: f64 = 0.1;
/// The forearm is longer than any bone of the hand by this factor,
const FOREARM_MIN: f64 = 1.3;
/// and the hand reaches no farther than this many forearms.
const REACH_MAX: f64 = 1.2;
/// One end is the hand itself, three or more are fingers; so many are neither.
const STRAY_ENDS: usize = 2;

/// Which fingers there are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fingers {
    /// Those of hands whose shape has fingers, put by that shape; of other hands those that the networks find, but for two ends.
    #[default]
    Auto,
    /// The same, but less has to speak for a hand, and two ends stay.
    On,
    /// None.
    Off,
}

/// A wrist and what follows it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hand {
    pub wrist: usize,
    /// Joints below the wrist, ascending.
    pub joints: Vec<usize>,
    /// How many of them have no child.
    pub fingers: usize,
}

/// The hands of `skeleton`, by ascending wrist.
pub fn hands(skeleton: &Skeleton, from_middle: impl Fn(DVec3) -> f64) -> Vec<Hand> {
    let children = skeleton.children();
    let mut hands: Vec<Hand> = Vec::new();
    for wrist in 0..skeleton.joints.len() {
        let inside_another = hands.iter().any(|hand| hand.joints.contains(&wrist));
        let joints = below(wrist, &children);
        if !inside_another && is_hand(skeleton, wrist, &joints, &from_middle) {
            let fingers = joints.iter().filter(|&&joint| children[joint].is_empty()).count();
            hands.push(Hand { wrist, joints, fingers });
        }
    }
    hands
}

/// The skeleton without the fingers that are not wanted, and how many fingers it has left.
pub fn with_fingers(skeleton: Skeleton, fingers: Fingers, from_middle: impl Fn(DVec3) -> f64) -> (Skeleton, usize) {
    let is_kept = |hand: &Hand| match fingers {
        Fingers::Auto => hand.fingers != STRAY_ENDS,
        Fingers::On => true,
        Fingers::Off => false,
    };
    let (kept, folded): (Vec<Hand>, Vec<Hand>) = hands(&skeleton, from_middle).into_iter().partition(is_kept);
    let gone: Vec<usize> = folded.into_iter().flat_map(|hand| hand.joints).collect();
    (skeleton.without(&gone), kept.iter().map(|hand| hand.fingers).sum())
}

fn is_hand(skeleton: &Skeleton, wrist: usize, joints: &[usize], from_middle: impl Fn(DVec3) -> f64) -> bool {
    let at = |joint: usize| skeleton.joints[joint].position;
    let Some(elbow) = skeleton.joints[wrist].parent.filter(|_| !joints.is_empty()) else { return false };
    let side = |position: DVec3| (from_middle(position).abs() > MIDDLE).then_some(from_middle(position) > 0.0);
    let forearm = at(wrist).distance(at(elbow));
    let bone = |joint: usize| skeleton.joints[joint].parent.map_or(0.0, |parent| at(joint).distance(at(parent)));
    let belongs = |&joint: &usize| {
        FOREARM_MIN * bone(joint) < forearm
            && at(joint).distance(at(wrist)) < REACH_MAX * forearm
            && at(joint).y > FEET_HEIGHT
            && (from_middle(at(joint)) > 0.0) == (from_middle(at(wrist)) > 0.0)
    };
    side(at(wrist)).is_some()
        && side(at(elbow)) == side(at(wrist))
        && at(wrist).y > FEET_HEIGHT
        && joints.iter().all(belongs)
        && skeleton.joints[elbow].parent.is_some()
}

/// All joints below `joint`, ascending: parents precede children.
pub(super) fn below(joint: usize, children: &[Vec<usize>]) -> Vec<usize> {
    let mut found = children[joint].clone();
    let mut next = 0;
    while let Some(&at) = found.get(next) {
        found.extend(&children[at]);
        next += 1;
    }
    found.sort_unstable();
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::Joint;

    /// Trunk, then per side shoulder, elbow, wrist, `fingers` fingers; and legs with toes.
    fn figure(fingers: usize) -> Skeleton {
        let mut joints: Vec<Joint> = Vec::new();
        let mut add = |parent: Option<usize>, x: f64, y: f64, z: f64| {
            let name = format!("joint_{}", joints.len());
            joints.push(Joint { name, parent, position: DVec3::new(x, y, z) });
            joints.len() - 1
        };
        let pelvis = add(None, 0.0, 0.5, 0.0);
        let chest = add(Some(pelvis), 0.0, 0.8, 0.0);
        for side in [1.0, -1.0] {
            let shoulder = add(Some(chest), side * 0.1, 0.8, 0.0);
            let elbow = add(Some(shoulder), side * 0.25, 0.8, 0.0);
            let wrist = add(Some(elbow), side * 0.4, 0.8, 0.0);
            for finger in 0..fingers {
                add(Some(wrist), side * 0.45, 0.8, 0.02 * finger as f64);
            }
            let knee = add(Some(pelvis), side * 0.08, 0.3, 0.0);
            let ankle = add(Some(knee), side * 0.08, 0.05, 0.0);
            add(Some(ankle), side * 0.08, 0.0, 0.08);
        }
        Skeleton { joints }
    }

    #[test]
    fn hands_are_found_and_feet_are_none() {
        let found = hands(&figure(5), |point| point.x);
        assert_eq!(found.iter().map(|hand| (hand.joints.len(), hand.fingers)).collect::<Vec<_>>(), [(5, 5), (5, 5)]);
        assert_eq!(hands(&figure(0), |point| point.x), []);
    }

    #[test]
    fn two_ends_are_folded_into_the_wrist_and_a_whole_hand_stays() {
        for (given, wanted, left) in [
            (1, Fingers::Auto, 2),
            (2, Fingers::Auto, 0),
            (5, Fingers::Auto, 10),
            (2, Fingers::On, 4),
            (5, Fingers::Off, 0),
            (0, Fingers::On, 0),
        ] {
            let (skeleton, fingers) = with_fingers(figure(given), wanted, |point| point.x);
            assert_eq!(fingers, left);
            assert_eq!(skeleton.joints.len(), figure(0).joints.len() + left);
            let parents_come_first =
                skeleton.joints.iter().enumerate().all(|(at, joint)| joint.parent.is_none_or(|parent| parent < at));
            assert!(parents_come_first && skeleton.joints[1].name == "joint_1");
        }
    }
}
