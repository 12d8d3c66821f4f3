//! The rig that a file came with, where it is wanted: to keep its skeleton, or some of its weights.

use super::rig_json::{self, ReadJoint, RigFileError};
use crate::rig::{Influence, Skeleton};
use glam::DVec3;

/// A skeleton and the weights of the file's vertices.
#[derive(Clone, Debug, PartialEq)]
pub struct OldRig {
    /// In upload space, where the file's rest pose has it.
    pub skeleton: Skeleton,
    /// `[J]`: false for a joint that the file's skin does not name: it only holds the others together.
    pub deforms: Vec<bool>,
    /// `[V]`: per vertex weights over the joints, descending, of sum 1; an empty row where the file has none.
    pub rows: Vec<Vec<Influence>>,
}

/// One node of a file's graph, parents before children.
pub(super) struct GraphNode<'a> {
    pub(super) name: &'a str,
    /// Index in the same list.
    pub(super) parent: Option<usize>,
    /// In upload space.
    pub(super) position: DVec3,
    pub(super) is_joint: bool,
}

/// The joints of a graph as one skeleton, and the node of each joint.
///
/// A joint hangs from the nearest joint above it. Where that leaves several trees, the nearest node that is above all of them is
/// the root.
pub(super) fn skeleton_of(nodes: &[GraphNode]) -> Result<(Skeleton, Vec<usize>), RigFileError> {
    let above = |node: usize| std::iter::successors(nodes[node].parent, |&node| nodes[node].parent);
    let mut joints: Vec<usize> = (0..nodes.len()).filter(|&node| nodes[node].is_joint).collect();
    let roots: Vec<usize> =
        joints.iter().copied().filter(|&node| !above(node).any(|node| nodes[node].is_joint)).collect();
    if let [first, others @ ..] = roots.as_slice()
        && !others.is_empty()
    {
        // How many of the roots are below each node. Children come after their parents.
        let mut below = vec![0; nodes.len()];
        roots.iter().for_each(|&root| below[root] = 1);
        for node in (0..nodes.len()).rev() {
            if let Some(parent) = nodes[node].parent {
                below[parent] += below[node];
            }
        }
        match above(*first).find(|&node| below[node] == roots.len()) {
            Some(common) => joints.insert(0, common),
            None => {
                let top = |node: usize| above(node).last().unwrap_or(node);
                let apart = others.iter().copied().find(|&other| top(other) != top(*first)).unwrap_or(others[0]);
                let name = |node: usize| nodes[node].name.to_owned();
                return Err(RigFileError::Apart { first: name(*first), second: name(apart) });
            }
        }
    }
    let mut index_of = vec![None; nodes.len()];
    for (index, &node) in joints.iter().enumerate() {
        index_of[node] = Some(index);
    }
    let joint = |&node: &usize| {
        let name = nodes[node].name;
        ReadJoint {
            name: if name.is_empty() { format!("node_{node}") } else { name.to_owned() },
            parent: above(node).find_map(|node| index_of[node]),
            position: nodes[node].position.to_array(),
        }
    };
    Ok((rig_json::skeleton(joints.iter().map(joint).collect())?, joints))
}

/// A row as [`OldRig`] promises it; joints may repeat. Empty without a weight above zero.
pub(super) fn row_of(mut influences: Vec<Influence>) -> Vec<Influence> {
    influences.retain(|influence| influence.weight > 0.0 && influence.weight.is_finite());
    influences.sort_by_key(|influence| influence.joint);
    influences.dedup_by(|next, kept| {
        let same = next.joint == kept.joint;
        if same {
            kept.weight += next.weight;
        }
        same
    });
    let sum: f32 = influences.iter().map(|influence| influence.weight).sum();
    influences.iter_mut().for_each(|influence| influence.weight /= sum);
    influences.sort_by(|a, b| b.weight.total_cmp(&a.weight).then(a.joint.cmp(&b.joint)));
    influences
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(name: &str, parent: Option<usize>, is_joint: bool) -> GraphNode<'_> {
        GraphNode { name, parent, position: DVec3::ZERO, is_joint }
    }

    fn parents(skeleton: &Skeleton) -> Vec<(&str, Option<usize>)> {
        skeleton.joints.iter().map(|joint| (joint.name.as_str(), joint.parent)).collect()
    }

    #[test]
    fn a_joint_hangs_from_the_nearest_joint_above() {
        let nodes = [
            node("scene", None, false),
            node("hips", Some(0), true),
            node("offset", Some(1), false),
            node("", Some(2), true),
        ];
        let (skeleton, of) = skeleton_of(&nodes).expect("a skeleton");
        assert_eq!(parents(&skeleton), [("hips", None), ("node_3", Some(0))]);
        assert_eq!(of, [1, 3]);
    }

    #[test]
    fn trees_hang_from_what_is_above_them_all_and_without_that_are_refused_by_name() {
        let mut nodes = vec![
            node("scene", None, false),
            node("armature", Some(0), false),
            node("body", Some(1), true),
            node("props", Some(1), false),
            node("sword", Some(3), true),
        ];
        let (skeleton, of) = skeleton_of(&nodes).expect("a skeleton");
        assert_eq!(parents(&skeleton), [("armature", None), ("body", Some(0)), ("sword", Some(0))]);
        assert_eq!(of, [1, 2, 4]);
        nodes.push(node("other", None, true));
        let error = skeleton_of(&nodes).expect_err("refused");
        assert!(error.to_string().contains("\"body\"") && error.to_string().contains("\"other\""), "{error}");
        assert_eq!(skeleton_of(&nodes[..1]), Err(RigFileError::NoJoints));
    }

    #[test]
    fn rows_are_sorted_and_of_sum_one() {
        let of = |joint, weight| Influence { joint, weight };
        let row = row_of(vec![of(3, 0.5), of(1, 0.0), of(2, 1.0), of(3, 0.5), of(4, f32::NAN)]);
        assert_eq!(row, [of(2, 0.5), of(3, 0.5)]);
        assert!(row_of(vec![of(1, 0.0)]).is_empty());
    }
}
