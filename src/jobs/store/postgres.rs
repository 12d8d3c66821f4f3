//! Jobs in PostgreSQL: the engine of a service that is many processes on many machines.
//!
//! Transactions run side by side (`READ COMMITTED`). A job is taken with `FOR UPDATE SKIP LOCKED`; what must not happen
//! twice at a time is kept apart by advisory locks that end with their transaction. Time is the server's, so that the
//! machines' clocks need not agree. What one process does, the others hear by `NOTIFY`.

mod news;
mod server_clock;

use self::news::Wire;
use self::server_clock::ServerClock;
use super::sql::{Columns, Connection, Engine, Lock, SqlStore, Statement, engine_connection, sql};
use super::{News, StoreFailure};
use crate::jobs::clock::{Clock, Timestamp};
use sha2::{Digest, Sha256};
use sqlx::migrate::Migrator;
use sqlx::pool::PoolConnection;
use sqlx::postgres::{PgConnectOptions, PgPool, PgPoolOptions, PgRow};
use sqlx::{Connection as _, PgConnection, Postgres, Transaction};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::broadcast;

/// The schema, from nothing to the newest version.
pub static MIGRATOR: Migrator = sqlx::migrate!("src/jobs/migrations/postgres");

/// Connections of one process, beside two for the news.
const CONNECTIONS: u32 = 8;
/// How long a caller waits for a connection before it is told that the store does not answer.
const ACQUIRE_TIME: Duration = Duration::from_secs(10);
/// A connection that nobody used for this long is tried before it is used: the server may have gone and come back.
const UNTRIED_TIME: Duration = Duration::from_secs(1);
/// A statement that takes longer, and a transaction whose process says nothing for this long, is ended by the server: a
/// process that was stopped must not hold its locks for ever.
const STATEMENT_MILLIS: &str = "30000";
const SILENCE_MILLIS: &str = "10000";

/// The store. See the module.
pub type PostgresStore = SqlStore<PostgresEngine>;

pub struct PostgresEngine {
    pool: PgPool,
    clock: Arc<dyn Clock>,
    lease: Duration,
    wire: Wire,
}

impl PostgresStore {
    /// Opens the database at `url` (`postgres://user:password@host:port/name`), and brings its schema up to date. Time is
    /// the server's.
    pub async fn open(url: &str, lease: Duration) -> Result<Self, StoreFailure> {
        let (options, pool) = connect(url).await?;
        let clock = ServerClock::start(&pool).await?;
        Self::start(options, pool, clock, lease).await
    }

    /// The same, with a clock of its own, for trying rules about time.
    pub async fn open_with_clock(url: &str, clock: Arc<dyn Clock>, lease: Duration) -> Result<Self, StoreFailure> {
        let (options, pool) = connect(url).await?;
        Self::start(options, pool, clock, lease).await
    }

    async fn start(
        options: PgConnectOptions,
        pool: PgPool,
        clock: Arc<dyn Clock>,
        lease: Duration,
    ) -> Result<Self, StoreFailure> {
        let wire = Wire::start(options).await?;
        Ok(Self(PostgresEngine { pool, clock, lease, wire }))
    }
}

async fn connect(url: &str) -> Result<(PgConnectOptions, PgPool), StoreFailure> {
    let options = url
        .parse::<PgConnectOptions>()?
        .application_name("rigsmith")
        .options([("statement_timeout", STATEMENT_MILLIS), ("idle_in_transaction_session_timeout", SILENCE_MILLIS)]);
    let pool = PgPoolOptions::new()
        .max_connections(CONNECTIONS)
        .acquire_timeout(ACQUIRE_TIME)
        .test_before_acquire(false)
        .before_acquire(|connection, seen| {
            Box::pin(async move { Ok(seen.idle_for < UNTRIED_TIME || connection.ping().await.is_ok()) })
        });
    let pool = pool.connect_with(options.clone()).await?;
    MIGRATOR.run(&pool).await.map_err(|error| StoreFailure::new(&error))?;
    Ok((options, pool))
}

engine_connection!(Postgres, PgConnection, PgRow);

/// The number of an advisory lock.
fn number(lock: Lock<'_>) -> i64 {
    let digest = match lock {
        Lock::Naming | Lock::Forgetting => Sha256::digest("rigsmith blobs"),
        Lock::Upkeep => Sha256::digest("rigsmith upkeep"),
        Lock::Name { kind, caller, name } => Sha256::digest(format!("rigsmith {kind}\0{caller}\0{name}")),
    };
    digest.first_chunk().map_or(0, |bytes| i64::from_be_bytes(*bytes))
}

impl Connection for PgConnection {
    type Row = PgRow;

    const FOR_UPDATE: &'static str = " FOR UPDATE";
    const FOR_UPDATE_SKIP_LOCKED: &'static str = " FOR UPDATE OF jobs SKIP LOCKED";
    const SERVED: &'static str = "INSERT INTO callers (name, served) VALUES ($1, nextval('turns')) \
         ON CONFLICT (name) DO UPDATE SET served = excluded.served";

    async fn execute(&mut self, statement: Statement) -> Result<u64, StoreFailure> {
        Ok(query(statement).execute(self).await?.rows_affected())
    }

    async fn fetch(&mut self, statement: Statement) -> Result<Vec<PgRow>, StoreFailure> {
        Ok(query(statement).fetch_all(self).await?)
    }

    async fn lock(&mut self, lock: Lock<'_>) -> Result<bool, StoreFailure> {
        let statement = match lock {
            Lock::Naming => "SELECT CAST(1 AS BIGINT) AS taken FROM pg_advisory_xact_lock_shared($1)",
            Lock::Forgetting | Lock::Name { .. } => "SELECT CAST(1 AS BIGINT) AS taken FROM pg_advisory_xact_lock($1)",
            Lock::Upkeep => "SELECT CAST(taken AS INT)::BIGINT AS taken FROM pg_try_advisory_xact_lock($1) taken",
        };
        Ok(sql(statement).bind(number(lock)).one(self).await?.get::<i64>("taken")? != 0)
    }
}

impl Engine for PostgresEngine {
    type Connection = PgConnection;
    type Reading = PoolConnection<Postgres>;
    type Writing = Transaction<'static, Postgres>;

    fn now(&self) -> Timestamp {
        self.clock.now()
    }

    fn lease(&self) -> Duration {
        self.lease
    }

    async fn read(&self) -> Result<Self::Reading, StoreFailure> {
        Ok(self.pool.acquire().await?)
    }

    async fn write(&self) -> Result<Self::Writing, StoreFailure> {
        Ok(self.pool.begin().await?)
    }

    async fn commit(&self, writing: Self::Writing) -> Result<(), StoreFailure> {
        Ok(writing.commit().await?)
    }

    fn tell(&self, news: News) {
        self.wire.tell(news);
    }

    fn news(&self) -> Option<broadcast::Receiver<News>> {
        Some(self.wire.hear())
    }

    async fn close(&self) {
        self.wire.close().await;
        self.pool.close().await;
    }
}
