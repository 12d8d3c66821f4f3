//! The one way to jobs, for every door: here they are started, submitted and ended. Refuses early instead of queueing
//! without bound.

use super::clock::{SteadyClock, Timestamp};
use super::core::{Core, OwnRuntime};
use super::failure::JobError;
use super::options::{FieldError, FieldProblem, RigOptions};
use super::perform::{MethodInfo, Readiness, Rigger};
use super::running::Stop;
use super::settings::Settings;
use super::store::postgres::PostgresStore;
use super::store::sqlite::SqliteStore;
use super::store::{Admission, Counts, JobStore, NewFiles, NewJob, Remembered, StoreFailure};
use super::submission::{Caller, Refusal, Source, Submission, Submitted};
use super::upload::Upload;
use super::{counted, keeper, memory, recipe, worker};
use crate::storage::{Bundle, Store, StoreError};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::time::timeout;

/// Why the service has no jobs.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    #[error("the job database {}: {cause}", .path.display())]
    Database { path: std::path::PathBuf, cause: StoreFailure },
    #[error("the shared job database: {0}")]
    SharedDatabase(StoreFailure),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

/// The jobs of one data folder or shared database. Clones share them; the workers leave with the last clone.
#[derive(Clone)]
pub struct Jobs(Arc<Handle>);

struct Handle(Arc<Core>);

impl Drop for Handle {
    fn drop(&mut self) {
        self.0.close();
    }
}

/// The job database within the data folder.
const DATABASE: &str = "jobs.db";
/// How long [`Jobs::close`] waits for workers.
const CLOSE_TIME: Duration = Duration::from_secs(5);

impl Jobs {
    /// Opens the jobs of `files`' folder and starts the workers. Jobs that an earlier process left go on.
    pub fn start(rigger: Arc<dyn Rigger>, files: Store, settings: Settings) -> Result<Self, StartError> {
        let runtime = OwnRuntime::new()?;
        let path = files.root().join(DATABASE);
        let opened = runtime.finish({
            let (path, files) = (path.clone(), files.clone());
            async move {
                let jobs = SqliteStore::open(&path, Arc::new(SteadyClock::default()), settings.lease).await?;
                // The lock on the folder says that the process that held these leases is gone.
                let swept = jobs.lose_all().await?;
                if !swept.changed.is_empty() {
                    tracing::warn!(
                        jobs = swept.changed.len(),
                        requeued = swept.requeued,
                        "an earlier process left jobs"
                    );
                }
                let named = jobs.locations().await?;
                match files.sweep(&named, Duration::ZERO).await {
                    Ok(0) => {}
                    Ok(orphans) => tracing::warn!(orphans, "removed files that no job names"),
                    Err(error) => return Err(StoreFailure::new(&error)),
                }
                Ok(jobs)
            }
        });
        let jobs = opened.unwrap_or_else(|| Err(given_up())).map_err(|cause| StartError::Database { path, cause })?;
        Self::start_with(runtime, rigger, files, Arc::new(jobs), settings)
    }

    /// Opens the jobs in the PostgreSQL database at `url`, which other processes may share, and starts the workers.
    /// `files` are shared by the same processes.
    pub fn start_shared(
        rigger: Arc<dyn Rigger>,
        files: Store,
        url: &str,
        settings: Settings,
    ) -> Result<Self, StartError> {
        let runtime = OwnRuntime::new()?;
        let url = url.to_owned();
        let opened = runtime.finish(async move { PostgresStore::open(&url, settings.lease).await });
        let jobs = opened.unwrap_or_else(|| Err(given_up())).map_err(StartError::SharedDatabase)?;
        Self::start_with(runtime, rigger, files, Arc::new(jobs), settings)
    }

    /// Starts workers on jobs that are written down elsewhere.
    pub fn start_on(
        rigger: Arc<dyn Rigger>,
        files: Store,
        jobs: Arc<dyn JobStore>,
        settings: Settings,
    ) -> Result<Self, StartError> {
        Self::start_with(OwnRuntime::new()?, rigger, files, jobs, settings)
    }

    fn start_with(
        runtime: OwnRuntime,
        rigger: Arc<dyn Rigger>,
        files: Store,
        jobs: Arc<dyn JobStore>,
        settings: Settings,
    ) -> Result<Self, StartError> {
        let core = Arc::new(Core::new(runtime, rigger, files, jobs, settings)?);
        let started = Self(Arc::new(Handle(core.clone())));
        worker::start(&core)?;
        keeper::start(&core);
        Ok(started)
    }

