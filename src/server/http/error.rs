//! Every refusal, whichever door it leaves by, with a stable code. Over HTTP it is written as RFC 9457 problem details; how
//! gRPC tells the same stands in [`crate::server::grpc`].
//!
//! An [`ApiError`] travels in the extensions of an empty response; [`super::outermost`] writes the body, since it
//! knows the request.

use crate::jobs::{Denied, ErrorCode, FieldError, FieldProblem, JobError, PassedLimit, Refusal, StoreFailure};
use crate::storage::StoreError;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;
use utoipa::ToSchema;

/// Stable codes: those of failed work, and those of requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Code {
    Work(ErrorCode),
    InvalidJson,
    UnknownField,
    InvalidParameter,
    InvalidMultipart,
    UploadIncomplete,
    Unauthenticated,
    RateLimited,
    NotFound,
    Expired,
    MethodNotAllowed,
    NotAcceptable,
    UploadTimeout,
    Conflict,
    NotCancelable,
    RangeNotSatisfiable,
    FetchFailed,
    QueueFull,
    QuotaExceeded,
    IdempotencyMismatch,
    IdempotencyInProgress,
    StoreUnavailable,
    Starting,
}

/// What is fixed about a code.
pub struct Facts {
    pub code: &'static str,
    pub status: StatusCode,
    pub title: &'static str,
    pub meaning: &'static str,
}

impl Code {
    /// All codes, for the pages that explain them.
    pub fn all() -> impl Iterator<Item = Code> {
        const OF_REQUESTS: [Code; 22] = [
            Code::InvalidJson,
            Code::UnknownField,
            Code::InvalidParameter,
            Code::InvalidMultipart,
            Code::UploadIncomplete,
            Code::Unauthenticated,
            Code::RateLimited,
            Code::NotFound,
            Code::Expired,
            Code::MethodNotAllowed,
            Code::NotAcceptable,
            Code::UploadTimeout,
            Code::Conflict,
            Code::NotCancelable,
            Code::RangeNotSatisfiable,
            Code::FetchFailed,
            Code::QueueFull,
            Code::QuotaExceeded,
            Code::IdempotencyMismatch,
            Code::IdempotencyInProgress,
            Code::StoreUnavailable,
            Code::Starting,
        ];
        OF_REQUESTS.into_iter().chain(ErrorCode::ALL.into_iter().map(Code::Work))
    }

