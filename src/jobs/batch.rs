//! Batches: many requests that are handed in together. Each becomes a job when the queue has room for it; one that cannot
//! become a job says why and holds up no other.

use super::ids::{AssetId, BatchId, JobId};
use super::job::JobState;
use super::submission::Caller;
use std::time::SystemTime;

/// Requests to be written down together.
#[derive(Clone, Debug)]
pub struct NewBatch {
    pub caller: Caller,
    /// Unfinished jobs that the caller may have.
    pub jobs_max: Option<usize>,
    /// In order.
    pub items: Vec<NewItem>,
}

#[derive(Clone, Debug)]
pub struct NewItem {
    /// The caller's name for it.
    pub custom_id: String,
    /// The request, as its door reads it.
    pub request: String,
    /// Kept as long as the item waits.
    pub asset: Option<AssetId>,
    /// Why it will never be a job.
    pub error: Option<String>,
}

/// A batch at one moment.
#[derive(Clone, Debug)]
pub struct Batch {
    pub id: BatchId,
    pub created_at: SystemTime,
    pub canceled_at: Option<SystemTime>,
    pub finished_at: Option<SystemTime>,
    pub counts: BatchCounts,
}

/// How many items are in which state; those that are no job yet are queued.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BatchCounts {
    pub queued: usize,
    pub running: usize,
    pub succeeded: usize,
    pub failed: usize,
    pub canceled: usize,
}

impl BatchCounts {
    pub fn add(&mut self, state: ItemState, count: usize) {
        *match state {
            ItemState::Pending | ItemState::Job(JobState::Queued) => &mut self.queued,
            ItemState::Job(JobState::Running) => &mut self.running,
            ItemState::Job(JobState::Succeeded | JobState::Expired) => &mut self.succeeded,
            ItemState::Job(JobState::Failed) => &mut self.failed,
            ItemState::Job(JobState::Canceled) => &mut self.canceled,
        } += count;
    }

    pub fn total(&self) -> usize {
        self.queued + self.running + self.succeeded + self.failed + self.canceled
    }
}

/// Where an item stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ItemState {
    /// No job yet.
    Pending,
    /// As its job, or as a job would have ended.
    Job(JobState),
}

/// One request of a batch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BatchItem {
    /// From 0.
    pub position: usize,
    pub custom_id: String,
    pub state: ItemState,
    pub job: Option<JobId>,
    /// Why it became no job, in the words of the door.
    pub error: Option<String>,
}

/// A batch that is not over, as whoever feeds the queue needs it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OpenBatch {
    pub id: BatchId,
    pub caller: Caller,
    pub jobs_max: Option<usize>,
}

/// An item that is no job yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PendingItem {
    pub position: usize,
    pub request: String,
}

/// What became of a pending item.
#[derive(Clone, Debug)]
pub enum Settled {
    Job(JobId),
    Refused(String),
}
