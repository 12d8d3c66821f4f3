//! What happens to every request: an id, a line in the log, a count, and a body for every refusal.

use super::error::{ApiError, ProblemView};
use crate::jobs::JobId;
use crate::server::grpc;
use crate::telemetry::metrics as names;
use crate::telemetry::traces::TraceParent;
use axum::body::Body;
use axum::extract::{MatchedPath, Request};
use axum::http::{HeaderName, HeaderValue, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use metrics::{counter, gauge, histogram};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tracing::Instrument;
use uuid::Uuid;

pub const X_REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
const TRACE_PARENT: HeaderName = HeaderName::from_static("traceparent");
const SERVER_TIMING: HeaderName = HeaderName::from_static("server-timing");
const REQUEST_ID_BYTES_MAX: usize = 128;

/// The job that a request is about, for its line in the log. Handlers put it into the answer's extensions.
#[derive(Clone, Copy, Debug)]
pub struct AboutJob(pub JobId);

/// Wraps the whole service.
pub async fn outermost(request: Request, next: Next) -> Response {
    let began = Instant::now();
    let id = request_id(&request);
    let method = request.method().clone();
    let path = request.uri().path().to_owned();
    let route = Route::of(&request);
    let is_grpc = grpc::is_grpc(request.headers());
    let parent = request.headers().get(TRACE_PARENT).and_then(|value| TraceParent::parse(value.to_str().ok()?));
    let trace = parent.map(|parent| parent.trace_id()).unwrap_or_default();
    let empty = tracing::field::Empty;
    let span = tracing::info_span!("request", request.id = id, trace.id = trace, %method, path, caller = empty);
    if let Some(parent) = parent {
        parent.adopt(&span);
    }
    let in_flight = InFlight::new();
    let mut response = next.run(request).instrument(span.clone()).await;
    drop(in_flight);
    let refusal = response.extensions_mut().remove::<Arc<ApiError>>();
    let code = match &refusal {
        Some(refusal) => refusal.code.facts().code,
        None => grpc::refused_with(&response),
    };
    match refusal {
        Some(refusal) if is_grpc => grpc::write_refusal(&mut response, &refusal),
        Some(refusal) => write_problem(&mut response, &refusal.view(&path, &id)),
        None => {}
    }
    let job = response.extensions().get::<AboutJob>().map(|AboutJob(job)| job.to_string()).unwrap_or_default();
    let taken = began.elapsed();
    let fields = response.headers_mut();
    if let Ok(id) = HeaderValue::from_str(&id) {
        fields.insert(X_REQUEST_ID, id);
    }
    fields.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    if let Ok(total) = HeaderValue::from_str(&format!("total;dur={:.1}", taken.as_secs_f64() * 1000.0)) {
        fields.append(SERVER_TIMING, total);
    }
    let status = response.status().as_u16();
    count(&method, route, status, code, taken);
    let duration_ms = taken.as_millis() as u64;
    span.in_scope(|| tracing::info!(status, code, job.id = job, duration_ms, "{method} {path} answered {status}"));
    response
}

/// The pattern of the path, which is one of few; what is nowhere has none.
struct Route(Option<MatchedPath>);

impl Route {
    fn of(request: &Request) -> Self {
        Self(request.extensions().get::<MatchedPath>().cloned())
    }

    fn name(&self) -> String {
        self.0.as_ref().map_or("none", MatchedPath::as_str).to_owned()
    }
}

fn count(method: &Method, route: Route, status: u16, code: &'static str, taken: Duration) {
    let route = route.name();
    // Names that callers make up would be labels without end.
    let known = [Method::GET, Method::HEAD, Method::POST, Method::PUT, Method::DELETE, Method::OPTIONS, Method::PATCH];
    let method = known.iter().find(|known| *known == method).map_or("other", Method::as_str).to_owned();
    counter!(names::HTTP_REQUESTS, "route" => route.clone(), "method" => method.clone(), "status" => status.to_string())
        .increment(1);
    histogram!(names::HTTP_SECONDS, "route" => route, "method" => method).record(taken.as_secs_f64());
    if !code.is_empty() {
        counter!(names::REFUSALS, "code" => code).increment(1);
    }
}

/// Counts a request while it is answered, also when its caller hangs up.
struct InFlight;

impl InFlight {
    fn new() -> Self {
        gauge!(names::HTTP_IN_FLIGHT).increment(1.0);
        Self
    }
}

impl Drop for InFlight {
    fn drop(&mut self) {
        gauge!(names::HTTP_IN_FLIGHT).decrement(1.0);
    }
}

/// The caller's id when it is fit for a log, else one of ours.
fn request_id(request: &Request) -> String {
    let given = request.headers().get(X_REQUEST_ID).and_then(|id| id.to_str().ok());
    let fit =
        |id: &&str| (1..=REQUEST_ID_BYTES_MAX).contains(&id.len()) && id.bytes().all(|byte| byte.is_ascii_graphic());
    given.filter(fit).map_or_else(|| Uuid::now_v7().simple().to_string(), str::to_owned)
}

fn write_problem(response: &mut Response, problem: &ProblemView) {
    let body = serde_json::to_vec(problem).unwrap_or_default();
    response.headers_mut().remove(header::CONTENT_LENGTH);
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("application/problem+json"));
    *response.body_mut() = Body::from(body);
}

/// A handler panicked: a bug of ours.
pub fn panicked(panic: Box<dyn std::any::Any + Send>) -> Response {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
    ApiError::internal(&format!("a handler panicked: {text}")).into_response()
}
