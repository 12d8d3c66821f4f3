//! Where uploads and artifacts are kept: one folder, in use by one process, or a bucket that many processes share.
//!
//! ```text
//! DIR/lock                 held while a service uses the folder
//! DIR/incoming/ID          a file that is being written
//! DIR/blobs/SHA256-ID      a complete file; nobody changes it any more
//! s3://BUCKET/PREFIX/blobs/SHA256-ID   the same, in a bucket
//! ```
//!
//! A *blob* is a file whose content never changes. It appears by one rename after its bytes are on the disk, or by one
//! upload, whole or not at all. Which blobs are in use is written in the job database, and nowhere else: a blob that the database does
//! not name is swept ([`Store::sweep`]), so a crash between the two leaves nothing behind for long. The name carries
//! the digest for people, and an id so that removing one copy never hits another that was made in the same moment.
//!
//! Blobs are read, listed and removed through [`object_store`]. An upload always lands on the local disk first, so that
//! only what is complete travels to a bucket, and may be sent again. A prefix of a bucket belongs to one job database.

mod blobs;
mod bucket;
mod draft;

pub use blobs::{Content, ContentStream};
pub use draft::{Bundle, Draft, NewBlob};

use self::bucket::Bucket;
use object_store::ObjectStore;
use object_store::local::LocalFileSystem;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

const INCOMING: &str = "incoming";
const BLOBS: &str = "blobs";

/// A folder in use by this process. Clones share it.
#[derive(Clone, Debug)]
pub struct Store(Arc<Folder>);

#[derive(Debug)]
struct Folder {
    root: PathBuf,
    /// Held, not read: the operating system frees the lock with the file.
    _lock: File,
    local: Arc<LocalFileSystem>,
    /// Where the blobs are, unless they are here.
    bucket: Option<Bucket>,
    bytes_max: u64,
    /// Bytes in drafts, and in blobs that are here.
    bytes: AtomicU64,
}

#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    #[error("the data folder {} is in use by another service", .root.display())]
    InUse { root: PathBuf },
    #[error("there is no room: {bytes_max} bytes at most are kept")]
    Full { bytes_max: u64 },
    #[error("{doing} {}: {source}", .path.display())]
    Io { doing: &'static str, path: PathBuf, source: io::Error },
    #[error("blob {location}: {source}")]
    Blob { location: String, source: object_store::Error },
    #[error("blob {location} was not taken by the bucket: {source}")]
    Upload { location: String, source: object_store::Error },
    #[error("--storage: {reason}")]
    Bucket { reason: String },
    #[error("the writing task ended early")]
    Interrupted,
}

impl StoreError {
    /// Whether it is a matter of room, so that it may pass.
    pub fn is_full(&self) -> bool {
        match self {
            StoreError::Full { .. } => true,
            StoreError::Io { source, .. } => {
                matches!(source.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded)
            }
            StoreError::InUse { .. }
            | StoreError::Blob { .. }
            | StoreError::Upload { .. }
            | StoreError::Bucket { .. }
            | StoreError::Interrupted => false,
        }
    }

    /// Whether the store did not answer as it should, which may pass.
    pub fn is_away(&self) -> bool {
        match self {
            StoreError::Upload { .. } => true,
            StoreError::Blob { .. } => !self.is_missing(),
            _ => false,
        }
    }

    /// Whether the blob is not there (any more).
    pub fn is_missing(&self) -> bool {
        matches!(self, StoreError::Blob { source: object_store::Error::NotFound { .. }, .. })
    }
}

fn io_error<'a>(doing: &'static str, path: &'a Path) -> impl FnOnce(io::Error) -> StoreError + 'a {
    move |source| StoreError::Io { doing, path: path.to_owned(), source }
}

impl Store {
    /// Opens `root`, making it when it is missing. At most `bytes_max` bytes are kept in it.
    pub fn open(root: &Path, bytes_max: u64) -> Result<Self, StoreError> {
        Self::with(root, None, bytes_max)
    }

