//! Every code that an error may have: its HTTP status, and what it means to the caller.

use crate::jobs::ErrorCode;
use axum::http::StatusCode;

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
    UnsupportedVersion,
    ChecksumMismatch,
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
        const OF_REQUESTS: [Code; 24] = [
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
            Code::UnsupportedVersion,
            Code::ChecksumMismatch,
        ];
        OF_REQUESTS.into_iter().chain(ErrorCode::ALL.into_iter().map(Code::Work))
    }

    /// Name, HTTP status, and what it means to the caller.
    #[rustfmt::skip]
    pub fn facts(self) -> Facts {
        use ErrorCode as Work;
        use StatusCode as Status;
        let (code, status, title, meaning) = match self {
            Code::UnsupportedVersion => ("unsupported_version", Status::PRECONDITION_FAILED, "Another version is spoken here", "Resumable uploads are tus 1.0.0: every request but GET and OPTIONS says so in Tus-Resumable."),
            Code::ChecksumMismatch => ("checksum_mismatch", Status::from_u16(460).unwrap_or(Status::BAD_REQUEST), "The bytes are not those that were meant", "What arrived does not have the checksum that was sent along. Nothing of it was kept; send it again from the same offset."),
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
            Code::QuotaExceeded => ("quota_exceeded", Status::TOO_MANY_REQUESTS, "Your quota is used up", "You have as many unfinished jobs as one caller may have, or have sent as many bytes as one key may within the hour; limit says which."),
            Code::IdempotencyMismatch => ("idempotency_mismatch", Status::UNPROCESSABLE_ENTITY, "The key belongs to another request", "Within 24 hours an Idempotency-Key stands for one request; this one differs from it."),
            Code::IdempotencyInProgress => ("idempotency_in_progress", Status::CONFLICT, "Still being answered", "The first request with this Idempotency-Key has no answer yet."),
            Code::StoreUnavailable => ("store_unavailable", Status::SERVICE_UNAVAILABLE, "Jobs cannot be written down", "The disk, database or storage of the service is full or does not answer. What was accepted before is kept."),
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
            Code::Work(Work::AlreadyRigged) => ("already_rigged", Status::UNPROCESSABLE_ENTITY, "The file has a skeleton", "Send existing_rig=replace to remove it and make a new one, or existing_rig=reskin to keep it and make new weights."),
            Code::Work(Work::SkeletonInvalid) => ("skeleton_invalid", Status::UNPROCESSABLE_ENTITY, "The skeleton cannot be used", "The skeleton sent along is no tree of named joints with finite positions, or has no joint that the request names; detail names the joint."),
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
