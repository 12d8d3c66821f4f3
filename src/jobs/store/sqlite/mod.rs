//! Jobs in one SQLite file: the engine of a service that is one process.
//!
//! Everything that changes goes through one connection, whole transactions at a time, and is on the disk before the
//! call returns (`synchronous = FULL`); readers have connections of their own and never wait for a writer (WAL).

mod admission;
mod ending;
mod reading;
mod reuse;
mod rows;
mod upkeep;
mod work;

use super::{
    Admission, BlobPlace, Change, Claim, Counts, Ending, Finish, JobFilter, JobStore, Lease, LeaseState, Memory,
    NewJob, Remembered, StoreFailure, Swept,
};
use crate::jobs::asset::Asset;
use crate::jobs::clock::{Clock, Timestamp};
use crate::jobs::event::Event;
use crate::jobs::ids::{AssetId, JobId};
use crate::jobs::job::Job;
use crate::jobs::stage::Stage;
use crate::jobs::submission::Caller;
use crate::storage::NewBlob;
use async_trait::async_trait;
use sqlx::migrate::Migrator;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{Connection, Sqlite, SqliteConnection, Transaction};
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// The schema, from nothing to the newest version.
pub static MIGRATOR: Migrator = sqlx::migrate!("src/jobs/migrations/sqlite");

/// Connections that look while one writes.
const READERS: u32 = 4;
/// How long a connection waits for another process that writes.
const BUSY_TIME: Duration = Duration::from_secs(5);
/// How long a caller waits for a connection before it is told that the store does not answer.
const ACQUIRE_TIME: Duration = Duration::from_secs(10);

/// The store. See the module.
pub struct SqliteStore {
    writer: SqlitePool,
    readers: SqlitePool,
    clock: Arc<dyn Clock>,
    lease: Duration,
}

impl From<sqlx::Error> for StoreFailure {
    fn from(error: sqlx::Error) -> Self {
        Self::new(&error)
    }
}

impl SqliteStore {
    /// Opens the file at `path`, making it when it is missing, and brings its schema up to date.
    pub async fn open(path: &Path, clock: Arc<dyn Clock>, lease: Duration) -> Result<Self, StoreFailure> {
        let options = SqliteConnectOptions::new()
            .filename(path)
            .create_if_missing(true)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .foreign_keys(true)
            .busy_timeout(BUSY_TIME);
        let pool = |connections| {
            SqlitePoolOptions::new().max_connections(connections).acquire_timeout(ACQUIRE_TIME).idle_timeout(None)
        };
        // A commit that failed, as on a full disk, leaves the connection with a transaction that neither it nor SQLite can
        // end any more: such a connection is closed, and the next writer gets a new one.
        let writer = pool(1).max_lifetime(None).after_release(|connection, _| {
            Box::pin(async move {
                // Waits for a rollback that is under way.
                connection.ping().await?;
                Ok(!connection.is_in_transaction())
            })
        });
        let writer = writer.connect_with(options.clone()).await?;
        MIGRATOR.run(&writer).await.map_err(|error| StoreFailure::new(&error))?;
        let readers = pool(READERS).max_lifetime(None).connect_with(options).await?;
        Ok(Self { writer, readers, clock, lease })
    }

    fn now(&self) -> Timestamp {
        self.clock.now()
    }

    async fn begin(&self) -> Result<Transaction<'static, Sqlite>, StoreFailure> {
        Ok(self.writer.begin_with("BEGIN IMMEDIATE").await?)
    }
}

/// SQLite has signed integers alone.
fn int(value: u64) -> i64 {
    i64::try_from(value).unwrap_or(i64::MAX)
}

fn millis(time: Duration) -> i64 {
    i64::try_from(time.as_millis()).unwrap_or(i64::MAX)
}

#[async_trait]
impl JobStore for SqliteStore {
    async fn submit(&self, new: NewJob) -> Result<Admission, StoreFailure> {
        let mut transaction = self.begin().await?;
        let admission = admission::submit(&mut transaction, &new, self.now()).await?;
        transaction.commit().await?;
        Ok(admission)
    }

