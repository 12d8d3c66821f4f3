//! Skin weights for the bones of a skeleton: the last step of every method, and the only one for a skeleton that is given.
//! RigNet [Xu et al. 2020], Section 4.3; geodesic voxel binding [Dionne and de Lasa 2013]; bone heat [Baran and Popović 2007].
//!
//! | in         | space  | meaning                                                  |
//! |------------|--------|----------------------------------------------------------|
//! | `subject`  | upload | the mesh                                                 |
//! | `skeleton` | upload | any tree of joints, inside the mesh or not               |
//!
//! Out: the same skeleton, and for every vertex of the upload one row of weights. Bones outside the body and parts without
//! a bone are weighed too, see [`crate::geometry::voxel_binding`] and [`crate::geometry::volumetric_geodesic`].

use super::heter_skin::WeighedBones;
use super::prepared::{Prepared, SYMMETRIC_FROM};
use super::shape::Shape;
use super::{Facts, RigError, RigOptions, Rigged, SkinMethod, Stage, Subject, Symmetry, Watch};
use crate::geometry::symmetry_plane::SymmetryPlane;
use crate::geometry::transfer::transfer_map;
use crate::geometry::volumetric_geodesic::Segment;
use crate::nets::rignet::{RigNets, ShapeGraph};
use crate::rig::bone_features::{BONE_CHANNELS, NEAREST_BONES, bone_features};
use crate::rig::bone_weights::{BoneWeights, PRUNE_SHARE, SMOOTHINGS, TRACE_SHARE};
use crate::rig::distance_falloff::{FALLOFF, VOXEL_SMOOTHINGS, VOXEL_TRACE_SHARE, falloff_weights};
use crate::rig::heat_weights::HEAT_TRACE_SHARE;
use crate::rig::skeleton::Bone;
use crate::rig::verdict::{self, Quality};
use crate::rig::{Rig, Skeleton, SkinWeights};
use glam::DVec3;
use ndarray::ArrayView2;

/// Weighs the vertices of `subject` over `skeleton`. `nets` are asked where `options.skin_method` is RigNet.
pub(super) fn skin(
    subject: Subject,
    skeleton: &Skeleton,
    nets: Option<&RigNets>,
    options: &RigOptions,
    watch: Watch,
) -> Result<Rigged, RigError> {
    watch.enter(Stage::Normalize)?;
    let mut subject = Prepared::new(subject)?;
    if options.symmetry != Symmetry::Off {
        subject.face_the_front();
    }
    let normalised = skeleton.mapped(|point| subject.normalization.apply(point));

    watch.enter(Stage::Geometry)?;
    let shape = Shape::new(subject.working.mesh.clone());
    let graph = nets.map(|_| shape.graph(options.seed));

    watch.enter(Stage::Skin)?;
    let weigher = match (nets, &graph) {
        (Some(nets), Some(graph)) => Weigher::new(options.skin_method, nets, graph),
        _ => Weigher::Voxels(options.skin_method),
    };
    let (skin, vertices_by_nearest_bone) = weigh(&shape, &normalised, weigher, options.max_influences, watch)?;

    let plane = (shape.symmetry.score >= SYMMETRIC_FROM).then_some(&shape.symmetry);
    let quality = judged(&shape, &normalised, &skin, plane);

    watch.enter(Stage::Transfer)?;
    let skin = skin.transferred(&transfer_map(&subject.original, &subject.working), options.max_influences);
    let facts = Facts {
        working_vertices: shape.mesh.positions.len(),
        working_triangles: shape.mesh.triangles.len(),
        symmetry_plane: plane.map(|plane| subject.plane_in_upload(plane)),
        symmetry_score: shape.symmetry.score,
        bandwidth: None,
        joints_inside: quality.joints_inside,
        joints_far_outside: far_outside(&shape, &normalised),
        vertices_by_nearest_bone,
        quality,
    };
    Ok(Rigged { rig: Rig { skeleton: skeleton.clone(), skin }, facts })
}

/// What can be said of the rig of the working mesh.
pub(super) fn judged(shape: &Shape, skeleton: &Skeleton, skin: &SkinWeights, plane: Option<&SymmetryPlane>) -> Quality {
    let is_inside = |point| shape.solid.contains(point);
    verdict::judge(&verdict::Subject { mesh: &shape.mesh, skeleton, skin, is_inside: &is_inside, plane })
}

/// Joints farther than this from the bounding box, in lengths of its longest side, belong to another unit or another place.
/// Real rigs keep theirs within .2: end joints of ears and weapons.
const FAR: f64 = 0.5;

