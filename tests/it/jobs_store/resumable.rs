//! Uploads in parts: where they grow, how they end, and what they keep.

use super::engines::{Bench, DAY, FOR_EVER, alice, bob};
use rigsmith::jobs::store::Memory;
use rigsmith::jobs::{NewResumable, NotAdded, Resumable, ResumableState, UploadId};
use rigsmith::storage::NewBlob;
use std::time::Duration;

fn new(length: u64) -> NewResumable {
    let metadata = Some("filename aGVyby5vYmo=".to_owned());
    NewResumable { caller: alice(), file_name: "hero.obj".to_owned(), metadata, length, open_max: 2 }
}

async fn begin(bench: &Bench, length: u64) -> UploadId {
    bench.store.begin_resumable(&new(length), DAY).await.expect("answers").expect("one more may be").id
}

async fn add(bench: &Bench, id: UploadId, offset: u64, parts: &[NewBlob]) -> Result<Vec<String>, NotAdded> {
    bench.store.add_parts(&alice(), id, offset, parts, DAY).await.expect("answers")
}

async fn complete(bench: &Bench, id: UploadId, offset: u64, whole: &str) -> Result<Vec<String>, NotAdded> {
    let files = [bench.blob("hero.obj", whole)];
    bench.second.complete_resumable(&alice(), id, offset, &files, 100, DAY).await.expect("answers")
}

async fn find(bench: &Bench, id: UploadId) -> Option<Resumable> {
    bench.second.resumable(&alice(), id).await.expect("answers")
}

pub async fn an_upload_grows_at_its_end_alone(bench: &Bench) {
    let id = begin(bench, 9).await;
    let begun = find(bench, id).await.expect("is there");
    assert_eq!((begun.received, begun.length, begun.state), (0, 9, ResumableState::Open));
    assert_eq!((begun.file_name, begun.metadata), ("hero.obj".to_owned(), new(9).metadata));
    let parts = [bench.blob("hero.obj", "abc"), bench.blob("hero.obj", "de")];
    assert_eq!(add(bench, id, 0, &parts).await.map(|kept| kept.len()), Ok(2));
    for offset in [0, 4, 6] {
        let late = add(bench, id, offset, &[bench.blob("hero.obj", "late")]).await;
        assert_eq!(late, Err(NotAdded::Elsewhere), "{offset}");
    }
    assert_eq!(add(bench, id, 5, &[bench.blob("hero.obj", "abc")]).await, Ok(vec![]), "equal bytes are kept once");
    assert_eq!(find(bench, id).await.expect("is there").received, 8);
    let places = bench.second.resumable_parts(id, 8).await.expect("answers");
    assert_eq!(places.iter().map(|place| place.bytes).collect::<Vec<_>>(), [3, 2, 3]);
    assert_eq!(places[0], places[2]);
    assert_eq!(bench.second.resumable_parts(id, 5).await.expect("answers").len(), 2);
    assert_eq!((bench.collect().await, bench.named().await), (0, 2), "an open upload keeps its parts");
    let theirs = bench.store.add_parts(&bob(), id, 8, &[bench.blob("a", "x")], DAY).await.expect("answers");
    assert_eq!(theirs, Err(NotAdded::Gone));
    assert_eq!(bench.store.resumable(&bob(), id).await.expect("answers"), None);
    assert!(!bench.store.delete_resumable(&bob(), id).await.expect("answers"));
    assert!(bench.store.delete_resumable(&alice(), id).await.expect("answers"));
    assert_eq!(add(bench, id, 8, &[bench.blob("a", "x")]).await, Err(NotAdded::Gone));
    assert_eq!((bench.collect().await, bench.named().await), (2, 0));
}

pub async fn the_last_bytes_make_an_asset_of_an_upload_once(bench: &Bench) {
    let id = begin(bench, 5).await;
    add(bench, id, 0, &[bench.blob("hero.obj", "abc")]).await.expect("is added");
    assert_eq!(complete(bench, id, 0, "abcde").await, Err(NotAdded::Elsewhere));
    assert_eq!(bench.named().await, 1, "what is refused leaves nothing");
    assert_eq!(complete(bench, id, 3, "abcde").await.map(|kept| kept.len()), Ok(1));
    for again in [complete(bench, id, 3, "abcde").await, complete(bench, id, 5, "abcde").await] {
        assert_eq!(again, Err(NotAdded::Elsewhere));
    }
    assert_eq!(add(bench, id, 5, &[bench.blob("hero.obj", "f")]).await, Err(NotAdded::Elsewhere), "it is closed");
    let over = find(bench, id).await.expect("is there");
    let ResumableState::Complete(asset) = over.state else { panic!("{over:?}") };
    assert_eq!(over.received, 5);
    let made = bench.store.asset(&alice(), asset).await.expect("answers").expect("is there");
    assert_eq!((made.bytes(), made.files[0].name.as_str()), (5, "hero.obj"));
    assert_eq!((bench.collect().await, bench.named().await), (1, 1), "the part goes, the file stays");
    assert!(bench.store.delete_resumable(&alice(), id).await.expect("answers"));
    assert!(bench.store.asset(&alice(), asset).await.expect("answers").is_some());
}

pub async fn uploads_that_nobody_goes_on_with_expire_and_are_remembered(bench: &Bench) {
    let (idle, busy) = (begin(bench, 9).await, begin(bench, 9).await);
    assert_eq!(bench.store.begin_resumable(&new(9), DAY).await.expect("answers"), None, "two may be open");
    assert!(
        bench.store.begin_resumable(&NewResumable { caller: bob(), ..new(9) }, DAY).await.expect("answers").is_some()
    );
    add(bench, idle, 0, &[bench.blob("a", "abc")]).await.expect("is added");
    bench.advance(DAY - Duration::from_secs(1));
    add(bench, busy, 0, &[bench.blob("a", "de")]).await.expect("is added");
    assert!(!bench.sweep().await.freed);
    bench.advance(Duration::from_secs(2));
    assert_eq!(find(bench, idle).await.expect("is known").state, ResumableState::Expired, "before anybody sweeps");
    assert_eq!(add(bench, idle, 3, &[bench.blob("a", "x")]).await, Err(NotAdded::Gone));
    assert_eq!(complete(bench, idle, 3, "abcdefghi").await, Err(NotAdded::Gone));
    assert!(bench.sweep().await.freed);
    assert_eq!((bench.collect().await, bench.named().await), (1, 1));
    assert_eq!(find(bench, busy).await.expect("is there").state, ResumableState::Open);
    assert_eq!(find(bench, idle).await.expect("is known").state, ResumableState::Expired);
    begin(bench, 9).await;
    let memory = Memory { records_time: Duration::from_secs(60), ..FOR_EVER };
    bench.advance(Duration::from_secs(60));
    bench.store.sweep(memory).await.expect("answers");
    assert_eq!(find(bench, idle).await, None);
    assert!(find(bench, busy).await.is_some());
}