    /// Name, HTTP status, and what it means to the caller.
    #[rustfmt::skip]
    pub fn facts(self) -> Facts {
        use ErrorCode as Work;
        use StatusCode as Status;
        let (code, status, title, meaning) = match self {
            Code::InvalidJson => ("invalid_json", Status::BAD_REQUEST, "The JSON cannot be read", "The part named options must be one JSON object."),
            Code::UnknownField => ("unknown_field", Status::BAD_REQUEST, "Unknown field", "A query parameter, form field or JSON member has a name that this version does not know. Nothing is ignored silently."),
            Code::InvalidParameter => ("invalid_parameter", Status::BAD_REQUEST, "Invalid parameter", "A value is of the wrong kind, out of range, or contradicts another one; errors names each."),
            Code::InvalidMultipart => ("invalid_multipart", Status::BAD_REQUEST, "The form cannot be read", "The body is not the multipart/form-data that its Content-Type declares."),
            Code::UploadIncomplete => ("upload_incomplete", Status::BAD_REQUEST, "The upload ended early", "The connection closed before the declared body was complete. Nothing was kept."),
            Code::Unauthenticated => ("unauthenticated", Status::UNAUTHORIZED, "Who are you?", "This service asks for a key: Authorization: Bearer and the key. The one sent, if any, is not known."),
            Code::RateLimited => ("rate_limited", Status::TOO_MANY_REQUESTS, "Too many requests", "The key asks more often than it may. RateLimit says what is left; come back after Retry-After seconds."),
            Code::NotFound => ("not_found", Status::NOT_FOUND, "Not found", "There is no such path, job or artifact, or it is forgotten."),
            Code::Expired => ("expired", Status::GONE, "Results expired", "The job succeeded, but its files are no longer kept."),
            Code::MethodNotAllowed => ("method_not_allowed", Status::METHOD_NOT_ALLOWED, "Method not allowed", "The path exists, but not for this HTTP method; Allow names those that do."),
            Code::NotAcceptable => ("not_acceptable", Status::NOT_ACCEPTABLE, "Not acceptable", "The Accept header leaves no form in which the answer can be given."),
            Code::UploadTimeout => ("upload_timeout", Status::REQUEST_TIMEOUT, "The upload stalled", "No byte of the body arrived for too long, or the whole took too long. Nothing was kept."),
            Code::Conflict => ("conflict", Status::CONFLICT, "Not in this state", "The job is in a state that does not allow this."),
            Code::NotCancelable => ("not_cancelable", Status::CONFLICT, "The job is over", "Only jobs that wait or run can be canceled."),
            Code::RangeNotSatisfiable => ("range_not_satisfiable", Status::RANGE_NOT_SATISFIABLE, "Range not satisfiable", "The requested range lies outside the file; Content-Range gives its size."),
            Code::FetchFailed => ("fetch_failed", Status::FAILED_DEPENDENCY, "The mesh could not be fetched", "asset.url leads nowhere, inside, or to something else than the request says; detail says which."),
            Code::QueueFull => ("queue_full", Status::TOO_MANY_REQUESTS, "The queue is full", "The service is at its limit and refuses early. Come back after Retry-After seconds."),
            Code::QuotaExceeded => ("quota_exceeded", Status::TOO_MANY_REQUESTS, "Your quota is used up", "You have as many unfinished jobs as one caller may have."),
            Code::IdempotencyMismatch => ("idempotency_mismatch", Status::UNPROCESSABLE_ENTITY, "The key belongs to another request", "Within 24 hours an Idempotency-Key stands for one request; this one differs from it."),
            Code::IdempotencyInProgress => ("idempotency_in_progress", Status::CONFLICT, "Still being answered", "The first request with this Idempotency-Key has no answer yet."),
            Code::StoreUnavailable => ("store_unavailable", Status::SERVICE_UNAVAILABLE, "Jobs cannot be written down", "The disk of the service is full or cannot be written. What was accepted before is kept."),
            Code::Starting => ("starting", Status::SERVICE_UNAVAILABLE, "The service is starting", "The networks are being loaded and tested."),
            Code::Work(Work::TooLarge) => ("too_large", Status::PAYLOAD_TOO_LARGE, "The upload is too large", "The upload has more bytes than the service takes."),
            Code::Work(Work::TooManyFaces) => ("too_many_faces", Status::PAYLOAD_TOO_LARGE, "Too many faces", "The mesh has more faces than the service takes."),
            Code::Work(Work::TooManyVertices) => ("too_many_vertices", Status::PAYLOAD_TOO_LARGE, "Too many vertices", "The mesh has more vertices than the service takes."),
            Code::Work(Work::ZipBomb) => ("zip_bomb", Status::PAYLOAD_TOO_LARGE, "The archive grows too much", "The archive would grow beyond the limits when unpacked."),
            Code::Work(Work::UnsupportedMediaType) => ("unsupported_media_type", Status::UNSUPPORTED_MEDIA_TYPE, "Not a mesh format that is read here", "Read are GLB, glTF, OBJ, PLY, STL, FBX, and zip archives of them."),
            Code::Work(Work::UnreadableMesh) => ("unreadable_mesh", Status::UNPROCESSABLE_ENTITY, "The mesh cannot be read", "The file is damaged, or breaks the rules of its format."),
            Code::Work(Work::NoGeometry) => ("no_geometry", Status::UNPROCESSABLE_ENTITY, "No triangles", "The file holds no surface to rig."),
            Code::Work(Work::NonFiniteVertices) => ("non_finite_vertices", Status::UNPROCESSABLE_ENTITY, "Positions that are no numbers", "Some vertex positions are infinite or not a number."),
            Code::Work(Work::UnsupportedExtension) => ("unsupported_extension", Status::UNPROCESSABLE_ENTITY, "A required extension is not supported", "The file requires a glTF extension that is not read here."),
            Code::Work(Work::MissingResource) => ("missing_resource", Status::UNPROCESSABLE_ENTITY, "A file is missing", "The main file refers to another one that was not sent."),
            Code::Work(Work::AlreadyRigged) => ("already_rigged", Status::UNPROCESSABLE_ENTITY, "The file has a skeleton", "Send existing_rig=replace to remove it and make a new one."),
            Code::Work(Work::SkeletonInvalid) => ("skeleton_invalid", Status::UNPROCESSABLE_ENTITY, "The skeleton cannot be used", "The skeleton sent along is no tree of named joints with finite positions; detail names the joint."),
            Code::Work(Work::NotRiggable) => ("not_riggable", Status::UNPROCESSABLE_ENTITY, "The mesh cannot be rigged", "The mesh is readable, but not fit for a skeleton."),
            Code::Work(Work::NoJointsFound) => ("no_joints_found", Status::UNPROCESSABLE_ENTITY, "No joints found", "The method found no joints in this mesh, with any setting that it tried."),
            Code::Work(Work::DegenerateSkeleton) => ("degenerate_skeleton", Status::UNPROCESSABLE_ENTITY, "Degenerate skeleton", "The joints found make no usable skeleton."),
            Code::Work(Work::Timeout) => ("timeout", Status::GATEWAY_TIMEOUT, "The job took too long", "The job was stopped after the longest time that the service gives one."),
            Code::Work(Work::OutOfMemory) => ("out_of_memory", Status::PAYLOAD_TOO_LARGE, "Not enough memory", "The job needs more memory than the service gives its jobs."),
            Code::Work(Work::NumericalFailure) => ("numerical_failure", Status::INTERNAL_SERVER_ERROR, "A network gave no numbers", "A network gave values that are infinite or not a number. This is a defect of the service."),
            Code::Work(Work::OutputInvalid) => ("output_invalid", Status::INTERNAL_SERVER_ERROR, "The result failed its check", "The file made did not pass its validation and is withheld. This is a defect of the service."),
            Code::Work(Work::ModelUnavailable) => ("model_unavailable", Status::SERVICE_UNAVAILABLE, "A network is unavailable", "The method's networks are not here, or failed their self-test. No other method is used in its place."),
            Code::Work(Work::WorkerLost) => ("worker_lost", Status::SERVICE_UNAVAILABLE, "The worker was lost", "The process that did the work ended, twice, before the job was done."),
            Code::Work(Work::Draining) => ("draining", Status::SERVICE_UNAVAILABLE, "The service is stopping", "The service was asked to stop and takes no new work. Send the request again later."),
            Code::Work(Work::Canceled) => ("canceled", Status::CONFLICT, "Canceled", "The job was canceled by request."),
            Code::Work(Work::Internal) => ("internal", Status::INTERNAL_SERVER_ERROR, "An error of the service", "Not your fault. The request id leads the operator to the cause."),
        };
        Facts { code, status, title, meaning }
    }
}

