//! RigNet [Xu et al. 2020], Section 4, in the paper's order, with what a service has to add: any upload comes in, a
//! working mesh is made of it, and the weights go back to the upload's own vertices.

use super::boxes::Boxes;
use super::prepared::Prepared;
use super::shape::{Shape, points_f32};
use super::skin::{SkinNets, judged, weigh};
use super::transfer::{finished, transferred};
use super::{Facts, Fingers, LevelOfDetail, RigError, RigOptions, Rigged, Stage, Subject, Symmetry, Watch};
use crate::geometry::symmetry_plane::SymmetryPlane;
use crate::nets::rignet::{JointPairs, RigNets, ShapeGraph};
use crate::rig::deforming::Deforming;
use crate::rig::detect_joints::{DetectedJoints, Evidence, detect_joints};
use crate::rig::finger_bones::{FingerBones, with_finger_bones};
use crate::rig::hand_shape::HandRule;
use crate::rig::hands::with_fingers;
use crate::rig::joined_ends::joined_ends;
use crate::rig::limb_starts::with_limb_starts;
use crate::rig::spanning_tree::{BoneCosts, OutsideRule, Tree, minimum_spanning_tree, symmetric_spanning_tree};
use crate::rig::{Rig, Skeleton};
use glam::DVec3;
use ndarray::{Array2, ArrayView2};

/// Rigs `subject` with RigNet.
pub(super) fn rig(
    subject: Subject,
    nets: &RigNets,
    skin_nets: SkinNets,
    options: &RigOptions,
    watch: Watch,
) -> Result<Rigged, RigError> {
    watch.enter(Stage::Normalize)?;
    let mut subject = Prepared::new(subject)?;
    if options.symmetry != Symmetry::Off {
        subject.face_the_front();
    }

    watch.enter(Stage::Geometry)?;
    let shape = Shape::new(subject.working.mesh.clone());
    let plane = shape.mirror_plane(options.symmetry);
    let boxes = options.boxes.then(|| Boxes::of(&subject)).flatten();
    let of_boxes =
        boxes.as_ref().and_then(|boxes| Some((boxes, boxes.skeleton(options.level_of_detail, plane.as_ref())?)));

    let predicted = match &of_boxes {
        Some((_, made)) => Predicted { skeleton: made.skeleton.clone(), fingers: 0, graph: None, bandwidth: None },
        None => predicted(&shape, nets, plane.as_ref(), options, watch)?,
    };
    let Predicted { skeleton, fingers, graph, bandwidth } = predicted;

    watch.enter(Stage::Skin)?;
    let rigid = of_boxes.as_ref().filter(|_| options.rigid_boxes);
    let (skin, vertices_by_nearest_bone) = match rigid {
        Some((boxes, made)) => (boxes.working_weights(&made.joint_of_part), 0),
        None => weigh(&shape, graph.as_ref(), &Deforming::all(&skeleton), skin_nets, options, watch)?,
    };
    let quality = judged(&shape, &skeleton, &skin, plane.as_ref());

    watch.enter(Stage::Transfer)?;
    let on_upload = match rigid {
        Some((boxes, made)) => boxes.weights(&made.joint_of_part),
        None => transferred(&subject, &skin, options),
    };
    let is_rigid = rigid.is_some();
    let finished = finished(&subject, &shape, &skeleton, on_upload, None, options)?;
    let to_upload = |point: DVec3| subject.normalization.invert(point);
    let facts = Facts {
        working_vertices: shape.mesh.positions.len(),
        working_triangles: shape.mesh.triangles.len(),
        symmetry_plane: plane.map(|plane| subject.plane_in_upload(&plane)),
        symmetry_score: shape.symmetry.score,
        bandwidth,
        fingers,
        boxes: of_boxes.map(|(boxes, _)| boxes.count()),
        is_rigid,
        joints_inside: quality.joints_inside,
        joints_far_outside: Vec::new(),
        vertices_by_nearest_bone,
        vertices_mirrored: finished.mirrored,
        quality,
    };
    Ok(Rigged { rig: Rig { skeleton: skeleton.mapped(to_upload), skin: finished.skin }, facts })
}

/// A skeleton in the normalised frame, and what was found on the way to it.
struct Predicted {
    skeleton: Skeleton,
    fingers: usize,
    /// Made for the networks, if they were asked.
    graph: Option<ShapeGraph>,
    bandwidth: Option<f64>,
}

/// Joints and their tree by the networks, then what an animator would change at once.
fn predicted(
    shape: &Shape,
    nets: &RigNets,
    plane: Option<&SymmetryPlane>,
    options: &RigOptions,
    watch: Watch,
) -> Result<Predicted, RigError> {
    let graph = shape.graph(options.seed);
    watch.enter(Stage::Joints)?;
    let mut detected = find_joints(shape, &graph, nets, plane, options, watch)?;
    watch.enter(Stage::Connect)?;
    let mut tree = connect(shape, &graph, nets, &detected, watch)?;
    if let Some(joined) = joined_ends(&detected, &tree, &shape.solid) {
        tree = connect(shape, &graph, nets, &joined, watch)?;
        detected = joined;
    }
    let (connected, _) = Skeleton::from_tree(&detected.positions, &tree);
    let from_middle = |point: DVec3| plane.map_or(point.x, |plane| plane.signed_distance(point));
    let (mut skeleton, mut fingers) = with_fingers(connected, options.fingers, from_middle);
    let made = hand_rule(options)
        .and_then(|rule| with_finger_bones(&skeleton, (&shape.mesh, &shape.one_ring), plane, from_middle, &rule));
    if let Some(FingerBones { skeleton: with_hands, fingers: all }) = made {
        (skeleton, fingers) = (with_hands, all);
    }
    if let Some(plane) = plane {
        skeleton = with_limb_starts(skeleton, plane, |point| shape.solid.contains(point));
    }
    Ok(Predicted { skeleton, fingers, graph: Some(graph), bandwidth: Some(detected.bandwidth) })
}