    pub(super) fn core(&self) -> &Arc<Core> {
        &self.0.0
    }

    pub fn settings(&self) -> &Settings {
        &self.core().settings
    }

    pub fn methods(&self) -> Vec<MethodInfo> {
        self.core().rigger.methods()
    }

    pub fn ready(&self) -> Result<(), Refusal> {
        if self.core().is_draining() {
            return Err(Refusal::Draining);
        }
        match self.core().rigger.ready() {
            Readiness::Ready => Ok(()),
            Readiness::Starting => Err(Refusal::Starting),
            Readiness::Unavailable { reason } => Err(Refusal::ModelUnavailable { reason }),
        }
    }

    /// Whether a job with `options` would be taken now. Asked before an upload is received; [`Jobs::submit`] decides.
    pub async fn admit(&self, options: &RigOptions) -> Result<(), Refusal> {
        self.ready()?;
        self.method_exists(options)?;
        let Settings { workers, queue_max, .. } = *self.settings();
        let counts = self.counts().await?;
        if counts.queued < queue_max + workers.saturating_sub(counts.running) {
            Ok(())
        } else {
            Err(Refusal::QueueFull { waiting: counts.queued, retry_after: self.core().turn() })
        }
    }

    pub(super) fn method_exists(&self, options: &RigOptions) -> Result<(), Refusal> {
        let methods = self.methods();
        if let Some(wanted) =
            options.method.as_ref().filter(|wanted| methods.iter().all(|known| known.name != **wanted))
        {
            let names: Vec<&str> = methods.iter().map(|method| method.name.as_str()).collect();
            return Err(Refusal::Option(FieldError {
                field: "method".to_owned(),
                problem: FieldProblem::Invalid,
                detail: format!("{wanted:?} is not one of auto, {}", names.join(", ")),
            }));
        }
        match self.core().rigger.unavailable(options) {
            Some(reason) => Err(Refusal::ModelUnavailable { reason }),
            None => Ok(()),
        }
    }

    /// Begins to receive an upload.
    pub fn upload(&self) -> Result<Upload, StoreError> {
        Ok(Upload::new(self.core().clone(), self.core().files.draft()))
    }

    /// Queues a job, finds the one that the same request made before, or ends it at once with an earlier equal result.
    pub async fn submit(&self, submission: Submission) -> Result<Submitted, Refusal> {
        self.ready()?;
        self.method_exists(&submission.options)?;
        let core = self.core().clone();
        let wish = recipe::wish(&submission);
        let recipe = recipe::recipe(&submission.options, &self.methods(), &core.rigger.engine_version());
        let skeleton = self.skeleton(submission.skeleton).await?;
        let settings = core.settings;
        let (files, received) = match submission.source {
            Source::Upload(received) => {
                let memory_bytes = memory::expected_bytes(&received.files());
                let memory_max = settings.memory_max();
                if memory_bytes > memory_max {
                    return Err(Refusal::Check(memory::too_much(memory_bytes, memory_max)));
                }
                (NewFiles::Received { files: received.blobs(), memory_bytes }, Some(received.bundle))
            }
            Source::Asset(id) => (NewFiles::Asset(id), None),
            Source::Job(id) => (NewFiles::Job(id), None),
        };
        let new = NewJob {
            caller: submission.caller,
            files,
            skeleton: skeleton.as_ref().and_then(|bundle| bundle.files().first().cloned()),
            options: submission.options,
            priority: submission.priority,
            labels: submission.labels,
            timeout: submission.timeout.unwrap_or(settings.job_time_max).min(settings.job_time_max),
            deadline: submission.deadline.map(Timestamp::from),
            retention: submission.retention.unwrap_or(settings.keep_time).min(settings.keep_time),
            client_id: submission.client_id,
            idempotency_key: submission.idempotency_key,
            webhook: submission.webhook,
            wish,
            recipe,
            use_cache: submission.use_cache,
            waiting_max: settings.queue_max,
            workers: settings.workers,
            unfinished_max: submission.jobs_max,
            asset_retention: settings.keep_time,
        };
        // Detached: a caller who hangs up now must not leave it open whether the blobs belong to a job.
        let admission = core
            .detached({
                let core = core.clone();
                async move {
                    let admission = core.jobs.submit(new).await;
                    match &admission {
                        Ok(Admission::Admitted { kept, .. }) => keep([received, skeleton], kept),
                        Ok(_) => {}
                        Err(_) => leave_in_doubt([received, skeleton]),
                    }
                    admission
                }
            })
            .await?;
        self.submitted(admission)
    }

