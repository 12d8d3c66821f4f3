//! How jobs come into the hands of workers, and out of them.

use super::engines::{Bench, alice, bob};
use rigsmith::jobs::clock::Timestamp;
use rigsmith::jobs::store::{Finish, LEASE, LeaseState, NewFiles, NewJob, PASSING_TIME};
use rigsmith::jobs::{Caller, ErrorCode, JobId, JobState, Priority, Stage};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

const MOMENT: Duration = Duration::from_millis(1);

pub async fn a_job_is_taken_by_one_worker(bench: &Bench) {
    let id = bench.add(bench.new_job("a")).await;
    let claim = bench.take().await;
    assert_eq!((claim.lease.job, claim.lease.attempt), (id, 1));
    assert_eq!(claim.files.len(), 1);
    assert!(bench.claim().await.is_none());
    assert!(bench.second.claim("other", u64::MAX).await.expect("answers").is_none());
    let job = bench.job(id).await;
    assert_eq!((job.state, job.attempt, job.queue_position), (JobState::Running, 1, None));
}

pub async fn a_late_result_is_refused_by_its_attempt(bench: &Bench) {
    let id = bench.add(bench.new_job("a")).await;
    let late = bench.take().await;
    bench.advance(LEASE + MOMENT);
    bench.sweep().await;
    let current = bench.take().await;
    assert_eq!(current.lease.attempt, 2);
    assert_eq!(bench.store.extend(&[late.lease]).await.expect("answers"), [LeaseState::Lost]);
    assert!(!bench.store.advance(late.lease, Stage::Skin).await.expect("answers"));
    assert!(!bench.store.give_back(late.lease).await.expect("answers"));
    assert_eq!(bench.finish(&late, bench.good("late")).await, Finish::Fenced);
    assert_eq!(bench.finish(&late, bench.failed()).await, Finish::Fenced);
    assert_eq!(bench.state(id).await, JobState::Running);
    assert!(matches!(bench.finish(&current, bench.good("current")).await, Finish::Done { .. }));
    assert_eq!(bench.finish(&late, bench.good("later still")).await, Finish::Fenced);
    let made = bench.job(id).await.result.expect("a result").artifacts.clone();
    assert_eq!(made.first().map(|artifact| artifact.bytes), Some("current".len() as u64));
}

pub async fn a_lease_lasts_while_its_worker_is_heard_of(bench: &Bench) {
    let id = bench.add(bench.new_job("a")).await;
    let claim = bench.take().await;
    for _ in 0..5 {
        bench.advance(LEASE - MOMENT);
        assert_eq!(bench.store.extend(&[claim.lease]).await.expect("answers"), [LeaseState::Held]);
        bench.sweep().await;
    }
    assert_eq!((bench.state(id).await, bench.job(id).await.attempt), (JobState::Running, 1));
    // A worker that was stopped for long, and wakes before anybody missed it, has lost nothing.
    bench.advance(10 * LEASE);
    assert_eq!(bench.store.look_at(&[claim.lease]).await.expect("answers"), [LeaseState::Held]);
    assert_eq!(bench.store.extend(&[claim.lease]).await.expect("answers"), [LeaseState::Held]);
    bench.sweep().await;
    assert!(matches!(bench.finish(&claim, bench.good("x")).await, Finish::Done { .. }));
}

pub async fn a_lost_worker_costs_one_repeat_and_the_second_one_the_job(bench: &Bench) {
    let id = bench.add(bench.new_job("poison")).await;
    for attempt in 1..=2 {
        assert_eq!(bench.take().await.lease.attempt, attempt);
        bench.advance(LEASE + MOMENT);
        let swept = bench.sweep().await;
        assert_eq!(swept.changed, [id]);
    }
    let job = bench.job(id).await;
    assert_eq!((job.state, job.error.map(|error| error.code)), (JobState::Failed, Some(ErrorCode::WorkerLost)));
    assert!(bench.claim().await.is_none(), "a poison job ends");
}

pub async fn a_job_given_back_is_nobodys_loss(bench: &Bench) {
    let id = bench.add(bench.new_job("a")).await;
    for _ in 0..4 {
        let claim = bench.take().await;
        assert!(bench.store.give_back(claim.lease).await.expect("answers"));
        assert_eq!(bench.state(id).await, JobState::Queued);
    }
    bench.take().await;
    bench.advance(LEASE + MOMENT);
    bench.sweep().await;
    assert_eq!((bench.state(id).await, bench.take().await.lease.attempt), (JobState::Queued, 6));
}

pub async fn all_jobs_of_a_dead_process_wait_again_at_once(bench: &Bench) {
    let ids = [bench.add(bench.new_job("a")).await, bench.add(bench.new_job("b")).await];
    bench.take().await;
    bench.take().await;
    let swept = bench.store.lose_all().await.expect("answers");
    assert_eq!((swept.changed.len(), swept.requeued), (2, 2));
    for id in ids {
        assert_eq!(bench.state(id).await, JobState::Queued);
    }
    assert_eq!(bench.take().await.lease.job, ids[0], "older jobs keep their turn");
}

