//! `/metrics`, on an address of its own: what it tells is for the operator, not for callers.

use super::App;
use crate::telemetry::metrics::{self as names, resident_bytes};
use axum::Router;
use axum::extract::State;
use axum::http::header;
use axum::response::IntoResponse;
use axum::routing::get;
use metrics::gauge;
use metrics_exporter_prometheus::PrometheusHandle;
use std::time::SystemTime;

#[derive(Clone)]
struct Source {
    app: App,
    counted: PrometheusHandle,
}

pub fn routes(app: App, counted: PrometheusHandle) -> Router {
    Router::new().route("/metrics", get(write)).with_state(Source { app, counted })
}

async fn write(State(Source { app, counted }): State<Source>) -> impl IntoResponse {
    if let Ok(counts) = app.jobs.counts().await {
        gauge!(names::JOBS_WAITING).set(counts.queued as f64);
        gauge!(names::JOBS_RUNNING).set(counts.running as f64);
        let oldest = counts.oldest_queued_at.map(SystemTime::from);
        let waited = oldest.and_then(|since| SystemTime::now().duration_since(since).ok()).unwrap_or_default();
        gauge!(names::OLDEST_SECONDS).set(waited.as_secs_f64());
    }
    if let Some(bytes) = resident_bytes() {
        gauge!(names::RESIDENT_BYTES).set(bytes as f64);
    }
    for method in app.jobs.methods() {
        for model in method.models {
            let passed = if model.self_test == "passed" { 1.0 } else { 0.0 };
            gauge!(names::MODEL_PASSED, "model" => model.name).set(passed);
        }
    }
    counted.run_upkeep();
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], counted.render())
}