/// What counts as a hand; `None` where fingers are the networks' own, or none: a bandwidth asks for RigNet's own joints.
fn hand_rule(options: &RigOptions) -> Option<HandRule> {
    match (options.fingers, options.level_of_detail) {
        (Fingers::Auto, LevelOfDetail::Detail(_)) => Some(HandRule::SURE),
        (Fingers::On, _) => Some(HandRule::LIKELY),
        (Fingers::Auto, _) | (Fingers::Off, _) => None,
    }
}

/// Displacement and attention networks, then clustering (Section 4.1).
fn find_joints(
    shape: &Shape,
    graph: &ShapeGraph,
    nets: &RigNets,
    plane: Option<&SymmetryPlane>,
    options: &RigOptions,
    watch: Watch,
) -> Result<DetectedJoints, RigError> {
    let mut vertices = shape.mesh.positions.clone();
    let (mut displaced, mut attention) = asked(graph, nets, watch)?;
    if let Some(plane) = plane {
        // The mirror image of a symmetric character is the same character, but not to the networks. What they say of it
        // counts as much as what they say of the character: no side is favoured, and a mirrored upload gets the mirrored rig.
        // The mean of both stands for what lies in the middle: a spine is neither left nor right.
        let images: Vec<DVec3> = vertices.iter().map(|&vertex| plane.reflect(vertex)).collect();
        let offsets: Vec<DVec3> =
            points(graph.medial_offsets.view()).into_iter().map(|v| plane.reflect_direction(v)).collect();
        let image = graph.moved(points_f32(&images), points_f32(&offsets));
        let (displaced_images, attention_of_images) = asked(&image, nets, watch)?;
        let images: Vec<DVec3> = displaced_images.into_iter().map(|image| plane.reflect(image)).collect();
        let means: Vec<DVec3> = displaced.iter().zip(&images).map(|(&own, &image)| (own + image) * 0.5).collect();
        let mean_attention: Vec<f64> =
            attention.iter().zip(&attention_of_images).map(|(own, image)| (own + image) * 0.5).collect();
        vertices = vertices.repeat(3);
        displaced.extend(images.into_iter().chain(means));
        attention.extend(attention_of_images.into_iter().chain(mean_attention));
    }
    watch.cancellation.check()?;
    let evidence = Evidence { vertices: &vertices, displaced: &displaced, attention: &attention };
    Ok(detect_joints(&evidence, Some(&shape.solid), plane, options.level_of_detail, watch.cancellation)?)
}

/// Displaced vertices `[V, 3]` and attention `[V]`.
fn asked(graph: &ShapeGraph, nets: &RigNets, watch: Watch) -> Result<(Vec<DVec3>, Vec<f64>), RigError> {
    let displaced = points(nets.displaced(graph, watch.cancellation)?.view());
    let attention = nets.attention(graph, watch.cancellation)?;
    Ok((displaced, attention.into_iter().map(f64::from).collect()))
}

/// Bone and root networks, then the spanning tree (Section 4.2).
fn connect(
    shape: &Shape,
    graph: &ShapeGraph,
    nets: &RigNets,
    detected: &DetectedJoints,
    watch: Watch,
) -> Result<Tree, RigError> {
    let joints = &detected.positions;
    let (pairs, segments) = shape.bone_pairs(joints);
    let described = JointPairs {
        joints: points_f32(joints),
        pairs: Array2::from_shape_fn((pairs.len(), 2), |(pair, end)| pairs[pair][end] as i64),
        features: Array2::from_shape_fn((pairs.len(), 2), |(pair, channel)| match channel {
            0 => segments[pair].length as f32,
            _ => segments[pair].inside_share() as f32,
        }),
    };
    let probability = nets.bone_probability(graph, &described, watch.cancellation)?;
    let root = nets.root(graph, &described, watch.cancellation)?;
    let probability: Vec<f64> = probability.into_iter().map(f64::from).collect();
    let outside: Vec<usize> = segments.iter().map(|segment| segment.outside_count).collect();
    let mut costs = BoneCosts::from_probabilities(joints.len(), &pairs, &probability);
    costs.correct(&pairs, &outside, detected.sides.as_deref(), OutsideRule::Add);
    Ok(match &detected.sides {
        Some(sides) => symmetric_spanning_tree(&costs, joints, sides, root),
        None => minimum_spanning_tree(&costs, root),
    })
}

fn points(array: ArrayView2<f32>) -> Vec<DVec3> {
    array.rows().into_iter().map(|row| DVec3::new(row[0].into(), row[1].into(), row[2].into())).collect()
}
