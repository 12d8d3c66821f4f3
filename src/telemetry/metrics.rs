//! Metrics in Prometheus' text format. Names, labels and meaning are one table, [`METRICS`]; docs/operation.md shows it.

use metrics::Unit;
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
use std::sync::OnceLock;

pub const HTTP_REQUESTS: &str = "rigsmith_http_requests_total";
pub const HTTP_SECONDS: &str = "rigsmith_http_request_seconds";
pub const HTTP_IN_FLIGHT: &str = "rigsmith_http_requests_in_flight";
pub const REFUSALS: &str = "rigsmith_refusals_total";
pub const UPLOAD_BYTES: &str = "rigsmith_upload_bytes_total";
pub const JOBS: &str = "rigsmith_jobs_total";
pub const JOBS_WAITING: &str = "rigsmith_jobs_waiting";
pub const JOBS_RUNNING: &str = "rigsmith_jobs_running";
pub const OLDEST_SECONDS: &str = "rigsmith_jobs_oldest_waiting_seconds";
pub const WAIT_SECONDS: &str = "rigsmith_job_wait_seconds";
pub const STAGE_SECONDS: &str = "rigsmith_stage_seconds";
pub const FACES: &str = "rigsmith_job_faces";
pub const JOINTS: &str = "rigsmith_job_joints";
pub const CACHE_HITS: &str = "rigsmith_cache_hits_total";
pub const WEBHOOKS: &str = "rigsmith_webhook_attempts_total";
pub const MODEL_LOAD_SECONDS: &str = "rigsmith_models_load_seconds";
pub const MODEL_PASSED: &str = "rigsmith_model_self_test_passed";
pub const RESIDENT_BYTES: &str = "rigsmith_process_resident_bytes";

#[derive(Clone, Copy)]
enum Kind {
    Counter,
    Gauge,
    Histogram(&'static [f64]),
}

const SECONDS: &[f64] = &[0.001, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 300.0];
const FACE_COUNTS: &[f64] = &[1e3, 3e3, 1e4, 3e4, 1e5, 3e5, 1e6, 2e6];
const JOINT_COUNTS: &[f64] = &[5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 75.0, 100.0];

/// Name, kind, unit, and what it counts.
#[rustfmt::skip]
const METRICS: &[(&str, Kind, Unit, &str)] = &[
    (HTTP_REQUESTS, Kind::Counter, Unit::Count, "requests, by route, method and status"),
    (HTTP_SECONDS, Kind::Histogram(SECONDS), Unit::Seconds, "time to the first byte of the answer, by route and method"),
    (HTTP_IN_FLIGHT, Kind::Gauge, Unit::Count, "requests being answered"),
    (REFUSALS, Kind::Counter, Unit::Count, "refused requests, by code"),
    (UPLOAD_BYTES, Kind::Counter, Unit::Bytes, "bytes of complete uploads"),
    (JOBS, Kind::Counter, Unit::Count, "jobs that ended here, by method, state and error code"),
    (JOBS_WAITING, Kind::Gauge, Unit::Count, "jobs that wait"),
    (JOBS_RUNNING, Kind::Gauge, Unit::Count, "jobs that run"),
    (OLDEST_SECONDS, Kind::Gauge, Unit::Seconds, "how long the oldest waiting job has waited"),
    (WAIT_SECONDS, Kind::Histogram(SECONDS), Unit::Seconds, "time that a job waited before it ran"),
    (STAGE_SECONDS, Kind::Histogram(SECONDS), Unit::Seconds, "time per stage of a job, by stage"),
    (FACES, Kind::Histogram(FACE_COUNTS), Unit::Count, "faces of rigged meshes"),
    (JOINTS, Kind::Histogram(JOINT_COUNTS), Unit::Count, "joints of finished skeletons"),
    (CACHE_HITS, Kind::Counter, Unit::Count, "jobs answered by the result of an earlier equal one"),
    (WEBHOOKS, Kind::Counter, Unit::Count, "attempts to deliver a webhook, by outcome: delivered, retried, given_up, gone"),
    (MODEL_LOAD_SECONDS, Kind::Gauge, Unit::Seconds, "time to load and test the networks at start"),
    (MODEL_PASSED, Kind::Gauge, Unit::Count, "1 when the network passed its self-test at start, else 0; by model"),
    (RESIDENT_BYTES, Kind::Gauge, Unit::Bytes, "memory of the process"),
];

/// Begins to count; the handle writes what was counted. One per process: later calls give the first one's.
pub fn install() -> PrometheusHandle {
    static HANDLE: OnceLock<PrometheusHandle> = OnceLock::new();
    HANDLE.get_or_init(begin).clone()
}

fn begin() -> PrometheusHandle {
    let bucketed = METRICS.iter().try_fold(PrometheusBuilder::new(), |builder, (name, kind, ..)| match kind {
        Kind::Histogram(buckets) => builder.set_buckets_for_metric(Matcher::Full((*name).to_owned()), buckets),
        Kind::Counter | Kind::Gauge => Ok(builder),
    });
    // Fails only on an empty list of buckets, which none of these is.
    let builder = bucketed.unwrap_or_else(|_| PrometheusBuilder::new());
    let recorder = builder.build_recorder();
    let handle = recorder.handle();
    // Fails only when a recorder stands already, which `install` rules out.
    let _ = metrics::set_global_recorder(recorder);
    for (name, kind, unit, meaning) in METRICS {
        match kind {
            Kind::Counter => metrics::describe_counter!(*name, *unit, *meaning),
            Kind::Gauge => metrics::describe_gauge!(*name, *unit, *meaning),
            Kind::Histogram(_) => metrics::describe_histogram!(*name, *unit, *meaning),
        }
    }
    handle
}

/// Memory of this process, where the operating system tells.
pub fn resident_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.trim().trim_end_matches("kB").trim().parse::<u64>().ok().map(|kib| kib * 1024)
}