    async fn claim(&self, worker: &str, memory_free: u64) -> Result<Option<Claim>, StoreFailure> {
        // Looking costs a writer nothing, and most looks find nothing.
        if reading::counts(&self.readers).await?.queued == 0 {
            return Ok(None);
        }
        let mut transaction = self.begin().await?;
        let now = self.now();
        let claim = work::claim(&mut transaction, worker, memory_free, now, now.after(self.lease)).await?;
        transaction.commit().await?;
        Ok(claim)
    }

    async fn extend(&self, leases: &[Lease]) -> Result<Vec<LeaseState>, StoreFailure> {
        let mut transaction = self.begin().await?;
        let until = self.now().after(self.lease);
        let states = work::extend(&mut transaction, leases, until).await?;
        transaction.commit().await?;
        Ok(states)
    }

    async fn look_at(&self, leases: &[Lease]) -> Result<Vec<LeaseState>, StoreFailure> {
        work::look_at(&self.readers, leases).await
    }

    async fn advance(&self, lease: Lease, stage: Stage) -> Result<bool, StoreFailure> {
        let mut transaction = self.begin().await?;
        let held = work::advance(&mut transaction, lease, stage, self.now()).await?;
        transaction.commit().await?;
        Ok(held)
    }

    async fn finish(&self, lease: Lease, ending: Ending) -> Result<Finish, StoreFailure> {
        let mut transaction = self.begin().await?;
        let finish = ending::finish(&mut transaction, lease, &ending, self.now()).await?;
        transaction.commit().await?;
        Ok(finish)
    }

    async fn give_back(&self, lease: Lease) -> Result<bool, StoreFailure> {
        let mut transaction = self.begin().await?;
        let held = work::give_back(&mut transaction, lease, self.now()).await?;
        transaction.commit().await?;
        Ok(held)
    }

    async fn lose_all(&self) -> Result<Swept, StoreFailure> {
        let mut transaction = self.begin().await?;
        let mut swept = Swept::default();
        upkeep::lose(&mut transaction, Timestamp(i64::MAX), self.now(), &mut swept).await?;
        reuse::forget_unanswered(&mut transaction).await?;
        transaction.commit().await?;
        Ok(swept)
    }

    async fn sweep(&self, memory: Memory) -> Result<Swept, StoreFailure> {
        let now = self.now();
        if !upkeep::anything_due(&self.readers, memory, now).await? {
            return Ok(Swept::default());
        }
        let mut transaction = self.begin().await?;
        let swept = upkeep::sweep(&mut transaction, memory, now).await?;
        transaction.commit().await?;
        Ok(swept)
    }

    async fn expire_oldest(&self) -> Result<bool, StoreFailure> {
        let mut transaction = self.begin().await?;
        let expired = upkeep::expire_oldest(&mut transaction).await?;
        transaction.commit().await?;
        Ok(expired)
    }

    async fn cancel(&self, caller: &Caller, id: JobId) -> Result<Change, StoreFailure> {
        let mut transaction = self.begin().await?;
        let change = ending::cancel(&mut transaction, caller, id, self.now()).await?;
        transaction.commit().await?;
        Ok(change)
    }

    async fn delete(&self, caller: &Caller, id: JobId) -> Result<Change, StoreFailure> {
        let mut transaction = self.begin().await?;
        let change = ending::delete(&mut transaction, caller, id).await?;
        transaction.commit().await?;
        Ok(change)
    }

    async fn job(&self, caller: &Caller, id: JobId) -> Result<Option<Job>, StoreFailure> {
        reading::job(&self.readers, caller, id).await
    }

    async fn job_by_client_id(&self, caller: &Caller, client_id: &str) -> Result<Option<Job>, StoreFailure> {
        reading::job_by_client_id(&self.readers, caller, client_id).await
    }

    async fn list(
        &self,
        caller: &Caller,
        filter: &JobFilter,
        before: Option<JobId>,
        count: usize,
    ) -> Result<Vec<Job>, StoreFailure> {
        reading::list(&self.readers, caller, filter, before, count).await
    }

