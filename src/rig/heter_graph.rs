//! The heterogeneous graph of a mesh and a skeleton: what HeterSkinNet reads. Xiaoyu Pan et al.: *HeterSkinNet: A
//! Heterogeneous Network for Skin Weights Prediction*, I3D 2021, Sections 3.1 and 3.2.
//!
//! | in          | shape    | meaning                                                       |
//! |-------------|----------|---------------------------------------------------------------|
//! | `vertices`  | `[V, 3]` | normalised frame                                              |
//! | `skeleton`  | `[J]`    | the same frame                                                |
//! | `bones`     | `[B]`    | of the skeleton, leaf bones drawn out to where the body ends  |
//! | `distances` | `[V, B]` | HollowDist, distance through voxels, straight distance        |
//! | `heat`      | `[V, B]` | bone heat, rows of sum 1                                      |
//!
//! Out, for K = [`LINKS`] links per vertex: see [`HeterGraph`]. A link joins a vertex and a *joint*; of the bones that leave a
//! joint the nearest stands for it, because weights belong to joints. Links are chosen in turn by heat and by HollowDist.
//! # Departures from the paper
//! - Links to joints, not to bones: several bones of one hip cannot crowd out the others.
//! - A link carries two further distances, the heat, and where the vertex is along the bone, not HollowDist alone.
//! - Every joint looks at up to [`SIGHT`] of the vertices that its heat reaches, chosen by a hash: memory is bounded, and a change
//!   elsewhere on the skeleton leaves the choice as it is.

use super::Skeleton;
use super::bone_weights::{BoneWeights, masked_softmax};
use super::distance_falloff::nearest_of_joints;
use super::skeleton::Bone;
use crate::geometry::hollow_distance::HollowDistance;
use glam::DVec3;

/// K: joints that compete for a vertex.
pub const LINKS: usize = 8;
/// Numbers per link.
pub const LINK_CHANNELS: usize = 13;
/// Which of them is the heat.
const HEAT: usize = 3;
/// Numbers per joint.
pub const JOINT_CHANNELS: usize = 8;
/// Links that a joint looks at: how many, and from which heat on.
pub const SIGHT: usize = 32;
const SEEN_FROM: f32 = 0.05;
/// Of vertices [Knuth, The Art of Computer Programming, 6.4]: neighbours in the file are far apart in the order of their hashes.
const HASH_FACTOR: u32 = 2_654_435_761;
/// How far what the network says runs along the surface, of the strength of the option `smooth`: it answers vertex by vertex, and an artist
/// paints. 30 organic validation characters, whole meshes: L1 .460, precision .804, recall .766 without.
pub const LINK_SPREAD: f64 = 0.2;
/// Weights below this share of a row's greatest are dropped.
pub const LINK_PRUNE_SHARE: f32 = 0.067;
/// Stands for a distance that is infinite or absurd: two sides of the frame.
const FAR: f32 = 2.0;

/// Distances from vertices to bones.
pub struct BoneDistances<'a> {
    /// HollowDist and the straight distance, made row by row.
    pub hollow: &'a HollowDistance<'a>,
    /// Distance through voxels. `[V, B]`
    pub voxel: &'a [f32],
}

/// What the network reads, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct HeterGraph {
    /// `[V, K]`: the joint of each link; an empty link repeats the first.
    pub links: Vec<u32>,
    /// `[V, K]`: 1 for a link, 0 for an empty one.
    pub link_mask: Vec<f32>,
    /// `[V, K, 13]`: HollowDist, distance through voxels, straight distance, heat, place along the bone (0 to 1), length of
    /// the bone, leaf flag, from the bone's nearest point to the vertex (3), direction of the bone (3).
    pub link_features: Vec<f32>,
    /// `[J, 8]`: position (3), offset from the parent (3), leaf flag, root flag.
    pub joint_features: Vec<f32>,
    /// `[J]`: parent, then children.
    pub joint_neighbors: Vec<Vec<u32>>,
    /// `[J, 32]`: links that each joint looks at, as vertex · K + slot; a joint without links repeats 0.
    pub joint_links: Vec<u32>,
    /// `[J]`: 1 where a joint has links.
    pub joint_mask: Vec<f32>,
}

