//! What doors, workers and the keeper share.

use super::checking::Looks;
use super::job::{Job, JobState};
use super::perform::{NamedFile, Rigger};
use super::queue::StartError;
use super::running::{Running, Stop};
use super::settings::Settings;
use super::store::{BlobPlace, JobStore, StoreFailure};
use super::watchers::Watchers;
use crate::storage::{Store, StoreError};
use std::future::Future;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::runtime::{Builder, Handle, Runtime};
use tokio::sync::{Notify, Semaphore};

/// Threads that drive the store and the keeper; the work has threads of its own.
const STORE_THREADS: usize = 2;
/// Weight of the newest job in the mean run time.
const MEAN_WEIGHT: f64 = 0.2;
/// A file without a name is named within this time, or never.
const ORPHAN_AGE: Duration = Duration::from_secs(3600);
/// Whatever they hear, workers and watchers look now and then: news may get lost, and are made in other processes.
const LOOK_AGAIN: Duration = Duration::from_secs(1);
const LOOK_AGAIN_WHERE_TOLD: Duration = Duration::from_secs(5);
/// Before any job was run.
const FIRST_GUESS: Duration = Duration::from_secs(2);

pub struct Core {
    pub settings: Settings,
    pub files: Store,
    pub jobs: Arc<dyn JobStore>,
    pub rigger: Arc<dyn Rigger>,
    pub running: Running,
    pub watchers: Watchers,
    /// Told when there may be work, or when none will come any more.
    pub wake: Notify,
    /// How long whoever waits believes that nothing happens.
    pub look_again: Duration,
    pub checks: Arc<Semaphore>,
    /// What was seen of assets.
    pub looks: Looks,
    /// One worker at a time takes a job, so that two do not count on the same free memory.
    pub claiming: tokio::sync::Mutex<()>,
    /// Worker threads that have not left.
    pub workers_left: AtomicUsize,
    draining: AtomicBool,
    closed: AtomicBool,
    mean_run: Mutex<Option<Duration>>,
    runtime: OwnRuntime,
}

/// A runtime that may be dropped anywhere.
pub struct OwnRuntime(Option<Runtime>);

impl OwnRuntime {
    pub fn new() -> std::io::Result<Self> {
        let runtime =
            Builder::new_multi_thread().worker_threads(STORE_THREADS).thread_name("jobs").enable_all().build();
        runtime.map(|runtime| Self(Some(runtime)))
    }

    /// Runs `future` to its end from anywhere, also from within another runtime. For starting and little else.
    pub fn finish<T: Send + 'static>(&self, future: impl Future<Output = T> + Send + 'static) -> Option<T> {
        let (sender, receiver) = std::sync::mpsc::sync_channel(1);
        self.0.as_ref()?.spawn(async move {
            let _ = sender.send(future.await);
        });
        receiver.recv().ok()
    }
}

impl Drop for OwnRuntime {
    fn drop(&mut self) {
        if let Some(runtime) = self.0.take() {
            runtime.shutdown_background();
        }
    }
}

impl Core {
    pub fn new(
        runtime: OwnRuntime,
        rigger: Arc<dyn Rigger>,
        files: Store,
        jobs: Arc<dyn JobStore>,
        settings: Settings,
    ) -> Result<Self, StartError> {
        let look_again = if jobs.news().is_some() { LOOK_AGAIN_WHERE_TOLD } else { LOOK_AGAIN };
        Ok(Self {
            settings,
            files,
            jobs,
            rigger,
            running: Running::default(),
            watchers: Watchers::default(),
            wake: Notify::new(),
            look_again,
            checks: Arc::new(Semaphore::new(settings.workers.max(1))),
            looks: Looks::default(),
            claiming: tokio::sync::Mutex::new(()),
            workers_left: AtomicUsize::new(0),
            draining: AtomicBool::new(false),
            closed: AtomicBool::new(false),
            mean_run: Mutex::new(None),
            runtime,
        })
    }

    /// `None` only while the last of the service is dropped.
    pub fn handle(&self) -> Option<&Handle> {
        self.runtime.0.as_ref().map(Runtime::handle)
    }

