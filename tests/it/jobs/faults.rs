//! What goes wrong while jobs run, and how each of them ends.

use super::bench::{assert_blobs, assert_intact, get, settings, start, submission, submit, until};
use crate::http::scripted::Scripted;
use rigsmith::jobs::clock::{ManualClock, Timestamp};
use rigsmith::jobs::store::sqlite::SqliteStore;
use rigsmith::jobs::store::{Ending, Finish, JobStore, LEASE, Lease, Memory};
use rigsmith::jobs::{
    Caller, ErrorCode, EventKind, Job, JobId, JobResult, JobState, Jobs, Refusal, Settings, Submission,
};
use rigsmith::storage::Store;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, SystemTime};
use tokio::sync::Mutex;

/// Tests that look at the memory of the whole process do so one after the other.
static MEMORY: Mutex<()> = Mutex::const_new(());
const MIB: u64 = 1 << 20;

fn code(job: &Job) -> Option<ErrorCode> {
    job.error.as_ref().map(|error| error.code)
}

/// A worker that is stopped past its lease, as by SIGSTOP, and wakes when another one has done its job.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_that_wakes_too_late_changes_nothing() {
    let folder = tempfile::tempdir().expect("folder");
    let clock = Arc::new(ManualClock::at(Timestamp::from(SystemTime::now())));
    let open = async || SqliteStore::open(&folder.path().join("jobs.db"), clock.clone(), LEASE).await.expect("opens");
    // Its keeper is as good as stopped: it would speak up after minutes only.
    let asleep = Settings { lease: Duration::from_secs(3600), sweep_every: Duration::from_secs(3600), ..settings() };
    let files = Store::open(&folder.path().join("files"), 1 << 30).expect("store");
    let rigger = Arc::new(Scripted::default());
    let sleeper = Jobs::start_on(rigger, files, Arc::new(open().await), asleep).expect("starts");
    let id = submit(&sleeper, "deaf 1500").await;
    until(&sleeper, id, JobState::Running).await;
    clock.advance(LEASE + Duration::from_millis(1));
    // The store of another process.
    let store = open().await;
    let taken = second_attempt(&store, id).await;
    let ending = made_elsewhere();
    assert!(matches!(finish(&store, taken, ending).await, Finish::Done { .. }));
    let before = format!("{:?}", get(&sleeper, id).await);
    sleeper.idle().await;
    assert_eq!(format!("{:?}", get(&sleeper, id).await), before, "the late result is refused");
    let mut events = sleeper.events(&Caller::anonymous(), id, Some(0)).await.expect("answers").expect("is there");
    let mut ends = 0;
    while let Some(event) = events.next().await.expect("answers") {
        ends += usize::from(matches!(event.kind, EventKind::Done { .. }));
    }
    assert_eq!(ends, 1);
    // The late artifacts leave nothing beside the upload.
    assert_blobs(&folder.path().join("files"), 1);
}

async fn second_attempt(store: &SqliteStore, id: JobId) -> Lease {
    let memory = Memory { records_time: Duration::from_secs(86_400), records_max: 1000 };
    assert_eq!(store.sweep(memory).await.expect("answers").changed, [id]);
    let claim = store.claim("second", u64::MAX).await.expect("answers").expect("it waits again");
    assert_eq!(claim.lease.attempt, 2);
    claim.lease
}

fn made_elsewhere() -> Ending {
    let result = JobResult {
        method_used: "rignet".into(),
        models: Vec::new(),
        report: serde_json::Map::new(),
        findings: Vec::new(),
        artifacts: Vec::new(),
    };
    Ending { outcome: Ok((result, Vec::new())), stage: None, timings: Vec::new() }
}

async fn finish(store: &SqliteStore, lease: Lease, ending: Ending) -> Finish {
    store.finish(lease, ending).await.expect("answers")
}

#[tokio::test]
async fn a_panicking_stage_fails_its_job_and_no_other() {
    let folder = tempfile::tempdir().expect("folder");
    let (jobs, _) = start(folder.path(), |settings| settings.workers = 1);
    let (broken, next) = (submit(&jobs, "panic").await, submit(&jobs, "ok").await);
    let job = until(&jobs, broken, JobState::Failed).await;
    assert_eq!((code(&job), job.attempt), (Some(ErrorCode::Internal), 1), "a panic is an answer, not a lost worker");
    assert_intact(&jobs, &until(&jobs, next, JobState::Succeeded).await).await;
}