impl HeterGraph {
    pub fn new(
        vertices: &[DVec3],
        skeleton: &Skeleton,
        bones: &[Bone],
        distances: &BoneDistances,
        heat: &BoneWeights,
    ) -> Self {
        let rows: Vec<Vec<Link>> = distances.hollow.map(|row| {
            let voxel = &distances.voxel[row.vertex * bones.len()..][..bones.len()];
            links_of(vertices[row.vertex], bones, row.hollow, voxel, row.straight, heat.row(row.vertex))
        });
        let joint_count = skeleton.joints.len();
        let (joint_links, joint_mask) = seen_by_joints(&rows, joint_count);
        let slots = || rows.iter().flat_map(|row| (0..LINKS).map(move |slot| (row.get(slot), row.first())));
        Self {
            links: slots().map(|(own, first)| own.or(first).map_or(0, |link| link.joint)).collect(),
            link_mask: slots().map(|(own, _)| f32::from(own.is_some())).collect(),
            link_features: slots()
                .flat_map(|(own, first)| own.or(first).map_or([0.0; LINK_CHANNELS], |link| link.features))
                .collect(),
            joint_features: joint_features(skeleton),
            joint_neighbors: joint_neighbors(skeleton),
            joint_links,
            joint_mask,
        }
    }
}

impl HeterGraph {
    /// Softmax of each vertex's `logits` `[V, K]`, as weights of the first bone of each link's joint. Rows whose logits are no
    /// numbers become zero.
    pub fn weights(&self, logits: impl IntoIterator<Item = f32>, bones: &[Bone]) -> BoneWeights {
        let logits: Vec<f32> = logits.into_iter().collect();
        let mut bone_of_joint = vec![0; self.joint_mask.len()];
        bones.iter().enumerate().rev().for_each(|(index, bone)| bone_of_joint[bone.start_joint] = index);
        let mut values = vec![0.0; logits.len() / LINKS * bones.len()];
        let rows = values.chunks_exact_mut(bones.len().max(1)).zip(logits.chunks_exact(LINKS));
        let slots = self.links.chunks_exact(LINKS).zip(self.link_mask.chunks_exact(LINKS));
        for ((row, logits), (joints, mask)) in rows.zip(slots) {
            for (slot, share) in
                masked_softmax(logits, mask).into_iter().enumerate().filter(|&(slot, _)| mask[slot] > 0.0)
            {
                row[bone_of_joint[joints[slot] as usize]] += share;
            }
        }
        BoneWeights { bone_count: bones.len(), values }
    }
}

struct Link {
    joint: u32,
    features: [f32; LINK_CHANNELS],
}