/// A refusal of one request.
#[derive(Clone, Debug)]
pub struct ApiError {
    pub code: Code,
    about: Box<About>,
}

/// What is particular to one refusal.
#[derive(Clone, Debug, Default)]
struct About {
    detail: String,
    hint: String,
    stage: Option<&'static str>,
    errors: Vec<FieldError>,
    limit: Option<Limit>,
    retry_after: Option<Duration>,
    headers: Vec<(HeaderName, HeaderValue)>,
}

/// When the store is full, and a job has to finish or expire first.
const ROOM_RETRY: Duration = Duration::from_secs(30);
/// When nothing better is known.
const UNAVAILABLE_RETRY_SECONDS: u64 = 5;

/// A limit that was passed.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Limit {
    #[schema(example = "upload_bytes")]
    pub name: String,
    pub max: u64,
    /// `null` when reading stopped at the limit.
    pub actual: Option<u64>,
}

impl From<PassedLimit> for Limit {
    fn from(limit: PassedLimit) -> Self {
        Self { name: limit.name.into_owned(), max: limit.max, actual: limit.actual }
    }
}

impl ApiError {
    pub fn new(code: Code, detail: impl Into<String>) -> Self {
        Self { code, about: Box::new(About { detail: detail.into(), ..About::default() }) }
    }

    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.about.hint = hint.into();
        self
    }

    pub fn retry_after(mut self, time: Duration) -> Self {
        self.about.retry_after = Some(time);
        self
    }

    pub fn header(mut self, name: HeaderName, value: &str) -> Self {
        if let Ok(value) = HeaderValue::from_str(value) {
            self.about.headers.push((name, value));
        }
        self
    }

    pub fn not_found(what: &str) -> Self {
        Self::new(Code::NotFound, format!("there is no {what}"))
    }

    pub fn field(field: &str, detail: impl Into<String>) -> Self {
        let detail = detail.into();
        Self::fields(vec![FieldError { field: field.to_owned(), problem: FieldProblem::Invalid, detail }])
    }

    pub fn unknown_field(field: &str, known: &str) -> Self {
        let detail = format!("no such field; there are {known}");
        Self::fields(vec![FieldError { field: field.to_owned(), problem: FieldProblem::Unknown, detail }])
    }

    /// Refused fields, at least one.
    pub fn fields(errors: Vec<FieldError>) -> Self {
        let unknown = errors.iter().any(|error| error.problem == FieldProblem::Unknown);
        let detail = errors.iter().map(FieldError::to_string).collect::<Vec<_>>().join("; ");
        let code = if unknown { Code::UnknownField } else { Code::InvalidParameter };
        let mut error = Self::new(code, detail).hint("/docs lists every field with its range");
        error.about.errors = errors;
        error
    }

    pub fn too_large(max: u64, actual: Option<u64>) -> Self {
        let seen = actual.map_or_else(|| format!("more than {max}"), |actual| actual.to_string());
        let detail = format!("the upload has {seen} bytes; {max} are accepted");
        let mut error = Self::new(Code::Work(ErrorCode::TooLarge), detail)
            .hint("leave textures out, or simplify the mesh; neither changes the rig much");
        error.about.limit = Some(Limit { name: "upload_bytes".to_owned(), max, actual });
        error
    }

    /// Logs `cause`, which the caller does not see.
    pub fn internal(cause: &dyn std::fmt::Display) -> Self {
        tracing::error!(%cause, "a request failed");
        Self::new(Code::Work(ErrorCode::Internal), "the service could not answer this request")
            .hint("send it again; if it fails again, tell the operator the request id")
    }

    pub fn store(error: &StoreError) -> Self {
        if error.is_full() {
            return Self::new(Code::QueueFull, "the service has no room for another upload").retry_after(ROOM_RETRY);
        }
        Self::internal(error)
    }

    /// The body, for the request that is answered.
    pub fn view(&self, instance: &str, request_id: &str) -> ProblemView {
        let Facts { code, status, title, .. } = self.code.facts();
        let errors = self.about.errors.iter().map(|error| FieldErrorView {
            field: error.field.clone(),
            code: match error.problem {
                FieldProblem::Unknown => "unknown_field",
                FieldProblem::Invalid => "invalid_parameter",
            },
            detail: error.detail.clone(),
        });
        ProblemView {
            r#type: format!("/v1/problems/{code}"),
            title,
            status: status.as_u16(),
            detail: self.about.detail.clone(),
            instance: instance.to_owned(),
            code,
            retryable: self.retryable(),
            stage: self.about.stage,
            hint: Some(self.about.hint.clone()).filter(|hint| !hint.is_empty()),
            request_id: request_id.to_owned(),
            errors: errors.collect(),
            limit: self.about.limit.clone(),
        }
    }

    fn retryable(&self) -> bool {
        match self.code {
            Code::Work(code) => code.retryable(),
            code => matches!(
                code,
                Code::QueueFull
                    | Code::QuotaExceeded
                    | Code::RateLimited
                    | Code::IdempotencyInProgress
                    | Code::StoreUnavailable
                    | Code::Starting
                    | Code::UploadTimeout
                    | Code::UploadIncomplete
            ),
        }
    }

    /// After how many seconds to come back.
    pub fn retry_seconds(&self) -> Option<u64> {
        match self.about.retry_after {
            Some(time) => Some(time.as_secs_f64().ceil().clamp(1.0, 60.0) as u64),
            None => (self.code.facts().status == StatusCode::SERVICE_UNAVAILABLE).then_some(UNAVAILABLE_RETRY_SECONDS),
        }
    }
}

