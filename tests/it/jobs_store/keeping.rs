//! How long jobs, results and uploads are kept, and that what is over stays over.

use super::engines::{Bench, DAY, FOR_EVER, alice, bob};
use rigsmith::jobs::store::{Change, EndedWithout, Ending, Finish, LEASE, LeaseState, Memory, NewFiles, NewJob};
use rigsmith::jobs::{ErrorCode, JobState, Stage};
use std::time::Duration;

const MOMENT: Duration = Duration::from_millis(1);

pub async fn canceling_ends_a_waiting_job_and_asks_a_running_one(bench: &Bench) {
    let waiting = bench.add(bench.new_job("a")).await;
    let cancel = async |id| bench.store.cancel(&alice(), id).await.expect("answers");
    assert_eq!(bench.store.cancel(&bob(), waiting).await.expect("answers"), Change::NotFound);
    assert_eq!(cancel(waiting).await, Change::Done);
    assert_eq!(bench.state(waiting).await, JobState::Canceled);
    assert!(bench.claim().await.is_none());
    let running = bench.add(bench.new_job("b")).await;
    let claim = bench.take().await;
    assert_eq!(cancel(running).await, Change::Requested);
    assert!(bench.job(running).await.cancel_requested);
    assert_eq!(bench.store.extend(&[claim.lease]).await.expect("answers"), [LeaseState::CancelRequested]);
    let canceled = Ending { outcome: Err(EndedWithout::Canceled), stage: Some(Stage::Skin), timings: Vec::new() };
    bench.finish(&claim, canceled).await;
    assert_eq!(bench.state(running).await, JobState::Canceled);
    assert_eq!(cancel(running).await, Change::Done, "asking twice is asking once");
    let lost = bench.add(bench.new_job("c")).await;
    bench.take().await;
    cancel(lost).await;
    bench.advance(LEASE + MOMENT);
    bench.sweep().await;
    assert_eq!(bench.state(lost).await, JobState::Canceled, "nobody is left to yield");
}

pub async fn a_deadline_ends_a_waiting_job(bench: &Bench) {
    let deadline = Some(bench.now().after(Duration::from_secs(60)));
    let late = bench.add(NewJob { deadline, ..bench.new_job("a") }).await;
    let claimed = bench.add(NewJob { deadline, ..bench.new_job("b") }).await;
    bench.advance(Duration::from_secs(20));
    bench.store.cancel(&alice(), late).await.expect("answers");
    let late = bench.add(NewJob { deadline, ..bench.new_job("c") }).await;
    let claim = bench.take().await;
    assert_eq!((claim.lease.job, claim.time_left), (claimed, Some(Duration::from_secs(40))));
    bench.advance(Duration::from_secs(40));
    assert_eq!(bench.store.extend(&[claim.lease]).await.expect("answers"), [LeaseState::Held]);
    bench.sweep().await;
    let job = bench.job(late).await;
    assert_eq!((job.state, job.error.map(|error| error.code)), (JobState::Failed, Some(ErrorCode::Timeout)));
    assert_eq!(bench.state(claimed).await, JobState::Running, "its worker keeps its deadline");
}

pub async fn final_states_never_change(bench: &Bench) {
    let mut over = Vec::new();
    for (content, state) in [("a", JobState::Succeeded), ("b", JobState::Failed), ("c", JobState::Canceled)] {
        let id = bench.add(bench.new_job(content)).await;
        let claim = bench.take().await;
        let ending = match state {
            JobState::Succeeded => bench.good("made"),
            JobState::Failed => bench.failed(),
            _ => Ending { outcome: Err(EndedWithout::Canceled), stage: None, timings: Vec::new() },
        };
        bench.finish(&claim, ending).await;
        over.push((id, state, claim));
    }
    let mut before = Vec::new();
    for (id, ..) in &over {
        before.push(format!("{:?}", bench.job(*id).await));
    }
    for (id, state, claim) in &over {
        assert_eq!(bench.finish(claim, bench.good("again")).await, Finish::Fenced);
        assert_eq!(bench.finish(claim, bench.failed()).await, Finish::Fenced);
        assert!(!bench.store.give_back(claim.lease).await.expect("answers"));
        assert!(!bench.store.advance(claim.lease, Stage::Skin).await.expect("answers"));
        assert_eq!(bench.store.extend(&[claim.lease]).await.expect("answers"), [LeaseState::Lost]);
        let canceled = bench.store.cancel(&alice(), *id).await.expect("answers");
        assert_eq!(canceled, if *state == JobState::Canceled { Change::Done } else { Change::State(*state) });
    }
    bench.advance(2 * LEASE);
    bench.sweep().await;
    bench.store.lose_all().await.expect("answers");
    assert!(bench.claim().await.is_none());
    for ((id, ..), before) in over.iter().zip(before) {
        assert_eq!(format!("{:?}", bench.job(*id).await), before);
    }
}

