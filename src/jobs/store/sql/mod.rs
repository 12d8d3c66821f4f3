//! The job store in SQL: its statements are the same for every engine, which brings connections, locks and news.

mod admission;
mod batches;
mod deliveries;
mod ending;
mod endpoints;
mod messages;
mod reading;
mod resumable;
mod reuse;
mod rows;
mod statement;
mod upkeep;
mod webhooks;
mod work;

pub(super) use statement::{Columns, Connection, Lock, Statement, Value, engine_connection, sql};

use super::{
    Admission, BlobPlace, Change, Claim, Counts, Duty, Ending, Finish, JobFilter, JobStore, Lease, LeaseState, Memory,
    NewJob, News, Remembered, StoreFailure, Swept, codec,
};
use crate::jobs::asset::Asset;
use crate::jobs::batch::{Batch, BatchItem, NewBatch, OpenBatch, PendingItem, Settled};
use crate::jobs::clock::Timestamp;
use crate::jobs::event::{Event, EventKind};
use crate::jobs::ids::{AssetId, BatchId, JobId};
use crate::jobs::job::{Job, JobState};
use crate::jobs::stage::Stage;
use crate::jobs::submission::Caller;
use crate::storage::NewBlob;
use async_trait::async_trait;
use std::collections::BTreeSet;
use std::ops::DerefMut;
use std::time::Duration;
use tokio::sync::broadcast;

/// What an engine brings.
pub trait Engine: Send + Sync + 'static {
    type Connection: Connection;
    type Reading: DerefMut<Target = Self::Connection> + Send;
    /// A transaction; dropped, it is undone.
    type Writing: DerefMut<Target = Self::Connection> + Send;

    fn now(&self) -> Timestamp;

    /// How long a lease lasts.
    fn lease(&self) -> Duration;

    fn read(&self) -> impl Future<Output = Result<Self::Reading, StoreFailure>> + Send;

    fn write(&self) -> impl Future<Output = Result<Self::Writing, StoreFailure>> + Send;

    /// What was written is on the disk when this returns.
    fn commit(&self, writing: Self::Writing) -> impl Future<Output = Result<(), StoreFailure>> + Send;

    /// Tells other processes what was just committed. A hint, which may get lost.
    fn tell(&self, news: News);

    /// What other processes tell; `None`: there are none.
    fn news(&self) -> Option<broadcast::Receiver<News>>;

    fn close(&self) -> impl Future<Output = ()> + Send;
}

/// The store on an engine. See [`super`] for its rules.
pub struct SqlStore<E>(pub(super) E);

impl From<sqlx::Error> for StoreFailure {
    fn from(error: sqlx::Error) -> Self {
        Self::new(&error)
    }
}

/// The engines have signed integers alone.
fn int(value: u64) -> i64 {
    i64::try_from(value).unwrap_or(i64::MAX)
}

fn millis(time: Duration) -> i64 {
    i64::try_from(time.as_millis()).unwrap_or(i64::MAX)
}

impl<E: Engine> SqlStore<E> {
    fn tell_swept(&self, swept: &Swept) {
        swept.changed.iter().for_each(|id| self.0.tell(News::Job(*id)));
        if swept.requeued > 0 {
            self.0.tell(News::Queued);
        }
    }
}

#[async_trait]
impl<E: Engine> JobStore for SqlStore<E> {
    async fn submit(&self, new: NewJob) -> Result<Admission, StoreFailure> {
        let mut writing = self.0.write().await?;
        let admission = admission::submit(&mut *writing, &new, self.0.now()).await?;
        self.0.commit(writing).await?;
        if let Admission::Admitted { job, .. } = &admission
            && job.state == JobState::Queued
        {
            self.0.tell(News::Queued);
        }
        Ok(admission)
    }

    async fn claim(&self, worker: &str, memory_free: u64) -> Result<Option<Claim>, StoreFailure> {
        // Looking costs a writer nothing, and most looks find nothing.
        if !reading::any_waits(&mut *self.0.read().await?).await? {
            return Ok(None);
        }
        let mut writing = self.0.write().await?;
        let now = self.0.now();
        let claim = work::claim(&mut *writing, worker, memory_free, now, now.after(self.0.lease())).await?;
        self.0.commit(writing).await?;
        if let Some(claim) = &claim {
            self.0.tell(News::Job(claim.lease.job));
        }
        Ok(claim)
    }

    async fn extend(&self, leases: &[Lease]) -> Result<Vec<LeaseState>, StoreFailure> {
        let mut writing = self.0.write().await?;
        let until = self.0.now().after(self.0.lease());
        let states = work::extend(&mut *writing, leases, until).await?;
        self.0.commit(writing).await?;
        Ok(states)
    }

    async fn look_at(&self, leases: &[Lease]) -> Result<Vec<LeaseState>, StoreFailure> {
        work::look_at(&mut *self.0.read().await?, leases).await
    }

    async fn advance(&self, lease: Lease, stage: Stage) -> Result<bool, StoreFailure> {
        let mut writing = self.0.write().await?;
        let held = work::advance(&mut *writing, lease, stage, self.0.now()).await?;
        self.0.commit(writing).await?;
        self.0.tell(News::Job(lease.job));
        Ok(held)
    }