impl fmt::Display for ApiError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.about.detail)
    }
}

impl std::error::Error for ApiError {}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let mut response = self.code.facts().status.into_response();
        if let Some(seconds) = self.retry_seconds() {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        response.headers_mut().extend(self.about.headers.clone());
        response.extensions_mut().insert(Arc::new(self));
        response
    }
}

impl From<JobError> for ApiError {
    fn from(error: JobError) -> Self {
        let mut made = Self::new(Code::Work(error.code), error.message).hint(error.hint);
        made.about.stage = error.stage.map(|stage| stage.name());
        made.about.limit = error.limit.map(Limit::from);
        made
    }
}

impl From<Refusal> for ApiError {
    fn from(refusal: Refusal) -> Self {
        let detail = refusal.to_string();
        match refusal {
            Refusal::Starting => Self::new(Code::Starting, detail),
            Refusal::Draining => Self::new(Code::Work(ErrorCode::Draining), detail),
            Refusal::ModelUnavailable { .. } => Self::new(Code::Work(ErrorCode::ModelUnavailable), detail)
                .hint("GET /v1/methods says what is missing, and which methods run here"),
            Refusal::QueueFull { retry_after, .. } => Self::new(Code::QueueFull, detail)
                .retry_after(retry_after)
                .hint("send the same request again after Retry-After seconds"),
            Refusal::Option(error) => Self::fields(vec![error]),
            Refusal::QuotaExceeded { retry_after, .. } => Self::new(Code::QuotaExceeded, detail)
                .retry_after(retry_after)
                .hint("wait for one of your jobs to end, or cancel one"),
            Refusal::Store(error) => Self::store(&error),
            Refusal::Unavailable(error) => error.into(),
            Refusal::NotFound(_) => Self::new(Code::NotFound, detail),
            Refusal::IdempotencyMismatch => {
                Self::new(Code::IdempotencyMismatch, detail).hint("take a new key for another request")
            }
            Refusal::IdempotencyInProgress => Self::new(Code::IdempotencyInProgress, detail)
                .retry_after(Duration::from_secs(1))
                .hint("send the same request again in a moment"),
            Refusal::ClientIdTaken => Self::new(Code::Conflict, detail).hint("take another id for another request"),
            Refusal::Check(error) => error.into(),
        }
    }
}

