//! What the operator's metrics hear of jobs.

use super::job::{Job, JobState};
use super::store::{EndedWithout, Ending};
use crate::telemetry::metrics as names;
use metrics::{counter, histogram};
use serde_json::Value;

/// Work on `job` began.
pub fn began(job: &Job) {
    if let Some(waited) = job.queue_time {
        histogram!(names::WAIT_SECONDS).record(waited.as_secs_f64());
    }
}

/// Work on `job` ended so.
pub fn ended(job: &Job, ending: &Ending) {
    for timing in &ending.timings {
        histogram!(names::STAGE_SECONDS, "stage" => timing.stage.name()).record(timing.duration.as_secs_f64());
    }
    match &ending.outcome {
        Ok((result, _)) => {
            let number = |pointer: [&str; 2]| result.report.get(pointer[0])?.get(pointer[1]).and_then(Value::as_f64);
            if let Some(faces) = number(["input", "faces"]) {
                histogram!(names::FACES).record(faces);
            }
            if let Some(joints) = number(["skeleton", "joints"]) {
                histogram!(names::JOINTS).record(joints);
            }
            count(&result.method_used, JobState::Succeeded, "");
        }
        Err(EndedWithout::Canceled) => count(method(job), JobState::Canceled, ""),
        Err(EndedWithout::Failed(error)) => count(method(job), JobState::Failed, error.code.name()),
    }
}

/// A new job took the result of an earlier equal one.
pub fn answered_at_once(job: &Job) {
    counter!(names::CACHE_HITS).increment(1);
    let used = job.result.as_ref().map_or("auto", |result| result.method_used.as_str());
    count(used, JobState::Succeeded, "");
}

fn method(job: &Job) -> &str {
    job.request.options.method.as_deref().unwrap_or("auto")
}

fn count(method: &str, state: JobState, code: &'static str) {
    counter!(names::JOBS, "method" => method.to_owned(), "state" => state.name(), "error" => code).increment(1);
}
