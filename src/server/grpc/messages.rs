//! What goes over the wire as messages. Built from inner types here, and nowhere else; facts that take more than a look are
//! those that REST tells ([`super::super::http::views`]).

use super::super::http::request_views::{OptionsView, RequestView, WishesView};
use super::super::http::rigs::why_none;
use super::super::http::views::{self, hex};
use super::proto::google::longrunning::Operation;
use super::proto::google::longrunning::operation::Result as OperationResult;
use super::proto::rigsmith::v1::rig::State;
use super::proto::rigsmith::v1::rig_event::{Done, Event as Happened, Progress, StateChange};
use super::proto::rigsmith::v1::{
    Artifact, Asset, Finding, Model, Provenance, Rig, RigError, RigEvent, RigMetadata, RigOptions, RigResult,
    StoredFile, Webhook,
};
use super::status::rpc_status;
use crate::jobs::{self, ArtifactInfo, Event, EventKind, FileInfo, Job, JobError, JobResult, JobState, Notice};
use prost::Message;
use prost_types::value::Kind;
use prost_types::{Any, ListValue, Struct, Timestamp, Value};
use serde_json::Value as Json;
use std::time::SystemTime;

/// `message` with its name, which the compiled type does not know.
pub fn any(name: &str, message: &impl Message) -> Any {
    Any { type_url: format!("type.googleapis.com/{name}"), value: message.encode_to_vec() }
}

pub fn state(state: JobState) -> State {
    match state {
        JobState::Queued => State::Queued,
        JobState::Running => State::Running,
        JobState::Succeeded => State::Succeeded,
        JobState::Failed => State::Failed,
        JobState::Canceled => State::Canceled,
        JobState::Expired => State::Expired,
    }
}

/// The job as a long-running operation.
pub fn operation(job: &Job) -> Operation {
    let result = match job.state {
        JobState::Queued | JobState::Running => None,
        JobState::Succeeded | JobState::Expired => {
            Some(OperationResult::Response(any("rigsmith.v1.Rig", &Rig::from(job))))
        }
        JobState::Failed | JobState::Canceled => Some(OperationResult::Error(rpc_status(&why_none(job)))),
    };
    Operation {
        name: format!("operations/{}", job.id),
        metadata: Some(any("rigsmith.v1.RigMetadata", &metadata(job))),
        done: job.state.is_final(),
        result,
    }
}

fn metadata(job: &Job) -> RigMetadata {
    RigMetadata {
        rig: job.id.to_string(),
        state: state(job.state).into(),
        stage: job.stage.map(|stage| stage.name().to_owned()).unwrap_or_default(),
        progress: job.progress.into(),
        queue_position: job.queue_position.map(|position| position as u64),
        estimated_seconds_left: views::estimated_seconds_left(job),
        cancel_requested: job.cancel_requested,
        create_time: Some(job.created_at.into()),
    }
}

impl From<&Job> for Rig {
    fn from(job: &Job) -> Self {
        let time = |time: Option<SystemTime>| time.map(Timestamp::from);
        let result = job.result.as_deref();
        let RigMetadata { rig, state, stage, progress, queue_position, estimated_seconds_left, .. } = metadata(job);
        Self {
            id: rig,
            state,
            stage,
            progress,
            queue_position,
            estimated_seconds_left,
            cancel_requested: job.cancel_requested,
            attempt: job.attempt,
            create_time: time(Some(job.created_at)),
            start_time: time(job.started_at),
            end_time: time(job.finished_at),
            expire_time: time(job.expires_at),
            options: Some(views::request(job).into()),
            client_id: job.request.client_id.clone().unwrap_or_default(),
            asset: job.request.asset.map(|asset| asset.to_string()).unwrap_or_default(),
            files: job.request.files.iter().map(StoredFile::from).collect(),
            method_used: result.map(|result| result.method_used.clone()).unwrap_or_default(),
            provenance: Some(provenance(job, result)),
            timings_ms: views::timings_ms(job).map(|(name, ms)| (name.to_owned(), ms)).collect(),
            warnings: result.map(|result| result.findings.iter().map(Finding::from).collect()).unwrap_or_default(),
            result: result.map(|result| RigResult {
                report: Some(structure(&result.report)),
                artifacts: views::present(job, result).iter().map(Artifact::from).collect(),
            }),
            error: job.error.as_ref().map(RigError::from),
        }
    }
}

fn provenance(job: &Job, result: Option<&JobResult>) -> Provenance {
    let models = result.map(|result| views::models(&result.models)).unwrap_or_default();
    let model = |model: views::ModelView| Model { name: model.name, sha256: model.sha256, self_test: model.self_test };
    Provenance {
        asset_sha256: hex(&jobs::asset_sha256(&job.request.files)),
        service_version: env!("CARGO_PKG_VERSION").to_owned(),
        models: models.into_iter().map(model).collect(),
        cached: job.cached,
    }
}

