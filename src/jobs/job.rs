//! A job as its callers see it: a snapshot, true at the moment it was taken.
//!
//! ```text
//! queued ──► running ──► succeeded ──► expired      (results are kept for a time)
//!    │           ├─────► failed
//!    │  ▲        │
//!    │  └────────┤         (the worker is lost, or the service stops)
//!    └───────────┴─────► canceled
//! ```
//! A job whose deadline passes while it waits goes from queued to failed. Final states never change, but for expiry.

use super::failure::JobError;
use super::ids::{AssetId, JobId};
use super::options::RigOptions;
use super::perform::{ModelInfo, Timing};
use super::stage::Stage;
use super::submission::{Caller, Labels, Priority};
use super::webhooks::JobWebhook;
use crate::formats::{Finding, Severity};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JobState {
    Queued,
    Running,
    Succeeded,
    Failed,
    Canceled,
    /// Succeeded once; the results are gone.
    Expired,
}

impl JobState {
    pub const ALL: [JobState; 6] = [
        JobState::Queued,
        JobState::Running,
        JobState::Succeeded,
        JobState::Failed,
        JobState::Canceled,
        JobState::Expired,
    ];

    pub fn name(self) -> &'static str {
        match self {
            JobState::Queued => "queued",
            JobState::Running => "running",
            JobState::Succeeded => "succeeded",
            JobState::Failed => "failed",
            JobState::Canceled => "canceled",
            JobState::Expired => "expired",
        }
    }

    /// Nothing more will happen, but for expiry.
    pub fn is_final(self) -> bool {
        !matches!(self, JobState::Queued | JobState::Running)
    }
}

/// A job at one moment.
#[derive(Clone, Debug)]
pub struct Job {
    pub id: JobId,
    pub caller: Caller,
    pub state: JobState,
    /// Where the work is, or where it ended.
    pub stage: Option<Stage>,
    /// 0 to 100, never falling; 100 with success alone.
    pub progress: u8,
    /// 1 for the next to run; `None` unless queued.
    pub queue_position: Option<usize>,
    /// Cancelled while running; the work has not yielded yet.
    pub cancel_requested: bool,
    /// How often work on it began; 0 while it waits for the first time.
    pub attempt: u32,
    pub created_at: SystemTime,
    pub started_at: Option<SystemTime>,
    pub finished_at: Option<SystemTime>,
    /// When the results go; `None` unless succeeded.
    pub expires_at: Option<SystemTime>,
    pub request: Arc<JobRequest>,
    /// Time in the queue, once it is over.
    pub queue_time: Option<Duration>,
    /// Time per stage, once the job is final.
    pub timings: Vec<Timing>,
    pub result: Option<Arc<JobResult>>,
    pub error: Option<JobError>,
    /// The result is that of an earlier equal job.
    pub cached: bool,
    /// The number of its last event.
    pub sequence: u64,
}

/// What was asked.
#[derive(Clone, Debug)]
pub struct JobRequest {
    pub options: RigOptions,
    /// The main file first.
    pub files: Vec<FileInfo>,
    /// The files as an asset, while it is kept.
    pub asset: Option<AssetId>,
    pub priority: Priority,
    pub labels: Labels,
    /// Longest run.
    pub timeout: Duration,
    pub deadline: Option<SystemTime>,
    /// How long results are kept.
    pub retention: Duration,
    /// The id that the caller gave it.
    pub client_id: Option<String>,
    /// Whether a skeleton came along.
    pub skeleton_given: bool,
    /// Where it wants told what becomes of it.
    pub webhook: Option<JobWebhook>,
}

/// What came out.
#[derive(Clone, Debug)]
pub struct JobResult {
    pub method_used: String,
    /// The networks of the method.
    pub models: Vec<ModelInfo>,
    pub report: serde_json::Map<String, serde_json::Value>,
    pub findings: Vec<Notice>,
    pub artifacts: Vec<ArtifactInfo>,
}

/// A finding, kept with its job. A later version of the program may read what an earlier one found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    pub code: String,
    /// Labels of the parts that it is about; empty: the whole file.
    pub parts: Vec<String>,
    pub severity: Severity,
    pub message: String,
    pub hint: String,
}

impl From<Finding> for Notice {
    fn from(finding: Finding) -> Self {
        let Finding { code, parts, severity, message, hint } = finding;
        Self { code: code.to_owned(), parts, severity, message, hint }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileInfo {
    pub name: String,
    pub bytes: u64,
    pub sha256: [u8; 32],
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ArtifactInfo {
    pub name: String,
    pub media_type: String,
    pub bytes: u64,
    pub sha256: [u8; 32],
}
