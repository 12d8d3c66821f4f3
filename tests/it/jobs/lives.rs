//! Jobs outlive the process, watchers outlive a connection.

use super::bench::{assert_blobs, assert_intact, get, received, start, submission, submit, until};
use rigsmith::jobs::{
    Caller, EventKind, JobFilter, JobState, NewResumable, Priority, Refusal, ResumableState, RigOptions, Source,
    Submission,
};
use std::time::Duration;

#[tokio::test]
async fn jobs_go_on_after_a_restart_and_results_stay() {
    let folder = tempfile::tempdir().expect("folder");
    let (jobs, _) = start(folder.path(), |settings| settings.workers = 1);
    let done = submit(&jobs, "ok 1").await;
    until(&jobs, done, JobState::Succeeded).await;
    let failed = submit(&jobs, "fail no_joints_found").await;
    until(&jobs, failed, JobState::Failed).await;
    let running = submit(&jobs, "sleep 300").await;
    until(&jobs, running, JobState::Running).await;
    let waiting = submit(&jobs, "ok 2").await;
    jobs.close().await;
    drop(jobs);

    let (jobs, _) = start(folder.path(), |settings| settings.workers = 1);
    assert_intact(&jobs, &get(&jobs, done).await).await;
    assert_eq!(get(&jobs, failed).await.state, JobState::Failed);
    for id in [running, waiting] {
        let job = until(&jobs, id, JobState::Succeeded).await;
        assert_intact(&jobs, &job).await;
    }
    assert_eq!(get(&jobs, running).await.attempt, 2, "it was given back, and done again");
    let page = jobs.list(&Caller::anonymous(), &JobFilter::default(), None, 3).await.expect("a page");
    assert_eq!(page.jobs.iter().map(|job| job.id).collect::<Vec<_>>(), [waiting, running, failed]);
    let token = page.next_page_token.expect("one more");
    let rest = jobs.list(&Caller::anonymous(), &JobFilter::default(), Some(&token), 3).await.expect("a page");
    assert_eq!((rest.jobs.iter().map(|job| job.id).collect::<Vec<_>>(), rest.next_page_token), (vec![done], None));
}

#[tokio::test]
async fn a_drained_service_begins_nothing_and_takes_nothing() {
    let folder = tempfile::tempdir().expect("folder");
    let (jobs, rigger) = start(folder.path(), |settings| settings.workers = 1);
    let running = submit(&jobs, "sleep 200").await;
    until(&jobs, running, JobState::Running).await;
    let waiting = submit(&jobs, "ok").await;
    let late = submission(&jobs, "late");
    jobs.drain();
    assert!(matches!(jobs.submit(late).await, Err(Refusal::Draining)));
    jobs.idle().await;
    assert_eq!(get(&jobs, running).await.state, JobState::Succeeded);
    assert_eq!(
        (get(&jobs, waiting).await.state, rigger.seen.lock().expect("not poisoned").len()),
        (JobState::Queued, 1)
    );
}

#[tokio::test]
async fn a_watcher_sees_everything_once_and_takes_up_where_it_stopped() {
    let folder = tempfile::tempdir().expect("folder");
    let (jobs, _) = start(folder.path(), |settings| settings.workers = 1);
    let ahead = submit(&jobs, "sleep 100").await;
    let id = submit(&jobs, "sleep 700").await;
    let caller = Caller::anonymous();
    let mut events = jobs.events(&caller, id, None).await.expect("answers").expect("is there");
    let mut seen = Vec::new();
    while let Some(event) = events.next().await.expect("answers") {
        seen.push(event);
    }
    let names: Vec<&str> = seen.iter().map(|event| event.kind.name()).collect();
    assert_eq!(names[..2], ["snapshot", "state"]);
    assert_eq!(names[names.len() - 4..], ["warning", "artifact", "artifact", "done"]);
    assert!(names.contains(&"progress"), "{names:?}");
    let numbers: Vec<u64> = seen.iter().map(|event| event.sequence).collect();
    assert!(numbers.windows(2).all(|pair| pair[1] == pair[0] + 1), "{numbers:?}");
    let middle = numbers[numbers.len() / 2];
    let mut rest = jobs.events(&caller, id, Some(middle)).await.expect("answers").expect("is there");
    let mut again = Vec::new();
    while let Some(event) = rest.next().await.expect("answers") {
        again.push(event.sequence);
    }
    assert_eq!(again, numbers[numbers.len() / 2 + 1..]);
    let over = jobs.events(&caller, id, numbers.last().copied()).await.expect("answers").expect("is there");
    assert!(over.is_over());
    let mut late = jobs.events(&caller, ahead, None).await.expect("answers").expect("is there");
    assert!(matches!(late.next().await.expect("answers").map(|event| event.kind), Some(EventKind::Snapshot(_))));
    assert!(matches!(late.next().await.expect("answers").map(|event| event.kind), Some(EventKind::Done { .. })));
    assert!(late.next().await.expect("answers").is_none());
    assert!(jobs.events(&Caller::named("else"), id, None).await.expect("answers").is_none());
}