    async fn events(&self, id: JobId, after: u64, count: usize) -> Result<Vec<Event>, StoreFailure> {
        reading::events(&self.readers, id, after, count).await
    }

    async fn counts(&self) -> Result<Counts, StoreFailure> {
        reading::counts(&self.readers).await
    }

    async fn put_asset(
        &self,
        caller: &Caller,
        files: &[NewBlob],
        memory_bytes: u64,
        retention: Duration,
    ) -> Result<(Asset, bool, Vec<String>), StoreFailure> {
        let mut transaction = self.begin().await?;
        let now = self.now();
        let upload = admission::UploadToKeep { files, memory_bytes, explicit: true };
        let put = admission::keep_files(&mut transaction, caller, upload, now, now.after(retention)).await?;
        transaction.commit().await?;
        Ok((put.asset, put.created, put.kept))
    }

    async fn asset(&self, caller: &Caller, id: AssetId) -> Result<Option<Asset>, StoreFailure> {
        let mut connection = self.readers.acquire().await?;
        Ok(admission::asset(&mut connection, caller, id).await?.map(|(asset, _)| asset))
    }

    async fn delete_asset(&self, caller: &Caller, id: AssetId) -> Result<bool, StoreFailure> {
        let deleted = sqlx::query("DELETE FROM assets WHERE id = ? AND caller = ?")
            .bind(id.to_bytes().to_vec())
            .bind(caller.name())
            .execute(&self.writer)
            .await?;
        Ok(deleted.rows_affected() > 0)
    }

    async fn blob(&self, sha256: &[u8; 32]) -> Result<Option<BlobPlace>, StoreFailure> {
        let mut connection = self.readers.acquire().await?;
        rows::blob(&mut connection, sha256).await
    }

    async fn collect(&self) -> Result<Vec<BlobPlace>, StoreFailure> {
        let mut transaction = self.begin().await?;
        let forgotten = upkeep::collect(&mut transaction).await?;
        transaction.commit().await?;
        Ok(forgotten)
    }

    async fn locations(&self) -> Result<BTreeSet<String>, StoreFailure> {
        let locations: Vec<String> = sqlx::query_scalar("SELECT location FROM blobs").fetch_all(&self.readers).await?;
        Ok(locations.into_iter().collect())
    }

    async fn recall(&self, caller: &Caller, key: &str, fingerprint: &[u8; 32]) -> Result<Remembered, StoreFailure> {
        let mut transaction = self.begin().await?;
        let remembered = reuse::recall(&mut transaction, caller, key, fingerprint, self.now()).await?;
        transaction.commit().await?;
        Ok(remembered)
    }

    async fn remember(&self, caller: &Caller, key: &str, answer: Option<&[u8]>) -> Result<(), StoreFailure> {
        reuse::remember(&self.writer, caller, key, answer).await
    }

    async fn close(&self) {
        self.readers.close().await;
        self.writer.close().await;
    }
}

/// Appends to a job's history: each event gets the next number.
async fn append(
    connection: &mut SqliteConnection,
    id: JobId,
    now: Timestamp,
    kinds: &[crate::jobs::event::EventKind],
) -> Result<(), StoreFailure> {
    let last: i64 = sqlx::query_scalar("UPDATE jobs SET sequence = sequence + ? WHERE id = ? RETURNING sequence")
        .bind(int(kinds.len() as u64))
        .bind(id.to_bytes().to_vec())
        .fetch_one(&mut *connection)
        .await?;
    let first = last - int(kinds.len() as u64) + 1;
    for (sequence, kind) in (first..).zip(kinds) {
        sqlx::query("INSERT INTO events (job, sequence, at, body) VALUES (?, ?, ?, ?)")
            .bind(id.to_bytes().to_vec())
            .bind(sequence)
            .bind(now.0)
            .bind(super::codec::event(kind).to_string())
            .execute(&mut *connection)
            .await?;
    }
    Ok(())
}
