//! Who asks: the bearer key of a request, and whether its owner asks too fast.

use super::App;
use super::error::{ApiError, Code};
use crate::jobs::Caller;
use crate::server::grpc;
use crate::server::keys::Key;
use axum::extract::{FromRequestParts, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Instant;

const RATE_LIMIT: HeaderName = HeaderName::from_static("ratelimit");
const RATE_LIMIT_POLICY: HeaderName = HeaderName::from_static("ratelimit-policy");

/// Whose request this is, as far as handlers need to know.
#[derive(Clone, Debug)]
pub struct Identity {
    pub caller: Caller,
    /// Unfinished jobs that the caller may have; `None`: as many as the queue holds.
    pub jobs_max: Option<usize>,
}

impl Identity {
    pub fn anonymous() -> Self {
        Self { caller: Caller::anonymous(), jobs_max: None }
    }

    fn of(key: &Key) -> Self {
        Self { caller: Caller::named(&key.caller), jobs_max: Some(key.quota.jobs as usize) }
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

/// Lets a request pass when it has to show no key, or shows a known one that is within its rate.
pub async fn authenticate(State(app): State<App>, mut request: Request, next: Next) -> Response {
    let Some(keys) = app.keys.as_ref().filter(|_| !is_open(request.uri().path())) else {
        return next.run(request).await;
    };
    let key = match bearer(request.headers()) {
        Ok(secret) => keys.find(secret).ok_or("the key is not known here; it may have been removed"),
        Err(reason) => Err(reason),
    };
    let key: Arc<Key> = match key {
        Ok(key) => key,
        Err(reason) => return unauthenticated(reason).into_response(),
    };
    let left = app.buckets.take(&key, Instant::now());
    let mut response = match left.refused_for {
        Some(wait) => ApiError::new(Code::RateLimited, format!("this key may ask {} times a minute", left.limit))
            .retry_after(wait)
            .hint("send the same request again after Retry-After seconds; events and Prefer: wait save requests")
            .into_response(),
        None => {
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
