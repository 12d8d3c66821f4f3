//! Batches, as far as they are kept here. What an item's request says is for its door to read, which feeds the queue.

use super::batch::{Batch, BatchItem, NewBatch, OpenBatch, PendingItem, Settled};
use super::ids::BatchId;
use super::looking::Denied;
use super::queue::Jobs;
use super::store::StoreFailure;
use super::submission::{Caller, Refusal};

impl Jobs {
    /// Writes a batch down, whole or not at all.
    pub async fn create_batch(&self, new: NewBatch) -> Result<BatchId, Refusal> {
        if self.core().is_draining() {
            return Err(Refusal::Draining);
        }
        let core = self.core().clone();
        Ok(self.core().detached(async move { core.jobs.create_batch(new).await }).await?)
    }

    pub async fn batch(&self, caller: &Caller, id: BatchId) -> Result<Option<Batch>, StoreFailure> {
        self.core().jobs.batch(caller, id).await
    }

    /// The caller's batches, newest first, older than `before`.
    pub async fn batches(
        &self,
        caller: &Caller,
        before: Option<BatchId>,
        count: usize,
    ) -> Result<Vec<Batch>, StoreFailure> {
        self.core().jobs.batches(caller, before, count).await
    }

    /// Items from `first` on, in order. Whose batch it is was asked before.
    pub async fn batch_items(&self, id: BatchId, first: usize, count: usize) -> Result<Vec<BatchItem>, StoreFailure> {
        self.core().jobs.batch_items(id, first, count).await
    }

    /// No further item becomes a job, and those that are jobs are canceled. `false`: there is no such batch.
    pub async fn cancel_batch(&self, caller: &Caller, id: BatchId) -> Result<bool, StoreFailure> {
        let Some(jobs) = self.core().jobs.cancel_batch(caller, id).await? else { return Ok(false) };
        for job in jobs {
            match self.cancel(caller, job).await {
                // Over or gone in the meantime is as good as canceled.
                Ok(_) | Err(Denied::NotFound | Denied::State(_)) => {}
                Err(Denied::Unavailable(error)) => return Err(error),
            }
        }
        self.conclude_batches().await?;
        Ok(true)
    }

    /// Batches that are not over, oldest first.
    pub async fn open_batches(&self) -> Result<Vec<OpenBatch>, StoreFailure> {
        self.core().jobs.open_batches().await
    }

    /// The first items of a batch that are no job yet.
    pub async fn pending_items(&self, id: BatchId, count: usize) -> Result<Vec<PendingItem>, StoreFailure> {
        self.core().jobs.pending_items(id, count).await
    }

    /// Says what became of a pending item; `false`: it is not pending any more.
    pub async fn settle_item(&self, id: BatchId, position: usize, settled: &Settled) -> Result<bool, StoreFailure> {
        self.core().jobs.settle_item(id, position, settled).await
    }

    /// Notes what jobs of batches have come to; gives the batches that are over now.
    pub async fn conclude_batches(&self) -> Result<Vec<BatchId>, StoreFailure> {
        self.core().jobs.conclude_batches().await
    }
}
