//! Assets, and the content of all that is kept.

use super::asset::{Asset, PutAsset};
use super::ids::AssetId;
use super::job::FileInfo;
use super::memory;
use super::perform::NamedFile;
use super::queue::{Jobs, keep, leave_in_doubt};
use super::store::StoreFailure;
use super::submission::{Caller, Missing, Refusal};
use super::upload::Received;
use crate::storage::Content;

impl Jobs {
    /// Files by their digests, read; the main one first.
    pub async fn load_files(&self, files: &[FileInfo], missing: Missing) -> Result<Vec<NamedFile>, Refusal> {
        let mut places = Vec::with_capacity(files.len());
        for file in files {
            let place = self.core().jobs.blob(&file.sha256).await?.ok_or(Refusal::NotFound(missing))?;
            places.push((file.name.clone(), place));
        }
        self.core().load(&places).await.map_err(Refusal::Store)
    }

    /// Keeps an upload as an asset of `caller`, or finds the one that it is. What it holds is looked at when somebody asks
    /// ([`Self::check_asset`]): a mesh that cannot be read is kept too, so that a batch can tell which of its items failed.
    pub async fn put_asset(&self, caller: &Caller, received: Received) -> Result<PutAsset, Refusal> {
        if self.core().is_draining() {
            return Err(Refusal::Draining);
        }
        let (core, caller) = (self.core().clone(), caller.clone());
        let memory_bytes = memory::expected_bytes(&received.files());
        let put = self.core().detached(async move {
            let (files, retention) = (received.blobs(), core.settings.keep_time);
            match core.jobs.put_asset(&caller, &files, memory_bytes, retention).await {
                Ok((asset, created, kept)) => {
                    keep([Some(received.bundle), None], &kept);
                    Ok(PutAsset { asset, created })
                }
                Err(error) => {
                    leave_in_doubt([Some(received.bundle), None]);
                    Err(error)
                }
            }
        });
        Ok(put.await?)
    }

    pub async fn asset(&self, caller: &Caller, id: AssetId) -> Result<Option<Asset>, StoreFailure> {
        self.core().jobs.asset(caller, id).await
    }

    /// `false`: there was none. Jobs that were made of it keep the files that they need.
    pub async fn delete_asset(&self, caller: &Caller, id: AssetId) -> Result<bool, StoreFailure> {
        let deleted = self.core().jobs.delete_asset(caller, id).await?;
        if deleted {
            self.core().collect_garbage().await?;
        }
        Ok(deleted)
    }

    /// The content of a file of an asset or a job, or of an artifact, while it is kept.
    pub async fn open(&self, sha256: &[u8; 32]) -> Result<Option<Content>, StoreFailure> {
        let place = self.core().jobs.blob(sha256).await?;
        Ok(place.map(|place| self.core().files.content(&place.location, place.bytes)))
    }
}
