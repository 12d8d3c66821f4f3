//! Jobs and batches as they were at one moment, as JSON, for messages that tell of it later.

use super::StoreFailure;
use super::codec;
use crate::jobs::batch::{Batch, BatchCounts};
use crate::jobs::clock::Timestamp;
use crate::jobs::ids::{AssetId, BatchId, EndpointId, JobId};
use crate::jobs::job::{Job, JobRequest};
use crate::jobs::options::RigOptions;
use crate::jobs::stage::Stage;
use crate::jobs::submission::{Caller, Priority};
use crate::jobs::webhooks::Subject;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

pub fn subject(subject: &Subject) -> Value {
    match subject {
        Subject::Rig(job) => json!({"rig": rig(job)}),
        Subject::Batch(batch) => json!({"batch": of_batch(batch)}),
        Subject::Endpoint(id) => json!({"endpoint": id.to_string()}),
    }
}

pub fn subject_from(value: &Value) -> Result<Subject, StoreFailure> {
    if let Some(rig) = value.get("rig") {
        return rig_from(rig).map(|job| Subject::Rig(Box::new(job)));
    }
    if let Some(batch) = value.get("batch") {
        return batch_from(batch).map(|batch| Subject::Batch(Box::new(batch)));
    }
    id::<EndpointId>(value, "endpoint").map(Subject::Endpoint)
}

fn damaged(field: &str) -> StoreFailure {
    StoreFailure::new(&format!("{field} of a message cannot be read back"))
}

fn millis(time: SystemTime) -> i64 {
    Timestamp::from(time).0
}

fn optional_time(value: &Value, field: &str) -> Option<SystemTime> {
    value.get(field).and_then(Value::as_i64).map(|millis| Timestamp(millis).into())
}

fn time(value: &Value, field: &str) -> Result<SystemTime, StoreFailure> {
    optional_time(value, field).ok_or_else(|| damaged(field))
}

fn optional_duration(value: &Value, field: &str) -> Option<Duration> {
    value.get(field).and_then(Value::as_u64).map(Duration::from_millis)
}

fn text<'a>(value: &'a Value, field: &str) -> Option<&'a str> {
    value.get(field).and_then(Value::as_str)
}

fn number<T: TryFrom<u64>>(value: &Value, field: &str) -> Result<T, StoreFailure> {
    let number = value.get(field).and_then(Value::as_u64).and_then(|number| T::try_from(number).ok());
    number.ok_or_else(|| damaged(field))
}

fn truth(value: &Value, field: &str) -> bool {
    value.get(field).and_then(Value::as_bool).unwrap_or_default()
}

fn id<T: std::str::FromStr>(value: &Value, field: &str) -> Result<T, StoreFailure> {
    text(value, field).and_then(|text| text.parse().ok()).ok_or_else(|| damaged(field))
}

/// Its place in the queue is left out: it has none once it is told of.
fn rig(job: &Job) -> Value {
    json!({
        "id": job.id.to_string(),
        "caller": job.caller.name(),
        "state": job.state.name(),
        "stage": job.stage.map(Stage::name),
        "progress": job.progress,
        "cancel_requested": job.cancel_requested,
        "attempt": job.attempt,
        "created_at": millis(job.created_at),
        "started_at": job.started_at.map(millis),
        "finished_at": job.finished_at.map(millis),
        "expires_at": job.expires_at.map(millis),
        "request": request(&job.request),
        "queue_ms": job.queue_time.map(|time| time.as_millis() as u64),
        "timings": codec::timings(&job.timings),
        "result": job.result.as_deref().map(codec::result),
        "error": job.error.as_ref().map(codec::error),
        "cached": job.cached,
        "sequence": job.sequence,
    })
}

fn rig_from(value: &Value) -> Result<Job, StoreFailure> {
    let inner = |field: &str| value.get(field).filter(|inner| !inner.is_null());
    Ok(Job {
        id: id::<JobId>(value, "id")?,
        caller: Caller::named(text(value, "caller").ok_or_else(|| damaged("caller"))?),
        state: codec::state_from(text(value, "state").unwrap_or_default())?,
        stage: text(value, "stage").and_then(Stage::named),
        progress: number(value, "progress")?,
        queue_position: None,
        cancel_requested: truth(value, "cancel_requested"),
        attempt: number(value, "attempt")?,
        created_at: time(value, "created_at")?,
        started_at: optional_time(value, "started_at"),
        finished_at: optional_time(value, "finished_at"),
        expires_at: optional_time(value, "expires_at"),
        request: Arc::new(request_from(inner("request").ok_or_else(|| damaged("request"))?)?),
        queue_time: optional_duration(value, "queue_ms"),
        timings: inner("timings").map(codec::timings_from).unwrap_or_default(),
        result: inner("result").map(codec::result_from).transpose()?.map(Arc::new),
        error: inner("error").map(codec::error_from),
        cached: truth(value, "cached"),
        sequence: number(value, "sequence")?,
    })
}

fn request(request: &JobRequest) -> Value {
    json!({
        "options": request.options.to_json(),
        "files": codec::files(&request.files),
        "asset": request.asset.map(|asset| asset.to_string()),
        "priority": request.priority.name(),
        "labels": codec::labels(&request.labels),
        "timeout_ms": request.timeout.as_millis() as u64,
        "deadline": request.deadline.map(millis),
        "retention_ms": request.retention.as_millis() as u64,
        "client_id": request.client_id,
        "skeleton_given": request.skeleton_given,
        "webhook": request.webhook.as_ref().map(codec::webhook),
    })
}

