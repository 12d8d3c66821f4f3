//! Every refusal, whichever door it leaves by, with a stable code. Over HTTP it is written as RFC 9457 problem details; how
//! gRPC tells the same stands in [`crate::server::grpc`].
//!
//! An [`ApiError`] travels in the extensions of an empty response; [`super::outermost`] writes the body, since it
//! knows the request.

pub use super::codes::{Code, Facts};
use crate::jobs::{Denied, ErrorCode, FieldError, FieldProblem, JobError, PassedLimit, Refusal, StoreFailure};
use crate::storage::StoreError;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;
use utoipa::ToSchema;

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

/// Nobody is sent away for longer than the longest window of a quota.
const RETRY_SECONDS_MAX: f64 = 3600.0;

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

    pub fn limit(mut self, limit: Limit) -> Self {
        self.about.limit = Some(limit);
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
        if error.is_away() {
            tracing::error!(%error, "a request failed");
            return Self::new(Code::StoreUnavailable, "the service cannot read or write its files now")
                .retry_after(ROOM_RETRY)
                .hint("send it again; the operator sees the cause in the log");
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
                    | Code::ChecksumMismatch
            ),
        }
    }

    /// After how many seconds to come back.
    pub fn retry_seconds(&self) -> Option<u64> {
        match self.about.retry_after {
            Some(time) => Some(time.as_secs_f64().ceil().clamp(1.0, RETRY_SECONDS_MAX) as u64),
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