pub async fn urgent_jobs_go_first_and_callers_take_turns(bench: &Bench) {
    let add = async |content: &str, caller: Caller, priority: Priority| {
        bench.add(NewJob { caller, priority, ..bench.new_job(content) }).await
    };
    let mut names = BTreeMap::new();
    for number in 0..4 {
        names.insert(add(&format!("a{number}"), alice(), Priority::Normal).await, format!("a{number}"));
    }
    names.insert(add("low", bob(), Priority::Low).await, "low".to_owned());
    names.insert(add("b0", bob(), Priority::Normal).await, "b0".to_owned());
    names.insert(add("b1", bob(), Priority::Normal).await, "b1".to_owned());
    names.insert(add("high", alice(), Priority::High).await, "high".to_owned());
    let positions: Vec<_> = names.keys().copied().collect();
    let mut order = Vec::new();
    for _ in 0..names.len() {
        let claim = bench.take().await;
        order.push(names[&claim.lease.job].clone());
        bench.finish(&claim, bench.failed()).await;
    }
    assert_eq!(order, ["high", "b0", "a0", "b1", "a1", "a2", "a3", "low"]);
    assert_eq!(positions.len(), 8);
    // With two at a time, one caller's queue takes one place while the other has work.
    let first: Vec<JobId> =
        vec![add("x0", alice(), Priority::Normal).await, add("x1", alice(), Priority::Normal).await];
    let running = bench.take().await.lease.job;
    assert_eq!(running, first[0]);
    let other = add("y0", bob(), Priority::Normal).await;
    assert_eq!(bench.job(first[1]).await.queue_position, Some(2));
    assert_eq!(bench.take().await.lease.job, other);
}

pub async fn a_large_job_lets_small_ones_pass_but_not_for_ever(bench: &Bench) {
    let sized = |content: &str, memory_bytes| NewJob {
        files: NewFiles::Received { files: vec![bench.blob("a.obj", content)], memory_bytes },
        ..bench.new_job(content)
    };
    let large = bench.add(sized("large", 500)).await;
    let small = [bench.add(sized("s0", 100)).await, bench.add(sized("s1", 100)).await];
    let claim = async |free| bench.store.claim("worker", free).await.expect("answers").map(|claim| claim.lease.job);
    assert_eq!(claim(400).await, Some(small[0]));
    bench.advance(PASSING_TIME + MOMENT);
    assert_eq!(claim(400).await, None, "now it is the large one's turn");
    assert_eq!(claim(500).await, Some(large));
    assert_eq!(claim(400).await, Some(small[1]));
}

pub async fn two_processes_share_the_work_without_doing_it_twice(bench: &Bench) {
    const JOBS: usize = 40;
    for number in 0..JOBS {
        bench.add(bench.new_job(&format!("job {number}"))).await;
    }
    let taken: Arc<Mutex<Vec<JobId>>> = Arc::default();
    let mut workers = Vec::new();
    for (index, store) in [&bench.store, &bench.second, &bench.store, &bench.second].into_iter().enumerate() {
        let (store, taken, ending) = (store.clone(), taken.clone(), bench.failed());
        workers.push(tokio::spawn(async move {
            while let Some(claim) = store.claim(&format!("worker {index}"), u64::MAX).await.expect("answers") {
                taken.lock().expect("not poisoned").push(claim.lease.job);
                assert!(matches!(
                    store.finish(claim.lease, ending.clone()).await.expect("answers"),
                    Finish::Done { .. }
                ));
            }
        }));
    }
    for worker in workers {
        worker.await.expect("no panic");
    }
    let mut taken = taken.lock().expect("not poisoned").clone();
    taken.sort();
    taken.dedup();
    assert_eq!(taken.len(), JOBS);
}

/// The outcome of a stepped clock, for engines whose clock can be stepped: forwards, work is done once more and its
/// late result refused; backwards, a lost worker is noticed later. Nothing is lost and nothing ends twice.
pub async fn stepping_the_clock_breaks_no_rule(bench: &Bench) {
    let id = bench.add(bench.new_job("a")).await;
    let before = bench.take().await;
    bench.advance(Duration::from_secs(3600));
    bench.sweep().await;
    let again = bench.take().await;
    bench.clock.set(Timestamp(bench.now().0 - 7_200_000));
    assert_eq!(bench.finish(&before, bench.good("before")).await, Finish::Fenced);
    bench.sweep().await;
    assert_eq!(bench.state(id).await, JobState::Running, "a lease does not end early");
    assert_eq!(bench.store.extend(&[again.lease]).await.expect("answers"), [LeaseState::Held]);
    bench.advance(LEASE + MOMENT);
    bench.sweep().await;
    assert_eq!(bench.job(id).await.error.map(|error| error.code), Some(ErrorCode::WorkerLost));
    let next = bench.done("next").await;
    bench.clock.set(Timestamp(bench.now().0 + 24 * 3_600_000 + 1));
    bench.sweep().await;
    assert_eq!(bench.state(next).await, JobState::Expired, "retention moves with the clock");
}
