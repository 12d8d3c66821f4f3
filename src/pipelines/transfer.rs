//! From weights on the working mesh to weights of the upload's vertices: transfer, then what is asked of the result.

use super::prepared::Prepared;
use super::shape::Shape;
use super::{RigOptions, Symmetry};
use crate::geometry::mirror_images::mirror_images;
use crate::geometry::transfer::transfer_map;
use crate::rig::mirror_weights::joint_twins;
use crate::rig::{Skeleton, SkinWeights};

/// Weights of the upload's vertices.
pub(super) struct Transferred {
    pub(super) skin: SkinWeights,
    /// Vertices that have the mean of both sides; `None` where sides were not to be made alike.
    pub(super) mirrored: Option<usize>,
}

/// `skin` is of the working mesh; `skeleton` in the normalised frame.
pub(super) fn transferred(
    subject: &Prepared,
    shape: &Shape,
    skeleton: &Skeleton,
    skin: &SkinWeights,
    options: &RigOptions,
) -> Transferred {
    let trim = options.trim();
    let skin = skin.transferred(&transfer_map(&subject.original, &subject.working), trim);
    let Some(plane) = shape.mirror_plane(options.mirror_weights) else {
        return Transferred { skin, mirrored: (options.mirror_weights != Symmetry::Off).then_some(0) };
    };
    let images = mirror_images(&subject.original, &plane);
    let (skin, mirrored) = skin.mirrored(&images, &joint_twins(skeleton, &plane), trim);
    Transferred { skin, mirrored: Some(mirrored) }
}
