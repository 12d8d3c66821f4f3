//! A job as its callers see it: a snapshot, true at the moment it was taken.
//!
//! ```text
//! queued ──► running ──► succeeded ──► expired      (results are kept for a time)
//!    │           ├─────► failed
//!    └───────────┴─────► canceled
//! ```
//! A job that the service gives up while it waits goes from queued to failed.

use super::failure::JobError;
use super::options::RigOptions;
use super::perform::{ModelInfo, Timing};
use super::stage::Stage;
use crate::formats::Finding;
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use uuid::Uuid;

/// `rig_` and a UUIDv7 in Crockford's base 32, lower case: ids sort by time of creation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct JobId(Uuid);

const ID_PREFIX: &str = "rig_";
const ID_DIGITS: usize = 26;
const BASE32: &[u8; 32] = b"0123456789abcdefghjkmnpqrstvwxyz";

impl JobId {
    /// An id after all ids that this process made before.
    pub fn new() -> Self {
        Self(Uuid::now_v7())
    }
}

impl Default for JobId {
    fn default() -> Self {
        Self::new()
    }
}

impl fmt::Display for JobId {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = self.0.as_u128();
        out.write_str(ID_PREFIX)?;
        for place in (0..ID_DIGITS).rev() {
            let digit = (value >> (5 * place)) & 31;
            write!(out, "{}", char::from(BASE32[digit as usize]))?;
        }
        Ok(())
    }
}

/// The text is no id.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("an id is rig_ and 26 letters and digits")]
pub struct NotAnId;

impl FromStr for JobId {
    type Err = NotAnId;

    fn from_str(text: &str) -> Result<Self, NotAnId> {
        let digits = text.strip_prefix(ID_PREFIX).filter(|digits| digits.len() == ID_DIGITS).ok_or(NotAnId)?;
        let mut value: u128 = 0;
        for byte in digits.bytes() {
            let digit = BASE32.iter().position(|known| *known == byte).ok_or(NotAnId)?;
            // 26 digits hold 130 bits; the first digit must leave the two topmost clear.
            value = value.checked_mul(32).ok_or(NotAnId)? + digit as u128;
        }
        Ok(Self(Uuid::from_u128(value)))
    }
}

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
    pub state: JobState,
    /// Where the work is, or where it ended.
    pub stage: Option<Stage>,
    /// 0 to 100, never falling; 100 with success alone.
    pub progress: u8,
    /// 1 for the next to run; `None` unless queued.
    pub queue_position: Option<usize>,
    /// Cancelled while running; the work has not yielded yet.
    pub cancel_requested: bool,
    /// 1 for the first.
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
}

/// What was asked.
#[derive(Clone, Debug)]
pub struct JobRequest {
    pub options: RigOptions,
    /// The main file first.
    pub files: Vec<FileInfo>,
}

/// What came out.
#[derive(Clone, Debug)]
pub struct JobResult {
    pub method_used: String,
    /// The networks of the method.
    pub models: Vec<ModelInfo>,
    pub report: serde_json::Map<String, serde_json::Value>,
    pub findings: Vec<Finding>,
    pub artifacts: Vec<ArtifactInfo>,
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
    pub media_type: &'static str,
    pub bytes: u64,
    pub sha256: [u8; 32],
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_survive_being_written_and_sort_by_age() {
        let ids: Vec<JobId> = (0..1000).map(|_| JobId::new()).collect();
        let written: Vec<String> = ids.iter().map(JobId::to_string).collect();
        assert!(written.is_sorted());
        for (id, text) in ids.iter().zip(&written) {
            assert_eq!(text.parse(), Ok(*id));
        }
    }

    #[test]
    fn what_is_no_id_is_refused() {
        for text in ["", "rig_", "rig_0", "ast_00000000000000000000000000", "rig_zzzzzzzzzzzzzzzzzzzzzzzzzz"] {
            assert_eq!(text.parse::<JobId>(), Err(NotAnId), "{text}");
        }
        assert_eq!("rig_7zzzzzzzzzzzzzzzzzzzzzzzzz".parse::<JobId>().map(|id| id.0), Ok(Uuid::max()));
    }
}
