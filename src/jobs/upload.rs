//! An upload while it arrives. Dropped at any moment before it belongs to a job or an asset, it leaves nothing.

use super::core::Core;
use super::job::FileInfo;
use crate::storage::{Bundle, Draft, StoreError, hex};
use sha2::{Digest, Sha256};
use std::sync::Arc;

/// Files being received. Writes block: call from a thread that may.
pub struct Upload {
    core: Arc<Core>,
    draft: Draft,
}

impl Upload {
    pub(super) fn new(core: Arc<Core>, draft: Draft) -> Self {
        Self { core, draft }
    }

    /// Begins the next file.
    pub fn begin(&mut self, name: &str) -> Result<(), StoreError> {
        self.draft.begin(name)
    }

    /// Adds to the file begun last. When there is no room, the oldest results go.
    pub fn append(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        let Self { core, draft } = self;
        core.making_room(|| draft.append(bytes))
    }

    /// All files are here, and on the disk. `main` names the one to rig.
    pub fn finish(self, main: &str) -> Result<Received, StoreError> {
        Ok(Received { bundle: self.draft.finish()?, main: main.to_owned() })
    }
}

/// A complete upload.
#[derive(Debug)]
pub struct Received {
    pub(super) bundle: Bundle,
    main: String,
}

impl Received {
    /// The main file first.
    pub fn files(&self) -> Vec<FileInfo> {
        let info = |file: &crate::storage::NewBlob| FileInfo {
            name: file.name.clone(),
            bytes: file.bytes,
            sha256: file.sha256,
        };
        self.blobs().iter().map(info).collect()
    }

    /// All files together.
    pub fn bytes(&self) -> u64 {
        self.bundle.files().iter().map(|file| file.bytes).sum()
    }

    pub(super) fn blobs(&self) -> Vec<crate::storage::NewBlob> {
        let mut blobs = self.bundle.files().to_vec();
        blobs.sort_by_key(|file| file.name != self.main);
        blobs
    }
}

/// What makes two uploads the same: the bytes of every file, the names of those that the main file refers to, and the
/// extension of the main file, which helps to tell its format.
pub(super) fn identity<'a>(files: impl Iterator<Item = (&'a str, &'a [u8; 32])>) -> [u8; 32] {
    let mut digest = Sha256::new();
    for (index, (name, sha256)) in files.enumerate() {
        let extension = || name.rsplit_once('.').map(|(_, extension)| extension.to_lowercase());
        let name = if index == 0 { extension().unwrap_or_default() } else { name.to_owned() };
        digest.update(format!("{}  {name}\n", hex(sha256)));
    }
    digest.finalize().into()
}

/// The digest that callers see: of the file when there is one, of the list of digests and names when there are several.
pub fn asset_sha256(files: &[FileInfo]) -> [u8; 32] {
    if let [file] = files {
        return file.sha256;
    }
    let mut digest = Sha256::new();
    for file in files {
        digest.update(format!("{}  {}\n", hex(&file.sha256), file.name));
    }
    digest.finalize().into()
}