    /// Opens the bucket at `url` (`s3://BUCKET/PREFIX?endpoint=URL&region=NAME`; keys come from the usual `AWS_…`
    /// `variables`). What is on its way lies in `root`, `bytes_max` bytes of it at most.
    pub fn open_bucket(
        root: &Path,
        url: &str,
        variables: impl Iterator<Item = (String, String)>,
        bytes_max: u64,
    ) -> Result<Self, StoreError> {
        let bucket = Bucket::open(url, variables)?;
        bucket.try_out()?;
        Self::with(root, Some(bucket), bytes_max)
    }

    fn with(root: &Path, bucket: Option<Bucket>, bytes_max: u64) -> Result<Self, StoreError> {
        fs::create_dir_all(root).map_err(io_error("making", root))?;
        let root = &root.canonicalize().map_err(io_error("finding", root))?;
        let lock_path = root.join("lock");
        let lock = File::create(&lock_path).map_err(io_error("making", &lock_path))?;
        if lock.try_lock().is_err() {
            return Err(StoreError::InUse { root: root.to_owned() });
        }
        clear(&root.join(INCOMING))?;
        // What the folder layout of version 0.1 left: its jobs did not outlive the process.
        let bundles = root.join("bundles");
        if bundles.exists() {
            fs::remove_dir_all(&bundles).map_err(io_error("clearing", &bundles))?;
        }
        let blobs = root.join(BLOBS);
        fs::create_dir_all(&blobs).map_err(io_error("making", &blobs))?;
        let bytes = AtomicU64::new(bytes_in(&blobs)?);
        let local = LocalFileSystem::new_with_prefix(root)
            .map_err(|source| StoreError::Blob { location: String::new(), source })?;
        let local = Arc::new(local);
        Ok(Self(Arc::new(Folder { root: root.to_owned(), _lock: lock, local, bucket, bytes_max, bytes })))
    }

    /// Whether other processes may use the same blobs.
    pub fn is_shared(&self) -> bool {
        self.0.bucket.is_some()
    }

    fn objects(&self) -> &dyn ObjectStore {
        match &self.0.bucket {
            Some(bucket) => &*bucket.objects,
            None => &*self.0.local,
        }
    }

    /// The folder itself, for what else lives in it.
    pub fn root(&self) -> &Path {
        &self.0.root
    }

    /// Bytes kept on this machine now.
    pub fn bytes(&self) -> u64 {
        self.0.bytes.load(Ordering::Relaxed)
    }

    /// Bytes kept on this machine at most.
    pub fn bytes_max(&self) -> u64 {
        self.0.bytes_max
    }

    fn claim(&self, bytes: u64) -> Result<(), StoreError> {
        let fits = |kept: u64| kept.checked_add(bytes).filter(|kept| *kept <= self.0.bytes_max);
        match self.0.bytes.fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits) {
            Ok(_) => Ok(()),
            Err(_) => Err(StoreError::Full { bytes_max: self.0.bytes_max }),
        }
    }

    fn give_back(&self, bytes: u64) {
        // Saturating: a file removed behind our back must not make the folder look endlessly full.
        let less = |kept: u64| Some(kept.saturating_sub(bytes));
        let _ = self.0.bytes.fetch_update(Ordering::Relaxed, Ordering::Relaxed, less);
    }
}

/// An empty folder at `path`, whatever was there.
fn clear(path: &Path) -> Result<(), StoreError> {
    match fs::remove_dir_all(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(io_error("clearing", path)(error)),
        _ => fs::create_dir(path).map_err(io_error("making", path)),
    }
}

fn bytes_in(folder: &Path) -> Result<u64, StoreError> {
    let mut bytes = 0;
    for entry in fs::read_dir(folder).map_err(io_error("reading", folder))? {
        let length = entry.and_then(|entry| entry.metadata()).map_err(io_error("reading below", folder))?.len();
        bytes += length;
    }
    Ok(bytes)
}

