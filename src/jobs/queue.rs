//! The one way to jobs, for every door: submit, look, wait, cancel, delete. Refuses early instead of queueing without
//! bound.
//!
//! Functions are `async` where a durable store will have to wait for its disk.

use super::failure::JobError;
use super::job::{FileInfo, Job, JobId, JobRequest, JobState};
use super::ledger::{Denied, Ledger, Stop};
use super::options::{FieldError, FieldProblem, RigOptions};
use super::perform::{Availability, MethodInfo, NamedFile, Readiness, RigRequest, Rigger, Watch};
use super::upload::{Received, Upload};
use super::worker;
use crate::cancellation::Cancellation;
use crate::storage::{Bundle, Store, StoreError};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::Semaphore;
use tokio::time::{Instant, timeout_at};

/// Numbers that an operator sets.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Jobs that run at the same time, at least 1.
    pub workers: usize,
    /// Jobs that may wait.
    pub queue_max: usize,
    /// Running work is asked to stop after this time.
    pub job_time_max: Duration,
    /// Results are kept this long.
    pub keep_time: Duration,
    /// Final jobs are remembered up to this number of jobs.
    pub records_max: usize,
    /// How often deadlines and retention are looked at.
    pub sweep_every: Duration,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            workers: 1,
            queue_max: 100,
            job_time_max: Duration::from_secs(300),
            keep_time: Duration::from_secs(24 * 3600),
            records_max: 10_000,
            sweep_every: Duration::from_millis(500),
        }
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
    #[error("{waiting} jobs are waiting, and no more may")]
    QueueFull { waiting: usize, retry_after: Duration },
    #[error("{0}")]
    Option(FieldError),
    #[error("the upload could not be stored")]
    Store(#[source] StoreError),
    #[error(transparent)]
    Check(JobError),
}

/// The jobs of this process. Clones share them; the workers leave with the last clone.
#[derive(Clone)]
pub struct Jobs(Arc<Handle>);

struct Handle(Arc<Core>);

/// What doors, workers and the sweeper share.
pub(super) struct Core {
    pub settings: Settings,
    pub store: Store,
    pub rigger: Arc<dyn Rigger>,
    ledger: Mutex<Ledger>,
    /// Told when there is work, or none will come any more.
    pub wake: Condvar,
    /// Told when a worker has finished, or the ledger closes.
    pub tick: Condvar,
    checks: Arc<Semaphore>,
}

impl Core {
    pub fn ledger(&self) -> MutexGuard<'_, Ledger> {
        // No code that can panic runs under the lock, so a poisoned ledger is whole all the same.
        self.ledger.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Runs `write`, and again each time the oldest results have made room, until it fits or there are none left.
    pub fn making_room<T>(&self, mut write: impl FnMut() -> Result<T, StoreError>) -> Result<T, StoreError> {
        loop {
            match write() {
                Err(error) if error.is_full() && self.ledger().expire_oldest() => {}
                other => return other,
            }
        }
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        let mut ledger = self.0.ledger();
        ledger.drain();
        ledger.stop_running(Stop::Draining, None);
        ledger.closed = true;
        drop(ledger);
        self.0.wake.notify_all();
        self.0.tick.notify_all();
    }
}

impl Jobs {
    /// Starts the workers.
    pub fn start(rigger: Arc<dyn Rigger>, store: Store, settings: Settings) -> std::io::Result<Self> {
        let core = Arc::new(Core {
            settings,
            store,
            rigger,
            ledger: Mutex::default(),
            wake: Condvar::new(),
            tick: Condvar::new(),
            checks: Arc::new(Semaphore::new(settings.workers.max(1))),
        });
        let jobs = Self(Arc::new(Handle(core.clone())));
        worker::start(&core)?;
        Ok(jobs)
    }

    fn core(&self) -> &Arc<Core> {
        &self.0.0
    }

    pub fn settings(&self) -> &Settings {
        &self.core().settings
    }

    pub fn methods(&self) -> Vec<MethodInfo> {
        self.core().rigger.methods()
    }

    pub fn ready(&self) -> Result<(), Refusal> {
        if self.core().ledger().draining {
            return Err(Refusal::Draining);
        }
        match self.core().rigger.ready() {
            Readiness::Ready => Ok(()),
            Readiness::Starting => Err(Refusal::Starting),
            Readiness::Unavailable { reason } => Err(Refusal::ModelUnavailable { reason }),
        }
    }

    /// Whether a job with `options` would be taken now. Asked before an upload is received, and again by
    /// [`Jobs::submit`].
    pub async fn admit(&self, options: &RigOptions) -> Result<(), Refusal> {
        self.ready()?;
        self.method_exists(options)?;
        self.room(&self.core().ledger())
    }

    fn room(&self, ledger: &Ledger) -> Result<(), Refusal> {
        let Settings { workers, queue_max, .. } = *self.settings();
        let waiting = ledger.waiting();
        // Free workers take from the queue, so that many more may be on their way through it.
        let free = workers.saturating_sub(ledger.running());
        if waiting < queue_max + free {
            Ok(())
        } else {
            Err(Refusal::QueueFull { waiting, retry_after: ledger.turn(workers) })
        }
    }

