//! From weights on the working mesh to weights of the upload's vertices: transfer, then what is asked of the result.

use super::prepared::Prepared;
use super::shape::Shape;
use super::{RigError, RigOptions, Symmetry};
use crate::geometry::mirror_images::mirror_images;
use crate::geometry::transfer::transfer_map;
use crate::rig::locked_weights::Locks;
use crate::rig::mirror_weights::joint_twins;
use crate::rig::{Skeleton, SkinWeights};

/// Weights of the upload's vertices, as they were asked for.
pub(super) struct Finished {
    pub(super) skin: SkinWeights,
    /// Vertices that have the mean of both sides; `None` where sides were not to be made alike.
    pub(super) mirrored: Option<usize>,
}

/// `skin` is of the working mesh.
pub(super) fn transferred(subject: &Prepared, skin: &SkinWeights, options: &RigOptions) -> SkinWeights {
    skin.transferred(&transfer_map(&subject.original, &subject.working), options.trim())
}

/// `skin` and `locks` are of the upload's vertices; `skeleton` in the normalised frame.
pub(super) fn finished(
    subject: &Prepared,
    shape: &Shape,
    skeleton: &Skeleton,
    skin: SkinWeights,
    locks: Option<&Locks>,
    options: &RigOptions,
) -> Result<Finished, RigError> {
    let trim = options.trim();
    let (skin, mirrored) = match shape.mirror_plane(options.mirror_weights) {
        Some(plane) => {
            let images = mirror_images(&subject.original, &plane);
            let (skin, mirrored) = skin.mirrored(&images, &joint_twins(skeleton, &plane), trim);
            (skin, Some(mirrored))
        }
        None => (skin, (options.mirror_weights != Symmetry::Off).then_some(0)),
    };
    let Some(locks) = locks else { return Ok(Finished { skin, mirrored }) };
    let skin = skin.with_locked(locks, skeleton, trim).map_err(|full| {
        let name = |&joint: &u32| skeleton.joints.get(joint as usize).map_or("", |joint| joint.name.as_str());
        RigError::NoRoomForLocked {
            vertex: full.vertex,
            joints: full.joints.iter().map(name).collect::<Vec<_>>().join(", "),
            limit: trim.max_influences,
        }
    })?;
    Ok(Finished { skin, mirrored })
}
