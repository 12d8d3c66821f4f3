//! Values of jobs as JSON, for the columns that no query looks into. What a later version of the program does not
//! know any more is read as the nearest thing that it does.

use super::StoreFailure;
use crate::formats::Severity;
use crate::jobs::event::EventKind;
use crate::jobs::failure::{ErrorCode, JobError, PassedLimit};
use crate::jobs::job::{ArtifactInfo, FileInfo, JobResult, JobState, Notice};
use crate::jobs::options::{OptionsReader, RigOptions};
use crate::jobs::perform::{ModelInfo, Timing};
use crate::jobs::stage::Stage;
use crate::jobs::submission::Labels;
use crate::jobs::webhooks::{JobWebhook, MessageType};
use crate::storage::hex;
use serde_json::{Map, Value, json};
use std::time::Duration;

fn damaged(what: &str) -> StoreFailure {
    StoreFailure::new(&format!("{what} cannot be read back"))
}

pub fn parse(text: &str, what: &str) -> Result<Value, StoreFailure> {
    serde_json::from_str(text).map_err(|_| damaged(what))
}

fn text<'a>(value: &'a Value, field: &str) -> &'a str {
    value.get(field).and_then(Value::as_str).unwrap_or_default()
}

fn number(value: &Value, field: &str) -> u64 {
    value.get(field).and_then(Value::as_u64).unwrap_or_default()
}

fn list<'a>(value: &'a Value, field: &str) -> impl Iterator<Item = &'a Value> {
    value.get(field).and_then(Value::as_array).into_iter().flatten()
}

/// 64 hexadecimal digits.
fn digest(text: &str) -> Option<[u8; 32]> {
    let mut bytes = [0; 32];
    for (index, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from_str_radix(text.get(2 * index..2 * index + 2)?, 16).ok()?;
    }
    Some(bytes)
}

pub fn options_from(value: &Value) -> Result<RigOptions, StoreFailure> {
    let mut reader = OptionsReader::default();
    for (field, value) in value.as_object().into_iter().flatten() {
        reader.json(field, value);
    }
    reader.finish().map_err(|_| damaged("the options of a job"))
}

pub fn files(files: &[FileInfo]) -> Value {
    let file = |file: &FileInfo| json!({"name": file.name, "bytes": file.bytes, "sha256": hex(&file.sha256)});
    files.iter().map(file).collect()
}

pub fn files_from(value: &Value) -> Result<Vec<FileInfo>, StoreFailure> {
    let file = |value: &Value| {
        let sha256 = digest(text(value, "sha256")).ok_or_else(|| damaged("a list of files"))?;
        Ok(FileInfo { name: text(value, "name").to_owned(), bytes: number(value, "bytes"), sha256 })
    };
    value.as_array().into_iter().flatten().map(file).collect()
}

pub fn labels(labels: &Labels) -> Value {
    labels.iter().map(|(name, value)| (name.clone(), Value::from(value.clone()))).collect::<Map<_, _>>().into()
}

pub fn labels_from(value: &Value) -> Labels {
    let label = |(name, value): (&String, &Value)| Some((name.clone(), value.as_str()?.to_owned()));
    value.as_object().into_iter().flatten().filter_map(label).collect()
}

pub fn message_types(types: &[MessageType]) -> Value {
    types.iter().map(|kind| kind.name()).collect()
}

/// Types of another version are passed over.
pub fn message_types_from(value: &Value) -> Vec<MessageType> {
    value.as_array().into_iter().flatten().filter_map(|name| MessageType::named(name.as_str()?)).collect()
}

pub fn webhook(webhook: &JobWebhook) -> Value {
    json!({"url": webhook.url, "events": message_types(&webhook.events)})
}

pub fn webhook_from(value: &Value) -> Option<JobWebhook> {
    Some(JobWebhook { url: value.get("url")?.as_str()?.to_owned(), events: message_types_from(value.get("events")?) })
}