    fn method_exists(&self, options: &RigOptions) -> Result<(), Refusal> {
        let Some(wanted) = &options.method else { return Ok(()) };
        let methods = self.methods();
        match methods.iter().find(|method| method.name == *wanted).map(|method| &method.availability) {
            Some(Availability::Available) => Ok(()),
            Some(Availability::Unavailable { reason }) => {
                Err(Refusal::ModelUnavailable { reason: format!("method {wanted} cannot run here: {reason}") })
            }
            None => {
                let names: Vec<&str> = methods.iter().map(|method| method.name.as_str()).collect();
                Err(Refusal::Option(FieldError {
                    field: "method".to_owned(),
                    problem: FieldProblem::Invalid,
                    detail: format!("{wanted:?} is not one of auto, {}", names.join(", ")),
                }))
            }
        }
    }

    /// Begins to receive an upload.
    pub fn upload(&self) -> Result<Upload, StoreError> {
        Ok(Upload::new(self.core().clone(), self.core().store.draft()?))
    }

    /// Queues a job.
    pub async fn submit(&self, received: Received, options: RigOptions) -> Result<Job, Refusal> {
        self.ready()?;
        self.method_exists(&options)?;
        let (files, upload) = received.into_parts();
        let request = JobRequest { options, files };
        let mut ledger = self.core().ledger();
        // Looked at again under the lock: the service may have begun to stop while the upload came in.
        if ledger.draining {
            return Err(Refusal::Draining);
        }
        self.room(&ledger)?;
        let id = ledger.add(request, upload);
        let job = ledger.snapshot(id);
        drop(ledger);
        self.core().wake.notify_one();
        job.ok_or(Refusal::Draining)
    }

    /// What would be rigged, now and without a job.
    pub async fn check(
        &self,
        received: Received,
        options: RigOptions,
    ) -> Result<serde_json::Map<String, serde_json::Value>, Refusal> {
        self.ready()?;
        self.method_exists(&options)?;
        let core = self.core().clone();
        let Ok(permit) = core.checks.clone().try_acquire_owned() else {
            return Err(Refusal::QueueFull { waiting: core.ledger().waiting(), retry_after: Duration::from_secs(1) });
        };
        let span = tracing::Span::current();
        let work = move || {
            let (_permit, _entered) = (permit, span.enter());
            let (files, upload) = received.into_parts();
            let request = RigRequest { files: load(&files, &upload).map_err(Refusal::Store)?, options };
            worker::guarded(|| core.rigger.check(&request, &Watch::new(Cancellation::default(), |_| {})))
                .map_err(Refusal::Check)
        };
        match tokio::task::spawn_blocking(work).await {
            Ok(checked) => checked,
            Err(_) => Err(Refusal::Draining),
        }
    }

    pub async fn get(&self, id: JobId) -> Option<Job> {
        self.core().ledger().snapshot(id)
    }

    /// The job as soon as it is final, or as it is after `time`.
    pub async fn wait(&self, id: JobId, time: Duration) -> Option<Job> {
        let until = Instant::now() + time;
        let mut revision = self.core().ledger().watch(id)?;
        loop {
            let job = self.get(id).await?;
            if job.state.is_final() {
                return Some(job);
            }
            // An error says that the job is being forgotten: `get` above will tell.
            if timeout_at(until, revision.changed()).await.is_err() {
                return self.get(id).await;
            }
        }
    }

    /// Newest first, older than `before`.
    pub async fn list(&self, before: Option<JobId>, state: Option<JobState>, count: usize) -> Vec<Job> {
        self.core().ledger().list(before, state, count)
    }

    pub async fn cancel(&self, id: JobId) -> Result<Job, Denied> {
        let mut ledger = self.core().ledger();
        ledger.cancel(id)?;
        ledger.snapshot(id).ok_or(Denied::NotFound)
    }

    pub async fn delete(&self, id: JobId) -> Result<(), Denied> {
        self.core().ledger().delete(id)
    }

    /// The files that a job made, while they are kept.
    pub async fn artifacts(&self, id: JobId) -> Option<Arc<Bundle>> {
        self.core().ledger().artifacts(id)
    }

    /// No new jobs from now on; waiting ones fail with `draining`.
    pub fn drain(&self) {
        self.core().ledger().drain();
    }

    /// How many jobs run now.
    pub fn running(&self) -> usize {
        self.core().ledger().running()
    }

    /// Resolves when no job runs.
    pub async fn idle(&self) {
        // Looked at a few times a second: it happens once in the life of a process.
        while self.running() > 0 {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Asks running jobs to stop; they fail with `draining`.
    pub fn stop_running(&self) {
        self.core().ledger().stop_running(Stop::Draining, None);
    }

    /// Forgets every job and removes every file: nothing outlives the process yet.
    pub fn clear(&self) {
        self.core().ledger().clear();
    }
}

/// The bytes of an upload, the main file first.
pub(super) fn load(files: &[FileInfo], upload: &Bundle) -> Result<Vec<NamedFile>, StoreError> {
    let stored = files.iter().filter_map(|file| upload.file(&file.name));
    stored.map(|file| Ok(NamedFile { name: file.name.clone(), bytes: upload.read(file)?.into() })).collect()
}
