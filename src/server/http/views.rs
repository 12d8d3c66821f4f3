//! What goes over the wire as JSON. Built from inner types here, and nowhere else.

use super::error::{ApiError, Limit, ProblemView};
use super::request_views::RequestView;
use super::timestamp::rfc3339;
use super::words::{SeverityName, StageName, StateName};
use crate::formats::Severity;
use crate::jobs::{ArtifactInfo, FileInfo, Job, JobError, JobResult, JobState, ModelInfo, Notice, asset_sha256};
use serde::Serialize;
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::time::{Duration, SystemTime};
use utoipa::ToSchema;

/// One rig: what was asked, where it stands, and what came out.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Rig)]
pub struct JobView {
    #[schema(example = "rig_01jdf5fj63fh5ra1njpy75fmyg")]
    pub id: String,
    #[schema(example = "rig")]
    pub object: &'static str,
    #[schema(value_type = StateName, example = "succeeded")]
    pub state: &'static str,
    #[schema(value_type = Option<StageName>, example = "validate")]
    pub stage: Option<&'static str>,
    /// Never falls; 100 only with `succeeded`.
    #[schema(example = 100, minimum = 0, maximum = 100)]
    pub progress: u8,
    /// 1 is next; `null` unless queued.
    #[schema(example = json!(null))]
    pub queue_position: Option<usize>,
    /// About how long it will still run, by how far it has come; `null` unless running.
    #[schema(example = json!(null))]
    pub estimated_seconds_left: Option<u64>,
    /// Canceled while running; the work yields soon.
    pub cancel_requested: bool,
    #[schema(example = 1)]
    pub attempt: u32,
    #[schema(example = "2026-11-24T15:20:07.042Z", format = DateTime)]
    pub created_at: String,
    #[schema(example = "2026-11-24T15:20:07.050Z", format = DateTime)]
    pub started_at: Option<String>,
    #[schema(example = "2026-11-24T15:20:10.611Z", format = DateTime)]
    pub finished_at: Option<String>,
    /// When the results go.
    #[schema(example = "2026-11-25T15:20:10.611Z", format = DateTime)]
    pub expires_at: Option<String>,
    pub request: RequestView,
    /// The id that the caller gave it.
    #[schema(example = "hero-v3")]
    pub client_id: Option<String>,
    /// The files as an asset, while they are kept as one.
    #[schema(example = "ast_01jdf5fj5rfxm8s1m2q1d2zt8v")]
    pub asset: Option<String>,
    /// The files received, the main one first.
    pub files: Vec<FileView>,
    #[schema(example = "rignet")]
    pub method_used: Option<String>,
    pub provenance: ProvenanceView,
    /// Milliseconds in the queue and per stage, once the job is over.
    #[schema(example = json!({"queue": 8, "ingest": 12, "geometry": 840, "joints": 610, "skin": 700}))]
    pub timings_ms: BTreeMap<&'static str, u64>,
    pub warnings: Vec<FindingView>,
    pub result: Option<ResultView>,
    pub error: Option<JobErrorView>,
    pub links: LinksView,
}

/// A file of the upload.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = UploadedFile)]
pub struct FileView {
    #[schema(example = "hero.glb")]
    pub name: String,
    #[schema(example = 482_113)]
    pub bytes: u64,
    #[schema(example = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08")]
    pub sha256: String,
}

/// Everything that decides the result, beside the options.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Provenance)]
pub struct ProvenanceView {
    /// Digest of the file sent; of the list of names and digests when there were several.
    #[schema(example = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08")]
    pub asset_sha256: String,
    #[schema(example = "0.1.0")]
    pub service_version: &'static str,
    /// The networks of the method used.
    pub models: Vec<ModelView>,
    pub cached: bool,
}

/// A network.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Model)]
pub struct ModelView {
    #[schema(example = "rignet_skin")]
    pub name: String,
    #[schema(example = "2c26b46b68ffc68ff99b453c1d30413413422d706483bfa0f98a5e886266e7ae")]
    pub sha256: String,
    /// What the known-answer test at start gave.
    #[schema(example = "passed")]
    pub self_test: String,
}

/// Something worth knowing that did not stop the work.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Finding)]
pub struct FindingView {
    #[schema(example = "degenerate_faces")]
    pub code: String,
    #[schema(value_type = SeverityName, example = "warning")]
    pub severity: &'static str,
    #[schema(example = "12 faces have no area and are ignored")]
    pub message: String,
    #[schema(example = "")]
    pub hint: String,
    /// Names of the parts of the file that it is about, twenty at most; empty: the whole file.
    #[schema(example = json!(["Hair", "Body, primitive 1"]))]
    pub r#where: Vec<String>,
}

