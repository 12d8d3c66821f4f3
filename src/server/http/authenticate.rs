//! Who asks: the bearer key of a request, and whether its owner asks or sends too fast.

use super::App;
use super::error::{ApiError, Code, Limit};
use crate::jobs::Caller;
use crate::server::Guard;
use crate::server::grpc;
use crate::server::keys::Key;
use crate::server::quota::Charge;
use axum::body::Body;
use axum::extract::{FromRequestParts, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use http_body_util::BodyExt;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::{Instant, SystemTime};

const RATE_LIMIT: HeaderName = HeaderName::from_static("ratelimit");
const RATE_LIMIT_POLICY: HeaderName = HeaderName::from_static("ratelimit-policy");

/// The parameter that may stand for the key where events are watched.
pub const TICKET: &str = "ticket";

/// Whose request this is, as far as handlers need to know.
#[derive(Clone, Debug)]
pub struct Identity {
    pub caller: Caller,
    /// Unfinished jobs that the caller may have; `None`: as many as the queue holds.
    pub jobs_max: Option<usize>,
    /// `None` where no key is asked for.
    pub key_id: Option<String>,
}

impl Identity {
    pub fn anonymous() -> Self {
        Self { caller: Caller::anonymous(), jobs_max: None, key_id: None }
    }

    fn of(key: &Key) -> Self {
        Self {
            caller: Caller::named(&key.caller),
            jobs_max: Some(key.quota.jobs as usize),
            key_id: Some(key.id.clone()),
        }
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Identity {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Infallible> {
        Ok(parts.extensions.get::<Identity>().cloned().unwrap_or_else(Identity::anonymous))
    }
}

/// Whether everybody may ask for `path`: pages, descriptions and probes, which tell nothing of anybody's work.
fn is_open(path: &str) -> bool {
    const OPEN: [&str; 8] =
        ["/", "/docs", "/livez", "/readyz", "/startupz", "/version", "/v1/openapi.json", "/v1/problems"];
    OPEN.contains(&path) || path.starts_with("/v1/problems/") || grpc::is_open(path)
}

/// Lets a request pass when it has to show no key, or shows a known one that is within its quota.
pub async fn authenticate(State(app): State<App>, request: Request, next: Next) -> Response {
    let Some(guard) = app.guard.as_ref().filter(|_| !is_open(request.uri().path())) else {
        return next.run(request).await;
    };
    let key = match key_of(guard, &request) {
        Ok(key) => key,
        Err(reason) => return unauthenticated(reason).into_response(),
    };
    let now = Instant::now();
    let passed = match guard.buckets.ask(&key, now) {
        Err(wait) => Err(ApiError::new(
            Code::RateLimited,
            format!("this key may ask {} times a minute", key.quota.requests_per_minute),
        )
        .retry_after(wait)
        .hint("send the same request again after Retry-After seconds; events and Prefer: wait save requests")),
        Ok(()) => charged(guard, &key, request, now),
    };
    let left = guard.buckets.left(&key, now);
    let mut response = match passed {
        Err(refusal) => refusal.into_response(),
        Ok(mut request) => {
            tracing::Span::current().record("caller", key.caller.as_str());
            request.extensions_mut().insert(Identity::of(&key));
            next.run(request).await
        }
    };
    for (name, value) in [(RATE_LIMIT_POLICY, left.policy()), (RATE_LIMIT, left.state())] {
        if let Ok(value) = HeaderValue::from_str(&value) {
            response.headers_mut().insert(name, value);
        }
    }
    response
}

/// The key that a request shows, or that the ticket in its address stands for.
fn key_of(guard: &Guard, request: &Request) -> Result<Arc<Key>, &'static str> {
    if let Some((rig, ticket)) = ticket_of(request.method(), request.uri())
        && !request.headers().contains_key(header::AUTHORIZATION)
    {
        let id = guard.tickets.key_id(ticket, rig, SystemTime::now());
        return id
            .and_then(|id| guard.keys.by_id(&id))
            .ok_or("the ticket is for another rig, too old, or none of ours");
    }
    let secret = bearer(request.headers())?;
    guard.keys.find(secret).ok_or("the key is not known here; it may have been removed")
}

/// The rig that is to be watched, and the ticket shown.
fn ticket_of<'a>(method: &Method, uri: &'a Uri) -> Option<(&'a str, &'a str)> {
    let rig = uri.path().strip_prefix("/v1/rigs/")?.strip_suffix("/events")?;
    let ticket = uri.query()?.split('&').find_map(|pair| pair.strip_prefix(TICKET)?.strip_prefix('='))?;
    (method == Method::GET).then_some((rig, ticket))
}

/// The request with its body counted, if the key may send that much.
fn charged(guard: &Guard, key: &Arc<Key>, request: Request, now: Instant) -> Result<Request, ApiError> {
    let length = request.headers().get(header::CONTENT_LENGTH);
    let declared = length.and_then(|length| length.to_str().ok()?.parse().ok());
    if declared == Some(0) || (declared.is_none() && !request.headers().contains_key(header::TRANSFER_ENCODING)) {
        return Ok(request);
    }
    let mut charge: Charge = guard.buckets.receive(key, declared, now).map_err(|wait| {
        let max = key.quota.upload_bytes_per_hour;
        ApiError::new(Code::QuotaExceeded, format!("this key may send {max} bytes an hour, and too few are left"))
            .retry_after(wait)
            .limit(Limit { name: "upload_bytes_per_hour".to_owned(), max, actual: declared })
            .hint("send it after Retry-After seconds; an asset that was uploaded once can be rigged often")
    })?;
    Ok(request.map(|body| {
        Body::new(body.map_frame(move |frame| {
            charge.received(frame.data_ref().map_or(0, |data| data.len() as u64));
            frame
        }))
    }))
}

fn bearer(headers: &HeaderMap) -> Result<&str, &'static str> {
    let mut fields = headers.get_all(header::AUTHORIZATION).iter();
    let field = fields.next().ok_or("a key is needed here")?;
    if fields.next().is_some() {
        return Err("Authorization is sent twice");
    }
    let (scheme, secret) = field.to_str().ok().and_then(|text| text.split_once(' ')).unwrap_or_default();
    if scheme.eq_ignore_ascii_case("bearer") { Ok(secret.trim()) } else { Err("Authorization is not Bearer and a key") }
}

fn unauthenticated(reason: &str) -> ApiError {
    ApiError::new(Code::Unauthenticated, reason)
        .header(header::WWW_AUTHENTICATE, "Bearer realm=\"rigsmith\"")
        .hint("send Authorization: Bearer and the key; the operator makes one with rigsmith keys new")
}