/// Microseconds by stage.
pub fn timings(timings: &[Timing]) -> Value {
    let timing = |timing: &Timing| {
        let micros = u64::try_from(timing.duration.as_micros()).unwrap_or(u64::MAX);
        (timing.stage.name().to_owned(), Value::from(micros))
    };
    timings.iter().map(timing).collect::<Map<_, _>>().into()
}

pub fn timings_from(value: &Value) -> Vec<Timing> {
    let timing = |stage: Stage| {
        let duration = Duration::from_micros(value.get(stage.name())?.as_u64()?);
        Some(Timing { stage, duration })
    };
    Stage::ALL.into_iter().filter_map(timing).collect()
}

fn notice(notice: &Notice) -> Value {
    let severity = match notice.severity {
        Severity::Info => "info",
        Severity::Warning => "warning",
    };
    let Notice { code, parts, message, hint, .. } = notice;
    json!({"code": code, "parts": parts, "severity": severity, "message": message, "hint": hint})
}

fn notice_from(value: &Value) -> Notice {
    let severity = if text(value, "severity") == "info" { Severity::Info } else { Severity::Warning };
    let owned = |field| text(value, field).to_owned();
    let parts = list(value, "parts").filter_map(|part| part.as_str().map(str::to_owned)).collect();
    Notice { code: owned("code"), parts, severity, message: owned("message"), hint: owned("hint") }
}

fn artifact(artifact: &ArtifactInfo) -> Value {
    let ArtifactInfo { name, media_type, bytes, sha256 } = artifact;
    json!({"name": name, "media_type": media_type, "bytes": bytes, "sha256": hex(sha256)})
}

fn artifact_from(value: &Value) -> Result<ArtifactInfo, StoreFailure> {
    let owned = |field| text(value, field).to_owned();
    let sha256 = digest(text(value, "sha256")).ok_or_else(|| damaged("a list of artifacts"))?;
    Ok(ArtifactInfo { name: owned("name"), media_type: owned("media_type"), bytes: number(value, "bytes"), sha256 })
}

pub fn result(result: &JobResult) -> Value {
    let JobResult { method_used, models, report, findings, artifacts } = result;
    let model = |model: &ModelInfo| json!({"name": model.name, "sha256": model.sha256, "self_test": model.self_test});
    json!({
        "method_used": method_used,
        "models": models.iter().map(model).collect::<Vec<_>>(),
        "report": report,
        "findings": findings.iter().map(notice).collect::<Vec<_>>(),
        "artifacts": artifacts.iter().map(artifact).collect::<Vec<_>>(),
    })
}

pub fn result_from(value: &Value) -> Result<JobResult, StoreFailure> {
    let model = |value: &Value| ModelInfo {
        name: text(value, "name").to_owned(),
        sha256: text(value, "sha256").to_owned(),
        self_test: text(value, "self_test").to_owned(),
    };
    Ok(JobResult {
        method_used: text(value, "method_used").to_owned(),
        models: list(value, "models").map(model).collect(),
        report: value.get("report").and_then(Value::as_object).cloned().unwrap_or_default(),
        findings: list(value, "findings").map(notice_from).collect(),
        artifacts: list(value, "artifacts").map(artifact_from).collect::<Result<_, _>>()?,
    })
}

pub fn error(error: &JobError) -> Value {
    let limit = error.limit.as_ref();
    json!({
        "code": error.code.name(),
        "stage": error.stage.map(Stage::name),
        "message": error.message,
        "hint": error.hint,
        "limit": limit.map(|limit| json!({"name": limit.name, "max": limit.max, "actual": limit.actual})),
    })
}

pub fn error_from(value: &Value) -> JobError {
    let limit = value.get("limit").filter(|limit| limit.is_object());
    JobError {
        code: ErrorCode::named(text(value, "code")).unwrap_or(ErrorCode::Internal),
        stage: Stage::named(text(value, "stage")),
        message: text(value, "message").to_owned(),
        hint: text(value, "hint").to_owned(),
        limit: limit.map(|limit| PassedLimit {
            name: text(limit, "name").to_owned().into(),
            max: number(limit, "max"),
            actual: limit.get("actual").and_then(Value::as_u64),
        }),
    }
}

