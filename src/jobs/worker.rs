//! The threads that do the work, and the one that keeps the time.

use super::failure::{ErrorCode, JobError};
use super::job::{ArtifactInfo, JobResult};
use super::ledger::{Ending, Stop, Task};
use super::perform::{Artifact, ModelInfo, Outcome, RigRequest, Watch};
use super::queue::{Core, load};
use crate::storage::{Bundle, StoreError};
use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, PoisonError};
use std::time::{Instant, SystemTime};

/// Starts the workers and the sweeper. They leave when the ledger is closed.
pub(super) fn start(core: &Arc<Core>) -> std::io::Result<()> {
    // What the main thread of a program has, so that the command line and the service go equally deep.
    const STACK_BYTES: usize = 8 << 20;
    for number in 0..core.settings.workers.max(1) {
        let core = core.clone();
        std::thread::Builder::new()
            .name(format!("worker-{number}"))
            .stack_size(STACK_BYTES)
            .spawn(move || work(&core))?;
    }
    let core = core.clone();
    std::thread::Builder::new().name("sweeper".to_owned()).spawn(move || sweep(&core))?;
    Ok(())
}

fn work(core: &Arc<Core>) {
    while let Some(task) = next(core) {
        let id = task.id;
        let span = tracing::info_span!("job", job.id = %id);
        let _entered = span.enter();
        tracing::info!("the job runs");
        let ending = run(core, task);
        let duration_ms = ending.run_time.as_millis() as u64;
        match &ending.outcome {
            Ok(_) => tracing::info!(duration_ms, "the job succeeded"),
            Err(error) => {
                let stage = error.stage.or(ending.stage).map_or("none", |stage| stage.name());
                tracing::info!(duration_ms, code = error.code.name(), stage, "the job ended without result: {error}");
            }
        }
        core.ledger().finish(id, ending, core.settings.keep_time);
        core.tick.notify_all();
    }
}

/// Waits for work; `None`: there will be none.
fn next(core: &Core) -> Option<Task> {
    let mut ledger = core.ledger();
    loop {
        if let Some(task) = ledger.take(core.settings.job_time_max) {
            return Some(task);
        }
        if ledger.closed {
            return None;
        }
        ledger = core.wake.wait(ledger).unwrap_or_else(PoisonError::into_inner);
    }
}

fn run(core: &Arc<Core>, task: Task) -> Ending {
    let began = Instant::now();
    let Task { id, request, upload, cancellation } = task;
    let watched = Arc::downgrade(core);
    let watch = Watch::new(cancellation, move |stage| {
        if let Some(core) = watched.upgrade() {
            core.ledger().enter(id, stage);
        }
    });
    let outcome = load(&request.files, &upload)
        .map_err(|error| storage_failed(&error))
        .map(|files| RigRequest { files, options: request.options.clone() })
        .and_then(|request| guarded(|| core.rigger.perform(&request, &watch)))
        .and_then(|outcome| keep(core, outcome));
    Ending { outcome, stage: watch.stage(), timings: watch.timings(), run_time: began.elapsed() }
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
    JobError::new(ErrorCode::Internal, "the service could not read or write the files of the job")
}

/// Stores what was made.
fn keep(core: &Core, outcome: Outcome) -> Result<(JobResult, Bundle), JobError> {
    let Outcome { artifacts, mut report, findings, method_used } = outcome;
    // The name belongs to the list of stored files.
    report.remove("artifacts");
    let names: BTreeSet<&str> = artifacts.iter().map(|artifact| artifact.name.as_str()).collect();
    if names.len() != artifacts.len() || !names.iter().all(|name| plain(name)) {
        tracing::error!(?names, "artifact names are not distinct and plain");
        return Err(JobError::new(ErrorCode::Internal, "the files made have unusable names"));
    }
    let bundle = store(core, &artifacts).map_err(|error| storage_failed(&error))?;
    let artifacts = artifacts
        .iter()
        .zip(bundle.files())
        .map(|(artifact, stored)| ArtifactInfo {
            name: artifact.name.clone(),
            media_type: artifact.media_type,
            bytes: stored.bytes,
            sha256: stored.sha256,
        })
        .collect();
    let models = models_of(core, &method_used);
    Ok((JobResult { method_used, models, report, findings, artifacts }, bundle))
}

fn store(core: &Core, artifacts: &[Artifact]) -> Result<Bundle, StoreError> {
    let mut draft = core.store.draft()?;
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

/// Looks at deadlines and retention until the ledger is closed.
fn sweep(core: &Core) {
    let mut ledger = core.ledger();
    while !ledger.closed {
        ledger.stop_running(Stop::TimedOut, Some(Instant::now()));
        ledger.sweep(SystemTime::now(), core.settings.records_max);
        let waited = core.tick.wait_timeout(ledger, core.settings.sweep_every);
        ledger = waited.unwrap_or_else(PoisonError::into_inner).0;
    }
}