/// What came out.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Result)]
pub struct ResultView {
    /// `skeleton`, `skin` and further members about the rig.
    #[serde(flatten)]
    pub report: Map<String, Value>,
    /// Empty once the results expired.
    pub artifacts: Vec<ArtifactView>,
}

/// A file that was made.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Artifact)]
pub struct ArtifactView {
    #[schema(example = "rigged.glb")]
    pub name: String,
    #[schema(example = "model/gltf-binary")]
    pub media_type: String,
    #[schema(example = 531_004)]
    pub bytes: u64,
    #[schema(example = "fcde2b2edba56bf408601fb721fe9b5c338d10ee429ea04fae5511b68fbf8fb9")]
    pub sha256: String,
    #[schema(example = "/v1/rigs/rig_01jdf5fj63fh5ra1njpy75fmyg/artifacts/rigged.glb")]
    pub url: String,
}

/// Why the job has no result.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = JobError)]
pub struct JobErrorView {
    #[schema(example = "no_joints_found")]
    pub code: &'static str,
    #[schema(value_type = Option<StageName>, example = "joints")]
    pub stage: Option<&'static str>,
    #[schema(example = "no joints were found with bandwidths from 0.02 to 0.1")]
    pub message: String,
    #[schema(example = "send a mesh of one whole character")]
    pub hint: Option<String>,
    pub retryable: bool,
    /// A page about this kind of problem.
    #[schema(example = "/v1/problems/no_joints_found")]
    pub r#type: String,
    /// The limit that was passed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit: Option<Limit>,
}

#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Links)]
pub struct LinksView {
    #[schema(example = "/v1/rigs/rig_01jdf5fj63fh5ra1njpy75fmyg")]
    #[serde(rename = "self")]
    pub this: String,
    #[schema(example = "/v1/rigs/rig_01jdf5fj63fh5ra1njpy75fmyg/artifacts")]
    pub artifacts: String,
    /// Server-sent events: progress as it happens.
    #[schema(example = "/v1/rigs/rig_01jdf5fj63fh5ra1njpy75fmyg/events")]
    pub events: String,
    /// POST here; `null` once the job is over.
    #[schema(example = "/v1/rigs/rig_01jdf5fj63fh5ra1njpy75fmyg:cancel")]
    pub cancel: Option<String>,
}

/// Rigs, newest first.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = RigList)]
pub struct JobListView {
    #[schema(example = "list")]
    pub object: &'static str,
    pub data: Vec<JobView>,
    /// Give it as `page_token` for the next page; `null` on the last one.
    pub next_page_token: Option<String>,
}

#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ArtifactList)]
pub struct ArtifactListView {
    #[schema(example = "list")]
    pub object: &'static str,
    pub data: Vec<ArtifactView>,
}

