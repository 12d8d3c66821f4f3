//! HeterSkinNet [Pan et al. 2021]: the facts that its network reads of a working mesh and a skeleton.
//!
//! Mesh and skeleton are in the normalised frame. The distances through voxels and the bone heat are those of the methods that
//! ask no network, so a program that weighs by them has most of this already.

use super::shape::Shape;
use crate::cancellation::{Cancellation, Cancelled};
use crate::geometry::hollow_distance::{HOLLOW_RESOLUTION, HollowDistance};
use crate::geometry::voxel_binding::VoxelBinding;
use crate::rig::Skeleton;
use crate::rig::bone_features::bone_features;
use crate::rig::bone_weights::BoneWeights;
use crate::rig::heat_weights::{HEAT, heat_weights};
use crate::rig::heter_graph::{BoneDistances, HeterGraph};
use crate::rig::skeleton::Bone;

/// The bones of a skeleton with what needs no network to know of them.
pub struct WeighedBones {
    /// Leaf bones drawn out to where the body ends. `[B]`
    pub bones: Vec<Bone>,
    /// Distance through voxels `[V, B]`, see [`VoxelBinding`].
    pub voxel_distance: Vec<f32>,
}

impl WeighedBones {
    /// `bones` are those of `skeleton`, or some of them.
    pub fn new(
        shape: &Shape,
        skeleton: &Skeleton,
        bones: &[Bone],
        cancellation: &Cancellation,
    ) -> Result<Self, Cancelled> {
        let drawn_out = |bone: &Bone| Bone { end: shape.reach_of(bone, skeleton), ..*bone };
        let bones: Vec<Bone> = bones.iter().map(drawn_out).collect();
        let segments: Vec<_> = bones.iter().map(|bone| (bone.start, bone.end)).collect();
        let binding = VoxelBinding::new(&shape.mesh, &shape.solid, &segments);
        cancellation.check()?;
        let voxel_distance = binding.distances(&shape.mesh.positions);
        cancellation.check()?;
        Ok(Self { bones, voxel_distance })
    }

    /// Bone heat over the distances through voxels.
    pub fn heat(&self, shape: &Shape) -> BoneWeights {
        heat_weights(&shape.mesh, &self.voxel_distance, &self.bones, HEAT)
    }

    /// The bones nearest to each vertex, `[V, K]`, nearest first.
    pub fn nearest_bones(&self) -> Vec<u32> {
        bone_features(&self.voxel_distance, &self.bones).nearest
    }

    /// What HeterSkinNet reads.
    pub fn heter_graph(&self, shape: &Shape, skeleton: &Skeleton) -> HeterGraph {
        let segments: Vec<_> = self.bones.iter().map(|bone| (bone.start, bone.end)).collect();
        // Before HollowDist is there: both need memory of their own.
        let heat = self.heat(shape);
        let hollow = HollowDistance::new(&shape.mesh, &segments, HOLLOW_RESOLUTION);
        let distances = BoneDistances { hollow: &hollow, voxel: &self.voxel_distance };
        HeterGraph::new(&shape.mesh.positions, skeleton, &self.bones, &distances, &heat)
    }
}
