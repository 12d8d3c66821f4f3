//! What callers are told: the same thing again for the same request, and everything in order.

use super::engines::{Bench, DAY, alice, bob};
use rigsmith::jobs::store::{Admission, Change, JobFilter, NewJob, Remembered};
use rigsmith::jobs::{EventKind, JobId, JobState, Labels, Stage};
use std::time::Duration;

fn replayed(admission: Admission) -> JobId {
    match admission {
        Admission::Replayed(job) => job.id,
        other => panic!("not replayed: {other:?}"),
    }
}

pub async fn an_equal_job_succeeds_at_once_with_the_earlier_result(bench: &Bench) {
    let first = bench.done("a").await;
    let second = bench.add(bench.new_job("a")).await;
    let (first, job) = (bench.job(first).await, bench.job(second).await);
    assert_eq!((job.state, job.cached, job.progress, job.attempt), (JobState::Succeeded, true, 100, 0));
    assert_eq!(job.result.expect("a result").artifacts, first.result.expect("a result").artifacts);
    for other in [
        NewJob { use_cache: false, ..bench.new_job("a") },
        NewJob { recipe: [3; 32], ..bench.new_job("a") },
        bench.new_job("b"),
    ] {
        assert_eq!(bench.state(bench.add(other).await).await, JobState::Queued);
    }
    // Whoever asks: what is equal is equal.
    let theirs = bench.submit(NewJob { caller: bob(), ..bench.new_job("a") }).await;
    assert!(matches!(theirs, Admission::Admitted { job, .. } if job.cached));
    bench.store.delete(&alice(), first.id).await.expect("answers");
    bench.collect().await;
    let result = bench.job(second).await.result.expect("a result");
    let sha256 = result.artifacts.first().expect("an artifact").sha256;
    assert!(bench.store.blob(&sha256).await.expect("answers").is_some(), "each job holds the files that it shows");
    bench.advance(DAY);
    bench.sweep().await;
    bench.collect().await;
    assert!(bench.store.blob(&sha256).await.expect("answers").is_none());
    assert_eq!(bench.state(bench.add(bench.new_job("a")).await).await, JobState::Queued, "what is gone serves nobody");
}

pub async fn an_idempotency_key_stands_for_one_request_for_a_day(bench: &Bench) {
    let keyed = |content: &str| NewJob { idempotency_key: Some("key".into()), ..bench.new_job(content) };
    let id = bench.add(keyed("a")).await;
    assert_eq!(replayed(bench.submit(keyed("a")).await), id, "while it waits");
    let claim = bench.take().await;
    assert_eq!(replayed(bench.submit(keyed("a")).await), id, "while it runs");
    bench.finish(&claim, bench.failed()).await;
    assert_eq!(replayed(bench.submit(keyed("a")).await), id, "when it is over");
    assert!(matches!(bench.submit(keyed("b")).await, Admission::IdempotencyMismatch));
    let otherwise = NewJob { wish: [9; 32], ..keyed("a") };
    assert!(matches!(bench.submit(otherwise).await, Admission::IdempotencyMismatch));
    let theirs = bench.submit(NewJob { caller: bob(), ..keyed("b") }).await;
    assert!(matches!(theirs, Admission::Admitted { .. }), "another caller's key is another key");
    bench.advance(DAY);
    bench.sweep().await;
    assert_ne!(bench.add(keyed("b")).await, id);
}

pub async fn a_callers_own_id_stands_for_one_job(bench: &Bench) {
    let named = |content: &str| NewJob { client_id: Some("hero".into()), ..bench.new_job(content) };
    let id = bench.add(named("a")).await;
    assert_eq!(replayed(bench.submit(named("a")).await), id);
    assert!(matches!(bench.submit(named("b")).await, Admission::ClientIdTaken));
    let found = bench.store.job_by_client_id(&alice(), "hero").await.expect("answers");
    assert_eq!(found.map(|job| job.id), Some(id));
    assert!(bench.store.job_by_client_id(&bob(), "hero").await.expect("answers").is_none());
    assert!(matches!(bench.store.delete(&alice(), id).await.expect("answers"), Change::Done));
    assert_ne!(bench.add(named("b")).await, id, "a deleted job frees its id");
}

pub async fn answers_to_other_requests_are_given_again(bench: &Bench) {
    let recall = async |key: &str, print: u8| bench.store.recall(&alice(), key, &[print; 32]).await.expect("answers");
    assert_eq!(recall("k", 1).await, Remembered::Fresh);
    assert_eq!(recall("k", 1).await, Remembered::InProgress);
    bench.store.remember(&alice(), "k", Some(b"answer")).await.expect("answers");
    assert_eq!(recall("k", 1).await, Remembered::Answer(b"answer".to_vec()));
    assert_eq!(recall("k", 2).await, Remembered::Mismatch);
    assert_eq!(recall("refused", 1).await, Remembered::Fresh);
    bench.store.remember(&alice(), "refused", None).await.expect("answers");
    assert_eq!(recall("refused", 2).await, Remembered::Fresh, "a refused request holds no key");
    bench.store.lose_all().await.expect("answers");
    assert_eq!(recall("refused", 3).await, Remembered::Fresh, "nor does a process that is gone");
    assert_eq!(recall("k", 1).await, Remembered::Answer(b"answer".to_vec()));
    bench.advance(DAY);
    assert_eq!(recall("k", 2).await, Remembered::Fresh);
}

