//! The threads that do the work.

use super::core::Core;
use super::counted;
use super::failure::{ErrorCode, JobError};
use super::job::{ArtifactInfo, JobResult};
use super::perform::{Artifact, ModelInfo, Outcome, RigRequest, Watch};
use super::queue::refused_by_memory;
use super::running::{Stop, ended_without_result};
use super::store::{Claim, EndedWithout, Ending, Finish, StoreFailure};
use crate::storage::{Bundle, StoreError};
use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use tokio::time::timeout;

/// What the main thread of a program has, so that the command line and the service go equally deep.
const STACK_BYTES: usize = 8 << 20;
/// How long a worker rests when the files of a job could not be read or written.
const STORAGE_REST: Duration = Duration::from_secs(3);
/// How often an ending is written again when the store does not take it,
const TELL_TRIES: u32 = 20;
/// and how long after. Together longer than a lease: then the job is done again.
const TELL_AGAIN: Duration = Duration::from_secs(1);

/// Starts the workers. They leave when the service drains.
pub fn start(core: &Arc<Core>) -> std::io::Result<()> {
    let worker = format!("{}-{}", std::process::id(), uuid::Uuid::now_v7().simple());
    for number in 0..core.settings.workers {
        let (core, name) = (core.clone(), format!("{worker}-{number}"));
        core.workers_left.fetch_add(1, Ordering::SeqCst);
        let leaving = Leaving(core.clone());
        std::thread::Builder::new().name(format!("worker-{number}")).stack_size(STACK_BYTES).spawn(move || {
            let _leaving = leaving;
            while let Some(claim) = next(&core, &name) {
                work(&core, claim);
            }
        })?;
    }
    Ok(())
}

/// Counts a worker off, however it leaves.
struct Leaving(Arc<Core>);

