//! The facts of a working mesh that all of RigNet's stages share, computed once.

use super::Symmetry;
use super::prepared::SYMMETRIC_FROM;
use crate::geometry::bone_pairs::BonePair;
use crate::geometry::bvh::Bvh;
use crate::geometry::medial_offset::medial_offsets;
use crate::geometry::neighbor_table::{GEODESIC_CAP, NeighborTable};
use crate::geometry::surface_geodesic::{BALL_RADIUS, SurfaceGeodesic};
use crate::geometry::surface_samples::{SAMPLE_COUNT, SurfaceSamples};
use crate::geometry::symmetry_plane::{SymmetryPlane, detect_symmetry_plane};
use crate::geometry::volumetric_geodesic::{Segment, volumetric_geodesic_distance};
use crate::geometry::voxel_grid::VoxelGrid;
use crate::mesh::Mesh;
use crate::mesh::adjacency::{Neighbors, one_ring};
use crate::nets::rignet::ShapeGraph;
use crate::rig::Skeleton;
use crate::rig::skeleton::Bone;
use glam::DVec3;
use ndarray::Array2;

/// A working mesh in the normalised frame, and what is true of it.
pub struct Shape {
    pub mesh: Mesh,
    /// Neighbours by an edge.
    pub one_ring: Neighbors,
    /// All vertices within a surface distance of [`BALL_RADIUS`].
    pub geodesic_ball: Neighbors,
    pub surface_distance: SurfaceGeodesic,
    pub surface: Bvh,
    pub solid: VoxelGrid,
    pub symmetry: SymmetryPlane,
}

impl Shape {
    /// `mesh` is in the normalised frame, welded, with at least one face that has an area.
    pub fn new(mesh: Mesh) -> Self {
        let samples = SurfaceSamples::new(&mesh, SAMPLE_COUNT);
        let surface = Bvh::new(&mesh);
        let symmetry = detect_symmetry_plane(&samples, &surface);
        let surface_distance = SurfaceGeodesic::new(&samples, &mesh.positions);
        let geodesic_ball = surface_distance.balls(BALL_RADIUS);
        let (one_ring, solid) = (one_ring(&mesh), VoxelGrid::solid(&mesh));
        Self { mesh, one_ring, geodesic_ball, surface_distance, surface, solid, symmetry }
    }

    /// What the networks see: all one-ring neighbours, and at most [`GEODESIC_CAP`] of the geodesic ball, which `seed`
    /// chooses.
    pub fn graph(&self, seed: u64) -> ShapeGraph {
        let positions = &self.mesh.positions;
        ShapeGraph {
            positions: points_f32(positions),
            medial_offsets: points_f32(&self.medial_offsets()),
            one_ring: table(NeighborTable::padded(&self.one_ring)),
            geodesic_ball: table(NeighborTable::capped(&self.geodesic_ball, GEODESIC_CAP, positions, seed)),
        }
    }

    /// From each vertex to the middle of its body part. `[V]`
    pub fn medial_offsets(&self) -> Vec<DVec3> {
        medial_offsets(&self.mesh, &self.surface)
    }

    /// All pairs of joints, i < j, in lexical order: indices `[P, 2]`, and the segments between them.
    pub fn bone_pairs(&self, joints: &[DVec3]) -> (Vec<[usize; 2]>, Vec<BonePair>) {
        let pairs: Vec<[usize; 2]> =
            (0..joints.len()).flat_map(|i| (i + 1..joints.len()).map(move |j| [i, j])).collect();
        let segments = pairs.iter().map(|&[i, j]| BonePair::new(joints[i], joints[j], &self.solid)).collect();
        (pairs, segments)
    }

    /// The plane to make left and right alike about, if any.
    pub(super) fn mirror_plane(&self, symmetry: Symmetry) -> Option<SymmetryPlane> {
        let wanted = match symmetry {
            Symmetry::Auto => self.symmetry.score >= SYMMETRIC_FROM,
            Symmetry::On => true,
            Symmetry::Off => false,
        };
        wanted.then_some(self.symmetry)
    }

    /// Where a bone ends. A leaf bone goes on along the bone before it until it leaves the solid: what lies beyond a hand's or a
    /// head's joint follows that joint, although the bone that ends there is as near.
    pub(super) fn reach_of(&self, bone: &Bone, skeleton: &Skeleton) -> DVec3 {
        let parent = skeleton.joints[bone.start_joint].parent.filter(|_| bone.is_leaf());
        let Some(parent) = parent else { return bone.end };
        let along = (bone.start - skeleton.joints[parent].position).normalize_or_zero();
        self.solid.last_inside(bone.start, along)
    }

    /// Volumetric geodesic distances `[V, B]`, row-major.
    pub fn bone_distances(&self, bones: &[Segment]) -> Vec<f32> {
        volumetric_geodesic_distance(&self.mesh.positions, &self.surface_distance, &self.surface, bones)
    }
}

/// Points as an `[N, 3]` array of the networks' precision.
pub fn points_f32(points: &[DVec3]) -> Array2<f32> {
    Array2::from_shape_fn((points.len(), 3), |(row, axis)| points[row][axis] as f32)
}

fn table(table: NeighborTable) -> Array2<i64> {
    Array2::from_shape_fn((table.vertex_count, table.width), |(row, column)| table.row(row)[column])
}