pub async fn no_more_jobs_wait_than_may(bench: &Bench) {
    let new = |content: &str| NewJob { waiting_max: 2, workers: 1, ..bench.new_job(content) };
    // A free worker takes one more.
    for content in ["a", "b", "c"] {
        bench.add(new(content)).await;
    }
    assert!(matches!(bench.submit(new("d")).await, Admission::QueueFull { waiting: 3 }));
    bench.take().await;
    assert!(matches!(bench.submit(new("d")).await, Admission::QueueFull { waiting: 2 }));
    let quota = NewJob { caller: bob(), unfinished_max: Some(1), ..bench.new_job("e") };
    bench.add(quota.clone()).await;
    let second = NewJob { wish: [5; 32], recipe: [5; 32], ..quota };
    assert!(matches!(bench.submit(second).await, Admission::QuotaExceeded { unfinished: 1 }));
}

pub async fn events_have_numbers_without_gaps_and_end_with_done(bench: &Bench) {
    let id = bench.add(bench.new_job("a")).await;
    let claim = bench.take().await;
    for stage in [Stage::Ingest, Stage::Joints, Stage::Skin] {
        bench.store.advance(claim.lease, stage).await.expect("answers");
    }
    bench.store.give_back(claim.lease).await.expect("answers");
    let claim = bench.take().await;
    bench.finish(&claim, bench.good("made")).await;
    let events = bench.store.events(id, 0, 100).await.expect("answers");
    let numbers: Vec<u64> = events.iter().map(|event| event.sequence).collect();
    assert_eq!(numbers, (1..=events.len() as u64).collect::<Vec<_>>());
    let names: Vec<&str> = events.iter().map(|event| event.kind.name()).collect();
    let expected = ["state", "state", "progress", "progress", "progress", "state", "state", "artifact", "done"];
    assert_eq!(names, expected);
    assert!(matches!(events.last().map(|event| &event.kind), Some(EventKind::Done { state: JobState::Succeeded, .. })));
    assert_eq!(bench.job(id).await.sequence, events.len() as u64);
    let rest = bench.second.events(id, 7, 100).await.expect("answers");
    assert_eq!(rest.iter().map(|event| event.sequence).collect::<Vec<_>>(), [8, 9]);
    assert_eq!(bench.store.events(id, 2, 1).await.expect("answers").len(), 1);
}

pub async fn progress_never_falls(bench: &Bench) {
    let id = bench.add(bench.new_job("a")).await;
    let claim = bench.take().await;
    bench.store.advance(claim.lease, Stage::Skin).await.expect("answers");
    let reached = bench.job(id).await.progress;
    bench.store.advance(claim.lease, Stage::Geometry).await.expect("answers");
    assert_eq!((bench.job(id).await.stage, bench.job(id).await.progress), (Some(Stage::Geometry), reached));
    bench.store.give_back(claim.lease).await.expect("answers");
    let claim = bench.take().await;
    bench.store.advance(claim.lease, Stage::Ingest).await.expect("answers");
    assert_eq!(bench.job(id).await.progress, reached, "not even when the work begins anew");
    let all = bench.store.events(id, 0, 100).await.expect("answers");
    let told: Vec<u8> = all
        .iter()
        .filter_map(|event| match event.kind {
            EventKind::Progress { progress, .. } => Some(progress),
            _ => None,
        })
        .collect();
    assert!(told.is_sorted() && told.len() == 3, "{told:?}");
}

pub async fn lists_are_newest_first_filtered_and_each_callers_own(bench: &Bench) {
    let labelled = |content: &str, value: &str| NewJob {
        labels: Labels::from([("project".to_owned(), value.to_owned())]),
        ..bench.new_job(content)
    };
    let mut ids = Vec::new();
    for number in 0..5 {
        ids.insert(0, bench.add(labelled(&format!("{number}"), if number % 2 == 0 { "x" } else { "y" })).await);
        bench.advance(Duration::from_millis(5));
    }
    bench.add(NewJob { caller: bob(), ..bench.new_job("theirs") }).await;
    bench.store.cancel(&alice(), ids[1]).await.expect("answers");
    let list = async |filter: JobFilter, before, count| {
        let jobs = bench.store.list(&alice(), &filter, before, count).await.expect("answers");
        jobs.into_iter().map(|job| job.id).collect::<Vec<_>>()
    };
    assert_eq!(list(JobFilter::default(), None, 100).await, ids);
    assert_eq!(list(JobFilter::default(), Some(ids[1]), 2).await, ids[2..4]);
    let canceled = JobFilter { state: Some(JobState::Canceled), ..JobFilter::default() };
    assert_eq!(list(canceled, None, 100).await, [ids[1]]);
    let x = JobFilter { label: Some(("project".into(), "x".into())), ..JobFilter::default() };
    assert_eq!(list(x.clone(), None, 100).await, [ids[0], ids[2], ids[4]]);
    assert_eq!(list(JobFilter { state: Some(JobState::Canceled), ..x }, None, 100).await, []);
    let first = &bench.store.list(&alice(), &JobFilter::default(), None, 1).await.expect("answers")[0];
    assert_eq!((first.queue_position, first.request.labels["project"].as_str()), (Some(5), "x"));
}
