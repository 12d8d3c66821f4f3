//! Characters made of boxes: joints where the boxes touch, and every box moves as a whole.

use super::LevelOfDetail;
use super::prepared::Prepared;
use crate::geometry::box_parts::{BoxParts, box_parts};
use crate::geometry::bvh::Bvh;
use crate::geometry::symmetry_plane::SymmetryPlane;
use crate::rig::SkinWeights;
use crate::rig::box_skeleton::{BoxSkeleton, box_skeleton, joints_by_weight, rigid_weights};

/// The boxes of a character, over the upload's vertices and over those of its working mesh.
pub(super) struct Boxes {
    parts: BoxParts,
    /// `[V working]`.
    part_of_working: Vec<u32>,
}

impl Boxes {
    /// `None` where the character is not made of boxes.
    pub(super) fn of(subject: &Prepared) -> Option<Self> {
        let parts = box_parts(&subject.original, &subject.working.welded)?;
        let bvh = Bvh::new(&subject.original);
        let part = |&position| bvh.nearest_point(position).map_or(0, |near| parts.part_of_face[near.triangle as usize]);
        let part_of_working = subject.working.mesh.positions.iter().map(part).collect();
        Some(Self { parts, part_of_working })
    }

    pub(super) fn count(&self) -> usize {
        self.parts.parts.len()
    }

    /// `None` for a bandwidth, which asks for RigNet's own joints, and where nothing moves by itself. Sides are made alike about
    /// `plane`, where there is one.
    pub(super) fn skeleton(
        &self,
        level_of_detail: LevelOfDetail,
        plane: Option<&SymmetryPlane>,
    ) -> Option<BoxSkeleton> {
        let LevelOfDetail::Detail(detail) = level_of_detail else { return None };
        let made = box_skeleton(&self.parts.parts, SMALL_MAX * (1.0 - detail))?;
        Some(match plane {
            Some(plane) => made.mirrored(plane),
            None => made,
        })
    }

    /// For every box the joint that most of it belongs to, by the weights of the working mesh, which covers it evenly; by those of
    /// the upload's vertices where nothing is left of the box in the working mesh.
    pub(super) fn joints_by_weight(&self, working: &SkinWeights, upload: &SkinWeights) -> Vec<u32> {
        let evenly = joints_by_weight(&self.part_of_working, self.count(), working);
        let by_corners = joints_by_weight(&self.parts.part_of_vertex, self.count(), upload);
        evenly.into_iter().zip(by_corners).map(|(joint, corner)| joint.or(corner).unwrap_or(0)).collect()
    }

    /// Weights of the upload's vertices, each box moving with one joint.
    pub(super) fn weights(&self, joint_of_box: &[u32]) -> SkinWeights {
        rigid_weights(&self.parts.part_of_vertex, joint_of_box)
    }

    /// The same of the working mesh's vertices.
    pub(super) fn working_weights(&self, joint_of_box: &[u32]) -> SkinWeights {
        rigid_weights(&self.part_of_working, joint_of_box)
    }
}

/// With detail 0, boxes that stand out of others by less than this share of the longest side have no joint of their own; with
/// detail .5 by half of it, which gives 1.3 times the joints of the artists (validation, 19 characters).
const SMALL_MAX: f64 = 0.1;