impl Drop for Leaving {
    fn drop(&mut self) {
        self.0.workers_left.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Waits for work; `None`: there will be none.
fn next(core: &Core, name: &str) -> Option<Claim> {
    let handle = core.handle()?.clone();
    handle.block_on(async {
        loop {
            let mut woken = std::pin::pin!(core.wake.notified());
            woken.as_mut().enable();
            if core.is_draining() {
                return None;
            }
            match claim(core, name).await {
                Ok(Some(claim)) => return Some(claim),
                Ok(None) => {}
                Err(error) => tracing::error!(%error, "no job could be taken"),
            }
            // Woken or not, the store is asked.
            let _ = timeout(core.look_again, woken).await;
        }
    })
}

/// Takes the next job that fits beside those that run.
async fn claim(core: &Core, name: &str) -> Result<Option<Claim>, StoreFailure> {
    let _one_at_a_time = core.claiming.lock().await;
    let taken = core.running.memory_bytes();
    // Alone, a job runs or is refused by name; it never waits for memory that nobody holds.
    let free = if core.running.count() == 0 { u64::MAX } else { core.settings.memory_max().saturating_sub(taken) };
    let claim = core.jobs.claim(name, free).await?;
    if let Some(claim) = &claim {
        core.running.begin(claim);
        core.watchers.tell(claim.lease.job);
        // There may be more, and others who rest.
        core.wake.notify_one();
    }
    Ok(claim)
}

fn work(core: &Arc<Core>, claim: Claim) {
    let (lease, id) = (claim.lease, claim.lease.job);
    let span = tracing::info_span!("job", job.id = %id, attempt = lease.attempt);
    let _entered = span.enter();
    tracing::info!("the job runs");
    let (began, job) = (Instant::now(), claim.job.clone());
    counted::began(&job);
    let Run { ending, bundle, storage_away } = run(core, claim);
    core.note_run(began.elapsed());
    let duration_ms = began.elapsed().as_millis() as u64;
    match &ending {
        Some(Ending { outcome: Ok(_), .. }) => tracing::info!(duration_ms, "the job succeeded"),
        Some(Ending { outcome: Err(EndedWithout::Canceled), .. }) => {
            tracing::info!(duration_ms, "the job was canceled")
        }
        Some(Ending { outcome: Err(EndedWithout::Failed(error)), .. }) => {
            let stage = error.stage.map_or("none", |stage| stage.name());
            tracing::info!(duration_ms, code = error.code.name(), stage, "the job ended without result: {error}");
        }
        None => tracing::info!(duration_ms, "the job goes back"),
    }
    if let Some(ending) = &ending {
        counted::ended(&job, ending);
    }
    let made_nothing = matches!(&ending, Some(Ending { outcome: Err(_), .. }));
    match ending {
        Some(ending) => tell(core, lease, ending, bundle),
        None => go_back(core, lease),
    }
    if made_nothing && let Err(error) = core.block_on(core.collect_garbage()) {
        tracing::error!(%error, "the files of a job could not be removed");
    }
    core.running.end(lease);
    core.watchers.tell(id);
    core.wake.notify_waiters();
    if storage_away {
        std::thread::sleep(STORAGE_REST);
    }
}

/// What became of the work.
#[derive(Default)]
struct Run {
    /// `None`: it has no end that is ours to tell.
    ending: Option<Ending>,
    bundle: Option<Bundle>,
    storage_away: bool,
}

/// Why there is no result.
enum Undone {
    Failed(JobError),
    /// The storage does not answer, which is no fault of the job.
    StorageAway(StoreError),
}

impl From<StoreError> for Undone {
    fn from(error: StoreError) -> Self {
        if error.is_away() { Self::StorageAway(error) } else { Self::Failed(storage_failed(&error)) }
    }
}

impl From<JobError> for Undone {
    fn from(error: JobError) -> Self {
        Self::Failed(error)
    }
}

/// Does the work.
fn run(core: &Arc<Core>, claim: Claim) -> Run {
    let lease = claim.lease;
    let watched = Arc::downgrade(core);
    let Some(cancellation) = core.running.cancellation(lease) else { return Run::default() };
    let watch = Watch::new(cancellation, move |stage| {
        if let Some(core) = watched.upgrade() {
            core.running.enter(lease, stage);
        }
    });
    let done = prepare(core, &claim)
        .and_then(|request| Ok(guarded(|| core.rigger.perform(&request, &watch))?))
        .and_then(|outcome| keep(core, outcome));
    let (stage, timings) = (watch.stage(), watch.timings());
    let (outcome, bundle) = match done {
        // A late result of work that was fenced is refused by the store.
        Ok((result, bundle)) => (Ok((result, bundle.files().to_vec())), Some(bundle)),
        Err(Undone::StorageAway(error)) => {
            tracing::error!(%error, "the storage does not answer; the job goes back");
            return Run { storage_away: true, ..Run::default() };
        }
        Err(Undone::Failed(error)) => {
            let error = match error.stage.or(stage) {
                Some(stage) => error.at(stage),
                None => error,
            };
            match ended_without_result(core.running.stop_of(lease), error) {
                Some(ended) => (Err(ended), None),
                None => return Run::default(),
            }
        }
    };
    Run { ending: Some(Ending { outcome, stage, timings }), bundle, storage_away: false }
}

/// The request with its files, unless it needs more memory than there is.
fn prepare(core: &Core, claim: &Claim) -> Result<RigRequest, Undone> {
    if let Some(refused) = refused_by_memory(claim.memory_bytes, &core.settings) {
        return Err(refused.into());
    }
    let mut places: Vec<_> = claim.files.iter().map(|(file, place)| (file.name.clone(), place.clone())).collect();
    places.extend(claim.skeleton.iter().map(|place| (String::new(), place.clone())));
    let handle = core.handle().ok_or(StoreError::Interrupted)?;
    let mut files = handle.block_on(core.load(&places))?;
    let skeleton = claim.skeleton.as_ref().and_then(|_| files.pop()).map(|file| file.bytes);
    Ok(RigRequest { files, options: claim.job.request.options.clone(), skeleton })
}

/// Writes the end of a job down, again and again while the store does not take it.
fn tell(core: &Core, lease: super::store::Lease, ending: Ending, mut bundle: Option<Bundle>) {
    for _ in 0..TELL_TRIES {
        match core.block_on(core.jobs.finish(lease, ending.clone())) {
            Ok(Finish::Done { kept }) => {
                if let Some(mut bundle) = bundle {
                    kept.iter().for_each(|location| bundle.keep(location));
                }
                return;
            }
            Ok(Finish::Fenced) => {
                tracing::warn!("a late result was refused: the job is in other hands or over");
                return;
            }
            Err(error) => {
                tracing::error!(%error, "the end of a job could not be written down");
                // It may have been, and only the answer be lost: then the next try finds the job over.
                bundle.iter_mut().for_each(Bundle::leave_in_doubt);
                std::thread::sleep(TELL_AGAIN);
            }
        }
        if core.is_closed() {
            break;
        }
    }
    tracing::error!("the result is given up; the job is done again when its lease ends");
}

fn go_back(core: &Core, lease: super::store::Lease) {
    if core.running.stop_of(lease) == Some(Stop::Fenced) {
        return;
    }
    if let Err(error) = core.block_on(core.jobs.give_back(lease)) {
        tracing::error!(%error, "a job could not be put back; it is when its lease ends");
    }
}

/// A panic in the work is a bug of ours: the job fails, the thread lives.
pub(super) fn guarded<T>(work: impl FnOnce() -> Result<T, JobError>) -> Result<T, JobError> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
        let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
        tracing::error!(panic = text, "the work panicked");
        Err(JobError::new(
            ErrorCode::Internal,
            "an error of the service stopped the work; it is logged under the job's id",
        ))
    })
}

