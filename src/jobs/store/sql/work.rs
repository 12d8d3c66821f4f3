//! Jobs in the hands of workers.

use super::ending::end;
use super::{Columns, Connection, append, reading, rows, sql};
use crate::jobs::clock::Timestamp;
use crate::jobs::event::EventKind;
use crate::jobs::failure::{ErrorCode, JobError};
use crate::jobs::ids::JobId;
use crate::jobs::job::{FileInfo, Job, JobState};
use crate::jobs::stage::Stage;
use crate::jobs::store::{BlobPlace, Claim, Lease, LeaseState, StoreFailure, codec};
use sqlx::AssertSqlSafe;

pub async fn claim<C: Connection>(
    connection: &mut C,
    worker: &str,
    memory_free: u64,
    now: Timestamp,
    lease_until: Timestamp,
) -> Result<Option<Claim>, StoreFailure> {
    let Some(chosen) = reading::next(connection, memory_free, now).await? else { return Ok(None) };
    let reading::Place { id, memory_bytes, queued_at } = chosen;
    sql("UPDATE jobs SET state = 'running', attempt = attempt + 1, worker = $1, lease_until = $2, stage = NULL, \
         started_at = coalesce(started_at, $3), queue_ms = coalesce(queue_ms, 0) + $4 WHERE id = $5")
    .bind(worker)
    .bind(lease_until.0)
    .bind(now.0)
    .bind(super::millis(now.since(queued_at)))
    .bind(id.to_bytes())
    .execute(connection)
    .await?;
    let Some((job, (files, skeleton))) = whole(connection, id).await? else {
        // It would stand at the head of the queue for ever.
        end(connection, id, JobState::Failed, Some(&unreadable()), now).await?;
        return Ok(None);
    };
    append(connection, id, now, &[EventKind::State { state: JobState::Running, attempt: job.attempt }]).await?;
    sql(C::SERVED).bind(job.caller.name()).execute(connection).await?;
    let lease = Lease { job: id, attempt: job.attempt };
    let time_left = job.request.deadline.map(|deadline| Timestamp::from(deadline).since(now));
    Ok(Some(Claim { lease, files, skeleton, memory_bytes, time_left, job }))
}

type Places = (Vec<(FileInfo, BlobPlace)>, Option<BlobPlace>);

/// A job with all that its work needs; `None` when this version cannot read what another one wrote, or a file is gone.
async fn whole(connection: &mut impl Connection, id: JobId) -> Result<Option<(Job, Places)>, StoreFailure> {
    let row = sql("SELECT options, skeleton FROM jobs WHERE id = $1").bind(id.to_bytes()).one(connection).await?;
    let options = codec::parse(row.get("options")?, "options").and_then(|options| codec::options_from(&options));
    let (Ok(_), Some(job)) = (options, reading::snapshot(connection, id).await?) else { return Ok(None) };
    let mut files = Vec::with_capacity(job.request.files.len());
    for file in &job.request.files {
        let Some(place) = rows::blob(connection, &file.sha256).await? else { return Ok(None) };
        files.push((file.clone(), place));
    }
    let skeleton = match row.get::<Option<&[u8]>>("skeleton")? {
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
    connection: &mut impl Connection,
    leases: &[Lease],
    until: Timestamp,
) -> Result<Vec<LeaseState>, StoreFailure> {
    let mut states = Vec::with_capacity(leases.len());
    for lease in leases {
        let row = sql("UPDATE jobs SET lease_until = $1 WHERE id = $2 AND attempt = $3 AND state = 'running' \
             RETURNING cancel_requested")
        .bind(until.0)
        .bind(lease.job.to_bytes())
        .bind(i64::from(lease.attempt))
        .optional(connection)
        .await?;
        states.push(lease_state(row.map(|row| row.get("cancel_requested")).transpose()?));
    }
    Ok(states)
}

pub async fn look_at(connection: &mut impl Connection, leases: &[Lease]) -> Result<Vec<LeaseState>, StoreFailure> {
    let mut states = Vec::with_capacity(leases.len());
    for lease in leases {
        let row = sql("SELECT cancel_requested FROM jobs WHERE id = $1 AND attempt = $2 AND state = 'running'")
            .bind(lease.job.to_bytes())
            .bind(i64::from(lease.attempt))
            .optional(connection)
            .await?;
        states.push(lease_state(row.map(|row| row.get("cancel_requested")).transpose()?));
    }
    Ok(states)
}

pub async fn advance(
    connection: &mut impl Connection,
    lease: Lease,
    stage: Stage,
    now: Timestamp,
) -> Result<bool, StoreFailure> {
    let row = sql(
        "UPDATE jobs SET stage = $1, progress = CASE WHEN progress < $2 THEN $2 ELSE progress END WHERE id = $3 AND attempt = $4 AND state = 'running' \
         RETURNING progress",
    )
    .bind(stage.name())
    .bind(i64::from(stage.progress()))
    .bind(lease.job.to_bytes())
    .bind(i64::from(lease.attempt))
    .optional(connection)
    .await?;
    let Some(row) = row else { return Ok(false) };
    let progress = u8::try_from(row.get::<i64>("progress")?).unwrap_or(0);
    append(connection, lease.job, now, &[EventKind::Progress { stage, progress }]).await?;
    Ok(true)
}

pub async fn give_back<C: Connection>(connection: &mut C, lease: Lease, now: Timestamp) -> Result<bool, StoreFailure> {
    let held = format!("SELECT id FROM jobs WHERE id = $1 AND attempt = $2 AND state = 'running'{}", C::FOR_UPDATE);
    let held = sql(AssertSqlSafe(held)).bind(lease.job.to_bytes()).bind(i64::from(lease.attempt));
    if held.optional(connection).await?.is_none() {
        return Ok(false);
    }
    requeue(connection, lease.job, lease.attempt, 0, now).await?;
    Ok(true)
}

/// A running job waits again, after `losses` more lost workers.
pub async fn requeue(
    connection: &mut impl Connection,
    id: JobId,
    attempt: u32,
    losses: i64,
    now: Timestamp,
) -> Result<(), StoreFailure> {
    sql("UPDATE jobs SET state = 'queued', worker = NULL, lease_until = NULL, stage = NULL, queued_at = $1, \
         losses = losses + $2 WHERE id = $3")
    .bind(now.0)
    .bind(losses)
    .bind(id.to_bytes())
    .execute(connection)
    .await?;
    append(connection, id, now, &[EventKind::State { state: JobState::Queued, attempt }]).await
}
