//! Receiving uploads in parts. Each part is a blob, so that any process that shares the storage may take the next one.

use super::ids::UploadId;
use super::memory;
use super::queue::{Jobs, keep, leave_in_doubt};
use super::resumable::{NewResumable, NotAdded, Resumable};
use super::store::StoreFailure;
use super::submission::{Caller, Refusal};
use super::upload::{Received, Upload};
use crate::storage::{NewBlob, StoreError};

impl Jobs {
    /// Begins an upload in parts. `None`: the caller has as many open ones as it may have.
    pub async fn begin_resumable(&self, new: NewResumable) -> Result<Option<Resumable>, Refusal> {
        if self.core().is_draining() {
            return Err(Refusal::Draining);
        }
        let core = self.core().clone();
        let begun = async move { core.jobs.begin_resumable(&new, core.settings.keep_time).await };
        Ok(self.core().detached(begun).await?)
    }

    pub async fn resumable(&self, caller: &Caller, id: UploadId) -> Result<Option<Resumable>, StoreFailure> {
        self.core().jobs.resumable(caller, id).await
    }

    /// `false`: there was none. The asset of a complete one stays.
    pub async fn delete_resumable(&self, caller: &Caller, id: UploadId) -> Result<bool, StoreFailure> {
        let deleted = self.core().jobs.delete_resumable(caller, id).await?;
        if deleted {
            self.core().collect_garbage().await?;
        }
        Ok(deleted)
    }

    /// Adds what begins at byte `offset` of `upload`, all of it or nothing. The last bytes make it an asset.
    pub async fn add_to_resumable(
        &self,
        caller: &Caller,
        upload: &Resumable,
        offset: u64,
        parts: Vec<Received>,
    ) -> Result<Result<(), NotAdded>, Refusal> {
        if self.core().is_draining() {
            return Err(Refusal::Draining);
        }
        let bytes: u64 = parts.iter().map(Received::bytes).sum();
        if offset.saturating_add(bytes) < upload.length {
            Ok(self.add_parts(caller, upload.id, offset, parts).await?)
        } else {
            self.complete(caller, upload, offset, parts).await
        }
    }

    async fn add_parts(
        &self,
        caller: &Caller,
        id: UploadId,
        offset: u64,
        parts: Vec<Received>,
    ) -> Result<Result<(), NotAdded>, StoreFailure> {
        let (core, caller) = (self.core().clone(), caller.clone());
        let added = async move {
            let files: Vec<NewBlob> = parts.iter().flat_map(Received::blobs).collect();
            let bundles = parts.into_iter().map(|part| Some(part.bundle));
            match core.jobs.add_parts(&caller, id, offset, &files, core.settings.keep_time).await {
                Ok(Ok(kept)) => {
                    keep(bundles, &kept);
                    Ok(Ok(()))
                }
                Ok(Err(not_added)) => Ok(Err(not_added)),
                Err(error) => {
                    leave_in_doubt(bundles);
                    Err(error)
                }
            }
        };
        self.core().detached(added).await
    }

    async fn complete(
        &self,
        caller: &Caller,
        upload: &Resumable,
        offset: u64,
        last: Vec<Received>,
    ) -> Result<Result<(), NotAdded>, Refusal> {
        let whole = match self.assemble(upload, offset, last).await {
            // Somebody else completed it, and its parts went.
            Err(Refusal::Store(error)) if error.is_missing() => return Ok(Err(NotAdded::Elsewhere)),
            whole => whole?,
        };
        let (core, caller, id) = (self.core().clone(), caller.clone(), upload.id);
        let completed = async move {
            let (files, retention) = (whole.blobs(), core.settings.keep_time);
            let memory_bytes = memory::expected_bytes(&whole.files());
            match core.jobs.complete_resumable(&caller, id, offset, &files, memory_bytes, retention).await {
                Ok(Ok(kept)) => {
                    keep([Some(whole.bundle)], &kept);
                    core.collect_garbage().await?;
                    Ok(Ok(()))
                }
                Ok(Err(not_added)) => Ok(Err(not_added)),
                Err(error) => {
                    leave_in_doubt([Some(whole.bundle)]);
                    Err(error)
                }
            }
        };
        Ok(self.core().detached(completed).await?)
    }

    /// The parts that are kept, those before `offset`, and `last` after them, as one file.
    async fn assemble(&self, upload: &Resumable, offset: u64, last: Vec<Received>) -> Result<Received, Refusal> {
        let name = upload.file_name.clone();
        let mut whole = self.upload().map_err(Refusal::Store)?;
        whole = written(whole, move |whole| whole.begin(&name)).await?;
        for part in self.core().jobs.resumable_parts(upload.id, offset).await? {
            let bytes = self.core().files.content(&part.location, part.bytes).read().await.map_err(Refusal::Store)?;
            whole = written(whole, move |whole| whole.append(&bytes)).await?;
        }
        whole = written(whole, move |whole| {
            let mut files = last.iter().flat_map(|part| part.bundle.files().iter().map(|file| (&part.bundle, file)));
            files.try_for_each(|(bundle, file)| whole.append(&bundle.read(file)?))
        })
        .await?;
        let name = upload.file_name.clone();
        let finished = tokio::task::spawn_blocking(move || whole.finish(&name)).await;
        finished.unwrap_or(Err(StoreError::Interrupted)).map_err(Refusal::Store)
    }
}

/// `upload` after a write that may block.
async fn written(
    mut upload: Upload,
    write: impl FnOnce(&mut Upload) -> Result<(), StoreError> + Send + 'static,
) -> Result<Upload, Refusal> {
    let written = tokio::task::spawn_blocking(move || write(&mut upload).map(|()| upload)).await;
    written.unwrap_or(Err(StoreError::Interrupted)).map_err(Refusal::Store)
}