impl From<StoreFailure> for ApiError {
    fn from(error: StoreFailure) -> Self {
        tracing::error!(%error, "a request failed");
        Self::new(Code::StoreUnavailable, "the service cannot read or write its jobs now")
            .hint("send it again; the operator sees the cause in the log")
    }
}

/// Which wish was denied decides the code.
pub fn denied(denied: Denied, code: Code) -> ApiError {
    match denied {
        Denied::NotFound => ApiError::not_found("such job"),
        Denied::State(state) => ApiError::new(code, format!("the job is {}", state.name())),
        Denied::Unavailable(error) => error.into(),
    }
}

/// Why a request was refused (RFC 9457).
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Problem)]
pub struct ProblemView {
    /// A page about this kind of problem, relative to the service.
    #[schema(example = "/v1/problems/queue_full")]
    pub r#type: String,
    #[schema(example = "The queue is full")]
    pub title: &'static str,
    #[schema(example = 429)]
    pub status: u16,
    /// What happened this time.
    #[schema(example = "100 jobs are waiting, and no more may")]
    pub detail: String,
    /// The path that was asked.
    #[schema(example = "/v1/rigs")]
    pub instance: String,
    /// Stable; for programs.
    #[schema(example = "queue_full")]
    pub code: &'static str,
    /// Whether the same request may succeed later, unchanged.
    #[schema(example = true)]
    pub retryable: bool,
    /// Where in the work it happened.
    pub stage: Option<&'static str>,
    /// The next step.
    #[schema(example = "send the same request again after Retry-After seconds")]
    pub hint: Option<String>,
    #[schema(example = "0193a5b0c7d87c4aa2f5b1f0e5d9a7c3")]
    pub request_id: String,
    /// One entry per refused field.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub errors: Vec<FieldErrorView>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit: Option<Limit>,
}

/// Why one field was refused.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = FieldError)]
pub struct FieldErrorView {
    #[schema(example = "detail")]
    pub field: String,
    #[schema(example = "invalid_parameter")]
    pub code: &'static str,
    #[schema(example = "1.5 is outside 0 to 1")]
    pub detail: String,
}
