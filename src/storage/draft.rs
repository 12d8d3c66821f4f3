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

/// A file of a draft. Dropped, it goes, with the room that it took.
#[derive(Debug)]
struct Incoming {
    store: Store,
    name: String,
    path: PathBuf,
    bytes: u64,
    sha256: [u8; 32],
    kept: bool,
}

impl Drop for Incoming {
    fn drop(&mut self) {
        if self.kept {
            return;
        }
        if let Err(error) = fs::remove_file(&self.path) {
            tracing::warn!(path = %self.path.display(), %error, "a file could not be removed");
        }
        self.store.give_back(self.bytes);
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
        self.files.push(Incoming { store, name, path, bytes: 0, sha256: [0; 32], kept: false });
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

    /// Makes every file a blob: its bytes are on the disk and it has its final name.
    pub fn finish(mut self) -> Result<Bundle, StoreError> {
        self.seal()?;
        let blobs = self.store.root().join(BLOBS);
        let mut files = Vec::with_capacity(self.files.len());
        for incoming in &mut self.files {
            let location = format!("{BLOBS}/{}-{}", hex(&incoming.sha256), Uuid::now_v7().simple());
            let path = self.store.root().join(&location);
            fs::rename(&incoming.path, &path).map_err(io_error("renaming", &incoming.path))?;
            incoming.path = path;
            let Incoming { name, bytes, sha256, .. } = &*incoming;
            files.push(NewBlob { name: name.clone(), bytes: *bytes, sha256: *sha256, location });
        }
        // The renames are on the disk once the folder is.
        File::open(&blobs).and_then(|folder| folder.sync_all()).map_err(io_error("writing", &blobs))?;
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

    /// Reads a file while it is surely there. Blocks.
    pub fn read(&self, file: &NewBlob) -> Result<Vec<u8>, StoreError> {
        let at = self.files.iter().zip(&self.incoming).find(|(known, _)| known.location == file.location);
        let (_, incoming) = at.ok_or(StoreError::Interrupted)?;
        fs::read(&incoming.path).map_err(io_error("reading", &incoming.path))
    }
}