pub fn hex(digest: &[u8]) -> String {
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn milliseconds(time: Duration) -> u64 {
    time.as_millis() as u64
}

/// Where a job lives.
pub fn job_path(job: &Job) -> String {
    format!("/v1/rigs/{}", job.id)
}

impl From<&Job> for JobView {
    fn from(job: &Job) -> Self {
        let path = job_path(job);
        let result = job.result.as_deref();
        Self {
            id: job.id.to_string(),
            object: "rig",
            state: job.state.name(),
            stage: job.stage.map(|stage| stage.name()),
            progress: job.progress,
            queue_position: job.queue_position,
            estimated_seconds_left: estimated_seconds_left(job),
            cancel_requested: job.cancel_requested,
            attempt: job.attempt,
            created_at: rfc3339(job.created_at),
            started_at: job.started_at.map(rfc3339),
            finished_at: job.finished_at.map(rfc3339),
            expires_at: job.expires_at.map(rfc3339),
            request: request(job),
            client_id: job.request.client_id.clone(),
            asset: job.request.asset.map(|asset| asset.to_string()),
            files: job.request.files.iter().map(FileView::from).collect(),
            method_used: result.map(|result| result.method_used.clone()),
            provenance: ProvenanceView {
                asset_sha256: hex(&asset_sha256(&job.request.files)),
                service_version: env!("CARGO_PKG_VERSION"),
                models: result.map(|result| models(&result.models)).unwrap_or_default(),
                cached: job.cached,
            },
            timings_ms: timings_ms(job).collect(),
            warnings: result.map(|result| result.findings.iter().map(FindingView::from).collect()).unwrap_or_default(),
            result: result
                .map(|result| ResultView { report: result.report.clone(), artifacts: artifacts(job, result) }),
            error: job.error.as_ref().map(JobErrorView::from),
            links: LinksView {
                artifacts: format!("{path}/artifacts"),
                events: format!("{path}/events"),
                cancel: (!job.state.is_final()).then(|| format!("{path}:cancel")),
                this: path,
            },
        }
    }
}

/// What was asked.
pub fn request(job: &Job) -> RequestView {
    RequestView { options: (&job.request.options).into(), wishes: (&*job.request).into() }
}

/// The time that the rest takes if it goes on as it went so far. Nothing is said before there is something to go by.
pub fn estimated_seconds_left(job: &Job) -> Option<u64> {
    const PROGRESS_TOLD: u8 = 10;
    let began = job.started_at.filter(|_| job.state == JobState::Running && job.progress >= PROGRESS_TOLD)?;
    let taken = SystemTime::now().duration_since(began).ok()?.as_secs_f64();
    let (done, left) = (f64::from(job.progress), f64::from(100 - job.progress.min(100)));
    Some((taken * left / done).ceil() as u64)
}

/// Milliseconds in the queue and per stage, in the order of the work.
pub fn timings_ms(job: &Job) -> impl Iterator<Item = (&'static str, u64)> {
    let queue = job.queue_time.map(|time| ("queue", milliseconds(time)));
    queue.into_iter().chain(job.timings.iter().map(|timing| (timing.stage.name(), milliseconds(timing.duration))))
}

fn artifacts(job: &Job, result: &JobResult) -> Vec<ArtifactView> {
    present(job, result).iter().map(|artifact| ArtifactView::new(job, artifact)).collect()
}

pub fn models(models: &[ModelInfo]) -> Vec<ModelView> {
    models
        .iter()
        .map(|model| ModelView {
            name: model.name.clone(),
            sha256: model.sha256.clone(),
            self_test: model.self_test.clone(),
        })
        .collect()
}

/// The files of a result that are still there.
pub fn present<'result>(job: &Job, result: &'result JobResult) -> &'result [ArtifactInfo] {
    if job.state == JobState::Expired { &[] } else { &result.artifacts }
}

impl ArtifactView {
    pub fn new(job: &Job, artifact: &ArtifactInfo) -> Self {
        Self {
            name: artifact.name.clone(),
            media_type: artifact.media_type.clone(),
            bytes: artifact.bytes,
            sha256: hex(&artifact.sha256),
            url: format!("{}/artifacts/{}", job_path(job), artifact.name),
        }
    }
}

impl From<&FileInfo> for FileView {
    fn from(file: &FileInfo) -> Self {
        Self { name: file.name.clone(), bytes: file.bytes, sha256: hex(&file.sha256) }
    }
}

impl From<&Notice> for FindingView {
    fn from(finding: &Notice) -> Self {
        let severity = match finding.severity {
            Severity::Info => "info",
            Severity::Warning => "warning",
        };
        let Notice { code, parts, message, hint, .. } = finding.clone();
        Self { code, severity, message, hint, r#where: parts }
    }
}

/// Why a file cannot be read.
impl From<&JobError> for FindingView {
    fn from(error: &JobError) -> Self {
        Self {
            code: error.code.name().to_owned(),
            severity: "error",
            message: error.message.clone(),
            hint: error.hint.clone(),
            r#where: Vec::new(),
        }
    }
}

impl From<&ApiError> for JobErrorView {
    fn from(error: &ApiError) -> Self {
        let ProblemView { r#type, detail, code, retryable, stage, hint, limit, .. } = error.view("", "");
        Self { code, stage, message: detail, hint, retryable, r#type, limit }
    }
}

impl From<&JobError> for JobErrorView {
    fn from(error: &JobError) -> Self {
        Self {
            code: error.code.name(),
            stage: error.stage.map(|stage| stage.name()),
            message: error.message.clone(),
            hint: Some(error.hint.clone()).filter(|hint| !hint.is_empty()),
            retryable: error.code.retryable(),
            r#type: format!("/v1/problems/{}", error.code.name()),
            limit: error.limit.clone().map(Limit::from),
        }
    }
}
