//! Jobs in one SQLite file: the engine of a service that is one process.
//!
//! Everything that changes goes through one connection, whole transactions at a time, and is on the disk before the
//! call returns (`synchronous = FULL`); readers have connections of their own and never wait for a writer (WAL).

use super::sql::{Connection, Engine, Lock, SqlStore, Statement, engine_connection};
use super::{News, StoreFailure};
use crate::jobs::clock::{Clock, Timestamp};
use sqlx::migrate::Migrator;
use sqlx::pool::PoolConnection;
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteRow, SqliteSynchronous,
};
use sqlx::{Connection as _, Sqlite, SqliteConnection, Transaction};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::broadcast;

/// The schema, from nothing to the newest version.
pub static MIGRATOR: Migrator = sqlx::migrate!("src/jobs/migrations/sqlite");

/// Connections that look while one writes.
const READERS: u32 = 4;
/// How long a connection waits for another process that writes.
const BUSY_TIME: Duration = Duration::from_secs(5);
/// How long a caller waits for a connection before it is told that the store does not answer.
const ACQUIRE_TIME: Duration = Duration::from_secs(10);

/// The store. See the module.
pub type SqliteStore = SqlStore<SqliteEngine>;

pub struct SqliteEngine {
    writer: SqlitePool,
    readers: SqlitePool,
    clock: Arc<dyn Clock>,
    lease: Duration,
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
        Ok(Self(SqliteEngine { writer, readers, clock, lease }))
    }
}

engine_connection!(Sqlite, SqliteConnection, SqliteRow);

impl Connection for SqliteConnection {
    type Row = SqliteRow;

    // There is one writer, so nothing needs a lock.
    const FOR_UPDATE: &'static str = "";
    const FOR_UPDATE_SKIP_LOCKED: &'static str = "";
    const SERVED: &'static str = "INSERT INTO callers (name, served) \
         SELECT $1, coalesce(max(served), 0) + 1 FROM callers WHERE true \
         ON CONFLICT (name) DO UPDATE SET served = excluded.served";

    async fn execute(&mut self, statement: Statement) -> Result<u64, StoreFailure> {
        Ok(query(statement).execute(self).await?.rows_affected())
    }

    async fn fetch(&mut self, statement: Statement) -> Result<Vec<SqliteRow>, StoreFailure> {
        Ok(query(statement).fetch_all(self).await?)
    }

    async fn lock(&mut self, _: Lock<'_>) -> Result<bool, StoreFailure> {
        Ok(true)
    }
}

impl Engine for SqliteEngine {
    type Connection = SqliteConnection;
    type Reading = PoolConnection<Sqlite>;
    type Writing = Transaction<'static, Sqlite>;

    fn now(&self) -> Timestamp {
        self.clock.now()
    }

    fn lease(&self) -> Duration {
        self.lease
    }

    async fn read(&self) -> Result<Self::Reading, StoreFailure> {
        Ok(self.readers.acquire().await?)
    }

    async fn write(&self) -> Result<Self::Writing, StoreFailure> {
        Ok(self.writer.begin_with("BEGIN IMMEDIATE").await?)
    }

    async fn commit(&self, writing: Self::Writing) -> Result<(), StoreFailure> {
        Ok(writing.commit().await?)
    }

    /// Nobody else is there to hear them.
    fn tell(&self, _: News) {}

    fn news(&self) -> Option<broadcast::Receiver<News>> {
        None
    }

    async fn close(&self) {
        self.readers.close().await;
        self.writer.close().await;
    }
}
