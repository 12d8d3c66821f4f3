//! Why there is no rig, in stable codes, split by who must act.

use super::stage::Stage;
use crate::cancellation::Cancelled;
use crate::formats::ExceededLimit;
use std::borrow::Cow;

/// Why there is no rig. The message names the thing; the hint, the next step.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct JobError {
    pub code: ErrorCode,
    /// Where it happened; `None`: before or after the work.
    pub stage: Option<Stage>,
    pub message: String,
    /// Empty when there is no next step.
    pub hint: String,
    /// The limit that was passed.
    pub limit: Option<PassedLimit>,
}

/// A limit that was passed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PassedLimit {
    pub name: Cow<'static, str>,
    pub max: u64,
    /// `None` where nobody counted on.
    pub actual: Option<u64>,
}

impl From<ExceededLimit> for PassedLimit {
    fn from(limit: ExceededLimit) -> Self {
        Self { name: limit.name.into(), max: limit.max, actual: limit.actual }
    }
}

impl JobError {
    pub fn new(code: ErrorCode, message: impl Into<String>) -> Self {
        Self { code, stage: None, message: message.into(), hint: String::new(), limit: None }
    }

    pub fn at(mut self, stage: Stage) -> Self {
        self.stage = Some(stage);
        self
    }

    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = hint.into();
        self
    }
}

impl From<Cancelled> for JobError {
    fn from(cancelled: Cancelled) -> Self {
        JobError::new(ErrorCode::Canceled, cancelled.to_string())
    }
}

/// Who must act.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorClass {
    /// The sender: the file is refused.
    File,
    /// The sender: the file is fine, but this mesh cannot be rigged so.
    Rig,
    /// The operator, or the authors.
    Service,
    /// Nobody: the caller asked for it.
    Canceled,
}

/// Stable codes of failed work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorCode {
    TooLarge,
    TooManyFaces,
    TooManyVertices,
    ZipBomb,
    UnsupportedMediaType,
    UnreadableMesh,
    NoGeometry,
    NonFiniteVertices,
    UnsupportedExtension,
    MissingResource,
    AlreadyRigged,
    SkeletonInvalid,
    NotRiggable,
    NoJointsFound,
    DegenerateSkeleton,
    Timeout,
    OutOfMemory,
    NumericalFailure,
    OutputInvalid,
    ModelUnavailable,
    /// Two workers in turn were lost while they did it.
    WorkerLost,
    Draining,
    Canceled,
    Internal,
}

impl ErrorCode {
    pub const ALL: [ErrorCode; 24] = [
        ErrorCode::TooLarge,
        ErrorCode::TooManyFaces,
        ErrorCode::TooManyVertices,
        ErrorCode::ZipBomb,
        ErrorCode::UnsupportedMediaType,
        ErrorCode::UnreadableMesh,
        ErrorCode::NoGeometry,
        ErrorCode::NonFiniteVertices,
        ErrorCode::UnsupportedExtension,
        ErrorCode::MissingResource,
        ErrorCode::AlreadyRigged,
        ErrorCode::SkeletonInvalid,
        ErrorCode::NotRiggable,
        ErrorCode::NoJointsFound,
        ErrorCode::DegenerateSkeleton,
        ErrorCode::Timeout,
        ErrorCode::OutOfMemory,
        ErrorCode::NumericalFailure,
        ErrorCode::OutputInvalid,
        ErrorCode::ModelUnavailable,
        ErrorCode::WorkerLost,
        ErrorCode::Draining,
        ErrorCode::Canceled,
        ErrorCode::Internal,
    ];

    /// The code that is called `name`.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|code| code.name() == name)
    }

    pub fn name(self) -> &'static str {
        match self {
            ErrorCode::TooLarge => "too_large",
            ErrorCode::TooManyFaces => "too_many_faces",
            ErrorCode::TooManyVertices => "too_many_vertices",
            ErrorCode::ZipBomb => "zip_bomb",
            ErrorCode::UnsupportedMediaType => "unsupported_media_type",
            ErrorCode::UnreadableMesh => "unreadable_mesh",
            ErrorCode::NoGeometry => "no_geometry",
            ErrorCode::NonFiniteVertices => "non_finite_vertices",
            ErrorCode::UnsupportedExtension => "unsupported_extension",
            ErrorCode::MissingResource => "missing_resource",
            ErrorCode::AlreadyRigged => "already_rigged",
            ErrorCode::SkeletonInvalid => "skeleton_invalid",
            ErrorCode::NotRiggable => "not_riggable",
            ErrorCode::NoJointsFound => "no_joints_found",
            ErrorCode::DegenerateSkeleton => "degenerate_skeleton",
            ErrorCode::Timeout => "timeout",
            ErrorCode::OutOfMemory => "out_of_memory",
            ErrorCode::NumericalFailure => "numerical_failure",
            ErrorCode::OutputInvalid => "output_invalid",
            ErrorCode::ModelUnavailable => "model_unavailable",
            ErrorCode::WorkerLost => "worker_lost",
            ErrorCode::Draining => "draining",
            ErrorCode::Canceled => "canceled",
            ErrorCode::Internal => "internal",
        }
    }

    pub fn class(self) -> ErrorClass {
        match self {
            ErrorCode::TooLarge
            | ErrorCode::TooManyFaces
            | ErrorCode::TooManyVertices
            | ErrorCode::ZipBomb
            | ErrorCode::UnsupportedMediaType
            | ErrorCode::UnreadableMesh
            | ErrorCode::NoGeometry
            | ErrorCode::NonFiniteVertices
            | ErrorCode::UnsupportedExtension
            | ErrorCode::MissingResource
            | ErrorCode::AlreadyRigged
            | ErrorCode::SkeletonInvalid => ErrorClass::File,
            ErrorCode::NotRiggable
            | ErrorCode::NoJointsFound
            | ErrorCode::DegenerateSkeleton
            | ErrorCode::Timeout
            | ErrorCode::OutOfMemory => ErrorClass::Rig,
            ErrorCode::NumericalFailure
            | ErrorCode::OutputInvalid
            | ErrorCode::ModelUnavailable
            | ErrorCode::WorkerLost
            | ErrorCode::Draining
            | ErrorCode::Internal => ErrorClass::Service,
            ErrorCode::Canceled => ErrorClass::Canceled,
        }
    }

    /// Exit status of the command line: 3 the file is refused, 4 it cannot be rigged, 5 internal.
    pub fn exit_code(self) -> u8 {
        match self.class() {
            ErrorClass::File => 3,
            ErrorClass::Rig => 4,
            ErrorClass::Service => 5,
            ErrorClass::Canceled => 130,
        }
    }

    /// Whether the same request may succeed later, unchanged.
    pub fn retryable(self) -> bool {
        matches!(self, ErrorCode::Timeout | ErrorCode::ModelUnavailable | ErrorCode::WorkerLost | ErrorCode::Draining)
    }
}
