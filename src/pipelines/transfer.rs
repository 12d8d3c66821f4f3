//! From weights on the working mesh to weights of the upload's vertices: transfer, then what is asked of the result.

use super::boxes::Boxes;
use super::prepared::Prepared;
use super::shape::Shape;
use super::{RigError, RigOptions, Symmetry};
use crate::geometry::mirror_images::mirror_images;
use crate::geometry::transfer::transfer_map;
use crate::rig::locked_weights::Locks;
use crate::rig::mirror_weights::joint_twins;
use crate::rig::{Skeleton, SkinWeights};

/// Weights of the upload's vertices.
pub(super) struct Transferred {
    pub(super) skin: SkinWeights,
    /// Vertices that have the mean of both sides; `None` where sides were not to be made alike.
    pub(super) mirrored: Option<usize>,
    /// The joint that each box follows, where boxes move as a whole.
    pub(super) joint_of_box: Option<Vec<u32>>,
}

/// `skin` is of the working mesh; `skeleton` in the normalised frame; `boxes` are to move as a whole; `locks` are of the upload's
/// vertices.
pub(super) fn transferred(
    subject: &Prepared,
    shape: &Shape,
    skeleton: &Skeleton,
    skin: &SkinWeights,
    boxes: Option<&Boxes>,
    locks: Option<&Locks>,
    options: &RigOptions,
) -> Result<Transferred, RigError> {
    let trim = options.trim();
    let skin = skin.transferred(&transfer_map(&subject.original, &subject.working), trim);
    let joint_of_box = boxes.map(|boxes| boxes.joints_by_weight(&skin, skeleton.joints.len()));
    let skin = match (boxes, &joint_of_box) {
        (Some(boxes), Some(joint_of_box)) => boxes.weights(joint_of_box),
        _ => skin,
    };
    let (skin, mirrored) = match shape.mirror_plane(options.mirror_weights) {
        Some(plane) => {
            let images = mirror_images(&subject.original, &plane);
            let (skin, mirrored) = skin.mirrored(&images, &joint_twins(skeleton, &plane), trim);
            (skin, Some(mirrored))
        }
        None => (skin, (options.mirror_weights != Symmetry::Off).then_some(0)),
    };
    let Some(locks) = locks else { return Ok(Transferred { skin, mirrored, joint_of_box }) };
    let skin = skin.with_locked(locks, skeleton, trim).map_err(|full| {
        let name = |&joint: &u32| skeleton.joints.get(joint as usize).map_or("", |joint| joint.name.as_str());
        RigError::NoRoomForLocked {
            vertex: full.vertex,
            joints: full.joints.iter().map(name).collect::<Vec<_>>().join(", "),
            limit: trim.max_influences,
        }
    })?;
    Ok(Transferred { skin, mirrored, joint_of_box })
}
