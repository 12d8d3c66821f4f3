//! An upload while it arrives. Dropped at any moment before the job is queued, it leaves nothing.

use super::job::FileInfo;
use super::queue::Core;
use crate::storage::{Bundle, Draft, StoreError};
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

    /// All files are here. `main` names the one to rig.
    pub fn finish(self, main: &str) -> Result<Received, StoreError> {
        Ok(Received { bundle: self.draft.finish()?, main: main.to_owned() })
    }
}

/// A complete upload.
pub struct Received {
    bundle: Bundle,
    main: String,
}

impl Received {
    pub(super) fn into_parts(self) -> (Vec<FileInfo>, Bundle) {
        let info = |name: &str, bytes, sha256| FileInfo { name: name.to_owned(), bytes, sha256 };
        let mut files: Vec<FileInfo> =
            self.bundle.files().iter().map(|file| info(&file.name, file.bytes, file.sha256)).collect();
        files.sort_by_key(|file| file.name != self.main);
        (files, self.bundle)
    }
}