fn far_outside(shape: &Shape, skeleton: &Skeleton) -> Vec<usize> {
    let Some((low, high)) = shape.mesh.bounding_box() else { return Vec::new() };
    let is_far = |joint: DVec3| joint.distance(joint.clamp(low, high)) > FAR;
    skeleton.positions().into_iter().enumerate().filter(|&(_, joint)| is_far(joint)).map(|(index, _)| index).collect()
}

/// What answers for the weights.
#[derive(Clone, Copy)]
pub(super) enum Weigher<'a> {
    RigNet {
        nets: &'a RigNets,
        graph: &'a ShapeGraph,
    },
    /// One of the methods that ask no network.
    Voxels(SkinMethod),
}

impl<'a> Weigher<'a> {
    pub(super) fn new(method: SkinMethod, nets: &'a RigNets, graph: &'a ShapeGraph) -> Self {
        match method {
            SkinMethod::RigNet => Self::RigNet { nets, graph },
            SkinMethod::GeodesicVoxel | SkinMethod::GeodesicHeat => Self::Voxels(method),
        }
    }
}

/// Weights of the working mesh's vertices over the joints of `skeleton` (normalised frame). Second: vertices that no weight
/// reached, which follow their nearest bone.
pub(super) fn weigh(
    shape: &Shape,
    skeleton: &Skeleton,
    weigher: Weigher,
    max_influences: usize,
    watch: Watch,
) -> Result<(SkinWeights, usize), RigError> {
    let bones = skeleton.bones();
    let segments: Vec<Segment> = bones.iter().map(|bone| (bone.start, bone.end)).collect();
    let (weights, nearest) = match weigher {
        Weigher::RigNet { nets, graph } => by_network(shape, graph, nets, &bones, &segments, watch)?,
        Weigher::Voxels(method) => by_voxels(shape, skeleton, method, watch)?,
    };
    Ok(SkinWeights::from_bones(&weights, &bones, &nearest, max_influences))
}

/// Volumetric distances and the skin network (RigNet, Section 4.3), cleaned. Second: the nearest bones `[V, K]`.
fn by_network(
    shape: &Shape,
    graph: &ShapeGraph,
    nets: &RigNets,
    bones: &[Bone],
    segments: &[Segment],
    watch: Watch,
) -> Result<(BoneWeights, Vec<u32>), RigError> {
    let distances = shape.bone_distances(segments);
    watch.cancellation.check()?;
    let features = bone_features(&distances, bones);
    let vertex_count = graph.vertex_count();
    let logits = nets.skin_logits(
        graph,
        rows(&features.values, vertex_count, NEAREST_BONES * BONE_CHANNELS),
        rows(&features.mask, vertex_count, NEAREST_BONES),
        watch.cancellation,
    )?;
    let logits: Vec<f32> = logits.iter().copied().collect();
    let weights =
        BoneWeights::from_logits(&logits, &features, bones.len()).one_ring_mean(&shape.one_ring).pruned(PRUNE_SHARE);
    Ok((smoothed(weights, shape, SMOOTHINGS).pruned(TRACE_SHARE), features.nearest))
}

/// Distances through voxels, and their falloff or the heat over them. Second: the nearest bones `[V, K]`.
fn by_voxels(
    shape: &Shape,
    skeleton: &Skeleton,
    method: SkinMethod,
    watch: Watch,
) -> Result<(BoneWeights, Vec<u32>), RigError> {
    let weighed = WeighedBones::new(shape, skeleton, watch.cancellation)?;
    let weights = match method {
        SkinMethod::GeodesicHeat => weighed.heat(shape).pruned(HEAT_TRACE_SHARE),
        _ => {
            let weights = falloff_weights(&weighed.voxel_distance, &weighed.bones, &FALLOFF);
            smoothed(weights, shape, VOXEL_SMOOTHINGS).pruned(VOXEL_TRACE_SHARE)
        }
    };
    Ok((weights, bone_features(&weighed.voxel_distance, &weighed.bones).nearest))
}

fn smoothed(mut weights: BoneWeights, shape: &Shape, times: usize) -> BoneWeights {
    for _ in 0..times {
        weights = weights.smoothed(&shape.one_ring);
    }
    weights
}

/// A flat buffer as `[rows, columns]`.
fn rows(values: &[f32], rows: usize, columns: usize) -> ArrayView2<'_, f32> {
    ArrayView2::from_shape((rows, columns), values).expect("features hold one row per vertex")
}