#[tokio::test]
async fn jobs_wait_for_memory_that_others_hold() {
    let _alone = MEMORY.lock().await;
    let folder = tempfile::tempdir().expect("folder");
    let (jobs, rigger) = start(folder.path(), |settings| {
        // Two jobs of 144 MiB fit, a third does not.
        (settings.workers, settings.memory_bytes_max) = (4, Some(400 * MIB));
    });
    let mut ids = Vec::new();
    for number in 0..6 {
        ids.push(submit(&jobs, &format!("sleep {}", 100 + number)).await);
    }
    for id in ids {
        until(&jobs, id, JobState::Succeeded).await;
    }
    assert_eq!(rigger.running_most.load(Ordering::SeqCst), 2);
}

#[tokio::test]
async fn a_job_that_needs_more_memory_than_there_is_is_refused_by_name() {
    let folder = tempfile::tempdir().expect("folder");
    let (jobs, _) = start(folder.path(), |settings| settings.memory_bytes_max = Some(100 * MIB));
    let Err(Refusal::Check(error)) = jobs.submit(submission(&jobs, "ok")).await else { panic!("was taken") };
    let limit = error.limit.expect("a limit");
    assert_eq!((error.code, limit.name.as_ref(), limit.max), (ErrorCode::OutOfMemory, "memory_bytes", 100 * MIB));
    assert!(limit.actual.is_some_and(|actual| actual > limit.max));
    assert_blobs(folder.path(), 0);
    // The bound was lowered while a job waited: it ends, by the same name.
    drop(jobs);
    let (roomy, _) = start(folder.path(), |settings| settings.workers = 1);
    let running = submit(&roomy, "sleep 60000").await;
    until(&roomy, running, JobState::Running).await;
    let waiting = submit(&roomy, "ok").await;
    roomy.close().await;
    drop(roomy);
    let (jobs, _) = start(folder.path(), |settings| settings.memory_bytes_max = Some(100 * MIB));
    for id in [running, waiting] {
        assert_eq!(code(&until(&jobs, id, JobState::Failed).await), Some(ErrorCode::OutOfMemory));
    }
}

#[tokio::test]
async fn a_job_that_takes_more_memory_than_it_may_is_stopped() {
    let _alone = MEMORY.lock().await;
    let folder = tempfile::tempdir().expect("folder");
    let (jobs, _) = start(folder.path(), |settings| settings.memory_bytes_max = Some(600 * MIB));
    let greedy = submit(&jobs, "eat 1000").await;
    let job = until(&jobs, greedy, JobState::Failed).await;
    let error = job.error.expect("an error");
    assert_eq!(error.code, ErrorCode::OutOfMemory);
    assert!(error.limit.and_then(|limit| limit.actual).is_some_and(|actual| actual > 600 * MIB));
    let modest = submit(&jobs, "ok").await;
    until(&jobs, modest, JobState::Succeeded).await;
}

#[tokio::test]
async fn work_that_never_yields_ends_without_it() {
    let folder = tempfile::tempdir().expect("folder");
    let (jobs, _) = start(folder.path(), |_| {});
    let stuck = Submission { timeout: Some(Duration::from_millis(20)), ..submission(&jobs, "deaf 14000") };
    let stuck = jobs.submit(stuck).await.expect("taken").job.id;
    let job = until(&jobs, stuck, JobState::Failed).await;
    assert_eq!(code(&job), Some(ErrorCode::Timeout));
    let before = format!("{:?}", get(&jobs, stuck).await);
    jobs.idle().await;
    assert_eq!(format!("{:?}", get(&jobs, stuck).await), before, "its late result is refused");
    let next = submit(&jobs, "ok").await;
    until(&jobs, next, JobState::Succeeded).await;
}

#[tokio::test]
async fn a_caller_may_ask_for_less_time() {
    let folder = tempfile::tempdir().expect("folder");
    let (jobs, _) = start(folder.path(), |_| {});
    let timed = Submission { timeout: Some(Duration::from_millis(30)), ..submission(&jobs, "hang") };
    let deadline = SystemTime::now() + Duration::from_millis(400);
    let dated = Submission { deadline: Some(deadline), ..submission(&jobs, "hang 2") };
    for submission in [timed, dated] {
        let id = jobs.submit(submission).await.expect("taken").job.id;
        assert_eq!(code(&until(&jobs, id, JobState::Failed).await), Some(ErrorCode::Timeout));
    }
}
