//! Looking, without changing anything.

use super::rows::{self, JOB};
use crate::jobs::clock::Timestamp;
use crate::jobs::event::Event;
use crate::jobs::ids::JobId;
use crate::jobs::job::{Job, JobState};
use crate::jobs::store::{Counts, JobFilter, StoreFailure, codec};
use crate::jobs::submission::Caller;
use sqlx::sqlite::{SqlitePool, SqliteRow};
use sqlx::{AssertSqlSafe, QueryBuilder, Row, Sqlite, SqliteConnection, SqliteExecutor};

/// A job that waits.
#[derive(Clone, Copy)]
pub struct Place {
    pub id: JobId,
    pub memory_bytes: u64,
    pub queued_at: Timestamp,
}

/// The jobs that wait, the next one first. Within a priority callers take turns: a caller's first job goes with the
/// first jobs of the others, counted after those that run; among equals the caller served longest ago goes first.
pub async fn queue(executor: impl SqliteExecutor<'_>) -> Result<Vec<Place>, StoreFailure> {
    let rows = sqlx::query(
        "WITH waiting AS (SELECT id, priority, memory_bytes, queued_at, \
         row_number() OVER (PARTITION BY priority, caller ORDER BY id) \
         + (SELECT count(*) FROM jobs r WHERE r.state = 'running' AND r.caller = jobs.caller) AS turn, \
         coalesce((SELECT served FROM callers WHERE name = jobs.caller), 0) AS served \
         FROM jobs WHERE state = 'queued') \
         SELECT id, memory_bytes, queued_at FROM waiting ORDER BY priority DESC, turn, served, id",
    )
    .fetch_all(executor)
    .await?;
    let place = |row: &SqliteRow| {
        let memory_bytes = u64::try_from(row.try_get::<i64, _>("memory_bytes")?).unwrap_or(0);
        Ok(Place { id: rows::job_id(row)?, memory_bytes, queued_at: Timestamp(row.try_get("queued_at")?) })
    };
    rows.iter().map(place).collect()
}

/// Fills in places in the queue.
async fn placed(connection: &mut SqliteConnection, jobs: &mut [Job]) -> Result<(), StoreFailure> {
    if jobs.iter().all(|job| job.state != JobState::Queued) {
        return Ok(());
    }
    let queue = queue(connection).await?;
    for job in jobs.iter_mut().filter(|job| job.state == JobState::Queued) {
        job.queue_position = queue.iter().position(|place| place.id == job.id).map(|index| index + 1);
    }
    Ok(())
}

async fn with_place(connection: &mut SqliteConnection, row: Option<SqliteRow>) -> Result<Option<Job>, StoreFailure> {
    let Some(row) = row else { return Ok(None) };
    let mut job = [rows::job(&row)?];
    placed(connection, &mut job).await?;
    let [job] = job;
    Ok(Some(job))
}

/// A job, whosever it is.
pub async fn snapshot(connection: &mut SqliteConnection, id: JobId) -> Result<Option<Job>, StoreFailure> {
    let query = AssertSqlSafe(format!("{JOB} WHERE id = ?"));
    let row = sqlx::query(query).bind(id.to_bytes().to_vec()).fetch_optional(&mut *connection).await?;
    with_place(connection, row).await
}

pub async fn job(readers: &SqlitePool, caller: &Caller, id: JobId) -> Result<Option<Job>, StoreFailure> {
    let mut connection = readers.acquire().await?;
    let query = AssertSqlSafe(format!("{JOB} WHERE id = ? AND caller = ?"));
    let query = sqlx::query(query).bind(id.to_bytes().to_vec()).bind(caller.name());
    let row = query.fetch_optional(&mut *connection).await?;
    with_place(&mut connection, row).await
}

pub async fn job_by_client_id(
    readers: &SqlitePool,
    caller: &Caller,
    client_id: &str,
) -> Result<Option<Job>, StoreFailure> {
    let mut connection = readers.acquire().await?;
    let query = AssertSqlSafe(format!("{JOB} WHERE caller = ? AND client_id = ?"));
    let row = sqlx::query(query).bind(caller.name()).bind(client_id).fetch_optional(&mut *connection).await?;
    with_place(&mut connection, row).await
}

pub async fn list(
    readers: &SqlitePool,
    caller: &Caller,
    filter: &JobFilter,
    before: Option<JobId>,
    count: usize,
) -> Result<Vec<Job>, StoreFailure> {
    let mut query = QueryBuilder::<Sqlite>::new(JOB);
    query.push(" WHERE caller = ").push_bind(caller.name());
    if let Some(before) = before {
        query.push(" AND id < ").push_bind(before.to_bytes().to_vec());
    }
    if let Some(state) = filter.state {
        query.push(" AND state = ").push_bind(state.name());
    }
    if let Some((name, value)) = &filter.label {
        query.push(" AND id IN (SELECT job FROM job_labels WHERE name = ").push_bind(name.as_str());
        query.push(" AND value = ").push_bind(value.as_str()).push(")");
    }
    query.push(" ORDER BY id DESC LIMIT ").push_bind(super::int(count as u64));
    let mut connection = readers.acquire().await?;
    let rows = query.build().fetch_all(&mut *connection).await?;
    let mut jobs = rows.iter().map(rows::job).collect::<Result<Vec<_>, _>>()?;
    placed(&mut connection, &mut jobs).await?;
    Ok(jobs)
}

pub async fn events(readers: &SqlitePool, id: JobId, after: u64, count: usize) -> Result<Vec<Event>, StoreFailure> {
    let rows =
        sqlx::query("SELECT sequence, at, body FROM events WHERE job = ? AND sequence > ? ORDER BY sequence LIMIT ?")
            .bind(id.to_bytes().to_vec())
            .bind(super::int(after))
            .bind(super::int(count as u64))
            .fetch_all(readers)
            .await?;
    let event = |row: &SqliteRow| {
        Ok(Event {
            sequence: u64::try_from(row.try_get::<i64, _>("sequence")?).unwrap_or(0),
            at: Timestamp(row.try_get("at")?).into(),
            kind: codec::event_from(&codec::parse(row.try_get("body")?, "an event")?)?,
        })
    };
    rows.iter().map(event).collect()
}

pub async fn counts(executor: impl SqliteExecutor<'_>) -> Result<Counts, StoreFailure> {
    let row = sqlx::query(
        "SELECT (SELECT count(*) FROM jobs WHERE state = 'queued') AS queued, \
         (SELECT count(*) FROM jobs WHERE state = 'running') AS running, \
         (SELECT min(queued_at) FROM jobs WHERE state = 'queued') AS oldest",
    )
    .fetch_one(executor)
    .await?;
    let count = |column| Ok::<_, sqlx::Error>(usize::try_from(row.try_get::<i64, _>(column)?).unwrap_or(0));
    Ok(Counts {
        queued: count("queued")?,
        running: count("running")?,
        oldest_queued_at: row.try_get::<Option<i64>, _>("oldest")?.map(Timestamp),
    })
}