/// Lower-case hexadecimal.
pub fn hex(digest: &[u8]) -> String {
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use sha2::{Digest, Sha256};
    use std::collections::BTreeSet;
    use std::time::Duration;

    fn entries(root: &Path) -> usize {
        [INCOMING, BLOBS].iter().map(|name| fs::read_dir(root.join(name)).expect("folder").count()).sum()
    }

    fn bundle(store: &Store, content: &[u8]) -> Bundle {
        let mut draft = store.draft();
        draft.begin("a").expect("begins");
        draft.append(content).expect("writes");
        draft.finish().expect("finishes")
    }

    #[tokio::test]
    async fn a_kept_blob_is_there_whole_until_it_is_removed() {
        let root = tempfile::tempdir().expect("folder");
        let store = Store::open(root.path(), 100).expect("opens");
        let mut draft = store.draft();
        draft.begin("../a b.obj").expect("begins");
        draft.append(b"v 0 ").expect("writes");
        draft.append(b"0 0").expect("writes");
        draft.begin("empty").expect("begins");
        let mut bundle = draft.finish().expect("finishes");
        let blob = bundle.files().first().expect("is there").clone();
        assert_eq!((blob.name.as_str(), blob.bytes), ("../a b.obj", 7));
        assert_eq!(blob.sha256[..], Sha256::digest(b"v 0 0 0")[..]);
        bundle.keep(&blob.location);
        drop(bundle);
        assert_eq!((store.bytes(), entries(root.path())), (7, 1), "what nobody keeps goes");
        let content = store.content(&blob.location, blob.bytes);
        assert_eq!(content.read().await.expect("reads"), "v 0 0 0");
        store.remove(&blob.location, blob.bytes).await.expect("removes");
        assert_eq!((store.bytes(), entries(root.path())), (0, 0));
        assert!(content.read().await.expect_err("gone").is_missing());
    }

    #[test]
    fn an_abandoned_or_overfull_draft_leaves_nothing() {
        let root = tempfile::tempdir().expect("folder");
        let store = Store::open(root.path(), 10).expect("opens");
        let mut draft = store.draft();
        draft.begin("a").expect("begins");
        draft.append(&[0; 8]).expect("writes");
        assert!(draft.append(&[0; 3]).expect_err("refused").is_full());
        drop(draft);
        assert_eq!((store.bytes(), entries(root.path())), (0, 0));
        drop(bundle(&store, b"finished, but never kept"[..9].as_ref()));
        assert_eq!((store.bytes(), entries(root.path())), (0, 0));
    }

    #[tokio::test]
    async fn a_folder_serves_one_process_and_keeps_its_blobs_for_the_next() {
        let root = tempfile::tempdir().expect("folder");
        let store = Store::open(root.path(), 100).expect("opens");
        let refused = Store::open(root.path(), 100).expect_err("in use");
        assert!(matches!(refused, StoreError::InUse { .. }), "{refused}");
        let mut known = bundle(&store, b"known");
        let location = known.files().first().expect("a file").location.clone();
        known.keep(&location);
        let mut crashed = bundle(&store, b"written before its row");
        let orphan = crashed.files().first().expect("a file").location.clone();
        crashed.keep(&orphan);
        drop((known, crashed));
        fs::write(root.path().join("incoming/left"), b"from a crash").expect("writes");
        drop(store);
        let store = Store::open(root.path(), 100).expect("opens again");
        assert_eq!((store.bytes(), entries(root.path())), (27, 2));
        let swept = store.sweep(&BTreeSet::from([location.clone()]), Duration::ZERO).await.expect("sweeps");
        assert_eq!((swept, store.bytes(), entries(root.path())), (1, 5, 1));
        assert_eq!(store.content(&location, 5).read().await.expect("reads"), "known");
    }
}
