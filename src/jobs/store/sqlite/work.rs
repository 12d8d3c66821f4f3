//! Jobs in the hands of workers.

use super::ending::end;
use super::{append, reading, rows};
use crate::jobs::clock::Timestamp;
use crate::jobs::event::EventKind;
use crate::jobs::failure::{ErrorCode, JobError};
use crate::jobs::ids::JobId;
use crate::jobs::job::{FileInfo, Job, JobState};
use crate::jobs::stage::Stage;
use crate::jobs::store::{BlobPlace, Claim, Lease, LeaseState, PASSING_TIME, StoreFailure, codec};
use sqlx::sqlite::SqlitePool;
use sqlx::{Row, SqliteConnection};

pub async fn claim(
    connection: &mut SqliteConnection,
    worker: &str,
    memory_free: u64,
    now: Timestamp,
    lease_until: Timestamp,
) -> Result<Option<Claim>, StoreFailure> {
    let waiting = reading::queue(&mut *connection).await?;
    let fits = |place: &&reading::Place| place.memory_bytes <= memory_free;
    let chosen = match waiting.first() {
        // Small jobs may pass a large one, but not for ever.
        Some(head) if now.since(head.queued_at) > PASSING_TIME => Some(head).filter(fits),
        _ => waiting.iter().find(fits),
    };
    let Some(reading::Place { id, memory_bytes, queued_at }) = chosen.copied() else { return Ok(None) };
    sqlx::query(
        "UPDATE jobs SET state = 'running', attempt = attempt + 1, worker = ?, lease_until = ?, stage = NULL, \
         started_at = coalesce(started_at, ?), queue_ms = coalesce(queue_ms, 0) + ? WHERE id = ?",
    )
    .bind(worker)
    .bind(lease_until.0)
    .bind(now.0)
    .bind(super::millis(now.since(queued_at)))
    .bind(id.to_bytes().to_vec())
    .execute(&mut *connection)
    .await?;
    let Some((job, (files, skeleton))) = whole(connection, id).await? else {
        // It would stand at the head of the queue for ever.
        end(connection, id, JobState::Failed, Some(&unreadable()), now).await?;
        return Ok(None);
    };
    sqlx::query(
        "INSERT INTO callers (name, served) SELECT ?, coalesce(max(served), 0) + 1 FROM callers WHERE true \
         ON CONFLICT (name) DO UPDATE SET served = excluded.served",
    )
    .bind(job.caller.name())
    .execute(&mut *connection)
    .await?;
    append(connection, id, now, &[EventKind::State { state: JobState::Running, attempt: job.attempt }]).await?;
    let lease = Lease { job: id, attempt: job.attempt };
    let time_left = job.request.deadline.map(|deadline| Timestamp::from(deadline).since(now));
    Ok(Some(Claim { lease, files, skeleton, memory_bytes, time_left, job }))
}

type Places = (Vec<(FileInfo, BlobPlace)>, Option<BlobPlace>);

/// A job with all that its work needs; `None` when this version cannot read what another one wrote, or a file is gone.
async fn whole(connection: &mut SqliteConnection, id: JobId) -> Result<Option<(Job, Places)>, StoreFailure> {
    let row = sqlx::query("SELECT options, skeleton FROM jobs WHERE id = ?")
        .bind(id.to_bytes().to_vec())
        .fetch_one(&mut *connection)
        .await?;
    let options = codec::parse(row.try_get("options")?, "options").and_then(|options| codec::options_from(&options));
    let (Ok(_), Some(job)) = (options, reading::snapshot(connection, id).await?) else { return Ok(None) };
    let mut files = Vec::with_capacity(job.request.files.len());
    for file in &job.request.files {
        let Some(place) = rows::blob(connection, &file.sha256).await? else { return Ok(None) };
        files.push((file.clone(), place));
    }
    let skeleton = match row.try_get::<Option<&[u8]>, _>("skeleton")? {
        Some(digest) => match rows::blob(connection, &rows::bytes(digest)?).await? {
            Some(place) => Some(place),
            None => return Ok(None),
        },
        None => None,
    };
    Ok(Some((job, (files, skeleton))))
}

