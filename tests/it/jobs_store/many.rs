//! What is particular to jobs that many processes share: news, and what must not happen twice at the same time.

use super::engines::{Bench, DAY, alice, postgres, postgres_url};
use rigsmith::jobs::store::postgres::PostgresStore;
use rigsmith::jobs::store::{Admission, Duty, JobStore, LEASE, NewJob, News, Remembered};
use rigsmith::jobs::{Job, JobId, JobState, Stage};
use std::collections::BTreeSet;
use std::time::{Duration, SystemTime};
use tokio::sync::broadcast::Receiver;
use tokio::task::JoinSet;

async fn hears(news: &mut Receiver<News>, expected: News) {
    let heard = async { while news.recv().await.expect("is open") != expected {} };
    tokio::time::timeout(Duration::from_secs(5), heard).await.unwrap_or_else(|_| panic!("{expected:?} was not heard"));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_one_process_does_the_others_hear() {
    let bench = postgres().await;
    let mut news = bench.second.news().expect("there are others");
    let id = bench.add(bench.new_job("a")).await;
    hears(&mut news, News::Queued).await;
    let claim = bench.take().await;
    hears(&mut news, News::Job(id)).await;
    bench.store.advance(claim.lease, Stage::Skin).await.expect("answers");
    hears(&mut news, News::Job(id)).await;
    bench.store.cancel(&alice(), id).await.expect("answers");
    hears(&mut news, News::Stop(id)).await;
    bench.store.give_back(claim.lease).await.expect("answers");
    hears(&mut news, News::Queued).await;
}

/// Both processes send the same `requests` at once, many times over; gives the admitted and the replayed jobs.
async fn at_once(bench: &Bench, requests: &[NewJob]) -> (BTreeSet<JobId>, BTreeSet<JobId>) {
    let mut sent = JoinSet::new();
    for round in 0..8 {
        for new in requests {
            let store = if round % 2 == 0 { bench.store.clone() } else { bench.second.clone() };
            let new = new.clone();
            sent.spawn(async move { store.submit(new).await.expect("answers") });
        }
    }
    let (mut admitted, mut replayed) = (BTreeSet::new(), BTreeSet::new());
    while let Some(admission) = sent.join_next().await {
        let id = |job: Box<Job>| job.id;
        match admission.expect("no panic") {
            Admission::Admitted { job, .. } => admitted.insert(id(job)),
            Admission::Replayed(job) => replayed.insert(id(job)),
            other => panic!("{other:?}"),
        };
    }
    (admitted, replayed)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_same_request_at_two_doors_at_once_makes_one_job() {
    let bench = postgres().await;
    let keyed = NewJob { idempotency_key: Some("key".into()), ..bench.new_job("a") };
    let named = NewJob { client_id: Some("hero".into()), ..bench.new_job("b") };
    let (admitted, replayed) = at_once(&bench, &[keyed, named]).await;
    assert_eq!(admitted.len(), 2);
    assert_eq!(replayed, admitted);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_quota_holds_when_requests_come_at_once() {
    let bench = postgres().await;
    let mut sent = JoinSet::new();
    for number in 0..12u8 {
        let new = NewJob { unfinished_max: Some(3), wish: [number; 32], ..bench.new_job(&format!("{number}")) };
        let store = if number % 2 == 0 { bench.store.clone() } else { bench.second.clone() };
        sent.spawn(async move { matches!(store.submit(new).await.expect("answers"), Admission::Admitted { .. }) });
    }
    assert_eq!(sent.join_all().await.into_iter().filter(|admitted| *admitted).count(), 3);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn equal_files_sent_at_once_are_one_asset_and_one_blob() {
    let bench = postgres().await;
    let mut sent = JoinSet::new();
    for number in 0..10 {
        let (store, blob) = (if number % 2 == 0 { &bench.store } else { &bench.second }, bench.blob("a.obj", "same"));
        let store = store.clone();
        sent.spawn(async move { store.put_asset(&alice(), &[blob], 100, DAY).await.expect("answers") });
    }
    let answers = sent.join_all().await;
    assert_eq!(answers.iter().filter(|(_, created, _)| *created).count(), 1);
    assert_eq!(answers.iter().map(|(.., kept)| kept.len()).sum::<usize>(), 1);
    assert_eq!(answers.iter().map(|(asset, ..)| asset.id).collect::<BTreeSet<_>>().len(), 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_request_with_a_key_is_answered_by_one_process() {
    let bench = postgres().await;
    let mut asked = JoinSet::new();
    for number in 0..10 {
        let store = if number % 2 == 0 { bench.store.clone() } else { bench.second.clone() };
        asked.spawn(async move { store.recall(&alice(), "key", &[1; 32]).await.expect("answers") });
    }
    let answers = asked.join_all().await;
    assert_eq!(answers.iter().filter(|answer| **answer == Remembered::Fresh).count(), 1);
    // The process that was to answer is gone.
    bench.advance(Duration::from_secs(15 * 60));
    assert_eq!(bench.second.recall(&alice(), "key", &[1; 32]).await.expect("answers"), Remembered::Fresh);
}

/// One process forgets blobs while the other names them again for new jobs: whatever is named stays.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn blobs_that_are_being_named_are_not_forgotten() {
    let bench = postgres().await;
    for round in 0..20 {
        let content = format!("{}", round % 2);
        let job = bench.add(NewJob { use_cache: false, ..bench.new_job(&content) }).await;
        bench.store.cancel(&alice(), job).await.expect("answers");
        // The upload that came with the canceled job is nobody's now; here it comes again.
        let (again, store) = (NewJob { use_cache: false, ..bench.new_job(&content) }, bench.second.clone());
        let (added, _) = tokio::join!(store.submit(again), bench.store.collect());
        let Admission::Admitted { job, .. } = added.expect("answers") else { panic!("not admitted") };
        let claim = bench.take().await;
        assert_eq!((claim.lease.job, claim.files.len()), (job.id, 1), "its file is there");
        bench.finish(&claim, bench.failed()).await;
    }
}

/// The same for results: equal files that nothing needs any more are forgotten while a job ends with them.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn results_that_are_being_named_are_not_forgotten() {
    let bench = postgres().await;
    let mut last = None;
    for round in 0..20 {
        let id = bench.add(NewJob { use_cache: false, ..bench.new_job(&format!("{round}")) }).await;
        let claim = bench.take().await;
        if let Some(last) = last.replace(id) {
            bench.store.delete(&alice(), last).await.expect("answers");
        }
        let (ended, _) = tokio::join!(bench.second.finish(claim.lease, bench.good("same")), bench.store.collect());
        ended.expect("answers");
        let made = bench.job(id).await.result.expect("a result").artifacts[0].sha256;
        assert!(bench.store.blob(&made).await.expect("answers").is_some(), "its file is there");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_processes_that_sweep_at_once_count_a_loss_once() {
    let bench = postgres().await;
    let mut ids = Vec::new();
    for number in 0..10 {
        ids.push(bench.add(bench.new_job(&format!("{number}"))).await);
        bench.take().await;
    }
    bench.advance(LEASE + Duration::from_millis(1));
    let sweep = |store: &std::sync::Arc<dyn JobStore>| {
        let store = store.clone();
        async move { store.sweep(super::engines::FOR_EVER).await.expect("answers").requeued }
    };
    let (first, second) = tokio::join!(sweep(&bench.store), sweep(&bench.second));
    assert_eq!(first + second, 10);
    for id in ids {
        assert_eq!(bench.state(id).await, JobState::Queued);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_duty_is_done_by_one_process_at_a_time() {
    let bench = postgres().await;
    let hour = Duration::from_secs(3600);
    for _ in 0..3 {
        let mut turns = JoinSet::new();
        for store in [&bench.store, &bench.second, &bench.store, &bench.second] {
            let store = store.clone();
            turns.spawn(async move { store.take_turn(Duty::RemoveOrphans, hour).await.expect("answers") });
        }
        assert_eq!(turns.join_all().await.into_iter().filter(|turn| *turn).count(), 1);
        bench.advance(hour);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn time_is_the_servers() {
    let url = postgres_url().await;
    let store = PostgresStore::open(&url, LEASE).await.expect("opens");
    let bench = postgres().await;
    let (new, before) = (bench.new_job("a"), SystemTime::now());
    let Admission::Admitted { job, .. } = store.submit(new).await.expect("answers") else { panic!("not admitted") };
    // Server and test share a machine.
    let apart = job.created_at.duration_since(before).unwrap_or_else(|late| late.duration());
    assert!(apart < Duration::from_secs(2), "{apart:?}");
}

#[tokio::test]
async fn a_database_that_does_not_answer_is_named_and_its_password_is_not() {
    let refused =
        PostgresStore::open("postgres://rigsmith:s3cret@127.0.0.1:9/none", LEASE).await.err().expect("nobody there");
    assert!(!refused.to_string().contains("s3cret"), "{refused}");
}
