//! How jobs end: by their work, by request, or not at all.

use super::{Columns, Connection, Lock, append, rows, sql};
use crate::jobs::clock::Timestamp;
use crate::jobs::event::EventKind;
use crate::jobs::failure::JobError;
use crate::jobs::ids::JobId;
use crate::jobs::job::{JobResult, JobState};
use crate::jobs::store::{Change, EndedWithout, Ending, Finish, Lease, StoreFailure, codec};
use crate::jobs::submission::Caller;
use crate::storage::NewBlob;

pub async fn finish(
    connection: &mut impl Connection,
    lease: Lease,
    ending: &Ending,
    now: Timestamp,
) -> Result<Finish, StoreFailure> {
    if ending.outcome.is_ok() {
        connection.lock(Lock::Naming).await?;
    }
    let held = sql(
        "UPDATE jobs SET stage = coalesce($1, stage), timings = $2 WHERE id = $3 AND attempt = $4 AND state = 'running' \
         RETURNING retention_ms",
    )
    .bind(ending.stage.map(|stage| stage.name()))
    .bind(codec::timings(&ending.timings).to_string())
    .bind(lease.job.to_bytes())
    .bind(i64::from(lease.attempt))
    .optional(connection)
    .await?;
    let Some(held) = held else { return Ok(Finish::Fenced) };
    let kept = match &ending.outcome {
        Ok((result, files)) => {
            let expires_at = Timestamp(now.0.saturating_add(held.get("retention_ms")?));
            succeed(connection, lease.job, result, files, now, expires_at).await?
        }
        Err(EndedWithout::Canceled) => {
            end(connection, lease.job, JobState::Canceled, None, now).await?;
            Vec::new()
        }
        Err(EndedWithout::Failed(error)) => {
            end(connection, lease.job, JobState::Failed, Some(error), now).await?;
            Vec::new()
        }
    };
    Ok(Finish::Done { kept })
}

async fn succeed(
    connection: &mut impl Connection,
    id: JobId,
    result: &JobResult,
    files: &[NewBlob],
    now: Timestamp,
    expires_at: Timestamp,
) -> Result<Vec<String>, StoreFailure> {
    let kept = rows::name_blobs(connection, files, now).await?;
    rows::hold_blobs(connection, id, files.iter().map(|file| file.sha256)).await?;
    sql("UPDATE jobs SET state = 'succeeded', progress = 100, finished_at = $1, expires_at = $2, result = $3, \
         worker = NULL, lease_until = NULL WHERE id = $4")
    .bind(now.0)
    .bind(expires_at.0)
    .bind(codec::result(result).to_string())
    .bind(id.to_bytes())
    .execute(connection)
    .await?;
    append(connection, id, now, &success(result)).await?;
    Ok(kept)
}

/// The last events of a job that succeeds.
pub fn success(result: &JobResult) -> Vec<EventKind> {
    let warnings = result.findings.iter().cloned().map(EventKind::Warning);
    let artifacts = result.artifacts.iter().cloned().map(EventKind::Artifact);
    let done = EventKind::Done { state: JobState::Succeeded, error: None };
    warnings.chain(artifacts).chain([done]).collect()
}

/// Ends a job that waits or runs, without a result.
pub async fn end(
    connection: &mut impl Connection,
    id: JobId,
    state: JobState,
    error: Option<&JobError>,
    now: Timestamp,
) -> Result<(), StoreFailure> {
    sql("UPDATE jobs SET state = $1, error = $2, finished_at = $3, worker = NULL, lease_until = NULL \
         WHERE id = $4 AND state IN ('queued', 'running')")
    .bind(state.name())
    .bind(error.map(|error| codec::error(error).to_string()))
    .bind(now.0)
    .bind(id.to_bytes())
    .execute(connection)
    .await?;
    append(connection, id, now, &[EventKind::Done { state, error: error.cloned() }]).await
}

/// A waiting job ends at once; a running one is asked to. Asking twice is asking once.
pub async fn cancel(
    connection: &mut impl Connection,
    caller: &Caller,
    id: JobId,
    now: Timestamp,
) -> Result<Change, StoreFailure> {
    match rows::standing(connection, id, caller).await? {
        None => Ok(Change::NotFound),
        Some(JobState::Queued) => {
            end(connection, id, JobState::Canceled, None, now).await?;
            Ok(Change::Done)
        }
        Some(JobState::Running) => {
            sql("UPDATE jobs SET cancel_requested = 1 WHERE id = $1").bind(id.to_bytes()).execute(connection).await?;
            Ok(Change::Requested)
        }
        Some(JobState::Canceled) => Ok(Change::Done),
        Some(state) => Ok(Change::State(state)),
    }
}

pub async fn delete(connection: &mut impl Connection, caller: &Caller, id: JobId) -> Result<Change, StoreFailure> {
    match rows::standing(connection, id, caller).await? {
        None => Ok(Change::NotFound),
        Some(JobState::Running) => Ok(Change::State(JobState::Running)),
        Some(_) => {
            sql("DELETE FROM jobs WHERE id = $1").bind(id.to_bytes()).execute(connection).await?;
            Ok(Change::Done)
        }
    }
}