fn unreadable() -> JobError {
    JobError::new(ErrorCode::Internal, "the job was written down by another version, or its files are gone")
        .hint("send the request again")
}

fn lease_state(cancel_requested: Option<i64>) -> LeaseState {
    match cancel_requested {
        Some(0) => LeaseState::Held,
        Some(_) => LeaseState::CancelRequested,
        None => LeaseState::Lost,
    }
}

pub async fn extend(
    connection: &mut SqliteConnection,
    leases: &[Lease],
    until: Timestamp,
) -> Result<Vec<LeaseState>, StoreFailure> {
    let mut states = Vec::with_capacity(leases.len());
    for lease in leases {
        let cancel_requested: Option<i64> = sqlx::query_scalar(
            "UPDATE jobs SET lease_until = ? WHERE id = ? AND attempt = ? AND state = 'running' \
             RETURNING cancel_requested",
        )
        .bind(until.0)
        .bind(lease.job.to_bytes().to_vec())
        .bind(i64::from(lease.attempt))
        .fetch_optional(&mut *connection)
        .await?;
        states.push(lease_state(cancel_requested));
    }
    Ok(states)
}

pub async fn look_at(readers: &SqlitePool, leases: &[Lease]) -> Result<Vec<LeaseState>, StoreFailure> {
    let mut states = Vec::with_capacity(leases.len());
    for lease in leases {
        let cancel_requested: Option<i64> =
            sqlx::query_scalar("SELECT cancel_requested FROM jobs WHERE id = ? AND attempt = ? AND state = 'running'")
                .bind(lease.job.to_bytes().to_vec())
                .bind(i64::from(lease.attempt))
                .fetch_optional(readers)
                .await?;
        states.push(lease_state(cancel_requested));
    }
    Ok(states)
}

pub async fn advance(
    connection: &mut SqliteConnection,
    lease: Lease,
    stage: Stage,
    now: Timestamp,
) -> Result<bool, StoreFailure> {
    let row = sqlx::query(
        "UPDATE jobs SET stage = ?, progress = max(progress, ?) WHERE id = ? AND attempt = ? AND state = 'running' \
         RETURNING progress",
    )
    .bind(stage.name())
    .bind(i64::from(stage.progress()))
    .bind(lease.job.to_bytes().to_vec())
    .bind(i64::from(lease.attempt))
    .fetch_optional(&mut *connection)
    .await?;
    let Some(row) = row else { return Ok(false) };
    let progress = u8::try_from(row.try_get::<i64, _>("progress")?).unwrap_or(0);
    append(connection, lease.job, now, &[EventKind::Progress { stage, progress }]).await?;
    Ok(true)
}

pub async fn give_back(connection: &mut SqliteConnection, lease: Lease, now: Timestamp) -> Result<bool, StoreFailure> {
    let given: Option<i64> =
        sqlx::query_scalar("SELECT attempt FROM jobs WHERE id = ? AND attempt = ? AND state = 'running'")
            .bind(lease.job.to_bytes().to_vec())
            .bind(i64::from(lease.attempt))
            .fetch_optional(&mut *connection)
            .await?;
    if given.is_none() {
        return Ok(false);
    }
    requeue(connection, lease.job, lease.attempt, 0, now).await?;
    Ok(true)
}

/// A running job waits again, after `losses` more lost workers.
pub async fn requeue(
    connection: &mut SqliteConnection,
    id: JobId,
    attempt: u32,
    losses: i64,
    now: Timestamp,
) -> Result<(), StoreFailure> {
    sqlx::query(
        "UPDATE jobs SET state = 'queued', worker = NULL, lease_until = NULL, stage = NULL, queued_at = ?, \
         losses = losses + ? WHERE id = ?",
    )
    .bind(now.0)
    .bind(losses)
    .bind(id.to_bytes().to_vec())
    .execute(&mut *connection)
    .await?;
    append(connection, id, now, &[EventKind::State { state: JobState::Queued, attempt }]).await
}