pub fn state_from(name: &str) -> Result<JobState, StoreFailure> {
    JobState::ALL.into_iter().find(|state| state.name() == name).ok_or_else(|| damaged("the state of a job"))
}

/// Snapshots are made when they are looked at, so they are never written.
pub fn event(kind: &EventKind) -> Value {
    let name = kind.name();
    match kind {
        EventKind::Snapshot(_) => json!({"event": name}),
        EventKind::State { state, attempt } => json!({"event": name, "state": state.name(), "attempt": attempt}),
        EventKind::Progress { stage, progress } => json!({"event": name, "stage": stage.name(), "progress": progress}),
        EventKind::Warning(warning) => json!({"event": name, "warning": notice(warning)}),
        EventKind::Artifact(made) => json!({"event": name, "artifact": artifact(made)}),
        EventKind::Done { state, error: cause } => {
            json!({"event": name, "state": state.name(), "error": cause.as_ref().map(error)})
        }
    }
}

pub fn event_from(value: &Value) -> Result<EventKind, StoreFailure> {
    let inner = |field: &str| value.get(field).unwrap_or(&Value::Null);
    match text(value, "event") {
        "state" => Ok(EventKind::State {
            state: state_from(text(value, "state"))?,
            attempt: u32::try_from(number(value, "attempt")).unwrap_or(u32::MAX),
        }),
        "progress" => Ok(EventKind::Progress {
            stage: Stage::named(text(value, "stage")).ok_or_else(|| damaged("an event"))?,
            progress: u8::try_from(number(value, "progress")).unwrap_or(0),
        }),
        "warning" => Ok(EventKind::Warning(notice_from(inner("warning")))),
        "artifact" => artifact_from(inner("artifact")).map(EventKind::Artifact),
        "done" => Ok(EventKind::Done {
            state: state_from(text(value, "state"))?,
            error: Some(inner("error")).filter(|error| error.is_object()).map(error_from),
        }),
        _ => Err(damaged("an event")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_back() {
        let limit = PassedLimit { name: "faces".into(), max: 7, actual: None };
        let failed = JobError { limit: Some(limit), ..JobError::new(ErrorCode::TooManyFaces, "too many") };
        let failed = failed.at(Stage::Ingest).hint("fewer");
        assert_eq!(error_from(&error(&failed)), failed);
        let warning = Notice {
            code: "x".into(),
            parts: vec!["Hair".into()],
            severity: Severity::Info,
            message: "m".into(),
            hint: String::new(),
        };
        let made = ArtifactInfo { name: "a.glb".into(), media_type: "m/t".into(), bytes: 3, sha256: [7; 32] };
        let outcome = JobResult {
            method_used: "rignet".into(),
            models: vec![ModelInfo { name: "n".into(), sha256: "00".into(), self_test: "passed".into() }],
            report: Map::from_iter([("joints".to_owned(), json!(24))]),
            findings: vec![warning.clone()],
            artifacts: vec![made.clone()],
        };
        let back = result_from(&result(&outcome)).expect("reads");
        assert_eq!((back.report, back.findings, back.artifacts), (outcome.report, outcome.findings, outcome.artifacts));
        for kind in [
            EventKind::State { state: JobState::Running, attempt: 2 },
            EventKind::Progress { stage: Stage::Skin, progress: 70 },
            EventKind::Warning(warning),
            EventKind::Artifact(made),
            EventKind::Done { state: JobState::Failed, error: Some(failed) },
        ] {
            let written = event(&kind);
            assert_eq!(event(&event_from(&written).expect("reads")), written);
        }
    }

    #[test]
    fn a_code_of_another_version_is_read_as_an_internal_error() {
        assert_eq!(error_from(&json!({"code": "from_the_future"})).code, ErrorCode::Internal);
        assert!(files_from(&json!([{"name": "a", "sha256": "zz"}])).is_err());
    }
}
