//! Files while they arrive. Dropped at any moment before somebody keeps them, they leave nothing.

use super::{BLOBS, INCOMING, Store, StoreError, hex, io_error};
use sha2::{Digest, Sha256};
use std::fs::{self, File};
use std::io::Write;
use std::path::PathBuf;
use uuid::Uuid;

/// Files being written. The calls block.
#[derive(Debug)]
pub struct Draft {
    store: Store,
    files: Vec<Incoming>,
    open: Option<(File, Sha256)>,
}

/// A file of a draft. Dropped, it goes, with the room that it took, unless it is kept here.
#[derive(Debug)]
struct Incoming {
    store: Store,
    name: String,
    path: PathBuf,
    bytes: u64,
    sha256: [u8; 32],
    /// Where a copy is in the bucket, or may be.
    copy: Option<String>,
    kept: bool,
}

impl Drop for Incoming {
    fn drop(&mut self) {
        if self.kept && !self.store.is_shared() {
            return;
        }
        if let (Some(bucket), Some(copy), false) = (&self.store.0.bucket, &self.copy, self.kept) {
            bucket.forget(copy);
        }
        if let Err(error) = fs::remove_file(&self.path) {
            tracing::warn!(path = %self.path.display(), %error, "a file could not be removed");
        }
        self.store.give_back(self.bytes);
    }
}

impl Incoming {
    /// Puts the file where its blob is looked for.
    fn settle(&mut self, location: &str) -> Result<(), StoreError> {
        let Some(bucket) = &self.store.0.bucket else {
            let path = self.store.root().join(location);
            fs::rename(&self.path, &path).map_err(io_error("renaming", &self.path))?;
            self.path = path;
            return Ok(());
        };
        self.copy = Some(location.to_owned());
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        bucket.upload(self.store.0.local.clone(), format!("{INCOMING}/{name}"), location)
    }
}

impl Store {
    /// Begins to receive files.
    pub fn draft(&self) -> Draft {
        Draft { store: self.clone(), files: Vec::new(), open: None }
    }
}

impl Draft {
    /// Begins the next file.
    pub fn begin(&mut self, name: &str) -> Result<(), StoreError> {
        self.seal()?;
        let path = self.store.root().join(INCOMING).join(Uuid::now_v7().simple().to_string());
        let file = File::create_new(&path).map_err(io_error("making", &path))?;
        self.open = Some((file, Sha256::new()));
        let (store, name) = (self.store.clone(), name.to_owned());
        self.files.push(Incoming { store, name, path, bytes: 0, sha256: [0; 32], copy: None, kept: false });
        Ok(())
    }

    /// Adds to the file begun last; nothing when none was begun.
    pub fn append(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        let (Some((file, digest)), Some(stored)) = (&mut self.open, self.files.last_mut()) else {
            return Ok(());
        };
        self.store.claim(bytes.len() as u64)?;
        // Counted from here on, so that dropping the draft gives the room back whatever happens.
        stored.bytes += bytes.len() as u64;
        file.write_all(bytes).map_err(io_error("writing", &stored.path))?;
        digest.update(bytes);
        Ok(())
    }

    /// Makes every file a blob: its bytes are on the disk, or in the bucket, and it has its final name.
    pub fn finish(mut self) -> Result<Bundle, StoreError> {
        self.seal()?;
        let mut files = Vec::with_capacity(self.files.len());
        for incoming in &mut self.files {
            let location = format!("{BLOBS}/{}-{}", hex(&incoming.sha256), Uuid::now_v7().simple());
            incoming.settle(&location)?;
            let Incoming { name, bytes, sha256, .. } = &*incoming;
            files.push(NewBlob { name: name.clone(), bytes: *bytes, sha256: *sha256, location });
        }
        if !self.store.is_shared() {
            // The renames are on the disk once the folder is.
            let blobs = self.store.root().join(BLOBS);
            File::open(&blobs).and_then(|folder| folder.sync_all()).map_err(io_error("writing", &blobs))?;
        }
        Ok(Bundle { files, incoming: std::mem::take(&mut self.files) })
    }

    /// Closes the file begun last, its bytes on the disk.
    fn seal(&mut self) -> Result<(), StoreError> {
        if let (Some((file, digest)), Some(stored)) = (self.open.take(), self.files.last_mut()) {
            file.sync_all().map_err(io_error("writing", &stored.path))?;
            stored.sha256 = digest.finalize().into();
        }
        Ok(())
    }
}

/// Complete files that nobody has kept yet: those that are not kept go with this value.
#[derive(Debug)]
pub struct Bundle {
    files: Vec<NewBlob>,
    incoming: Vec<Incoming>,
}

/// A complete file, on its way to be named by the database.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewBlob {
    /// As the sender named it.
    pub name: String,
    pub bytes: u64,
    pub sha256: [u8; 32],
    pub location: String,
}

impl Bundle {
    /// In the order in which they were written.
    pub fn files(&self) -> &[NewBlob] {
        &self.files
    }

    /// The database names this blob now.
    pub fn keep(&mut self, location: &str) {
        for (file, incoming) in self.files.iter().zip(&mut self.incoming) {
            if file.location == location {
                incoming.kept = true;
            }
        }
    }

    /// The answer of a shared database was lost, so that it may name these files or not: they stay, and what is not
    /// named goes with the next sweep. A database of one process has not named what it refused.
    pub fn leave_in_doubt(&mut self) {
        for incoming in &mut self.incoming {
            incoming.kept |= incoming.store.is_shared();
        }
    }

    /// Reads a file while it is surely there. Blocks.
    pub fn read(&self, file: &NewBlob) -> Result<Vec<u8>, StoreError> {
        let at = self.files.iter().zip(&self.incoming).find(|(known, _)| known.location == file.location);
        let (_, incoming) = at.ok_or(StoreError::Interrupted)?;
        fs::read(&incoming.path).map_err(io_error("reading", &incoming.path))
    }
}
