//! Where jobs are written down, and the rules that hold for them whatever engine keeps them.
//!
//! 1. **Taking.** [`JobStore::claim`] gives a job to one worker under a *lease*: a time until which the worker must be
//!    heard of again, and the attempt number, which is the fencing token. Whoever holds an older attempt changes
//!    nothing any more, however late it comes back.
//! 2. **Order.** Priority first; then the caller with the fewest jobs running, then the one served longest ago; then
//!    age. A job too large for the memory that is free lets smaller ones pass for [`PASSING_TIME`], then nobody.
//! 3. **Losing.** A lease that ran out puts the job back once; the second time it fails with `worker_lost`. A worker
//!    that gives a job back by itself has not lost it.
//! 4. **Ending.** Final states never change, but for expiry of a result. What ends a job is written in one transaction
//!    with its result, its events and the blobs that it names.
//! 5. **Numbers.** Every event of a job has the next number; they survive a restart.
//! 6. **Blobs.** The store alone says which blobs are in use; [`JobStore::collect`] forgets those that no asset, no
//!    unfinished job, no kept result and no open upload names, and its caller removes them.
//! 7. **Batches.** An item is pending until it is settled, once: as a job, as refused, or as canceled. An asset that a
//!    pending item needs is kept. A batch is over when all its items are.
//!
//! 8. **Webhooks.** What callers want to be told is written with the change that it tells of; [`webhooks`] has the rules.
//!
//! Every engine passes the suite in `tests/it/jobs_store`. [`sqlite`] is the embedded one; [`postgres`] is shared by many
//! processes. Both run the statements in `sql`.

pub(super) mod codec;
pub mod postgres;
pub mod resumable;
mod snapshot;
mod sql;
pub mod sqlite;
pub mod webhooks;

use self::resumable::ResumableStore;
use super::asset::Asset;
use super::batch::{Batch, BatchItem, NewBatch, OpenBatch, PendingItem, Settled};
use super::clock::Timestamp;
use super::event::Event;
use super::failure::JobError;
use super::ids::{AssetId, BatchId, JobId};
use super::job::{FileInfo, Job, JobResult, JobState};
use super::options::RigOptions;
use super::perform::Timing;
use super::stage::Stage;
use super::submission::{Caller, Labels, Missing, Priority};
use super::webhooks::JobWebhook;
use crate::storage::NewBlob;
use async_trait::async_trait;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::broadcast;
use webhooks::WebhookStore;

/// A worker is taken for lost when it was not heard of for this long.
pub const LEASE: Duration = Duration::from_secs(15);
/// How long a job too large for the free memory lets others pass.
pub const PASSING_TIME: Duration = Duration::from_secs(30);
/// Workers that a job may lose before it fails.
pub const LOSSES_MAX: u32 = 2;
/// How long an idempotency key is remembered.
pub const IDEMPOTENCY_TIME: Duration = Duration::from_secs(24 * 3600);
/// How long a request may take to answer before its idempotency key is free again: its process is gone.
pub const ANSWER_TIME: Duration = Duration::from_secs(15 * 60);

/// The store cannot answer: its disk is full, its file cannot be written, its server is away.
#[derive(Clone, Debug, thiserror::Error)]
#[error("the job store does not answer: {0}")]
pub struct StoreFailure(pub Arc<str>);

impl StoreFailure {
    pub fn new(cause: &dyn std::fmt::Display) -> Self {
        Self(cause.to_string().into())
    }
}

/// Which files a job is to rig.
#[derive(Clone, Debug)]
pub enum NewFiles {
    /// The main file first.
    Received {
        files: Vec<NewBlob>,
        memory_bytes: u64,
    },
    Asset(AssetId),
    Job(JobId),
}

/// A job to write down.
#[derive(Clone, Debug)]
pub struct NewJob {
    pub caller: Caller,
    pub files: NewFiles,
    pub skeleton: Option<NewBlob>,
    pub options: RigOptions,
    pub priority: Priority,
    pub labels: Labels,
    pub timeout: Duration,
    pub deadline: Option<Timestamp>,
    pub retention: Duration,
    pub client_id: Option<String>,
    pub idempotency_key: Option<String>,
    /// Where it wants told what becomes of it.
    pub webhook: Option<JobWebhook>,
    /// Digest of what is asked, beside the files.
    pub wish: [u8; 32],
    /// Digest of what decides the result, beside the files.
    pub recipe: [u8; 32],
    pub use_cache: bool,
    /// Jobs that may wait while `workers` jobs run.
    pub waiting_max: usize,
    pub workers: usize,
    /// Unfinished jobs that the caller may have, with this one.
    pub unfinished_max: Option<usize>,
    /// How long the files are kept as an asset.
    pub asset_retention: Duration,
}

