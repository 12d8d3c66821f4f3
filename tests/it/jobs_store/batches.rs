//! Batches: order, settling, ending, and what they keep.

use super::engines::{Bench, DAY, FOR_EVER, alice, bob};
use rigsmith::jobs::store::{Change, EndedWithout, Ending, Memory, NewFiles, NewJob};
use rigsmith::jobs::{
    AssetId, BatchCounts, BatchId, BatchItem, ItemState, JobState, NewBatch, NewItem, OpenBatch, PendingItem, Settled,
    Stage,
};
use std::time::Duration;

fn item(number: usize) -> NewItem {
    let (custom_id, request) = (format!("knight-{number}"), format!("{{\"seed\":{number}}}"));
    NewItem { custom_id, request, asset: None, error: None }
}

fn batch(items: Vec<NewItem>) -> NewBatch {
    NewBatch { caller: alice(), jobs_max: Some(3), items }
}

async fn create(bench: &Bench, items: Vec<NewItem>) -> BatchId {
    bench.store.create_batch(batch(items)).await.expect("answers")
}

async fn counts(bench: &Bench, id: BatchId) -> BatchCounts {
    bench.store.batch(&alice(), id).await.expect("answers").expect("is there").counts
}

async fn settle(bench: &Bench, id: BatchId, position: usize, settled: Settled) -> bool {
    bench.store.settle_item(id, position, &settled).await.expect("answers")
}

async fn states(bench: &Bench, id: BatchId) -> Vec<ItemState> {
    let items: Vec<BatchItem> = bench.store.batch_items(id, 0, 100).await.expect("answers");
    items.iter().map(|item| item.state).collect()
}

pub async fn a_batch_is_written_in_order_and_each_item_settled_once(bench: &Bench) {
    let mut items: Vec<NewItem> = (0..450).map(item).collect();
    items[3].error = Some("{}".to_owned());
    let id = create(bench, items).await;
    let page = bench.store.batch_items(id, 195, 10).await.expect("answers");
    let named: Vec<(usize, &str)> = page.iter().map(|item| (item.position, item.custom_id.as_str())).collect();
    assert_eq!(named[..2], [(195, "knight-195"), (196, "knight-196")]);
    assert_eq!(named.len(), 10);
    assert_eq!(bench.store.batch_items(id, 449, 10).await.expect("answers").len(), 1);
    let pending = bench.second.pending_items(id, 4).await.expect("answers");
    assert_eq!(pending[0], PendingItem { position: 0, request: "{\"seed\":0}".to_owned() });
    assert_eq!(
        pending.iter().map(|item| item.position).collect::<Vec<_>>(),
        [0, 1, 2, 4],
        "the broken one waits for nothing"
    );
    let job = bench.add(bench.new_job("a")).await;
    assert!(settle(bench, id, 0, Settled::Job(job)).await);
    assert!(!settle(bench, id, 0, Settled::Refused("late".to_owned())).await, "it is settled");
    assert!(settle(bench, id, 1, Settled::Refused("why".to_owned())).await);
    let items = bench.store.batch_items(id, 0, 2).await.expect("answers");
    assert_eq!((items[0].job, items[0].state), (Some(job), ItemState::Job(JobState::Queued)));
    assert_eq!((items[1].error.as_deref(), items[1].state), (Some("why"), ItemState::Job(JobState::Failed)));
    assert_eq!(counts(bench, id).await, BatchCounts { queued: 448, failed: 2, ..BatchCounts::default() });
    let open = bench.second.open_batches().await.expect("answers");
    assert_eq!(open, [OpenBatch { id, caller: alice(), jobs_max: Some(3) }]);
}

pub async fn a_batch_is_over_when_its_items_are(bench: &Bench) {
    let id = create(bench, (0..5).map(item).collect()).await;
    let mut jobs = Vec::new();
    for position in 0..4 {
        let job = bench.add(bench.new_job(&position.to_string())).await;
        settle(bench, id, position, Settled::Job(job)).await;
        jobs.push(job);
    }
    settle(bench, id, 4, Settled::Refused("{}".to_owned())).await;
    let conclude = async || bench.store.conclude_batches().await.expect("answers");
    let canceled = Ending { outcome: Err(EndedWithout::Canceled), stage: Some(Stage::Skin), timings: Vec::new() };
    for ending in [bench.good("made"), bench.failed(), canceled] {
        let claim = bench.take().await;
        bench.finish(&claim, ending).await;
    }
    assert_eq!(conclude().await, []);
    let now = counts(bench, id).await;
    assert_eq!(now, BatchCounts { queued: 1, succeeded: 1, failed: 2, canceled: 1, running: 0 });
    assert_eq!(bench.store.delete(&alice(), jobs[3]).await.expect("answers"), Change::Done);
    assert_eq!(conclude().await, [id], "the item of a job that was deleted has failed");
    assert_eq!(conclude().await, [], "once");
    let over = bench.store.batch(&alice(), id).await.expect("answers").expect("is there");
    assert!(over.finished_at.is_some() && over.canceled_at.is_none());
    // What is noted stays, whatever becomes of the job.
    bench.advance(DAY + Duration::from_secs(1));
    bench.sweep().await;
    assert_eq!(bench.state(jobs[0]).await, JobState::Expired);
    let ended = [JobState::Succeeded, JobState::Failed, JobState::Canceled, JobState::Failed, JobState::Failed];
    assert_eq!(states(bench, id).await, ended.map(ItemState::Job));
    assert_eq!(bench.store.open_batches().await.expect("answers"), []);
}