pub async fn results_end_by_time_and_their_files_are_collected(bench: &Bench) {
    let id = bench.done("a").await;
    let longer = bench.add(NewJob { retention: 2 * DAY, ..bench.new_job("b") }).await;
    let claim = bench.take().await;
    bench.finish(&claim, bench.good("rig of b")).await;
    assert_eq!((bench.collect().await, bench.named().await), (0, 4));
    bench.advance(DAY);
    let swept = bench.sweep().await;
    assert!(swept.freed && swept.changed.contains(&id));
    assert_eq!((bench.state(id).await, bench.state(longer).await), (JobState::Expired, JobState::Succeeded));
    assert!(bench.job(id).await.result.is_some(), "what is small stays");
    assert_eq!((bench.collect().await, bench.named().await), (2, 2));
    assert_eq!(bench.store.delete(&bob(), longer).await.expect("answers"), Change::NotFound);
    assert_eq!(bench.store.delete(&alice(), longer).await.expect("answers"), Change::Done);
    assert_eq!((bench.collect().await, bench.named().await), (2, 0));
}

pub async fn what_gives_nothing_keeps_nothing(bench: &Bench) {
    bench.add(bench.new_job("a")).await;
    let claim = bench.take().await;
    bench.finish(&claim, bench.failed()).await;
    let canceled = bench.add(bench.new_job("b")).await;
    bench.store.cancel(&alice(), canceled).await.expect("answers");
    assert_eq!((bench.collect().await, bench.named().await), (2, 0));
    let running = bench.add(bench.new_job("c")).await;
    bench.take().await;
    assert_eq!(bench.store.delete(&alice(), running).await.expect("answers"), Change::State(JobState::Running));
    assert_eq!((bench.collect().await, bench.named().await), (0, 1), "what runs keeps its files");
}

pub async fn the_oldest_results_and_assets_go_first(bench: &Bench) {
    let first = bench.done("a").await;
    bench.advance(MOMENT);
    let kept = bench.blob("b.obj", "b");
    let (asset, ..) = bench.store.put_asset(&alice(), &[kept], 100, DAY).await.expect("answers");
    bench.advance(MOMENT);
    let last = bench.done("c").await;
    let mut gone = Vec::new();
    while bench.store.expire_oldest().await.expect("answers") {
        bench.collect().await;
        let asset = bench.store.asset(&alice(), asset.id).await.expect("answers").is_some();
        gone.push((bench.state(first).await, asset, bench.state(last).await));
    }
    let (there, expired) = (JobState::Succeeded, JobState::Expired);
    gone.dedup();
    assert!(gone.contains(&(expired, true, there)) && gone.contains(&(expired, false, there)), "{gone:?}");
    assert_eq!((gone.last(), bench.named().await), (Some(&(expired, false, expired)), 0));
}

pub async fn old_records_and_surplus_ones_are_forgotten(bench: &Bench) {
    let mut ids = Vec::new();
    for number in 0..5 {
        ids.push(bench.done(&format!("job {number}")).await);
        bench.advance(Duration::from_secs(60));
    }
    let waiting = bench.add(bench.new_job("waiting")).await;
    bench.store.sweep(Memory { records_max: 3, ..FOR_EVER }).await.expect("answers");
    let there = async |id| bench.store.job(&alice(), id).await.expect("answers").is_some();
    assert_eq!([there(ids[2]).await, there(ids[3]).await, there(ids[4]).await], [false, true, true]);
    bench.advance(Duration::from_secs(3600));
    let memory = Memory { records_time: Duration::from_secs(3600), ..FOR_EVER };
    bench.store.sweep(memory).await.expect("answers");
    assert!(!there(ids[3]).await && !there(ids[4]).await && there(waiting).await, "what waits is never forgotten");
}

pub async fn equal_files_of_a_caller_are_one_asset(bench: &Bench) {
    let put = async |caller, name: &str, content: &str| {
        let files = [bench.blob(name, content), bench.blob("a.mtl", "m")];
        bench.store.put_asset(&caller, &files, 100, DAY).await.expect("answers")
    };
    let (asset, created, kept) = put(alice(), "a.obj", "x").await;
    assert_eq!((created, kept.len()), (true, 2));
    let (same, created, kept) = put(alice(), "A.OBJ", "x").await;
    assert_eq!((same.id, created, kept.len()), (asset.id, false, 0), "the main file's name does not matter");
    let (other, created, kept) = put(alice(), "a.ply", "x").await;
    assert!(created && kept.is_empty() && other.id != asset.id, "its extension does; the blobs are the same");
    assert_ne!(put(bob(), "a.obj", "x").await.0.id, asset.id);
    assert!(
        bench.store.asset(&bob(), asset.id).await.expect("answers").is_none(),
        "another caller's asset is not there"
    );
    let job = bench.add(NewJob { files: NewFiles::Asset(asset.id), ..bench.new_job("") }).await;
    assert_eq!(bench.job(job).await.request.files.len(), 2);
    assert!(bench.store.delete_asset(&alice(), asset.id).await.expect("answers"));
    let claim = bench.take().await;
    assert_eq!(claim.files.len(), 2, "the job keeps what it needs");
    bench.finish(&claim, bench.good("made")).await;
    let again =
        bench.add(NewJob { files: NewFiles::Job(job), wish: [9; 32], recipe: [9; 32], ..bench.new_job("") }).await;
    assert_eq!(bench.job(again).await.request.files, bench.job(job).await.request.files);
}
