//! Uploads and results in a bucket, with the stand-in in its place.

use super::s3;
use rigsmith::storage::{Bundle, Store, StoreError};
use sha2::{Digest, Sha256};
use std::collections::BTreeSet;
use std::time::Duration;
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio_stream::StreamExt;

/// A bucket of its own.
pub struct Bucket {
    pub address: String,
}

impl Bucket {
    pub async fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = format!("http://{}", listener.local_addr().expect("an address"));
        tokio::spawn(s3::serve(listener));
        Self { address }
    }

    /// What lies below `prefix`, as one of the machines that share it sees it.
    pub fn open(&self, folder: &TempDir, prefix: &str) -> Store {
        let url = format!("s3://rigs/{prefix}?endpoint={}", self.address);
        let opened = std::thread::scope(|scope| {
            scope.spawn(|| Store::open_bucket(folder.path(), &url, keys(s3::KEY_ID), 1 << 30)).join().expect("no panic")
        });
        opened.expect("opens")
    }

    pub async fn faults(&self, errors: f64, cuts: f64) {
        let url = format!("{}/-/faults?errors={errors}&cuts={cuts}", self.address);
        reqwest::Client::new().put(url).send().await.expect("answers");
    }

    pub async fn count(&self, what: &str) -> u64 {
        let text =
            reqwest::get(format!("{}/-/counts", self.address)).await.expect("answers").text().await.expect("reads");
        let counts: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        counts[what].as_u64().unwrap_or(0)
    }

    /// Waits until there are `count` objects; some seconds at most.
    pub async fn assert_objects(&self, count: u64) {
        for _ in 0..500 {
            if self.count("objects").await == count {
                return;
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        assert_eq!(self.count("objects").await, count);
    }
}

fn keys(id: &str) -> impl Iterator<Item = (String, String)> + Send + use<> {
    let keys = [("AWS_ACCESS_KEY_ID", id), ("AWS_SECRET_ACCESS_KEY", "secret"), ("PATH", "/bin")];
    keys.map(|(name, value)| (name.to_owned(), value.to_owned())).into_iter()
}

/// Writes files as an upload does, on a thread that may block.
async fn written(store: &Store, contents: &[&[u8]]) -> Result<Bundle, StoreError> {
    let (store, contents) = (store.clone(), contents.iter().map(|content| content.to_vec()).collect::<Vec<_>>());
    let write = move || {
        let mut draft = store.draft();
        for content in &contents {
            draft.begin("a.obj")?;
            content.chunks(100_000).try_for_each(|chunk| draft.append(chunk))?;
        }
        draft.finish()
    };
    tokio::task::spawn_blocking(write).await.expect("no panic")
}

fn left(folder: &TempDir) -> usize {
    ["incoming", "blobs"].map(|name| std::fs::read_dir(folder.path().join(name)).expect("folder").count()).iter().sum()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_kept_blob_is_seen_by_every_machine_until_it_is_removed() {
    let bucket = Bucket::start().await;
    let folders = [TempDir::new().expect("folder"), TempDir::new().expect("folder")];
    let (here, there) = (bucket.open(&folders[0], "a"), bucket.open(&folders[1], "a"));
    let elsewhere = TempDir::new().expect("folder");
    let elsewhere = bucket.open(&elsewhere, "other");
    let mut bundle = written(&here, &[b"v 0 0 0", b"nobody keeps this"]).await.expect("finishes");
    let blob = bundle.files()[0].clone();
    assert_eq!((blob.bytes, &blob.sha256[..]), (7, &Sha256::digest(b"v 0 0 0")[..]));
    assert_eq!(bundle.read(&blob).expect("reads"), b"v 0 0 0");
    bundle.keep(&blob.location);
    drop(bundle);
    bucket.assert_objects(1).await;
    assert_eq!((here.bytes(), left(&folders[0])), (0, 0), "nothing stays on the way");
    let content = there.content(&blob.location, blob.bytes);
    assert_eq!(content.read().await.expect("reads"), "v 0 0 0");
    assert!(elsewhere.content(&blob.location, 7).read().await.expect_err("another prefix").is_missing());
    there.remove(&blob.location, blob.bytes).await.expect("removes");
    there.remove(&blob.location, blob.bytes).await.expect("removing it twice is removing it once");
    let missing = content.read().await.expect_err("gone");
    assert!(missing.is_missing() && !missing.is_away());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_large_file_travels_in_parts_and_is_read_by_ranges() {
    let bucket = Bucket::start().await;
    let folder = TempDir::new().expect("folder");
    let store = bucket.open(&folder, "");
    let large: Vec<u8> = (0..20_000_000_u32).map(|index| (index % 251) as u8).collect();
    let mut bundle = written(&store, &[&large]).await.expect("finishes");
    let blob = bundle.files()[0].clone();
    bundle.keep(&blob.location);
    // Beside the mark, which is written at the start.
    assert_eq!((bucket.count("POST").await, bucket.count("PUT").await), (2, 3 + 1));
    let content = store.content(&blob.location, blob.bytes);
    assert_eq!(content.read().await.expect("reads"), large);
    for (offset, bytes) in [(0, 10), (8_388_600, 20), (19_999_999, 1), (5, 0)] {
        let mut stream = content.stream(offset, bytes).await.expect("opens");
        let mut read = Vec::new();
        while let Some(chunk) = stream.next().await {
            read.extend_from_slice(&chunk.expect("reads"));
        }
        assert_eq!(read, large[offset as usize..(offset + bytes) as usize]);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn errors_and_cut_connections_are_ridden_out() {
    let bucket = Bucket::start().await;
    let folder = TempDir::new().expect("folder");
    let store = bucket.open(&folder, "a");
    bucket.faults(0.2, 0.2).await;
    let large = vec![7; 9_000_000];
    let mut kept = BTreeSet::new();
    for number in 0..20 {
        let small = format!("file {number}").into_bytes();
        let mut bundle = written(&store, &[&small, &large]).await.expect("finishes");
        for blob in bundle.files().to_vec() {
            bundle.keep(&blob.location);
            let read = store.content(&blob.location, blob.bytes).read().await.expect("reads");
            assert_eq!(Sha256::digest(&read)[..], blob.sha256);
            kept.insert(blob.location);
        }
    }
    assert_eq!(store.sweep(&kept, Duration::ZERO).await.expect("lists"), 0, "nothing was left behind");
    bucket.faults(0.0, 0.0).await;
    assert_eq!(bucket.count("objects").await, 40);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_nobody_names_is_swept_when_it_is_old_enough() {
    let bucket = Bucket::start().await;
    let folder = TempDir::new().expect("folder");
    let store = bucket.open(&folder, "a");
    let mut named = BTreeSet::new();
    for number in 0..130 {
        let mut bundle = written(&store, &[format!("{number}").as_bytes()]).await.expect("finishes");
        let location = bundle.files()[0].location.clone();
        // Kept, so that it outlives its bundle as a crash would have it.
        bundle.keep(&location);
        if number >= 10 {
            named.insert(location);
        }
    }
    assert_eq!(store.sweep(&named, Duration::from_secs(u32::MAX.into())).await.expect("sweeps"), 0, "all are young");
    assert_eq!(store.sweep(&named, Duration::ZERO).await.expect("sweeps"), 10);
    assert_eq!(bucket.count("objects").await, 120);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_bucket_that_is_wrong_is_refused_at_once() {
    let bucket = Bucket::start().await;
    let open = async |url: String, id: &'static str| {
        let folder = TempDir::new().expect("folder");
        let opened = tokio::task::spawn_blocking(move || Store::open_bucket(folder.path(), &url, keys(id), 1));
        opened.await.expect("no panic").expect_err("refused").to_string()
    };
    let there = format!("s3://rigs?endpoint={}", bucket.address);
    assert!(open(there.clone(), "somebody else").await.contains("InvalidAccessKeyId"));
    assert!(open(format!("{there}&colour=red"), s3::KEY_ID).await.contains("colour"));
    for url in ["http://rigs", "s3:///", "rigs", "s3://rigs?endpoint=nowhere"] {
        assert!(open(url.to_owned(), s3::KEY_ID).await.starts_with("--storage: "), "{url}");
    }
}