pub async fn canceling_a_batch_ends_what_waits_and_names_what_runs(bench: &Bench) {
    let id = create(bench, (0..3).map(item).collect()).await;
    let job = bench.add(bench.new_job("a")).await;
    settle(bench, id, 0, Settled::Job(job)).await;
    assert_eq!(bench.store.cancel_batch(&bob(), id).await.expect("answers"), None);
    assert_eq!(bench.store.cancel_batch(&alice(), id).await.expect("answers"), Some(vec![job]));
    assert!(!settle(bench, id, 1, Settled::Job(job)).await, "no item becomes a job any more");
    assert_eq!(bench.store.pending_items(id, 9).await.expect("answers"), []);
    assert_eq!(bench.store.conclude_batches().await.expect("answers"), [], "a job is not over");
    bench.store.cancel(&alice(), job).await.expect("answers");
    assert_eq!(bench.store.conclude_batches().await.expect("answers"), [id]);
    assert_eq!(states(bench, id).await, [ItemState::Job(JobState::Canceled); 3]);
    assert_eq!(
        bench.store.cancel_batch(&alice(), id).await.expect("answers"),
        Some(vec![]),
        "asking twice is asking once"
    );
}

pub async fn an_asset_that_an_item_waits_for_is_kept(bench: &Bench) {
    let keep = async |content: &str| -> AssetId {
        let files = [bench.blob("hero.obj", content)];
        bench.store.put_asset(&alice(), &files, 100, DAY).await.expect("answers").0.id
    };
    let (awaited, idle) = (keep("a").await, keep("b").await);
    let id = create(bench, vec![NewItem { asset: Some(awaited), ..item(0) }]).await;
    bench.advance(DAY + Duration::from_secs(1));
    bench.sweep().await;
    let there = async |asset| bench.store.asset(&alice(), asset).await.expect("answers").is_some();
    assert!(there(awaited).await && !there(idle).await);
    assert!(!bench.store.expire_oldest().await.expect("answers"), "nor does it make room");
    let files = NewFiles::Asset(awaited);
    let job = bench.add(NewJob { files, ..bench.new_job("") }).await;
    settle(bench, id, 0, Settled::Job(job)).await;
    assert!(bench.store.expire_oldest().await.expect("answers"), "its job keeps the files, and nothing the asset");
}

pub async fn batches_are_each_callers_own_and_forgotten_in_time(bench: &Bench) {
    let mut ids = Vec::new();
    for _ in 0..3 {
        ids.push(create(bench, vec![NewItem { error: Some("{}".to_owned()), ..item(0) }]).await);
    }
    let list = async |before, count| {
        let page = bench.store.batches(&alice(), before, count).await.expect("answers");
        page.iter().map(|batch| batch.id).collect::<Vec<_>>()
    };
    assert_eq!(list(None, 2).await, [ids[2], ids[1]]);
    assert_eq!(list(Some(ids[1]), 2).await, [ids[0]]);
    assert_eq!(bench.store.batches(&bob(), None, 9).await.expect("answers").len(), 0);
    assert!(bench.store.batch(&bob(), ids[0]).await.expect("answers").is_none());
    assert_eq!(bench.store.conclude_batches().await.expect("answers").len(), 3);
    bench.advance(Duration::from_secs(60));
    bench.sweep().await;
    assert_eq!(list(None, 9).await.len(), 3);
    let memory = Memory { records_time: Duration::from_secs(30), ..FOR_EVER };
    bench.store.sweep(memory).await.expect("answers");
    assert_eq!(list(None, 9).await.len(), 0);
    assert_eq!(bench.store.batch_items(ids[0], 0, 9).await.expect("answers"), []);
}
