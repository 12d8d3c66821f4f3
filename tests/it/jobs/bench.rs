//! Jobs on a folder, with a scripted rigger.

use crate::http::scripted::Scripted;
use rigsmith::jobs::{Caller, Job, JobId, JobState, Jobs, Received, RigOptions, Settings, Source, Submission};
use rigsmith::storage::{Store, StoreError};
use sha2::{Digest, Sha256};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

pub fn settings() -> Settings {
    Settings { sweep_every: Duration::from_millis(10), ..Settings::default() }
}

/// A service on the jobs of `folder`.
pub fn start(folder: &Path, change: impl FnOnce(&mut Settings)) -> (Jobs, Arc<Scripted>) {
    let (mut settings, rigger) = (settings(), Arc::new(Scripted::default()));
    change(&mut settings);
    let store = free(folder);
    (Jobs::start(rigger.clone(), store, settings).expect("starts"), rigger)
}

/// The folder, as soon as the threads of an earlier service have left it.
fn free(folder: &Path) -> Store {
    for _ in 0..500 {
        match Store::open(folder, 1 << 30) {
            Err(StoreError::InUse { .. }) => std::thread::sleep(Duration::from_millis(10)),
            opened => return opened.expect("store"),
        }
    }
    panic!("the folder stays in use");
}

/// Waits until `count` blobs are in the folder; some seconds at most.
pub fn assert_blobs(folder: &Path, count: usize) {
    let blobs = || std::fs::read_dir(folder.join("blobs")).expect("folder").count();
    for _ in 0..500 {
        if blobs() == count {
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(blobs(), count);
}

pub fn received(jobs: &Jobs, name: &str, content: &str) -> Received {
    let mut upload = jobs.upload().expect("an upload");
    upload.begin(name).expect("begins");
    // Room is made by a thread that may block.
    std::thread::scope(|scope| scope.spawn(|| upload.append(content.as_bytes())).join().expect("no panic"))
        .expect("writes");
    upload.finish(name).expect("finishes")
}

pub fn submission(jobs: &Jobs, script: &str) -> Submission {
    let source = Source::Upload(received(jobs, "a.obj", script));
    Submission::new(Caller::anonymous(), source, RigOptions::default())
}

pub async fn submit(jobs: &Jobs, script: &str) -> JobId {
    jobs.submit(submission(jobs, script)).await.expect("taken").job.id
}

pub async fn get(jobs: &Jobs, id: JobId) -> Job {
    jobs.get(&Caller::anonymous(), id).await.expect("answers").expect("is there")
}

/// Waits until the job is in `state`; some seconds at most.
pub async fn until(jobs: &Jobs, id: JobId, state: JobState) -> Job {
    for _ in 0..2000 {
        let job = get(jobs, id).await;
        if job.state == state {
            return job;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    panic!("did not become {}: {:?}", state.name(), get(jobs, id).await);
}

/// Every artifact of a job is there, with the bytes that its digest says.
pub async fn assert_intact(jobs: &Jobs, job: &Job) {
    let result = job.result.as_ref().expect("a result");
    assert!(!result.artifacts.is_empty());
    for artifact in &result.artifacts {
        let content = jobs.open(&artifact.sha256).await.expect("answers").expect("is kept");
        let bytes = content.read().await.expect("reads");
        assert_eq!(bytes.len() as u64, artifact.bytes);
        assert_eq!(Sha256::digest(&bytes)[..], artifact.sha256);
    }
}
