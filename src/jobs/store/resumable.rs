//! Uploads in parts, as they are written down.
//!
//! An upload has one end, `received`; parts are added there and nowhere else, so that of two requests for the same bytes one wins. A
//! part is a blob that is in use while its upload is open. The last bytes come as the whole file, which becomes an asset in the
//! transaction that closes the upload.

use super::{BlobPlace, StoreFailure};
use crate::jobs::ids::UploadId;
use crate::jobs::resumable::{NewResumable, NotAdded, Resumable};
use crate::jobs::submission::Caller;
use crate::storage::NewBlob;
use async_trait::async_trait;
use std::time::Duration;

/// Where uploads in parts are written down. See the module.
#[async_trait]
pub trait ResumableStore: Send + Sync {
    /// Begins an upload that ends after `keep` unless something comes. `None`: the caller has as many as it may have.
    async fn begin_resumable(&self, new: &NewResumable, keep: Duration) -> Result<Option<Resumable>, StoreFailure>;

    async fn resumable(&self, caller: &Caller, id: UploadId) -> Result<Option<Resumable>, StoreFailure>;

    /// Adds parts, in order, at the end of an open upload if that is `offset`. The locations are those of blobs in use now.
    async fn add_parts(
        &self,
        caller: &Caller,
        id: UploadId,
        offset: u64,
        parts: &[NewBlob],
        keep: Duration,
    ) -> Result<Result<Vec<String>, NotAdded>, StoreFailure>;

    /// The parts before `offset`, in order. Whose upload it is was asked before.
    async fn resumable_parts(&self, id: UploadId, offset: u64) -> Result<Vec<BlobPlace>, StoreFailure>;

    /// Ends an open upload whose end is `offset` with an asset of `files`. The locations are those of blobs in use now.
    async fn complete_resumable(
        &self,
        caller: &Caller,
        id: UploadId,
        offset: u64,
        files: &[NewBlob],
        memory_bytes: u64,
        retention: Duration,
    ) -> Result<Result<Vec<String>, NotAdded>, StoreFailure>;

    /// `false`: there was none.
    async fn delete_resumable(&self, caller: &Caller, id: UploadId) -> Result<bool, StoreFailure>;
}
