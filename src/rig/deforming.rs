//! A skeleton without the joints that must not move vertices: targets of inverse kinematics, handles, attachment points.
//!
//! | in         | shape | meaning                                    |
//! |------------|-------|--------------------------------------------|
//! | `skeleton` | `[J]` | any tree of joints                         |
//! | `deforms`  | `[J]` | whether the joint may have weights         |
//!
//! What remains hangs from the nearest joint above that remains, so a bone passes over a helper in its middle, and a helper at its
//! end draws it nowhere. Where that leaves several trees, the nearest joint above them all stays to hold them, without bones.

use super::skeleton::Bone;
use super::{Influence, Joint, Skeleton, SkinWeights};

/// The joints that take part, as a skeleton of their own.
#[derive(Clone, Debug, PartialEq)]
pub struct Deforming {
    pub skeleton: Skeleton,
    /// `[K]`: index in the whole skeleton of each joint here, ascending.
    joint_of: Vec<u32>,
    /// False where joint 0 only holds the others.
    root_deforms: bool,
}

impl Deforming {
    /// All joints of `skeleton`.
    pub fn all(skeleton: &Skeleton) -> Self {
        let joint_of = (0..skeleton.joints.len() as u32).collect();
        Self { skeleton: skeleton.clone(), joint_of, root_deforms: true }
    }

    /// The joints that `deforms` marks; all where it marks none, since something must move the mesh.
    pub fn new(skeleton: &Skeleton, deforms: &[bool]) -> Self {
        let joints = &skeleton.joints;
        let is_in = |joint: usize| deforms.get(joint).copied().unwrap_or(false);
        let above = |joint: usize| std::iter::successors(joints[joint].parent, |&joint| joints[joint].parent);
        let mut kept: Vec<usize> = (0..joints.len()).filter(|&joint| is_in(joint)).collect();
        let roots: Vec<usize> = kept.iter().copied().filter(|&joint| !above(joint).any(is_in)).collect();
        let [first, others @ ..] = roots.as_slice() else { return Self::all(skeleton) };
        let mut root_deforms = true;
        if !others.is_empty() {
            let is_above_all = |joint: usize| others.iter().all(|&other| above(other).any(|above| above == joint));
            // Joint 0 is above all, so there is one.
            kept.insert(0, above(*first).find(|&joint| is_above_all(joint)).unwrap_or(0));
            root_deforms = false;
        }
        let mut index_of = vec![None; joints.len()];
        for (index, &joint) in kept.iter().enumerate() {
            index_of[joint] = Some(index);
        }
        let joint =
            |&joint: &usize| Joint { parent: above(joint).find_map(|joint| index_of[joint]), ..joints[joint].clone() };
        Self {
            skeleton: Skeleton { joints: kept.iter().map(joint).collect() },
            joint_of: kept.iter().map(|&joint| joint as u32).collect(),
            root_deforms,
        }
    }

    /// The bones that weights may go to, see [`Skeleton::bones`].
    pub fn bones(&self) -> Vec<Bone> {
        let mut bones = self.skeleton.bones();
        bones.retain(|bone| self.root_deforms || bone.start_joint > 0);
        bones
    }

    /// Weights over these joints as weights over the joints of the whole skeleton.
    pub fn in_whole(&self, mut skin: SkinWeights) -> SkinWeights {
        let name = |influence: &mut Influence| influence.joint = self.joint_of[influence.joint as usize];
        skin.rows.iter_mut().flatten().for_each(name);
        skin
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn skeleton(parents: &[Option<usize>]) -> Skeleton {
        let joint = |(index, &parent): (usize, &Option<usize>)| Joint {
            name: format!("j{index}"),
            parent,
            position: DVec3::Y * index as f64,
        };
        Skeleton { joints: parents.iter().enumerate().map(joint).collect() }
    }

    fn named(deforming: &Deforming) -> Vec<(&str, Option<usize>)> {
        deforming.skeleton.joints.iter().map(|joint| (joint.name.as_str(), joint.parent)).collect()
    }

    #[test]
    fn helpers_in_the_middle_are_passed_over_and_those_at_the_end_go() {
        let arm = skeleton(&[None, Some(0), Some(1), Some(2)]);
        let deforming = Deforming::new(&arm, &[true, false, true, false]);
        assert_eq!(named(&deforming), [("j0", None), ("j2", Some(0))]);
        let bones: Vec<_> = deforming.bones().iter().map(|bone| (bone.start_joint, bone.end_joint)).collect();
        assert_eq!(bones, [(0, 1), (1, 1)]);
        let skin = SkinWeights { rows: vec![vec![Influence { joint: 1, weight: 1.0 }]] };
        assert_eq!(deforming.in_whole(skin).rows[0][0].joint, 2);
    }

    #[test]
    fn trees_without_a_root_hang_from_the_joint_above_them_which_has_no_bone() {
        let pair = skeleton(&[None, Some(0), Some(1), Some(1), Some(3)]);
        let deforming = Deforming::new(&pair, &[false, false, true, true, true]);
        assert_eq!(named(&deforming), [("j1", None), ("j2", Some(0)), ("j3", Some(0)), ("j4", Some(2))]);
        assert!(deforming.bones().iter().all(|bone| bone.start_joint > 0));
        assert_eq!(deforming.bones().len(), 3);
    }

    #[test]
    fn all_marked_is_the_skeleton_itself_and_so_is_none() {
        let chain = skeleton(&[None, Some(0)]);
        for deforms in [[true; 2], [false; 2]] {
            assert_eq!(Deforming::new(&chain, &deforms), Deforming::all(&chain));
        }
    }
}