#[tokio::test]
async fn the_same_request_gives_the_same_job_and_an_equal_one_the_same_files() {
    let folder = tempfile::tempdir().expect("folder");
    let (jobs, rigger) = start(folder.path(), |_| {});
    let keyed = || Submission { idempotency_key: Some("k".into()), ..submission(&jobs, "sleep 100") };
    let first = jobs.submit(keyed()).await.expect("taken");
    let again = jobs.submit(keyed()).await.expect("the same");
    assert_eq!((first.replayed, again.replayed, again.job.id), (false, true, first.job.id));
    let urgent = Submission { priority: Priority::High, ..keyed() };
    assert!(matches!(jobs.submit(urgent).await, Err(Refusal::IdempotencyMismatch)));
    let done = jobs.wait(&Caller::anonymous(), first.job.id, Duration::from_secs(10)).await.expect("answers");
    let done = done.expect("is there");
    let equal = jobs.submit(submission(&jobs, "sleep 100")).await.expect("taken").job;
    assert!(equal.cached && equal.state == JobState::Succeeded && equal.id != done.id);
    assert_intact(&jobs, &equal).await;
    let anew = Submission { use_cache: false, ..submission(&jobs, "sleep 100") };
    let anew = jobs.submit(anew).await.expect("taken").job.id;
    until(&jobs, anew, JobState::Succeeded).await;
    assert_eq!(rigger.seen.lock().expect("not poisoned").len(), 2);
    // One upload and two artifacts, for three jobs.
    assert_blobs(folder.path(), 3);
}

#[tokio::test]
async fn an_asset_serves_many_jobs_and_a_job_another_one() {
    let folder = tempfile::tempdir().expect("folder");
    let (jobs, rigger) = start(folder.path(), |_| {});
    let caller = Caller::anonymous();
    let asset = jobs.put_asset(&caller, received(&jobs, "hero.obj", "ok")).await.expect("kept");
    let same = jobs.put_asset(&caller, received(&jobs, "other.obj", "ok")).await.expect("found");
    assert_eq!((asset.created, same.created, same.asset.id), (true, false, asset.asset.id));
    let submit = async |source, seed| {
        let options = RigOptions { seed, ..RigOptions::default() };
        jobs.submit(Submission::new(caller.clone(), source, options)).await.expect("taken").job.id
    };
    let first = submit(Source::Asset(asset.asset.id), 1).await;
    until(&jobs, first, JobState::Succeeded).await;
    assert!(jobs.delete_asset(&caller, asset.asset.id).await.expect("answers"));
    let second = submit(Source::Job(first), 2).await;
    until(&jobs, second, JobState::Succeeded).await;
    let skeleton = Some(bytes::Bytes::from_static(b"{\"joints\": []}"));
    let options = RigOptions { seed: 3, ..RigOptions::default() };
    let reskin = Submission { skeleton, ..Submission::new(caller.clone(), Source::Job(first), options) };
    let third = jobs.submit(reskin).await.expect("taken").job;
    assert!(third.request.skeleton_given);
    until(&jobs, third.id, JobState::Succeeded).await;
    let seen = rigger.seen.lock().expect("not poisoned").clone();
    assert!(seen.iter().all(|request| request.files.len() == 1 && request.files[0].bytes == "ok"));
    assert_eq!(seen[2].skeleton.as_deref(), Some(&b"{\"joints\": []}"[..]));
    assert!(matches!(
        jobs.submit(Submission::new(Caller::named("else"), Source::Job(first), RigOptions::default())).await,
        Err(Refusal::NotFound(_))
    ));
}

#[tokio::test]
async fn the_parts_of_an_upload_outlive_the_process() {
    let folder = tempfile::tempdir().expect("folder");
    let caller = Caller::anonymous();
    let new =
        NewResumable { caller: caller.clone(), file_name: "a.obj".to_owned(), metadata: None, length: 6, open_max: 1 };
    let (jobs, _) = start(folder.path(), |_| {});
    let upload = jobs.begin_resumable(new).await.expect("answers").expect("one may be");
    let part = received(&jobs, "a.obj", "abc");
    assert_eq!(jobs.add_to_resumable(&caller, &upload, 0, vec![part]).await.expect("answers"), Ok(()));
    jobs.close().await;
    drop(jobs);

    let (jobs, _) = start(folder.path(), |_| {});
    let upload = jobs.resumable(&caller, upload.id).await.expect("answers").expect("is there");
    assert_eq!(upload.received, 3);
    let part = received(&jobs, "a.obj", "def");
    assert_eq!(jobs.add_to_resumable(&caller, &upload, 3, vec![part]).await.expect("answers"), Ok(()));
    let upload = jobs.resumable(&caller, upload.id).await.expect("answers").expect("is there");
    let ResumableState::Complete(asset) = upload.state else { panic!("{upload:?}") };
    let asset = jobs.asset(&caller, asset).await.expect("answers").expect("is there");
    let content = jobs.open(&asset.files[0].sha256).await.expect("answers").expect("is kept");
    assert_eq!(content.read().await.expect("reads"), "abcdef");
    assert_blobs(folder.path(), 1);
}