/// The links of one vertex: in turn the warmest joint and the nearest by HollowDist, each joint once.
fn links_of(vertex: DVec3, bones: &[Bone], hollow: &[f32], voxel: &[f32], straight: &[f32], heat: &[f32]) -> Vec<Link> {
    let (by_hollow, by_voxel, by_line) =
        (nearest_of_joints(hollow, bones), nearest_of_joints(voxel, bones), nearest_of_joints(straight, bones));
    let mut warmth = vec![0.0f32; by_hollow.len()];
    for (bone, &own) in bones.iter().zip(heat) {
        warmth[bone.start_joint] += own;
    }
    let distance = |joint: usize| by_hollow[joint].map_or(FAR, |bone| hollow[bone].min(FAR));
    let joints: Vec<usize> = (0..by_hollow.len()).filter(|&joint| by_line[joint].is_some()).collect();
    let mut warm: Vec<usize> = joints.iter().copied().filter(|&joint| warmth[joint] > 0.0).collect();
    warm.sort_by(|&a, &b| warmth[b].total_cmp(&warmth[a]).then(a.cmp(&b)));
    let mut near = joints;
    near.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)));
    let mut chosen: Vec<usize> = Vec::with_capacity(LINKS);
    for turn in 0..near.len() {
        for joint in [warm.get(turn), near.get(turn)].into_iter().flatten() {
            if chosen.len() < LINKS && !chosen.contains(joint) {
                chosen.push(*joint);
            }
        }
    }
    let link = |joint: usize| {
        let bone = &bones[by_line[joint]?];
        let (along, offset) = (bone.end - bone.start, vertex - bone.start);
        let length = along.length();
        let direction = along.normalize_or_zero();
        let place = if length > 0.0 { (offset.dot(direction) / length).clamp(0.0, 1.0) } else { 0.0 };
        let beside = (offset - along * place).as_vec3();
        let direction = direction.as_vec3();
        let through = by_voxel[joint].map_or(FAR, |bone| voxel[bone].min(FAR));
        let features = [
            distance(joint),
            through,
            straight[by_line[joint]?].min(FAR),
            warmth[joint],
            place as f32,
            length as f32,
            f32::from(bone.is_leaf()),
            beside.x,
            beside.y,
            beside.z,
            direction.x,
            direction.y,
            direction.z,
        ];
        Some(Link { joint: joint as u32, features })
    };
    chosen.into_iter().filter_map(link).collect()
}

/// For each joint up to [`SIGHT`] of the links by which its heat reaches a vertex, in the order of the vertices' hashes, repeated
/// where there are fewer; and which joints have any.
fn seen_by_joints(rows: &[Vec<Link>], joint_count: usize) -> (Vec<u32>, Vec<f32>) {
    let mut of_joint: Vec<Vec<(u32, u32)>> = vec![Vec::new(); joint_count];
    for (vertex, row) in rows.iter().enumerate() {
        let hash = (vertex as u32).wrapping_mul(HASH_FACTOR);
        for (slot, link) in row.iter().enumerate().filter(|(_, link)| link.features[HEAT] >= SEEN_FROM) {
            of_joint[link.joint as usize].push((hash, (vertex * LINKS + slot) as u32));
        }
    }
    let mut seen = Vec::with_capacity(joint_count * SIGHT);
    for links in &mut of_joint {
        links.sort_unstable();
        let repeated = links.iter().cycle().map(|link| link.1).chain(std::iter::repeat(0));
        seen.extend(repeated.take(SIGHT));
    }
    (seen, of_joint.iter().map(|links| f32::from(!links.is_empty())).collect())
}

fn joint_features(skeleton: &Skeleton) -> Vec<f32> {
    let children = skeleton.children();
    let of_joint = |index: usize| {
        let joint = &skeleton.joints[index];
        let parent = joint.parent.map_or(joint.position, |parent| skeleton.joints[parent].position);
        let (place, offset) = (joint.position.as_vec3(), (joint.position - parent).as_vec3());
        let flags = [f32::from(children[index].is_empty()), f32::from(joint.parent.is_none())];
        [place.x, place.y, place.z, offset.x, offset.y, offset.z, flags[0], flags[1]]
    };
    (0..skeleton.joints.len()).flat_map(of_joint).collect()
}