/// What became of a new job.
#[derive(Clone, Debug)]
pub enum Admission {
    /// Written down: queued, or succeeded at once with an earlier result. `kept` are the locations of the blobs that
    /// are in use now; the others were there already.
    Admitted {
        job: Box<Job>,
        kept: Vec<String>,
    },
    /// It was there before.
    Replayed(Box<Job>),
    IdempotencyMismatch,
    ClientIdTaken,
    QueueFull {
        waiting: usize,
    },
    QuotaExceeded {
        unfinished: usize,
    },
    Missing(Missing),
}

/// The right to work on a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lease {
    pub job: JobId,
    /// The fencing token.
    pub attempt: u32,
}

/// A blob in use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BlobPlace {
    pub location: String,
    pub bytes: u64,
}

/// A job that a worker may do now.
#[derive(Clone, Debug)]
pub struct Claim {
    pub lease: Lease,
    pub job: Job,
    /// Where its files are, in the order of `job.request.files`.
    pub files: Vec<(FileInfo, BlobPlace)>,
    pub skeleton: Option<BlobPlace>,
    pub memory_bytes: u64,
    /// Time until its deadline.
    pub time_left: Option<Duration>,
}

/// What a worker hears when it says that it lives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeaseState {
    Held,
    /// Held, and the caller wants it stopped.
    CancelRequested,
    /// Somebody else has the job, or it is over.
    Lost,
}

/// How work ended.
#[derive(Clone, Debug)]
pub struct Ending {
    pub outcome: Result<(JobResult, Vec<NewBlob>), EndedWithout>,
    pub stage: Option<Stage>,
    pub timings: Vec<Timing>,
}

/// Work that gave nothing.
#[derive(Clone, Debug)]
pub enum EndedWithout {
    Canceled,
    Failed(JobError),
}

/// What became of an ending.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Finish {
    /// Written down. The locations of the blobs that are in use now.
    Done { kept: Vec<String> },
    /// Refused: the attempt is not the current one any more.
    Fenced,
}

/// What became of a wish to cancel or delete.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    Done,
    /// The running worker has been asked.
    Requested,
    NotFound,
    State(JobState),
}

/// Which jobs a list shows.
#[derive(Clone, Debug, Default)]
pub struct JobFilter {
    pub state: Option<JobState>,
    /// Name and value of a label.
    pub label: Option<(String, String)>,
}

/// Numbers for admission and metrics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    pub queued: usize,
    pub running: usize,
    /// When the job that waits longest was queued.
    pub oldest_queued_at: Option<Timestamp>,
}

/// What sweeping changed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Swept {
    /// Jobs whose state changed.
    pub changed: Vec<JobId>,
    /// Jobs that wait again.
    pub requeued: usize,
    /// Whether blobs may have become free.
    pub freed: bool,
}

/// How much is remembered.
#[derive(Clone, Copy, Debug)]
pub struct Memory {
    /// Final jobs are forgotten after this time,
    pub records_time: Duration,
    /// or when there are more of them than this.
    pub records_max: usize,
}

/// An answer that may be given again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Remembered {
    /// The key is new: answer, then [`JobStore::remember`].
    Fresh,
    Answer(Vec<u8>),
    InProgress,
    Mismatch,
}

/// What happened to jobs, perhaps in another process. Only a hint: it may get lost, and the facts are in the store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum News {
    /// Something happened to this job.
    Job(JobId),
    /// Whoever works on this job should stop.
    Stop(JobId),
    /// A job waits.
    Queued,
    /// News were missed.
    Missed,
}

/// What one process does for all, now and then.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Duty {
    /// Files that a crash left without a name are removed.
    RemoveOrphans,
}

impl Duty {
    pub fn name(self) -> &'static str {
        match self {
            Self::RemoveOrphans => "remove_orphans",
        }
    }
}

/// Where jobs are written down. See the module for its rules.
#[async_trait]
pub trait JobStore: ResumableStore + WebhookStore {
    /// Writes a job down, or finds it.
    async fn submit(&self, new: NewJob) -> Result<Admission, StoreFailure>;

    /// The next job that needs at most `memory_free` bytes, now running for `worker`.
    async fn claim(&self, worker: &str, memory_free: u64) -> Result<Option<Claim>, StoreFailure>;

    /// Extends leases; says of each how it stands.
    async fn extend(&self, leases: &[Lease]) -> Result<Vec<LeaseState>, StoreFailure>;

    /// Says of each lease how it stands, without extending it.
    async fn look_at(&self, leases: &[Lease]) -> Result<Vec<LeaseState>, StoreFailure>;

    /// The work has reached `stage`. Progress never falls. `false`: fenced.
    async fn advance(&self, lease: Lease, stage: Stage) -> Result<bool, StoreFailure>;

    async fn finish(&self, lease: Lease, ending: Ending) -> Result<Finish, StoreFailure>;

    /// Puts a job back that its worker cannot go on with, without blame. `false`: fenced.
    async fn give_back(&self, lease: Lease) -> Result<bool, StoreFailure>;