impl From<RequestView> for RigOptions {
    fn from(request: RequestView) -> Self {
        let RequestView { options, wishes } = request;
        let OptionsView { method, detail, bandwidth, symmetry, fingers, skin_method, boxes, skeleton, .. } = options;
        let WishesView { priority, timeout_seconds, retention_hours, labels, webhook } = wishes;
        let text = |word: &str| Some(word.to_owned());
        Self {
            method: Some(method),
            detail,
            bandwidth,
            symmetry: text(symmetry),
            fingers: text(fingers),
            skin_method: text(skin_method),
            boxes: text(boxes),
            skin_fallback: options.skin_fallback.into_iter().map(str::to_owned).collect(),
            skeleton,
            non_deforming: options.non_deforming,
            locked_joints: options.locked_joints,
            max_influences: u32::try_from(options.max_influences).ok(),
            smooth: Some(options.smooth),
            prune: Some(options.prune),
            mirror_weights: text(options.mirror_weights),
            seed: Some(options.seed),
            up: text(options.up),
            front: text(options.front),
            existing_rig: text(options.existing_rig),
            outputs: options.outputs.into_iter().map(str::to_owned).collect(),
            priority: text(priority),
            timeout_seconds: Some(timeout_seconds),
            retention_hours: Some(retention_hours),
            labels: labels.into_iter().collect(),
            webhook: webhook.map(|webhook| Webhook {
                url: webhook.url,
                events: webhook.events.into_iter().map(str::to_owned).collect(),
            }),
        }
    }
}

impl From<&jobs::Asset> for Asset {
    fn from(asset: &jobs::Asset) -> Self {
        Self {
            id: asset.id.to_string(),
            sha256: hex(&asset.sha256),
            bytes: asset.bytes(),
            files: asset.files.iter().map(StoredFile::from).collect(),
            create_time: Some(asset.created_at.into()),
            expire_time: Some(asset.expires_at.into()),
        }
    }
}

impl From<&FileInfo> for StoredFile {
    fn from(file: &FileInfo) -> Self {
        Self { name: file.name.clone(), bytes: file.bytes, sha256: hex(&file.sha256) }
    }
}

impl From<&ArtifactInfo> for Artifact {
    fn from(artifact: &ArtifactInfo) -> Self {
        let ArtifactInfo { name, media_type, bytes, sha256 } = artifact;
        Self { name: name.clone(), media_type: media_type.clone(), bytes: *bytes, sha256: hex(sha256) }
    }
}

impl From<&Notice> for Finding {
    fn from(notice: &Notice) -> Self {
        let views::FindingView { code, severity, message, hint, r#where } = notice.into();
        Self { code, severity: severity.to_owned(), message, hint, r#where }
    }
}

impl From<&JobError> for RigError {
    fn from(error: &JobError) -> Self {
        let views::JobErrorView { code, stage, message, hint, retryable, .. } = error.into();
        Self {
            code: code.to_owned(),
            stage: stage.unwrap_or_default().to_owned(),
            message,
            hint: hint.unwrap_or_default(),
            retryable,
        }
    }
}

impl From<&Event> for RigEvent {
    fn from(event: &Event) -> Self {
        let happened = match &event.kind {
            EventKind::Snapshot(job) => Happened::Snapshot(Rig::from(&**job)),
            EventKind::State { state: reached, attempt } => {
                Happened::State(StateChange { state: state(*reached).into(), attempt: *attempt })
            }
            EventKind::Progress { stage, progress } => {
                Happened::Progress(Progress { stage: stage.name().to_owned(), progress: (*progress).into() })
            }
            EventKind::Warning(notice) => Happened::Warning(notice.into()),
            EventKind::Artifact(artifact) => Happened::Artifact(artifact.into()),
            EventKind::Done { state: reached, error } => {
                Happened::Done(Done { state: state(*reached).into(), error: error.as_ref().map(RigError::from) })
            }
        };
        Self { sequence: event.sequence, time: Some(event.at.into()), event: Some(happened) }
    }
}

/// A JSON object as `google.protobuf.Struct`, whose numbers are doubles as those of JSON are.
pub fn structure(members: &serde_json::Map<String, Json>) -> Struct {
    Struct { fields: members.iter().map(|(name, member)| (name.clone(), value(member))).collect() }
}

fn value(json: &Json) -> Value {
    let kind = match json {
        Json::Null => Kind::NullValue(0),
        Json::Bool(truth) => Kind::BoolValue(*truth),
        Json::Number(number) => Kind::NumberValue(number.as_f64().unwrap_or(f64::NAN)),
        Json::String(text) => Kind::StringValue(text.clone()),
        Json::Array(items) => Kind::ListValue(ListValue { values: items.iter().map(value).collect() }),
        Json::Object(members) => Kind::StructValue(structure(members)),
    };
    Value { kind: Some(kind) }
}
