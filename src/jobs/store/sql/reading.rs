//! Looking, without changing anything.

use super::rows::{self, JOB};
use super::{Columns, Connection, int, sql};
use crate::jobs::clock::Timestamp;
use crate::jobs::event::Event;
use crate::jobs::ids::JobId;
use crate::jobs::job::{Job, JobState};
use crate::jobs::store::{Counts, JobFilter, PASSING_TIME, StoreFailure, codec};
use crate::jobs::submission::Caller;
use sqlx::AssertSqlSafe;

/// A job that waits.
#[derive(Clone, Copy)]
pub struct Place {
    pub id: JobId,
    pub memory_bytes: u64,
    pub queued_at: Timestamp,
}

/// The jobs that wait, with what decides their order ([`ORDER`]). Within a priority callers take turns: a caller's first
/// job goes with the first jobs of the others, counted after those that run; among equals the caller served longest ago
/// goes first.
const WAITING: &str = "WITH running AS (SELECT caller, count(*) AS jobs FROM jobs WHERE state = 'running' GROUP BY caller), \
     waiting AS (SELECT jobs.id, jobs.priority, jobs.memory_bytes, coalesce(callers.served, 0) AS served, \
     row_number() OVER (PARTITION BY jobs.priority, jobs.caller ORDER BY jobs.id) + coalesce(running.jobs, 0) AS turn \
     FROM jobs LEFT JOIN running ON running.caller = jobs.caller LEFT JOIN callers ON callers.name = jobs.caller \
     WHERE jobs.state = 'queued')";
/// Jobs that several processes may be taking at the same moment; one more looks again.
const AT_ONCE: usize = 100;
const ORDER: &str = "ORDER BY waiting.priority DESC, waiting.turn, waiting.served, waiting.id";

/// The jobs that wait, the next one first.
async fn queue(connection: &mut impl Connection) -> Result<Vec<JobId>, StoreFailure> {
    let rows = sql(AssertSqlSafe(format!("{WAITING} SELECT id FROM waiting {ORDER}"))).all(connection).await?;
    rows.iter().map(rows::job_id).collect()
}

/// The job to take next by somebody who has `memory_free` bytes. It is this transaction's; others pass it over.
pub async fn next<C: Connection>(
    connection: &mut C,
    memory_free: u64,
    now: Timestamp,
) -> Result<Option<Place>, StoreFailure> {
    let head = first_that_needs_at_most(connection, u64::MAX).await?;
    match head {
        Some(head) if head.memory_bytes > memory_free => {
            // Small jobs may pass a large one, but not for ever.
            if now.since(head.queued_at) > PASSING_TIME {
                return Ok(None);
            }
            first_that_needs_at_most(connection, memory_free).await
        }
        other => Ok(other),
    }
}

async fn first_that_needs_at_most<C: Connection>(
    connection: &mut C,
    memory_bytes: u64,
) -> Result<Option<Place>, StoreFailure> {
    // The first few are found before they are locked, so that no plan compares all that wait with all that wait.
    let query = format!(
        "{WAITING}, first AS MATERIALIZED (SELECT waiting.id, row_number() OVER ({ORDER}) AS place FROM waiting \
         WHERE waiting.memory_bytes <= $1 ORDER BY place LIMIT {AT_ONCE}) \
         SELECT jobs.id, jobs.memory_bytes, jobs.queued_at FROM first JOIN jobs ON jobs.id = first.id \
         WHERE jobs.state = 'queued' ORDER BY first.place LIMIT 1{}",
        C::FOR_UPDATE_SKIP_LOCKED
    );
    let row = sql(AssertSqlSafe(query)).bind(int(memory_bytes)).optional(connection).await?;
    let place = |row: C::Row| {
        let memory_bytes = u64::try_from(row.get::<i64>("memory_bytes")?).unwrap_or(0);
        Ok(Place { id: rows::job_id(&row)?, memory_bytes, queued_at: Timestamp(row.get("queued_at")?) })
    };
    row.map(place).transpose()
}

/// Whether any job waits.
pub async fn any_waits(connection: &mut impl Connection) -> Result<bool, StoreFailure> {
    Ok(sql("SELECT id FROM jobs WHERE state = 'queued' LIMIT 1").optional(connection).await?.is_some())
}