    async fn finish(&self, lease: Lease, ending: Ending) -> Result<Finish, StoreFailure> {
        let mut writing = self.0.write().await?;
        let finish = ending::finish(&mut *writing, lease, &ending, self.0.now()).await?;
        self.0.commit(writing).await?;
        self.0.tell(News::Job(lease.job));
        Ok(finish)
    }

    async fn give_back(&self, lease: Lease) -> Result<bool, StoreFailure> {
        let mut writing = self.0.write().await?;
        let held = work::give_back(&mut *writing, lease, self.0.now()).await?;
        self.0.commit(writing).await?;
        if held {
            self.0.tell(News::Job(lease.job));
            self.0.tell(News::Queued);
        }
        Ok(held)
    }

    async fn lose_all(&self) -> Result<Swept, StoreFailure> {
        let mut writing = self.0.write().await?;
        let mut swept = Swept::default();
        upkeep::lose(&mut *writing, Timestamp(i64::MAX), self.0.now(), &mut swept).await?;
        reuse::forget_unanswered(&mut *writing).await?;
        deliveries::lose_all(&mut *writing).await?;
        self.0.commit(writing).await?;
        self.tell_swept(&swept);
        Ok(swept)
    }

    async fn sweep(&self, memory: Memory) -> Result<Swept, StoreFailure> {
        let now = self.0.now();
        if !upkeep::anything_due(&mut *self.0.read().await?, memory, now).await? {
            return Ok(Swept::default());
        }
        let mut writing = self.0.write().await?;
        let swept = upkeep::sweep(&mut *writing, memory, now).await?;
        self.0.commit(writing).await?;
        self.tell_swept(&swept);
        Ok(swept)
    }

    async fn expire_oldest(&self) -> Result<bool, StoreFailure> {
        let mut writing = self.0.write().await?;
        let expired = upkeep::expire_oldest(&mut *writing).await?;
        self.0.commit(writing).await?;
        Ok(expired)
    }

    async fn cancel(&self, caller: &Caller, id: JobId) -> Result<Change, StoreFailure> {
        let mut writing = self.0.write().await?;
        let change = ending::cancel(&mut *writing, caller, id, self.0.now()).await?;
        self.0.commit(writing).await?;
        self.0.tell(if change == Change::Requested { News::Stop(id) } else { News::Job(id) });
        Ok(change)
    }

    async fn delete(&self, caller: &Caller, id: JobId) -> Result<Change, StoreFailure> {
        let mut writing = self.0.write().await?;
        let change = ending::delete(&mut *writing, caller, id).await?;
        self.0.commit(writing).await?;
        self.0.tell(News::Job(id));
        Ok(change)
    }

    async fn job(&self, caller: &Caller, id: JobId) -> Result<Option<Job>, StoreFailure> {
        reading::job(&mut *self.0.read().await?, caller, id).await
    }

    async fn job_by_client_id(&self, caller: &Caller, client_id: &str) -> Result<Option<Job>, StoreFailure> {
        reading::job_by_client_id(&mut *self.0.read().await?, caller, client_id).await
    }

    async fn list(
        &self,
        caller: &Caller,
        filter: &JobFilter,
        before: Option<JobId>,
        count: usize,
    ) -> Result<Vec<Job>, StoreFailure> {
        reading::list(&mut *self.0.read().await?, caller, filter, before, count).await
    }

    async fn events(&self, id: JobId, after: u64, count: usize) -> Result<Vec<Event>, StoreFailure> {
        reading::events(&mut *self.0.read().await?, id, after, count).await
    }

    async fn counts(&self) -> Result<Counts, StoreFailure> {
        reading::counts(&mut *self.0.read().await?).await
    }

    async fn put_asset(
        &self,
        caller: &Caller,
        files: &[NewBlob],
        memory_bytes: u64,
        retention: Duration,
    ) -> Result<(Asset, bool, Vec<String>), StoreFailure> {
        let mut writing = self.0.write().await?;
        writing.lock(Lock::Naming).await?;
        let now = self.0.now();
        let upload = admission::UploadToKeep { files, memory_bytes, explicit: true };
        let put = admission::keep_files(&mut *writing, caller, upload, now, now.after(retention)).await?;
        self.0.commit(writing).await?;
        Ok((put.asset, put.created, put.kept))
    }

    async fn asset(&self, caller: &Caller, id: AssetId) -> Result<Option<Asset>, StoreFailure> {
        let mut reading = self.0.read().await?;
        Ok(admission::asset(&mut *reading, caller, id).await?.map(|(asset, _)| asset))
    }

    async fn delete_asset(&self, caller: &Caller, id: AssetId) -> Result<bool, StoreFailure> {
        let mut writing = self.0.write().await?;
        let deleted = sql("DELETE FROM assets WHERE id = $1 AND caller = $2")
            .bind(id.to_bytes())
            .bind(caller.name())
            .execute(&mut *writing)
            .await?;
        self.0.commit(writing).await?;
        Ok(deleted > 0)
    }

