//! Where uploads and artifacts are kept while they are needed: files under one folder.
//!
//! ```text
//! DIR/lock              held while a service uses the folder
//! DIR/incoming/ID/N     file N of a bundle that is being written
//! DIR/bundles/ID/N      file N of a complete bundle
//! ```
//!
//! A *bundle* is a set of named files that belong together: an upload, or the artifacts of a job. It appears by one
//! rename, whole or not at all, and disappears with its last [`Bundle`] value. Names are kept in memory and never
//! become paths. Jobs do not outlive the process yet, so neither do bundles: [`Store::open`] removes what an earlier
//! process left.

use sha2::{Digest, Sha256};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use uuid::Uuid;

/// A folder in use by this process. Clones share it.
#[derive(Clone, Debug)]
pub struct Store(Arc<Folder>);

#[derive(Debug)]
struct Folder {
    root: PathBuf,
    /// Held, not read: the operating system frees the lock with the file.
    _lock: File,
    bytes_max: u64,
    /// Bytes in drafts and bundles.
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
}

impl StoreError {
    /// Whether it is a matter of room, so that it may pass.
    pub fn is_full(&self) -> bool {
        match self {
            StoreError::Full { .. } => true,
            StoreError::Io { source, .. } => source.kind() == io::ErrorKind::StorageFull,
            StoreError::InUse { .. } => false,
        }
    }
}

fn io_error<'a>(doing: &'static str, path: &'a Path) -> impl FnOnce(io::Error) -> StoreError + 'a {
    move |source| StoreError::Io { doing, path: path.to_owned(), source }
}

impl Store {
    /// Opens `root`, making it when it is missing. At most `bytes_max` bytes are kept in it.
    pub fn open(root: &Path, bytes_max: u64) -> Result<Self, StoreError> {
        fs::create_dir_all(root).map_err(io_error("making", root))?;
        let lock_path = root.join("lock");
        let lock = File::create(&lock_path).map_err(io_error("making", &lock_path))?;
        if lock.try_lock().is_err() {
            return Err(StoreError::InUse { root: root.to_owned() });
        }
        for name in ["incoming", "bundles"] {
            let folder = root.join(name);
            match fs::remove_dir_all(&folder) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    return Err(io_error("clearing", &folder)(error));
                }
                _ => fs::create_dir(&folder).map_err(io_error("making", &folder))?,
            }
        }
        Ok(Self(Arc::new(Folder { root: root.to_owned(), _lock: lock, bytes_max, bytes: AtomicU64::new(0) })))
    }

    /// Begins a bundle.
    pub fn draft(&self) -> Result<Draft, StoreError> {
        let id = Uuid::now_v7().simple().to_string();
        let folder = self.0.root.join("incoming").join(&id);
        fs::create_dir(&folder).map_err(io_error("making", &folder))?;
        let bundle = Bundle { store: self.clone(), folder, files: Vec::new() };
        Ok(Draft { bundle, id, open: None })
    }

    /// Bytes kept now.
    pub fn bytes(&self) -> u64 {
        self.0.bytes.load(Ordering::Relaxed)
    }

    /// Bytes kept at most.
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
}

/// A bundle being written. Dropped before [`Draft::finish`], it leaves nothing.
#[derive(Debug)]
pub struct Draft {
    bundle: Bundle,
    id: String,
    open: Option<(File, Sha256)>,
}

impl Draft {
    /// Begins the next file.
    pub fn begin(&mut self, name: &str) -> Result<(), StoreError> {
        self.seal();
        let index = self.bundle.files.len();
        let path = self.bundle.folder.join(index.to_string());
        let file = File::create_new(&path).map_err(io_error("making", &path))?;
        self.open = Some((file, Sha256::new()));
        self.bundle.files.push(StoredFile { name: name.to_owned(), bytes: 0, sha256: [0; 32], index });
        Ok(())
    }

    /// Adds to the file begun last; nothing when none was begun.
    pub fn append(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        let (Some((file, digest)), Some(stored)) = (&mut self.open, self.bundle.files.last_mut()) else {
            return Ok(());
        };
        self.bundle.store.claim(bytes.len() as u64)?;
        // Counted from here on, so that dropping the draft gives the room back whatever happens.
        stored.bytes += bytes.len() as u64;
        file.write_all(bytes).map_err(io_error("writing below", &self.bundle.folder))?;
        digest.update(bytes);
        Ok(())
    }

