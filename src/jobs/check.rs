//! What a look at a mesh tells, without rigging it.

use super::engine::Upload;
use super::job::Notice;
use super::options::RigOptions;
use crate::formats::{Contents, ExistingRig, ExistingRigPolicy, Finding, Format, Severity};
use crate::pipelines::Method;
use crate::pipelines::orientation::Orientation;
use crate::pipelines::survey::{Survey, survey};

/// The facts of an upload, and whether a rig can be made of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Check {
    pub riggable: Riggable,
    pub suggested_method: &'static str,
    pub format: Format,
    pub vertices: usize,
    pub faces: usize,
    pub primitives: usize,
    pub contents: Contents,
    pub existing_rig: Option<ExistingRig>,
    pub orientation: Orientation,
    /// Whether the axes were given (by caller or file) rather than guessed.
    pub orientation_given: bool,
    /// `None` when nothing of the mesh has an area.
    pub survey: Option<Survey>,
    /// What the job of the same request begins its warnings with; beyond that, why it would be refused.
    pub findings: Vec<Notice>,
}

/// Whether a rig request would be taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Riggable {
    Yes,
    /// Not as it was asked; the findings say why.
    Maybe,
    No,
}

impl Riggable {
    pub const ALL: [Self; 3] = [Self::Yes, Self::Maybe, Self::No];

    pub fn name(self) -> &'static str {
        match self {
            Self::Yes => "yes",
            Self::Maybe => "maybe",
            Self::No => "no",
        }
    }
}

impl Check {
    pub(super) fn of(method: Method, options: &RigOptions, upload: Upload) -> Self {
        let Upload { asset, orientation, orientation_given, mut findings } = upload;
        let survey = survey(&asset.mesh, orientation.rotation());
        let is_refused = asset.existing_rig.is_some() && options.existing_rig == ExistingRigPolicy::Reject;
        if is_refused {
            findings.push(Finding {
                code: "already_rigged",
                parts: Vec::new(),
                severity: Severity::Warning,
                message: "the file is already rigged; a rig request would be refused".into(),
                hint:
                    "set existing_rig to replace to rig it anew, or to reskin to keep its skeleton and make new weights"
                        .into(),
            });
        }
        let is_bare = asset.existing_rig.is_none() && options.existing_rig == ExistingRigPolicy::Reskin;
        if is_bare {
            findings.push(Finding {
                code: "not_rigged",
                parts: Vec::new(),
                severity: Severity::Warning,
                message: "the file has no skeleton to keep; a rig request would be refused".into(),
                hint: "leave existing_rig out to have a skeleton made".into(),
            });
        }
        Self {
            riggable: match &survey {
                Some(_) if is_refused || is_bare => Riggable::Maybe,
                Some(_) => Riggable::Yes,
                None => Riggable::No,
            },
            suggested_method: method.name(),
            format: asset.format,
            vertices: asset.mesh.positions.len(),
            faces: asset.mesh.triangles.len(),
            primitives: asset.parts.len(),
            contents: asset.contents,
            existing_rig: asset.existing_rig,
            orientation,
            orientation_given,
            survey,
            findings: findings.into_iter().map(Notice::from).collect(),
        }
    }
}
