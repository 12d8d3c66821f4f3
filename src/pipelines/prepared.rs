//! An upload brought into the frame and the resolution that the networks were trained on, and the way back.
//! RigNet [Xu et al. 2020], Section 3, "input".
//!
//! In: vertices and skeletons in upload space. Out: the normalised frame of [`crate::mesh::normalize`]; a working mesh of
//! 1,000 to about 4,000 vertices.
//! # Departures from the paper
//! - A symmetric character is turned about the vertical until its mirror plane is x = 0; theirs assumes that.

use super::survey::{normalised, plane_in_upload};
use super::{RigError, Subject};
use crate::geometry::bvh::Bvh;
use crate::geometry::surface_samples::SurfaceSamples;
use crate::geometry::symmetry_plane::{SymmetryPlane, detect_symmetry_plane};
use crate::mesh::Mesh;
use crate::mesh::normalize::Normalization;
use crate::mesh::working_mesh::WorkingMesh;
use glam::{DMat3, DVec3};

/// From this score on a shape counts as symmetric when symmetry is automatic. The score falls to 0 where mirrored
/// samples are 2 % of the longest side off on average: real characters with a prop or a turned head stay above .8.
pub(super) const SYMMETRIC_FROM: f64 = 0.75;

/// An upload in the normalised frame.
pub(super) struct Prepared<'a> {
    upload: Subject<'a>,
    pub(super) normalization: Normalization,
    /// All of the upload's vertices.
    pub(super) original: Mesh,
    pub(super) working: WorkingMesh,
}

impl<'a> Prepared<'a> {
    pub(super) fn new(upload: Subject<'a>) -> Result<Self, RigError> {
        let normalization = Normalization::new(&upload.mesh.positions, upload.to_upright).ok_or(RigError::NoExtent)?;
        let original = normalised(upload.mesh, &normalization);
        let working = WorkingMesh::new(&original).map_err(|_| RigError::NoExtent)?;
        Ok(Self { upload, normalization, original, working })
    }

    /// Turns a symmetric character about the vertical until its mirror plane is x = 0, as the networks were trained; by at
    /// most a quarter turn, so that front stays front.
    pub(super) fn face_the_front(&mut self) {
        let samples = SurfaceSamples::new(&self.working.mesh, FACING_SAMPLES);
        let plane = detect_symmetry_plane(&samples, &Bvh::new(&self.working.mesh));
        let angle = plane.normal.z.atan2(plane.normal.x);
        if plane.score < SYMMETRIC_FROM || angle.abs() < FACING_TOLERANCE {
            return;
        }
        let rotation = DMat3::from_rotation_y(angle) * self.upload.to_upright;
        let Some(turned) = Normalization::new(&self.upload.mesh.positions, rotation) else { return };
        let map = |position: &mut DVec3| *position = turned.apply(self.normalization.invert(*position));
        self.original.positions.iter_mut().for_each(map);
        self.working.mesh.positions.iter_mut().for_each(map);
        self.working.welded.mesh.positions.iter_mut().for_each(map);
        self.normalization = turned;
    }

    /// Unit normal and one point of a plane of the normalised frame, in upload space.
    pub(super) fn plane_in_upload(&self, plane: &SymmetryPlane) -> (DVec3, DVec3) {
        plane_in_upload(plane, &self.normalization)
    }
}

/// Enough to find the facing; the plane itself is found again with all samples.
const FACING_SAMPLES: usize = 2_000;
/// Half a degree: less than that no rig can tell.
const FACING_TOLERANCE: f64 = 0.0087;