    /// Runs `future` to its end. For threads that may block, and belong to no runtime or to its blocking ones.
    pub fn block_on<T>(&self, future: impl Future<Output = Result<T, StoreFailure>>) -> Result<T, StoreFailure> {
        match self.handle() {
            Some(handle) => handle.block_on(future),
            None => Err(StoreFailure::new(&"the service has ended")),
        }
    }

    /// Runs `future` to its end even when the caller hangs up.
    pub async fn detached<T: Send + 'static>(
        &self,
        future: impl Future<Output = Result<T, StoreFailure>> + Send + 'static,
    ) -> Result<T, StoreFailure> {
        let ended = || StoreFailure::new(&"the service has ended");
        match self.handle() {
            Some(handle) => handle.spawn(future).await.unwrap_or_else(|_| Err(ended())),
            None => Err(ended()),
        }
    }

    pub fn is_draining(&self) -> bool {
        self.draining.load(Ordering::SeqCst)
    }

    /// No new work is begun.
    pub fn drain(&self) {
        self.draining.store(true, Ordering::SeqCst);
        self.wake.notify_waiters();
    }

    pub fn is_closed(&self) -> bool {
        self.closed.load(Ordering::SeqCst)
    }

    /// Workers and keeper leave; running work is asked to stop and goes back to the queue.
    pub fn close(&self) {
        self.drain();
        self.closed.store(true, Ordering::SeqCst);
        self.running.stop_all(Stop::Draining);
        self.wake.notify_waiters();
    }

    /// Runs `write`, and again each time the oldest results have made room, until it fits or there are none left.
    /// Blocks.
    pub fn making_room<T>(&self, mut write: impl FnMut() -> Result<T, StoreError>) -> Result<T, StoreError> {
        loop {
            match write() {
                Err(error) if error.is_full() && self.make_room() => {}
                other => return other,
            }
        }
    }

    fn make_room(&self) -> bool {
        // Results are elsewhere: what fills this machine is on its way there, and goes by itself.
        if self.files.is_shared() {
            return false;
        }
        let room = self.block_on(async {
            let expired = self.jobs.expire_oldest().await?;
            self.collect_garbage().await?;
            Ok(expired)
        });
        room.unwrap_or_else(|error| {
            tracing::error!(%error, "no room could be made");
            false
        })
    }

    /// Removes the files that nothing needs any more.
    pub async fn collect_garbage(&self) -> Result<(), StoreFailure> {
        for BlobPlace { location, bytes } in self.jobs.collect().await? {
            if let Err(error) = self.files.remove(&location, bytes).await {
                // The next start sweeps it.
                tracing::warn!(%error, "a file could not be removed");
            }
        }
        Ok(())
    }

    /// Removes the files that a crash left without a name, as long as nobody can be about to name them.
    pub async fn remove_orphans(&self) -> Result<(), StoreFailure> {
        let named = self.jobs.locations().await?;
        match self.files.sweep(&named, ORPHAN_AGE).await {
            Ok(0) => {}
            Ok(orphans) => tracing::warn!(orphans, "removed files that no job names"),
            Err(error) => tracing::warn!(%error, "files that no job names could not be removed"),
        }
        Ok(())
    }

    /// The bytes of files that are in use.
    pub async fn load(&self, files: &[(String, BlobPlace)]) -> Result<Vec<NamedFile>, StoreError> {
        let mut loaded = Vec::with_capacity(files.len());
        for (name, place) in files {
            let bytes = self.files.content(&place.location, place.bytes).read().await?;
            loaded.push(NamedFile { name: name.clone(), bytes });
        }
        Ok(loaded)
    }

    /// The job as this process knows it.
    pub fn completed(&self, mut job: Job) -> Job {
        if job.state == JobState::Running {
            self.running.add_to(&mut job);
        }
        job
    }

    pub fn note_run(&self, time: Duration) {
        let mut mean = self.mean_run.lock().unwrap_or_else(PoisonError::into_inner);
        let before = mean.unwrap_or(time);
        *mean = Some(before.mul_f64(1.0 - MEAN_WEIGHT) + time.mul_f64(MEAN_WEIGHT));
    }

    /// About how long until a place in the queue is free.
    pub fn turn(&self) -> Duration {
        let mean = *self.mean_run.lock().unwrap_or_else(PoisonError::into_inner);
        mean.unwrap_or(FIRST_GUESS) / u32::try_from(self.settings.workers.max(1)).unwrap_or(1)
    }
}
