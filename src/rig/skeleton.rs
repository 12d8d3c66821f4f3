//! From a rooted tree to a skeleton, and its bones. RigNet [Xu et al. 2020], Section 4.2 and the published code's leaf bones.
//!
//! | out     | shape | order                                                             |
//! |---------|-------|-------------------------------------------------------------------|
//! | joints  | `[J]` | breadth first, children in the order of the tree's joints         |
//! | bones   | `[B]` | breadth first by parent; a leaf bone right after the bone that ends in its joint |
//!
//! B = (J − 1) + leaves. A leaf bone has length zero and carries the weights of a joint without children.
//! # Departures from the published code
//! - Joints are numbered as the skeleton lists them; theirs keep the number of the clustering.
//! - A skeleton of a root alone has one leaf bone, so that its skin has something to follow; theirs has none.
//! - A joint with several children is one joint. Theirs splits it into copies, each moved aside along the diagonal, because
//!   of how its tools draw; an artist wants one joint per place.

use super::spanning_tree::Tree;
use super::{Joint, Skeleton};
use glam::DVec3;
use std::collections::VecDeque;

impl Skeleton {
    /// The skeleton of a tree over `positions` `[J, 3]`, and for each of its joints the index that it had in the tree.
    ///
    /// Joints that the root does not reach are left out; a [`Tree`] has none.
    pub fn from_tree(positions: &[DVec3], tree: &Tree) -> (Self, Vec<usize>) {
        let children = children_of(&tree.parents);
        let mut order = vec![tree.root];
        let mut joints = vec![Joint { name: joint_name(0), parent: None, position: positions[tree.root] }];
        let mut at = 0;
        while at < order.len() {
            for &child in &children[order[at]] {
                joints.push(Joint { name: joint_name(order.len()), parent: Some(at), position: positions[child] });
                order.push(child);
            }
            at += 1;
        }
        (Self { joints }, order)
    }

    /// The same skeleton in another space.
    pub fn mapped(&self, map: impl Fn(DVec3) -> DVec3) -> Self {
        let joints = self.joints.iter().map(|joint| Joint { position: map(joint.position), ..joint.clone() });
        Self { joints: joints.collect() }
    }

    /// The same without some joints and all that is below them; the others are named anew by their places.
    pub fn without(&self, gone: &[usize]) -> Self {
        if gone.is_empty() {
            return self.clone();
        }
        let mut place: Vec<Option<usize>> = Vec::with_capacity(self.joints.len());
        let mut joints: Vec<Joint> = Vec::with_capacity(self.joints.len());
        for (index, joint) in self.joints.iter().enumerate() {
            let parent = joint.parent.map(|parent| place[parent]);
            if gone.contains(&index) || parent == Some(None) {
                place.push(None);
                continue;
            }
            place.push(Some(joints.len()));
            joints.push(Joint { name: joint_name(joints.len()), parent: parent.flatten(), position: joint.position });
        }
        Self { joints }
    }

    /// Joints on the longest way from the root to a leaf; 0 without joints.
    pub fn depth(&self) -> usize {
        let mut depths: Vec<usize> = Vec::with_capacity(self.joints.len());
        for joint in &self.joints {
            depths.push(joint.parent.and_then(|parent| depths.get(parent)).map_or(1, |depth| depth + 1));
        }
        depths.into_iter().max().unwrap_or(0)
    }

    pub fn positions(&self) -> Vec<DVec3> {
        self.joints.iter().map(|joint| joint.position).collect()
    }

    /// For every joint its children, ascending.
    pub fn children(&self) -> Vec<Vec<usize>> {
        children_of(&self.joints.iter().map(|joint| joint.parent).collect::<Vec<_>>())
    }

    /// Parent → child segments and the leaf bones.
    pub fn bones(&self) -> Vec<Bone> {
        let children = self.children();
        let bone = |start: usize, end: usize| Bone {
            start: self.joints[start].position,
            end: self.joints[end].position,
            start_joint: start,
            end_joint: end,
        };
        if self.joints.len() == 1 {
            return vec![bone(0, 0)];
        }
        let mut bones = Vec::with_capacity(2 * self.joints.len());
        let mut waiting: VecDeque<usize> = (0..self.joints.len().min(1)).collect();
        while let Some(parent) = waiting.pop_front() {
            for &child in &children[parent] {
                bones.push(bone(parent, child));
                if children[child].is_empty() {
                    bones.push(bone(child, child));
                }
                waiting.push_back(child);
            }
        }
        bones
    }
}

/// `root`, then `joint_1`, `joint_2` …: ASCII, unique, the same for the same skeleton.
fn joint_name(index: usize) -> String {
    if index == 0 { "root".to_owned() } else { format!("joint_{index}") }
}

fn children_of(parents: &[Option<usize>]) -> Vec<Vec<usize>> {
    let mut children = vec![Vec::new(); parents.len()];
    for (joint, parent) in parents.iter().enumerate() {
        if let Some(parent) = *parent {
            children[parent].push(joint);
        }
    }
    children
}

/// A segment that moves with a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bone {
    pub start: DVec3,
    pub end: DVec3,
    /// The joint whose rotation moves the bone, and which its weights belong to.
    pub start_joint: usize,
    /// The same joint for a leaf bone.
    pub end_joint: usize,
}

impl Bone {
    /// Whether this is the bone of length zero of a joint without children.
    pub fn is_leaf(&self) -> bool {
        self.start_joint == self.end_joint
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A trunk 3 → 1 → {0, 4}, 4 → 2.
    fn branching() -> (Skeleton, Vec<usize>) {
        let positions: Vec<DVec3> = (0..5).map(|k| DVec3::X * f64::from(k)).collect();
        let parents = vec![Some(1), Some(3), Some(4), None, Some(1)];
        Skeleton::from_tree(&positions, &Tree { root: 3, parents, keys: vec![0.0; 5] })
    }

    #[test]
    fn parents_come_before_children_and_names_are_unique() {
        let (skeleton, order) = branching();
        assert_eq!(order, [3, 1, 0, 4, 2]);
        let names: Vec<&str> = skeleton.joints.iter().map(|joint| joint.name.as_str()).collect();
        assert_eq!(names, ["root", "joint_1", "joint_2", "joint_3", "joint_4"]);
        for (index, joint) in skeleton.joints.iter().enumerate() {
            assert_eq!(joint.parent.is_none(), index == 0);
            assert!(joint.parent.is_none_or(|parent| parent < index));
            assert_eq!(joint.position.x, order[index] as f64);
        }
    }

    #[test]
    fn bones_are_the_edges_and_one_leaf_bone_per_leaf() {
        let (skeleton, _) = branching();
        let bones: Vec<(usize, usize)> =
            skeleton.bones().iter().map(|bone| (bone.start_joint, bone.end_joint)).collect();
        assert_eq!(bones, [(0, 1), (1, 2), (2, 2), (1, 3), (3, 4), (4, 4)]);
        assert!(skeleton.bones().iter().all(|bone| !bone.is_leaf() || bone.start == bone.end));
    }

    #[test]
    fn a_lone_root_has_a_leaf_bone_and_no_joints_have_no_bones() {
        let tree = Tree { root: 0, parents: vec![None], keys: vec![0.0] };
        assert_eq!(Skeleton::from_tree(&[DVec3::ONE], &tree).0.bones().len(), 1);
        assert!(Skeleton::default().bones().is_empty());
    }
}