    /// Takes every running job for lost: the process that held them all is gone.
    async fn lose_all(&self) -> Result<Swept, StoreFailure>;

    /// Applies what time has brought: leases, deadlines, retention, forgotten records and keys.
    async fn sweep(&self, memory: Memory) -> Result<Swept, StoreFailure>;

    /// Ends the result, or the unused asset, that was kept longest. `false`: there is none.
    async fn expire_oldest(&self) -> Result<bool, StoreFailure>;

    async fn cancel(&self, caller: &Caller, id: JobId) -> Result<Change, StoreFailure>;

    /// Forgets a job that does not run.
    async fn delete(&self, caller: &Caller, id: JobId) -> Result<Change, StoreFailure>;

    async fn job(&self, caller: &Caller, id: JobId) -> Result<Option<Job>, StoreFailure>;

    async fn job_by_client_id(&self, caller: &Caller, client_id: &str) -> Result<Option<Job>, StoreFailure>;

    /// Newest first, older than `before`, at most `count`.
    async fn list(
        &self,
        caller: &Caller,
        filter: &JobFilter,
        before: Option<JobId>,
        count: usize,
    ) -> Result<Vec<Job>, StoreFailure>;

    /// Events with numbers above `after`, oldest first, at most `count`.
    async fn events(&self, id: JobId, after: u64, count: usize) -> Result<Vec<Event>, StoreFailure>;

    async fn counts(&self) -> Result<Counts, StoreFailure>;

    /// Keeps files as an asset, or finds it. `true`: it is new. The locations are those of blobs in use now.
    async fn put_asset(
        &self,
        caller: &Caller,
        files: &[NewBlob],
        memory_bytes: u64,
        retention: Duration,
    ) -> Result<(Asset, bool, Vec<String>), StoreFailure>;

    async fn asset(&self, caller: &Caller, id: AssetId) -> Result<Option<Asset>, StoreFailure>;

    /// `false`: there was none. Jobs keep the files that they need.
    async fn delete_asset(&self, caller: &Caller, id: AssetId) -> Result<bool, StoreFailure>;

    /// Where a blob is, while it is in use.
    async fn blob(&self, sha256: &[u8; 32]) -> Result<Option<BlobPlace>, StoreFailure>;

    /// Forgets blobs that are not in use; the caller removes their files.
    async fn collect(&self) -> Result<Vec<BlobPlace>, StoreFailure>;

    /// The locations of all blobs that are written down.
    async fn locations(&self) -> Result<BTreeSet<String>, StoreFailure>;

    /// Writes a batch down, whole or not at all.
    async fn create_batch(&self, new: NewBatch) -> Result<BatchId, StoreFailure>;

    async fn batch(&self, caller: &Caller, id: BatchId) -> Result<Option<Batch>, StoreFailure>;

    /// Newest first, older than `before`, at most `count`.
    async fn batches(&self, caller: &Caller, before: Option<BatchId>, count: usize)
    -> Result<Vec<Batch>, StoreFailure>;

    /// Items from `first` on, in order, at most `count`.
    async fn batch_items(&self, id: BatchId, first: usize, count: usize) -> Result<Vec<BatchItem>, StoreFailure>;

    /// Batches that are not over, oldest first.
    async fn open_batches(&self) -> Result<Vec<OpenBatch>, StoreFailure>;

    /// The first items that are no job yet, in order, at most `count`.
    async fn pending_items(&self, id: BatchId, count: usize) -> Result<Vec<PendingItem>, StoreFailure>;

    /// Says what became of a pending item; `false`: it is not pending any more.
    async fn settle_item(&self, id: BatchId, position: usize, settled: &Settled) -> Result<bool, StoreFailure>;

    /// Ends all pending items. Gives the jobs of the batch that are not over; `None`: there is no such batch.
    async fn cancel_batch(&self, caller: &Caller, id: BatchId) -> Result<Option<Vec<JobId>>, StoreFailure>;

    /// Ends items as their jobs ended, and batches without open items. Gives those batches.
    async fn conclude_batches(&self) -> Result<Vec<BatchId>, StoreFailure>;

    /// Looks an idempotency key up for a request that makes no job, and reserves it when it is new.
    async fn recall(&self, caller: &Caller, key: &str, fingerprint: &[u8; 32]) -> Result<Remembered, StoreFailure>;

    /// Keeps the answer for a key that was reserved; `None` frees the key.
    async fn remember(&self, caller: &Caller, key: &str, answer: Option<&[u8]>) -> Result<(), StoreFailure>;

    /// Whether this process is the one to do `duty` now, which is due once in `every`.
    async fn take_turn(&self, duty: Duty, every: Duration) -> Result<bool, StoreFailure>;

    /// What other processes on the same jobs do; `None`: there are none.
    fn news(&self) -> Option<broadcast::Receiver<News>>;

    /// Writes what is pending and closes.
    async fn close(&self);
}
