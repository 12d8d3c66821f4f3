//! What a door hands in: who asks, for what, how urgently, and how often the same wish may arrive.

use super::failure::JobError;
use super::ids::{AssetId, JobId};
use super::job::Job;
use super::options::{FieldError, RigOptions};
use super::store::StoreFailure;
use super::upload::Received;
use super::webhooks::JobWebhook;
use crate::storage::StoreError;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

/// Who asks. Jobs, assets and idempotency keys of one caller are not there for another.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Caller(Arc<str>);

impl Caller {
    /// A caller by a name that stays the same: the name of a key, never the key itself.
    pub fn named(name: &str) -> Self {
        Self(name.into())
    }

    /// Everybody, where nobody has to say who they are.
    pub fn anonymous() -> Self {
        Self::named("")
    }

    pub fn name(&self) -> &str {
        &self.0
    }
}

/// What runs first when jobs wait.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Priority {
    Low,
    #[default]
    Normal,
    High,
}

impl Priority {
    pub const ALL: [Self; 3] = [Self::Low, Self::Normal, Self::High];

    pub fn name(self) -> &'static str {
        match self {
            Self::Low => "low",
            Self::Normal => "normal",
            Self::High => "high",
        }
    }

    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|priority| priority.name() == name)
    }
}

/// Words of the caller's own on a job, to find it by.
pub type Labels = BTreeMap<String, String>;

/// Where the mesh of a job comes from.
pub enum Source {
    /// Files that were just received.
    Upload(Received),
    /// Files that the caller sent before.
    Asset(AssetId),
    /// The files of an earlier job, for rigging them anew.
    Job(JobId),
}

/// A job to queue.
pub struct Submission {
    pub caller: Caller,
    pub source: Source,
    pub options: RigOptions,
    pub priority: Priority,
    pub labels: Labels,
    /// Longest run; no longer than the service allows.
    pub timeout: Option<Duration>,
    /// When the result is of no use any more: a job that is not over by then fails with `timeout`.
    pub deadline: Option<SystemTime>,
    /// How long results are kept; no longer than the service keeps any.
    pub retention: Option<Duration>,
    /// The id that the caller gave the job (`PUT /v1/rigs/{client_id}`). Once per caller.
    pub client_id: Option<String>,
    /// The same key with the same wish gives the same job, for 24 hours.
    pub idempotency_key: Option<String>,
    /// Take the result of an earlier equal job when there is one. `Cache-Control: no-cache` says no.
    pub use_cache: bool,
    /// Unfinished jobs that the caller may have, this one included.
    pub jobs_max: Option<usize>,
    /// `rig.json` with the skeleton to keep: only the skin is made.
    pub skeleton: Option<bytes::Bytes>,
    /// Where this job wants told what becomes of it.
    pub webhook: Option<JobWebhook>,
}

impl Submission {
    /// With defaults for all but what is to be rigged.
    pub fn new(caller: Caller, source: Source, options: RigOptions) -> Self {
        Self {
            caller,
            source,
            options,
            priority: Priority::default(),
            labels: Labels::new(),
            timeout: None,
            deadline: None,
            retention: None,
            client_id: None,
            idempotency_key: None,
            use_cache: true,
            jobs_max: None,
            skeleton: None,
            webhook: None,
        }
    }
}

/// What became of a submission.
#[derive(Clone, Debug)]
pub struct Submitted {
    pub job: Job,
    /// The job was there before: by its idempotency key or by the caller's id.
    pub replayed: bool,
}

/// Looks at meshes and exports are done at once or not at all, so they can be too many while no job waits.
fn queue_full(waiting: usize) -> String {
    match waiting {
        0 => "as many meshes are looked at and exported as may be at a time".to_owned(),
        waiting => format!("{waiting} jobs are waiting, and no more may"),
    }
}

/// Why a request does not become a job.
#[derive(Debug, thiserror::Error)]
pub enum Refusal {
    #[error("the service is starting")]
    Starting,
    #[error("the service is stopping")]
    Draining,
    #[error("{reason}")]
    ModelUnavailable { reason: String },
    #[error("{}", queue_full(*waiting))]
    QueueFull { waiting: usize, retry_after: Duration },
    #[error("{unfinished} of your jobs are not over, and no more may be")]
    QuotaExceeded { unfinished: usize, retry_after: Duration },
    #[error("{0}")]
    Option(FieldError),
    #[error("the upload could not be stored")]
    Store(#[source] StoreError),
    #[error("the job store does not answer")]
    Unavailable(#[from] StoreFailure),
    #[error("there is no such {0}")]
    NotFound(Missing),
    #[error("this idempotency key came with another request before")]
    IdempotencyMismatch,
    #[error("the request with this idempotency key is still being answered")]
    IdempotencyInProgress,
    #[error("this id belongs to another request of yours")]
    ClientIdTaken,
    #[error(transparent)]
    Check(JobError),
}

/// What a submission refers to in vain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Missing {
    Asset,
    Job,
}

impl fmt::Display for Missing {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Asset => "asset",
            Self::Job => "job",
        })
    }
}
