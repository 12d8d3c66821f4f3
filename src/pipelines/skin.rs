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

use super::boxes::Boxes;
use super::heter_skin::WeighedBones;
use super::prepared::{Prepared, SYMMETRIC_FROM};
use super::shape::Shape;
use super::transfer::{finished, transferred};
use super::{Facts, Given, RigError, RigOptions, Rigged, SkinMethod, Stage, Subject, Symmetry, Watch};
use crate::geometry::symmetry_plane::SymmetryPlane;
use crate::geometry::volumetric_geodesic::Segment;
use crate::nets::Models;
use crate::nets::heter_skin_net::HeterSkinNet;
use crate::nets::rignet::{RigNets, ShapeGraph};
use crate::rig::bone_features::{BONE_CHANNELS, NEAREST_BONES, bone_features};
use crate::rig::bone_weights::{BoneWeights, PRUNE_SHARE, SMOOTHINGS, TRACE_SHARE};
use crate::rig::deforming::Deforming;
use crate::rig::distance_falloff::{FALLOFF, VOXEL_SMOOTHINGS, VOXEL_TRACE_SHARE, falloff_weights};
use crate::rig::heat_weights::HEAT_TRACE_SHARE;
use crate::rig::heter_graph::{LINK_PRUNE_SHARE, LINK_SPREAD};
use crate::rig::skeleton::Bone;
use crate::rig::verdict::{self, Quality};
use crate::rig::{Rig, Skeleton, SkinWeights};
use glam::DVec3;
use ndarray::ArrayView2;
use std::borrow::Cow;