    fn submitted(&self, admission: Admission) -> Result<Submitted, Refusal> {
        let retry_after = self.core().turn();
        match admission {
            Admission::Admitted { job, .. } => {
                if job.cached {
                    counted::answered_at_once(&job);
                }
                self.core().wake.notify_one();
                Ok(Submitted { job: *job, replayed: false })
            }
            Admission::Replayed(job) => Ok(Submitted { job: self.core().completed(*job), replayed: true }),
            Admission::IdempotencyMismatch => Err(Refusal::IdempotencyMismatch),
            Admission::ClientIdTaken => Err(Refusal::ClientIdTaken),
            Admission::QueueFull { waiting } => Err(Refusal::QueueFull { waiting, retry_after }),
            Admission::QuotaExceeded { unfinished } => Err(Refusal::QuotaExceeded { unfinished, retry_after }),
            Admission::Missing(missing) => Err(Refusal::NotFound(missing)),
        }
    }

    /// A skeleton as a file of its own.
    async fn skeleton(&self, bytes: Option<bytes::Bytes>) -> Result<Option<Bundle>, Refusal> {
        let Some(bytes) = bytes else { return Ok(None) };
        let core = self.core().clone();
        let write = move || {
            let mut draft = core.files.draft();
            draft.begin("skeleton.rig.json")?;
            core.making_room(|| draft.append(&bytes))?;
            draft.finish()
        };
        let written = tokio::task::spawn_blocking(write).await.unwrap_or(Err(StoreError::Interrupted));
        written.map(Some).map_err(Refusal::Store)
    }

    /// For a request that makes no job: what was answered to its idempotency key before.
    pub async fn recall(&self, caller: &Caller, key: &str, fingerprint: &[u8; 32]) -> Result<Remembered, StoreFailure> {
        self.core().jobs.recall(caller, key, fingerprint).await
    }

    /// Keeps the answer to a key that [`Jobs::recall`] found fresh, for 24 hours; `None` frees the key.
    pub async fn remember(&self, caller: &Caller, key: &str, answer: Option<&[u8]>) -> Result<(), StoreFailure> {
        self.core().jobs.remember(caller, key, answer).await
    }

    /// How many jobs wait and run.
    pub async fn counts(&self) -> Result<Counts, StoreFailure> {
        self.core().jobs.counts().await
    }

    /// Bytes of uploads and results kept on this machine now, and at most.
    pub fn bytes_kept(&self) -> (u64, u64) {
        (self.core().files.bytes(), self.core().files.bytes_max())
    }

    /// No new jobs from now on, and none that waits is begun: they go on at the next start.
    pub fn drain(&self) {
        self.core().drain();
    }

    /// How many jobs this process works on now.
    pub fn running(&self) -> usize {
        self.core().running.count()
    }

    /// Resolves when no job runs.
    pub async fn idle(&self) {
        // Looked at a few times a second: it happens once in the life of a process.
        while self.running() > 0 {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Asks running jobs to stop; they go back to the queue.
    pub fn stop_running(&self) {
        self.core().running.stop_all(Stop::Draining);
    }

    /// Ends the workers and closes the database. Jobs that are not over go on at the next start.
    pub async fn close(&self) {
        self.core().close();
        let left = async {
            while self.core().workers_left.load(Ordering::SeqCst) > 0 {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
        };
        if timeout(CLOSE_TIME, left).await.is_err() {
            tracing::warn!("some work did not stop; its jobs are done again at the next start");
        }
        self.core().jobs.close().await;
    }
}

fn given_up() -> StoreFailure {
    StoreFailure::new(&"opening it was given up")
}

/// The database names these blobs now; the others go.
pub(super) fn keep(bundles: impl IntoIterator<Item = Option<Bundle>>, kept: &[String]) {
    for mut bundle in bundles.into_iter().flatten() {
        kept.iter().for_each(|location| bundle.keep(location));
    }
}

/// Nobody knows whether the database names these blobs.
pub(super) fn leave_in_doubt(bundles: impl IntoIterator<Item = Option<Bundle>>) {
    bundles.into_iter().flatten().for_each(|mut bundle| bundle.leave_in_doubt());
}

/// A job that is refused as soon as a worker sees it.
pub(super) fn refused_by_memory(needed: u64, settings: &Settings) -> Option<JobError> {
    let max = settings.memory_max();
    (needed > max).then(|| memory::too_much(needed, max))
}