fn request_from(value: &Value) -> Result<JobRequest, StoreFailure> {
    let inner = |field: &str| value.get(field).ok_or_else(|| damaged(field));
    Ok(JobRequest {
        // Options that this version does not know any more do not keep the message back.
        options: codec::options_from(inner("options")?).unwrap_or_else(|_| RigOptions::default()),
        files: codec::files_from(inner("files")?)?,
        asset: text(value, "asset").and_then(|id| id.parse::<AssetId>().ok()),
        priority: text(value, "priority").and_then(Priority::named).unwrap_or_default(),
        labels: codec::labels_from(inner("labels")?),
        timeout: optional_duration(value, "timeout_ms").ok_or_else(|| damaged("timeout_ms"))?,
        deadline: optional_time(value, "deadline"),
        retention: optional_duration(value, "retention_ms").ok_or_else(|| damaged("retention_ms"))?,
        client_id: text(value, "client_id").map(str::to_owned),
        skeleton_given: truth(value, "skeleton_given"),
        webhook: value.get("webhook").and_then(codec::webhook_from),
    })
}

fn of_batch(batch: &Batch) -> Value {
    let BatchCounts { queued, running, succeeded, failed, canceled } = batch.counts;
    json!({
        "id": batch.id.to_string(),
        "created_at": millis(batch.created_at),
        "canceled_at": batch.canceled_at.map(millis),
        "finished_at": batch.finished_at.map(millis),
        "counts": {
            "queued": queued, "running": running, "succeeded": succeeded, "failed": failed, "canceled": canceled,
        },
    })
}

fn batch_from(value: &Value) -> Result<Batch, StoreFailure> {
    let counts = value.get("counts").ok_or_else(|| damaged("counts"))?;
    Ok(Batch {
        id: id::<BatchId>(value, "id")?,
        created_at: time(value, "created_at")?,
        canceled_at: optional_time(value, "canceled_at"),
        finished_at: optional_time(value, "finished_at"),
        counts: BatchCounts {
            queued: number(counts, "queued")?,
            running: number(counts, "running")?,
            succeeded: number(counts, "succeeded")?,
            failed: number(counts, "failed")?,
            canceled: number(counts, "canceled")?,
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::failure::{ErrorCode, JobError};
    use crate::jobs::job::{ArtifactInfo, FileInfo, JobResult, JobState};
    use crate::jobs::perform::Timing;
    use crate::jobs::webhooks::{JobWebhook, MessageType};
    use std::time::UNIX_EPOCH;

    fn moment(seconds: u64) -> SystemTime {
        UNIX_EPOCH + Duration::from_secs(seconds)
    }

    fn job() -> Job {
        let artifact = ArtifactInfo {
            name: "rigged.glb".to_owned(),
            media_type: "model/gltf-binary".to_owned(),
            bytes: 3,
            sha256: [3; 32],
        };
        let result = JobResult {
            method_used: "rignet".to_owned(),
            models: Vec::new(),
            report: serde_json::Map::from_iter([("skeleton".to_owned(), json!({"joints": 24}))]),
            findings: Vec::new(),
            artifacts: vec![artifact],
        };
        Job {
            id: JobId::new(),
            caller: Caller::named("alice"),
            state: JobState::Succeeded,
            stage: Some(Stage::Export),
            progress: 100,
            queue_position: None,
            cancel_requested: true,
            attempt: 2,
            created_at: moment(1),
            started_at: Some(moment(2)),
            finished_at: Some(moment(3)),
            expires_at: Some(moment(4)),
            request: Arc::new(JobRequest {
                options: RigOptions { seed: 7, ..RigOptions::default() },
                files: vec![FileInfo { name: "hero.obj".to_owned(), bytes: 5, sha256: [5; 32] }],
                asset: Some(AssetId::new()),
                priority: Priority::High,
                labels: [("project".to_owned(), "knights".to_owned())].into(),
                timeout: Duration::from_millis(1500),
                deadline: Some(moment(9)),
                retention: Duration::from_secs(60),
                client_id: Some("hero-v3".to_owned()),
                skeleton_given: true,
                webhook: Some(JobWebhook {
                    url: "https://a.example/".to_owned(),
                    events: vec![MessageType::RigFailed],
                }),
            }),
            queue_time: Some(Duration::from_millis(12)),
            timings: vec![Timing { stage: Stage::Skin, duration: Duration::from_millis(3) }],
            result: Some(Arc::new(result)),
            error: Some(JobError::new(ErrorCode::Timeout, "late")),
            cached: true,
            sequence: 17,
        }
    }

    #[test]
    fn what_a_message_tells_of_is_read_back_as_it_was() {
        let batch = Batch {
            id: BatchId::new(),
            created_at: moment(1),
            canceled_at: None,
            finished_at: Some(moment(2)),
            counts: BatchCounts { queued: 1, running: 2, succeeded: 3, failed: 4, canceled: 5 },
        };
        for told in
            [Subject::Rig(Box::new(job())), Subject::Batch(Box::new(batch)), Subject::Endpoint(EndpointId::new())]
        {
            let back = subject_from(&subject(&told)).expect("reads");
            assert_eq!(format!("{back:?}"), format!("{told:?}"));
        }
    }

    #[test]
    fn what_is_damaged_is_not_told() {
        for damaged in [json!({}), json!({"rig": {}}), json!({"batch": {"id": "bat_"}}), json!({"endpoint": 5})] {
            assert!(subject_from(&damaged).is_err(), "{damaged}");
        }
    }
}
