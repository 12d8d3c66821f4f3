//! Jobs that several processes share: one takes them in, others do the work. Each process is a service of its own here,
//! on one database and one bucket.

use super::bench::{assert_intact, get, received, settings, submission, submit, until};
use crate::bucket::Bucket;
use crate::http::scripted::Scripted;
use crate::jobs_store::engines::postgres_url;
use rigsmith::jobs::{Caller, EventKind, JobState, Jobs, NewResumable, ResumableState, Settings};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// The processes of one service.
struct Service {
    url: String,
    bucket: Bucket,
}

struct Node {
    jobs: Jobs,
    rigger: Arc<Scripted>,
    _folder: TempDir,
}

impl Service {
    async fn new() -> Self {
        Self { url: postgres_url().await, bucket: Bucket::start().await }
    }

    async fn node(&self, workers: usize) -> Node {
        let folder = TempDir::new().expect("folder");
        let store = self.bucket.open(&folder, "rigs");
        let (rigger, url) = (Arc::new(Scripted::default()), self.url.clone());
        let settings = Settings { workers, lease: Duration::from_secs(2), ..settings().shared() };
        let started = {
            let rigger = rigger.clone();
            tokio::task::spawn_blocking(move || Jobs::start_shared(rigger, store, &url, settings))
        };
        Node { jobs: started.await.expect("no panic").expect("starts"), rigger, _folder: folder }
    }
}

fn did(node: &Node) -> usize {
    node.rigger.seen.lock().expect("not poisoned").len()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_process_takes_jobs_in_and_another_does_them() {
    let service = Service::new().await;
    let (door, other_door, worker) = (service.node(0).await, service.node(0).await, service.node(1).await);
    let mut ids = Vec::new();
    for number in 0..5 {
        ids.push(submit(&door.jobs, &format!("ok {number}")).await);
    }
    for id in ids {
        let job = until(&other_door.jobs, id, JobState::Succeeded).await;
        assert_intact(&other_door.jobs, &job).await;
    }
    assert_eq!((did(&door), did(&other_door), did(&worker)), (0, 0, 5));
    let again = submit(&other_door.jobs, "ok 1").await;
    assert!(get(&door.jobs, again).await.cached, "an equal job takes the result, whichever door it comes through");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_watcher_at_another_door_hears_at_once_what_happens() {
    let service = Service::new().await;
    let (door, worker) = (service.node(0).await, service.node(1).await);
    let id = submit(&worker.jobs, "sleep 600").await;
    let mut events = door.jobs.events(&Caller::anonymous(), id, Some(0)).await.expect("answers").expect("is there");
    let mut late = Duration::ZERO;
    let mut names = Vec::new();
    while let Some(event) = events.next().await.expect("answers") {
        if !matches!(event.kind, EventKind::Progress { .. }) {
            late = late.max(event.at.elapsed().unwrap_or_default());
        }
        names.push(event.kind.name());
    }
    assert_eq!((names.first(), names.last()), (Some(&"state"), Some(&"done")));
    // A watcher looks once a second by itself.
    assert!(late < Duration::from_millis(600), "{late:?} after it happened");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_is_canceled_from_any_process() {
    let service = Service::new().await;
    let (door, worker) = (service.node(0).await, service.node(1).await);
    let id = submit(&door.jobs, "hang").await;
    until(&door.jobs, id, JobState::Running).await;
    let asked = Instant::now();
    door.jobs.cancel(&Caller::anonymous(), id).await.expect("is asked");
    until(&door.jobs, id, JobState::Canceled).await;
    assert!(asked.elapsed() < Duration::from_secs(1), "{:?}", asked.elapsed());
    tokio::time::timeout(Duration::from_secs(5), worker.jobs.idle()).await.expect("the work stops");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_process_that_begins_takes_nothing_from_those_that_work() {
    let service = Service::new().await;
    let worker = service.node(1).await;
    let id = submit(&worker.jobs, "sleep 1500").await;
    until(&worker.jobs, id, JobState::Running).await;
    let newcomer = service.node(1).await;
    let job = until(&newcomer.jobs, id, JobState::Succeeded).await;
    assert_eq!((job.attempt, did(&newcomer)), (1, 0));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_jobs_of_a_process_that_leaves_are_done_by_others() {
    let service = Service::new().await;
    let (door, first) = (service.node(0).await, service.node(1).await);
    let id = submit(&door.jobs, "sleep 1000").await;
    until(&door.jobs, id, JobState::Running).await;
    first.jobs.close().await;
    let second = service.node(1).await;
    let job = until(&door.jobs, id, JobState::Succeeded).await;
    assert_eq!((job.attempt, did(&second)), (2, 1));
}

/// While the storage is away, jobs wait for it instead of failing.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn storage_that_fails_for_a_while_costs_no_job() {
    let service = Service::new().await;
    let (door, _worker) = (service.node(0).await, service.node(1).await);
    let new = submission(&door.jobs, "ok 1");
    service.bucket.faults(0.4, 0.3).await;
    let id = door.jobs.submit(new).await.expect("taken").job.id;
    let job = until(&door.jobs, id, JobState::Succeeded).await;
    service.bucket.faults(0.0, 0.0).await;
    assert_intact(&door.jobs, &job).await;
    door.jobs.delete(&Caller::anonymous(), id).await.expect("is deleted");
    service.bucket.assert_objects(0).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn any_process_takes_the_next_part_of_an_upload() {
    let service = Service::new().await;
    let (first, second) = (service.node(0).await, service.node(0).await);
    let caller = Caller::anonymous();
    let new =
        NewResumable { caller: caller.clone(), file_name: "a.obj".to_owned(), metadata: None, length: 9, open_max: 1 };
    let id = first.jobs.begin_resumable(new).await.expect("answers").expect("one may be").id;
    for (node, offset, bytes) in [(&first, 0, "abc"), (&second, 3, "def"), (&first, 6, "ghi")] {
        let upload = node.jobs.resumable(&caller, id).await.expect("answers").expect("is there");
        assert_eq!((upload.received, upload.state), (offset, ResumableState::Open));
        let part = received(&node.jobs, "a.obj", bytes);
        let added = node.jobs.add_to_resumable(&caller, &upload, offset, vec![part]).await.expect("answers");
        assert_eq!(added, Ok(()), "{bytes}");
    }
    let upload = second.jobs.resumable(&caller, id).await.expect("answers").expect("is there");
    let ResumableState::Complete(asset) = upload.state else { panic!("{upload:?}") };
    let asset = second.jobs.asset(&caller, asset).await.expect("answers").expect("is there");
    let content = second.jobs.open(&asset.files[0].sha256).await.expect("answers").expect("is kept");
    assert_eq!(content.read().await.expect("reads"), "abcdefghi");
    service.bucket.assert_objects(1).await;
}
