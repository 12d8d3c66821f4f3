//! Refusals as gRPC tells them: the code of the protocol, and beside it what the REST problem says, in the details of
//! `google.rpc`.

use super::super::http::error::{ApiError, Code as ProblemCode, ProblemView};
use super::messages::any;
use super::proto::google::rpc;
use super::proto::google::rpc::bad_request::FieldViolation;
use super::proto::google::rpc::quota_failure::Violation;
use crate::jobs::ErrorCode;
use axum::body::Body;
use axum::http::{Response, StatusCode, header};
use prost::Message;
use std::collections::HashMap;
use std::error::Error;
use std::sync::Arc;
use tonic::{Code, Status};

const DOMAIN: &str = "rigsmith";

/// The code of the protocol nearest to the HTTP status; the reason in the details tells exactly.
fn code(problem: ProblemCode) -> Code {
    match problem {
        ProblemCode::Work(ErrorCode::Canceled) => return Code::Cancelled,
        ProblemCode::IdempotencyInProgress => return Code::Aborted,
        _ => {}
    }
    match problem.facts().status {
        StatusCode::UNAUTHORIZED => Code::Unauthenticated,
        StatusCode::FORBIDDEN => Code::PermissionDenied,
        StatusCode::NOT_FOUND | StatusCode::GONE => Code::NotFound,
        StatusCode::METHOD_NOT_ALLOWED => Code::Unimplemented,
        StatusCode::REQUEST_TIMEOUT | StatusCode::GATEWAY_TIMEOUT => Code::DeadlineExceeded,
        StatusCode::CONFLICT | StatusCode::FAILED_DEPENDENCY => Code::FailedPrecondition,
        StatusCode::RANGE_NOT_SATISFIABLE => Code::OutOfRange,
        StatusCode::TOO_MANY_REQUESTS => Code::ResourceExhausted,
        StatusCode::SERVICE_UNAVAILABLE => Code::Unavailable,
        status if status.is_client_error() => Code::InvalidArgument,
        _ => Code::Internal,
    }
}

/// A refusal, or the failure of a job, as a message.
pub fn rpc_status(error: &ApiError) -> rpc::Status {
    let problem = error.view("", "");
    let mut details = vec![any("google.rpc.ErrorInfo", &info(&problem))];
    if !problem.errors.is_empty() {
        let field_violations = problem.errors.iter().map(|error| FieldViolation {
            field: error.field.clone(),
            description: error.detail.clone(),
            reason: error.code.to_owned(),
            localized_message: None,
        });
        let refused = rpc::BadRequest { field_violations: field_violations.collect() };
        details.push(any("google.rpc.BadRequest", &refused));
    }
    let code = code(error.code);
    if code == Code::ResourceExhausted {
        let subject = match error.code {
            ProblemCode::QueueFull => "service",
            _ => "caller",
        };
        let violation =
            Violation { subject: subject.to_owned(), description: problem.detail.clone(), ..Violation::default() };
        details.push(any("google.rpc.QuotaFailure", &rpc::QuotaFailure { violations: vec![violation] }));
    }
    if let Some(seconds) = error.retry_seconds() {
        let retry_delay = Some(prost_types::Duration { seconds: seconds as i64, nanos: 0 });
        details.push(any("google.rpc.RetryInfo", &rpc::RetryInfo { retry_delay }));
    }
    rpc::Status { code: code as i32, message: problem.detail, details }
}

/// What a program needs of a problem.
fn info(problem: &ProblemView) -> rpc::ErrorInfo {
    let mut metadata = HashMap::from([
        ("retryable".to_owned(), problem.retryable.to_string()),
        ("type".to_owned(), problem.r#type.clone()),
    ]);
    let mut tell = |name: &str, value: Option<String>| metadata.extend(value.map(|value| (name.to_owned(), value)));
    tell("hint", problem.hint.clone());
    tell("stage", problem.stage.map(str::to_owned));
    if let Some(limit) = &problem.limit {
        tell("limit", Some(limit.name.clone()));
        tell("limit_max", Some(limit.max.to_string()));
        tell("limit_actual", limit.actual.map(|actual| actual.to_string()));
    }
    rpc::ErrorInfo { reason: problem.code.to_owned(), domain: DOMAIN.to_owned(), metadata }
}

impl From<ApiError> for Status {
    fn from(error: ApiError) -> Self {
        let told = rpc_status(&error);
        let mut status =
            Status::with_details(Code::from_i32(told.code), told.message.clone(), told.encode_to_vec().into());
        status.set_source(Arc::new(error));
        status
    }
}

/// Writes a refusal that was made before a gRPC handler was reached. Fields of the answer stay.
pub fn write_refusal(response: &mut Response<Body>, refusal: &ApiError) {
    let written: Response<Body> = Status::from(refusal.clone()).into_http();
    *response.status_mut() = written.status();
    response.headers_mut().remove(header::CONTENT_LENGTH);
    response.headers_mut().extend(written.headers().clone());
    *response.body_mut() = Body::empty();
}

/// The code of the problem in an answer of a gRPC handler; empty when it is none of ours.
pub fn refused_with(response: &Response<Body>) -> &'static str {
    let source = response.extensions().get::<Status>().and_then(Error::source);
    let error = source.and_then(|source| source.downcast_ref::<ApiError>());
    error.map_or("", |error| error.code.facts().code)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_problem_has_a_code_of_the_protocol_and_only_our_own_faults_are_internal() {
        for problem in ProblemCode::all() {
            let (code, facts) = (code(problem), problem.facts());
            assert!(code != Code::Ok && code != Code::Unknown, "{}", facts.code);
            assert_eq!(code == Code::Internal, facts.status == StatusCode::INTERNAL_SERVER_ERROR, "{}", facts.code);
        }
    }
}