    /// Makes the bundle appear, whole.
    pub fn finish(mut self) -> Result<Bundle, StoreError> {
        self.seal();
        let folder = self.bundle.store.0.root.join("bundles").join(&self.id);
        fs::rename(&self.bundle.folder, &folder).map_err(io_error("renaming", &self.bundle.folder))?;
        self.bundle.folder = folder;
        Ok(self.bundle)
    }

    /// Closes the file begun last. Nothing is forced to the disk, since nothing has to outlive the process yet.
    fn seal(&mut self) {
        if let (Some((_, digest)), Some(stored)) = (self.open.take(), self.bundle.files.last_mut()) {
            stored.sha256 = digest.finalize().into();
        }
    }
}

/// Files that belong together. Dropping the value removes them.
#[derive(Debug)]
pub struct Bundle {
    store: Store,
    folder: PathBuf,
    files: Vec<StoredFile>,
}

/// A file of a bundle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoredFile {
    pub name: String,
    pub bytes: u64,
    pub sha256: [u8; 32],
    /// File name in the bundle's folder.
    index: usize,
}

impl Bundle {
    /// In the order in which they were written.
    pub fn files(&self) -> &[StoredFile] {
        &self.files
    }

    pub fn file(&self, name: &str) -> Option<&StoredFile> {
        self.files.iter().find(|file| file.name == name)
    }

    /// Opens a file of this bundle for reading. It stays readable when the bundle goes.
    pub fn open(&self, file: &StoredFile) -> Result<File, StoreError> {
        let path = self.path(file);
        File::open(&path).map_err(io_error("opening", &path))
    }

    pub fn read(&self, file: &StoredFile) -> Result<Vec<u8>, StoreError> {
        let path = self.path(file);
        fs::read(&path).map_err(io_error("reading", &path))
    }

    fn path(&self, file: &StoredFile) -> PathBuf {
        self.folder.join(file.index.to_string())
    }
}

impl Drop for Bundle {
    fn drop(&mut self) {
        if let Err(error) = fs::remove_dir_all(&self.folder) {
            tracing::warn!(folder = %self.folder.display(), %error, "a bundle could not be removed");
        }
        let bytes = self.files.iter().map(|file| file.bytes).sum();
        self.store.0.bytes.fetch_sub(bytes, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entries(root: &Path) -> usize {
        ["incoming", "bundles"].iter().map(|name| fs::read_dir(root.join(name)).expect("folder").count()).sum()
    }

    #[test]
    fn a_bundle_is_there_whole_until_it_is_dropped() {
        let root = tempfile::tempdir().expect("folder");
        let store = Store::open(root.path(), 100).expect("opens");
        let mut draft = store.draft().expect("draft");
        draft.begin("../a b.obj").expect("begins");
        draft.append(b"v 0 ").expect("writes");
        draft.append(b"0 0").expect("writes");
        draft.begin("empty").expect("begins");
        let bundle = draft.finish().expect("finishes");
        let file = bundle.file("../a b.obj").expect("is there");
        assert_eq!(bundle.read(file).expect("reads"), b"v 0 0 0");
        assert_eq!(file.sha256[..], Sha256::digest(b"v 0 0 0")[..]);
        assert_eq!((store.bytes(), entries(root.path())), (7, 1));
        drop(bundle);
        assert_eq!((store.bytes(), entries(root.path())), (0, 0));
    }

    #[test]
    fn an_abandoned_or_overfull_draft_leaves_nothing() {
        let root = tempfile::tempdir().expect("folder");
        let store = Store::open(root.path(), 10).expect("opens");
        let mut draft = store.draft().expect("draft");
        draft.begin("a").expect("begins");
        draft.append(&[0; 8]).expect("writes");
        assert!(draft.append(&[0; 3]).expect_err("refused").is_full());
        drop(draft);
        assert_eq!((store.bytes(), entries(root.path())), (0, 0));
    }

    #[test]
    fn a_folder_serves_one_process_and_forgets_the_last_one() {
        let root = tempfile::tempdir().expect("folder");
        let store = Store::open(root.path(), 10).expect("opens");
        let refused = Store::open(root.path(), 10).expect_err("in use");
        assert!(matches!(refused, StoreError::InUse { .. }), "{refused}");
        fs::write(root.path().join("incoming/left"), b"from a crash").expect("writes");
        drop(store);
        Store::open(root.path(), 10).expect("opens again");
        assert_eq!(entries(root.path()), 0);
    }
}
