//! `/metrics` and probes, on an address of their own: what they tell is for the operator, not for callers.

use crate::jobs::Jobs;
use crate::telemetry::metrics::{self as names, resident_bytes};
use axum::Router;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use axum::routing::get;
use metrics::gauge;
use metrics_exporter_prometheus::PrometheusHandle;
use std::time::SystemTime;

#[derive(Clone)]
struct Source {
    jobs: Jobs,
    counted: PrometheusHandle,
}

pub fn routes(jobs: Jobs, counted: PrometheusHandle) -> Router {
    let router = Router::new().route("/metrics", get(write)).route("/livez", get(async || "ok"));
    router.route("/readyz", get(ready)).with_state(Source { jobs, counted })
}

/// For workers, which have no other door.
async fn ready(State(Source { jobs, .. }): State<Source>) -> (StatusCode, String) {
    match (jobs.ready(), jobs.counts().await) {
        (Ok(()), Ok(_)) => (StatusCode::OK, "ok".to_owned()),
        (Err(refusal), _) => (StatusCode::SERVICE_UNAVAILABLE, refusal.to_string()),
        (_, Err(error)) => (StatusCode::SERVICE_UNAVAILABLE, error.to_string()),
    }
}

async fn write(State(Source { jobs, counted }): State<Source>) -> impl IntoResponse {
    if let Ok(counts) = jobs.counts().await {
        gauge!(names::JOBS_WAITING).set(counts.queued as f64);
        gauge!(names::JOBS_RUNNING).set(counts.running as f64);
        let oldest = counts.oldest_queued_at.map(SystemTime::from);
        let waited = oldest.and_then(|since| SystemTime::now().duration_since(since).ok()).unwrap_or_default();
        gauge!(names::OLDEST_SECONDS).set(waited.as_secs_f64());
    }
    if let Some(bytes) = resident_bytes() {
        gauge!(names::RESIDENT_BYTES).set(bytes as f64);
    }
    for method in jobs.methods() {
        for model in method.models {
            let passed = if model.self_test == "passed" { 1.0 } else { 0.0 };
            gauge!(names::MODEL_PASSED, "model" => model.name).set(passed);
        }
    }
    counted.run_upkeep();
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], counted.render())
}