    async fn blob(&self, sha256: &[u8; 32]) -> Result<Option<BlobPlace>, StoreFailure> {
        let mut reading = self.0.read().await?;
        rows::blob(&mut *reading, sha256).await
    }

    async fn collect(&self) -> Result<Vec<BlobPlace>, StoreFailure> {
        let mut writing = self.0.write().await?;
        let forgotten = upkeep::collect(&mut *writing).await?;
        self.0.commit(writing).await?;
        Ok(forgotten)
    }

    async fn locations(&self) -> Result<BTreeSet<String>, StoreFailure> {
        let rows = sql("SELECT location FROM blobs").all(&mut *self.0.read().await?).await?;
        rows.iter().map(|row| row.get("location")).collect()
    }

    async fn create_batch(&self, new: NewBatch) -> Result<BatchId, StoreFailure> {
        let mut writing = self.0.write().await?;
        let id = batches::create(&mut *writing, &new, self.0.now()).await?;
        self.0.commit(writing).await?;
        Ok(id)
    }

    async fn batch(&self, caller: &Caller, id: BatchId) -> Result<Option<Batch>, StoreFailure> {
        batches::batch(&mut *self.0.read().await?, caller, id).await
    }

    async fn batches(
        &self,
        caller: &Caller,
        before: Option<BatchId>,
        count: usize,
    ) -> Result<Vec<Batch>, StoreFailure> {
        batches::list(&mut *self.0.read().await?, caller, before, count).await
    }

    async fn batch_items(&self, id: BatchId, first: usize, count: usize) -> Result<Vec<BatchItem>, StoreFailure> {
        batches::items(&mut *self.0.read().await?, id, first, count).await
    }

    async fn open_batches(&self) -> Result<Vec<OpenBatch>, StoreFailure> {
        batches::open(&mut *self.0.read().await?).await
    }

    async fn pending_items(&self, id: BatchId, count: usize) -> Result<Vec<PendingItem>, StoreFailure> {
        batches::pending(&mut *self.0.read().await?, id, count).await
    }

    async fn settle_item(&self, id: BatchId, position: usize, settled: &Settled) -> Result<bool, StoreFailure> {
        let mut writing = self.0.write().await?;
        let changed = batches::settle(&mut *writing, id, position, settled).await?;
        self.0.commit(writing).await?;
        Ok(changed)
    }

    async fn cancel_batch(&self, caller: &Caller, id: BatchId) -> Result<Option<Vec<JobId>>, StoreFailure> {
        let mut writing = self.0.write().await?;
        let jobs = batches::cancel(&mut *writing, caller, id, self.0.now()).await?;
        self.0.commit(writing).await?;
        Ok(jobs)
    }

    async fn conclude_batches(&self) -> Result<Vec<BatchId>, StoreFailure> {
        let mut writing = self.0.write().await?;
        let over = batches::conclude(&mut *writing, self.0.now()).await?;
        self.0.commit(writing).await?;
        Ok(over)
    }

    async fn recall(&self, caller: &Caller, key: &str, fingerprint: &[u8; 32]) -> Result<Remembered, StoreFailure> {
        let mut writing = self.0.write().await?;
        let remembered = reuse::recall(&mut *writing, caller, key, fingerprint, self.0.now()).await?;
        self.0.commit(writing).await?;
        Ok(remembered)
    }

    async fn remember(&self, caller: &Caller, key: &str, answer: Option<&[u8]>) -> Result<(), StoreFailure> {
        let mut writing = self.0.write().await?;
        reuse::remember(&mut *writing, caller, key, answer, self.0.now()).await?;
        self.0.commit(writing).await
    }

    async fn take_turn(&self, duty: Duty, every: Duration) -> Result<bool, StoreFailure> {
        let mut writing = self.0.write().await?;
        let taken = upkeep::take_turn(&mut *writing, duty, every, self.0.now()).await?;
        self.0.commit(writing).await?;
        Ok(taken)
    }

    fn news(&self) -> Option<broadcast::Receiver<News>> {
        self.0.news()
    }

    async fn close(&self) {
        self.0.close().await;
    }
}

/// Appends to a job's history: each event gets the next number. Whoever wants to be told of it will be.
async fn append(
    connection: &mut impl Connection,
    id: JobId,
    now: Timestamp,
    kinds: &[EventKind],
) -> Result<(), StoreFailure> {
    let last = sql("UPDATE jobs SET sequence = sequence + $1 WHERE id = $2 RETURNING sequence")
        .bind(int(kinds.len() as u64))
        .bind(id.to_bytes())
        .one(connection)
        .await?;
    let first = last.get::<i64>("sequence")? - int(kinds.len() as u64) + 1;
    for (sequence, kind) in (first..).zip(kinds) {
        sql("INSERT INTO events (job, sequence, at, body) VALUES ($1, $2, $3, $4)")
            .bind(id.to_bytes())
            .bind(sequence)
            .bind(now.0)
            .bind(codec::event(kind).to_string())
            .execute(connection)
            .await?;
    }
    messages::of_job(connection, id, kinds, now).await
}