fn joint_neighbors(skeleton: &Skeleton) -> Vec<Vec<u32>> {
    let children = skeleton.children();
    let around = |index: usize| {
        let parent = skeleton.joints[index].parent.into_iter();
        parent.chain(children[index].iter().copied()).map(|joint| joint as u32).collect()
    };
    (0..skeleton.joints.len()).map(around).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::hollow_distance::HOLLOW_RESOLUTION;
    use crate::geometry::volumetric_geodesic::bone_euclid;
    use crate::mesh::Mesh;
    use crate::rig::Joint;

    /// A root with three arms of one bone each.
    fn skeleton() -> Skeleton {
        let joint = |parent: Option<usize>, position: DVec3| Joint { name: String::new(), parent, position };
        let arms = [DVec3::X, DVec3::Y, DVec3::Z].map(|arm| joint(Some(0), arm));
        Skeleton { joints: [vec![joint(None, DVec3::ZERO)], arms.to_vec()].concat() }
    }

    fn graph(vertices: &[DVec3]) -> HeterGraph {
        let (skeleton, bones) = (skeleton(), skeleton().bones());
        let segments: Vec<_> = bones.iter().map(|bone| (bone.start, bone.end)).collect();
        let voxel = bone_euclid(vertices, &segments);
        let heat = BoneWeights { bone_count: bones.len(), values: vec![1.0 / bones.len() as f32; voxel.len()] };
        let mesh = Mesh { positions: vertices.to_vec(), triangles: Vec::new() };
        let hollow = HollowDistance::new(&mesh, &segments, HOLLOW_RESOLUTION);
        let distances = BoneDistances { hollow: &hollow, voxel: &voxel };
        HeterGraph::new(vertices, &skeleton, &bones, &distances, &heat)
    }

    #[test]
    fn each_joint_is_linked_once_however_many_bones_leave_it() {
        let graph = graph(&[DVec3::new(0.5, 0.1, 0.0)]);
        let mut joints = graph.links[..4].to_vec();
        joints.sort_unstable();
        assert_eq!(joints, [0, 1, 2, 3]);
        assert_eq!(graph.link_mask, [1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
        let root = graph.links.iter().position(|&joint| joint == 0).unwrap();
        let features = &graph.link_features[root * LINK_CHANNELS..][..LINK_CHANNELS];
        assert!((features[2] - 0.1).abs() < 1e-6 && (features[4] - 0.5).abs() < 1e-6, "{features:?}");
        assert_eq!(features[10..], [1.0, 0.0, 0.0]);
    }

    #[test]
    fn a_joint_sees_vertices_that_its_heat_reaches_and_the_same_whatever_other_joints_do() {
        // Joint 1 warms the vertices from 20 on; joints 2 and 3 share the others in two ways.
        let seen = |shares: [f32; 2]| {
            let warmed = |vertex: usize| if vertex < 20 { [0.0, shares[0], shares[1]] } else { [1.0, 0.0, 0.0] };
            let row = |vertex: usize| {
                let link = |joint: usize, heat: f32| Link {
                    joint: joint as u32 + 1,
                    features: std::array::from_fn(|at| if at == HEAT { heat } else { 0.0 }),
                };
                warmed(vertex).into_iter().enumerate().map(|(joint, heat)| link(joint, heat)).collect()
            };
            seen_by_joints(&(0..100).map(row).collect::<Vec<Vec<Link>>>(), 4)
        };
        let (links, mask) = seen([0.5, 0.5]);
        assert_eq!(mask, [0.0, 1.0, 1.0, 1.0]);
        let of = |joint: usize| &links[joint * SIGHT..][..SIGHT];
        assert_eq!(of(0), [0; SIGHT]);
        let of_first: Vec<usize> = of(1).iter().map(|link| *link as usize / LINKS).collect();
        assert!(
            of_first.iter().all(|&vertex| vertex >= 20)
                && of(1).iter().all(|link| (*link as usize).is_multiple_of(LINKS))
        );
        assert!(
            of_first.iter().any(|&vertex| vertex < 40) && of_first.iter().any(|&vertex| vertex > 80),
            "{of_first:?}"
        );
        assert!(of(2).iter().all(|&link| (link as usize) < 20 * LINKS && link as usize % LINKS == 1));
        let (changed, mask) = seen([1.0, 0.0]);
        assert_eq!((&changed[SIGHT..2 * SIGHT], mask[3]), (of(1), 0.0));
    }

    #[test]
    fn no_bones_and_no_vertices_are_survived() {
        assert!(graph(&[]).links.is_empty());
        assert!(graph(&[]).joint_mask.iter().all(|&mask| mask == 0.0));
    }
}