fn storage_failed(error: &StoreError) -> JobError {
    tracing::error!(%error, "the files of a job could not be read or written");
    if error.is_full() {
        return JobError::new(ErrorCode::Internal, "the service has no room for the files of the job")
            .hint("send the request again when results have expired");
    }
    JobError::new(ErrorCode::Internal, "the service could not read or write the files of the job")
}

/// Stores what was made.
fn keep(core: &Core, outcome: Outcome) -> Result<(JobResult, Bundle), Undone> {
    let Outcome { artifacts, mut report, findings, method_used } = outcome;
    // The name belongs to the list of stored files.
    report.remove("artifacts");
    let names: BTreeSet<&str> = artifacts.iter().map(|artifact| artifact.name.as_str()).collect();
    if names.len() != artifacts.len() || !names.iter().all(|name| plain(name)) {
        tracing::error!(?names, "artifact names are not distinct and plain");
        return Err(JobError::new(ErrorCode::Internal, "the files made have unusable names").into());
    }
    let bundle = store(core, &artifacts)?;
    let artifacts = artifacts
        .iter()
        .zip(bundle.files())
        .map(|(artifact, stored)| ArtifactInfo {
            name: artifact.name.clone(),
            media_type: artifact.media_type.to_owned(),
            bytes: stored.bytes,
            sha256: stored.sha256,
        })
        .collect();
    let models = models_of(core, &method_used);
    let findings = findings.into_iter().map(Into::into).collect();
    Ok((JobResult { method_used, models, report, findings, artifacts }, bundle))
}

fn store(core: &Core, artifacts: &[Artifact]) -> Result<Bundle, StoreError> {
    let mut draft = core.files.draft();
    for artifact in artifacts {
        draft.begin(&artifact.name)?;
        core.making_room(|| draft.append(&artifact.bytes))?;
    }
    draft.finish()
}

fn models_of(core: &Core, method: &str) -> Vec<ModelInfo> {
    let methods = core.rigger.methods();
    methods.into_iter().find(|known| known.name == method).map(|known| known.models).unwrap_or_default()
}

/// Fit for a path segment and a header without escapes.
fn plain(name: &str) -> bool {
    let letters = name.chars().all(|c| c.is_ascii_alphanumeric() || ['.', '-', '_'].contains(&c));
    letters && !name.is_empty() && !name.starts_with('.')
}