/// Fills in places in the queue.
async fn placed(connection: &mut impl Connection, jobs: &mut [Job]) -> Result<(), StoreFailure> {
    if jobs.iter().all(|job| job.state != JobState::Queued) {
        return Ok(());
    }
    let queue = queue(connection).await?;
    for job in jobs.iter_mut().filter(|job| job.state == JobState::Queued) {
        job.queue_position = queue.iter().position(|id| *id == job.id).map(|index| index + 1);
    }
    Ok(())
}

async fn with_place<C: Connection>(connection: &mut C, row: Option<C::Row>) -> Result<Option<Job>, StoreFailure> {
    let Some(row) = row else { return Ok(None) };
    let mut job = [rows::job(&row)?];
    placed(connection, &mut job).await?;
    let [job] = job;
    Ok(Some(job))
}

/// A job, whosever it is.
pub async fn snapshot(connection: &mut impl Connection, id: JobId) -> Result<Option<Job>, StoreFailure> {
    let row = sql(AssertSqlSafe(format!("{JOB} WHERE id = $1"))).bind(id.to_bytes()).optional(connection).await?;
    with_place(connection, row).await
}

pub async fn job(connection: &mut impl Connection, caller: &Caller, id: JobId) -> Result<Option<Job>, StoreFailure> {
    let query = sql(AssertSqlSafe(format!("{JOB} WHERE id = $1 AND caller = $2")));
    let row = query.bind(id.to_bytes()).bind(caller.name()).optional(connection).await?;
    with_place(connection, row).await
}

pub async fn job_by_client_id(
    connection: &mut impl Connection,
    caller: &Caller,
    client_id: &str,
) -> Result<Option<Job>, StoreFailure> {
    let query = sql(AssertSqlSafe(format!("{JOB} WHERE caller = $1 AND client_id = $2")));
    let row = query.bind(caller.name()).bind(client_id).optional(connection).await?;
    with_place(connection, row).await
}

pub async fn list<C: Connection>(
    connection: &mut C,
    caller: &Caller,
    filter: &JobFilter,
    before: Option<JobId>,
    count: usize,
) -> Result<Vec<Job>, StoreFailure> {
    // A condition on nothing is true of every job.
    let query = format!(
        "{JOB} WHERE caller = $1 AND ($2 IS NULL OR id < $2) AND ($3 IS NULL OR state = $3) \
         AND ($4 IS NULL OR id IN (SELECT job FROM job_labels WHERE name = $4 AND value = $5)) \
         ORDER BY id DESC LIMIT $6"
    );
    let label = filter.label.as_ref();
    let rows = sql(AssertSqlSafe(query))
        .bind(caller.name())
        .bind(before.map(JobId::to_bytes))
        .bind(filter.state.map(JobState::name))
        .bind(label.map(|(name, _)| name.as_str()))
        .bind(label.map(|(_, value)| value.as_str()))
        .bind(int(count as u64))
        .all(connection)
        .await?;
    let mut jobs = rows.iter().map(rows::job).collect::<Result<Vec<_>, _>>()?;
    placed(connection, &mut jobs).await?;
    Ok(jobs)
}

pub async fn events<C: Connection>(
    connection: &mut C,
    id: JobId,
    after: u64,
    count: usize,
) -> Result<Vec<Event>, StoreFailure> {
    let rows = sql("SELECT sequence, at, body FROM events WHERE job = $1 AND sequence > $2 ORDER BY sequence LIMIT $3")
        .bind(id.to_bytes())
        .bind(int(after))
        .bind(int(count as u64))
        .all(connection)
        .await?;
    let event = |row: &C::Row| {
        Ok(Event {
            sequence: u64::try_from(row.get::<i64>("sequence")?).unwrap_or(0),
            at: Timestamp(row.get("at")?).into(),
            kind: codec::event_from(&codec::parse(row.get("body")?, "an event")?)?,
        })
    };
    rows.iter().map(event).collect()
}

pub async fn counts(connection: &mut impl Connection) -> Result<Counts, StoreFailure> {
    let row = sql("SELECT (SELECT count(*) FROM jobs WHERE state = 'queued') AS queued, \
         (SELECT count(*) FROM jobs WHERE state = 'running') AS running, \
         (SELECT min(queued_at) FROM jobs WHERE state = 'queued') AS oldest")
    .one(connection)
    .await?;
    let count = |column| Ok::<_, StoreFailure>(usize::try_from(row.get::<i64>(column)?).unwrap_or(0));
    Ok(Counts {
        queued: count("queued")?,
        running: count("running")?,
        oldest_queued_at: row.get::<Option<i64>>("oldest")?.map(Timestamp),
    })
}