/// Weighs the vertices of `subject` over the `given` joints by `nets`.
pub(super) fn skin(
    subject: Subject,
    given: Given,
    nets: SkinNets,
    options: &RigOptions,
    watch: Watch,
) -> Result<Rigged, RigError> {
    watch.enter(Stage::Normalize)?;
    let mut subject = Prepared::new(subject)?;
    if options.symmetry != Symmetry::Off {
        subject.face_the_front();
    }
    let normalised = given.skeleton.mapped(|point| subject.normalization.apply(point));
    let joints = match given.deforms {
        Some(deforms) => Deforming::new(&normalised, deforms),
        None => Deforming::all(&normalised),
    };

    watch.enter(Stage::Geometry)?;
    let shape = Shape::new(subject.working.mesh.clone());

    watch.enter(Stage::Skin)?;
    let (skin, vertices_by_nearest_bone) = weigh(&shape, None, &joints, nets, options, watch)?;
    let mut skin = joints.in_whole(skin);

    watch.enter(Stage::Transfer)?;
    let boxes = options.rigid_boxes.then(|| Boxes::of(&subject)).flatten();
    let mut on_upload = transferred(&subject, &skin, options);
    if let Some(boxes) = &boxes {
        let joint_of_box = boxes.joints_by_weight(&skin, &on_upload);
        (on_upload, skin) = (boxes.weights(&joint_of_box), boxes.working_weights(&joint_of_box));
    }
    let finished = finished(&subject, &shape, &normalised, on_upload, given.locks.as_ref(), options)?;
    let plane = (shape.symmetry.score >= SYMMETRIC_FROM).then_some(&shape.symmetry);
    let quality = judged(&shape, &normalised, &skin, plane);
    let facts = Facts {
        working_vertices: shape.mesh.positions.len(),
        working_triangles: shape.mesh.triangles.len(),
        symmetry_plane: plane.map(|plane| subject.plane_in_upload(plane)),
        symmetry_score: shape.symmetry.score,
        bandwidth: None,
        fingers: 0,
        is_rigid: boxes.is_some(),
        boxes: boxes.as_ref().map(Boxes::count),
        joints_inside: quality.joints_inside,
        joints_far_outside: far_outside(&shape, &normalised),
        vertices_by_nearest_bone,
        vertices_mirrored: finished.mirrored,
        quality,
    };
    Ok(Rigged { rig: Rig { skeleton: given.skeleton.clone(), skin: finished.skin }, facts })
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
pub(super) enum SkinNets<'a> {
    RigNet(&'a RigNets),
    HeterSkinNet(&'a HeterSkinNet),
    /// Falloff of the way through voxels; no network.
    Falloff,
    /// Heat by the same way; no network.
    Heat,
}

impl<'a> SkinNets<'a> {
    /// The networks of a skin method, or why it is unavailable.
    pub(super) fn of(method: SkinMethod, models: &'a Models) -> Result<Self, RigError> {
        let unavailable =
            |reason: &str| RigError::MethodUnavailable { method: method.name(), reason: reason.to_owned() };
        Ok(match method {
            SkinMethod::RigNet => Self::RigNet(models.rignet().map_err(unavailable)?),
            SkinMethod::HeterSkinNet => Self::HeterSkinNet(models.heter_skin_net().map_err(unavailable)?),
            SkinMethod::GeodesicVoxel => Self::Falloff,
            SkinMethod::GeodesicHeat => Self::Heat,
        })
    }
}

/// Weights of the working mesh's vertices over `joints` (normalised frame). Second: vertices that no weight
/// reached, which follow their nearest bone. `graph` is that of `shape`, if it is at hand.
pub(super) fn weigh(
    shape: &Shape,
    graph: Option<&ShapeGraph>,
    joints: &Deforming,
    nets: SkinNets,
    options: &RigOptions,
    watch: Watch,
) -> Result<(SkinWeights, usize), RigError> {
    let made = || graph.map_or_else(|| Cow::Owned(shape.graph(options.seed)), Cow::Borrowed);
    let bones = joints.bones();
    let (weights, nearest) = match nets {
        SkinNets::RigNet(nets) => by_rignet(shape, &made(), nets, &bones, watch)?,
        SkinNets::HeterSkinNet(net) => by_heter_skin_net(shape, &made(), net, joints, watch)?,
        SkinNets::Falloff => by_falloff(shape, joints, watch)?,
        SkinNets::Heat => by_heat(shape, joints, watch)?,
    };
    let weights = spread(weights, shape, options.smooth);
    Ok(SkinWeights::from_bones(&weights, &bones, &nearest, options.trim()))
}

/// Volumetric distances and the skin network (RigNet, Section 4.3), cleaned. Second: the nearest bones `[V, K]`.
fn by_rignet(
    shape: &Shape,
    graph: &ShapeGraph,
    nets: &RigNets,
    bones: &[Bone],
    watch: Watch,
) -> Result<(BoneWeights, Vec<u32>), RigError> {
    let segments: Vec<Segment> = bones.iter().map(|bone| (bone.start, bone.end)).collect();
    let distances = shape.bone_distances(&segments);
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

/// The graph of mesh, skeleton and links, and the network over it, cleaned. Second: the nearest bones `[V, K]`.
fn by_heter_skin_net(
    shape: &Shape,
    graph: &ShapeGraph,
    net: &HeterSkinNet,
    joints: &Deforming,
    watch: Watch,
) -> Result<(BoneWeights, Vec<u32>), RigError> {
    let weighed = weighed_bones(shape, joints, watch)?;
    let links = weighed.heter_graph(shape, &joints.skeleton);
    watch.cancellation.check()?;
    let logits = net.link_logits(graph, &links, watch.cancellation)?;
    let weights = links.weights(logits.iter().copied(), &weighed.bones).pruned(TRACE_SHARE);
    Ok((spread(weights, shape, LINK_SPREAD).pruned(LINK_PRUNE_SHARE), weighed.nearest_bones()))
}

/// Falloff of distances through voxels. Second: the nearest bones `[V, K]`.
fn by_falloff(shape: &Shape, joints: &Deforming, watch: Watch) -> Result<(BoneWeights, Vec<u32>), RigError> {
    let weighed = weighed_bones(shape, joints, watch)?;
    let weights = falloff_weights(&weighed.voxel_distance, &weighed.bones, &FALLOFF);
    Ok((smoothed(weights, shape, VOXEL_SMOOTHINGS).pruned(VOXEL_TRACE_SHARE), weighed.nearest_bones()))
}

/// Heat over distances through voxels. Second: the nearest bones `[V, K]`.
fn by_heat(shape: &Shape, joints: &Deforming, watch: Watch) -> Result<(BoneWeights, Vec<u32>), RigError> {
    let weighed = weighed_bones(shape, joints, watch)?;
    Ok((weighed.heat(shape).pruned(HEAT_TRACE_SHARE), weighed.nearest_bones()))
}

fn weighed_bones(shape: &Shape, joints: &Deforming, watch: Watch) -> Result<WeighedBones, RigError> {
    Ok(WeighedBones::new(shape, &joints.skeleton, &joints.bones(), watch.cancellation)?)
}

fn smoothed(mut weights: BoneWeights, shape: &Shape, times: usize) -> BoneWeights {
    for _ in 0..times {
        weights = weights.smoothed(&shape.one_ring);
    }
    weights
}

/// How often a smoothing that was asked for goes round: at full strength a hard edge becomes a slope of about five edges of the
/// working mesh, a tenth of a character's height.
const SPREAD_ROUNDS: usize = 10;

/// Weights that run into each other along the edges of the mesh, and so across no gap. `strength` 0 to 1 is how much of a
/// neighbour's mean is taken in each round.
fn spread(mut weights: BoneWeights, shape: &Shape, strength: f64) -> BoneWeights {
    if strength <= 0.0 {
        return weights;
    }
    for _ in 0..SPREAD_ROUNDS {
        weights = weights.blended(&shape.one_ring, (1.0 - strength / 2.0) as f32);
    }
    weights.pruned(TRACE_SHARE)
}

/// A flat buffer as `[rows, columns]`.
fn rows(values: &[f32], rows: usize, columns: usize) -> ArrayView2<'_, f32> {
    ArrayView2::from_shape((rows, columns), values).expect("features hold one row per vertex")
}
