//! How jobs end: by their work, by request, or not at all.

use super::{append, rows};
use crate::jobs::clock::Timestamp;
use crate::jobs::event::EventKind;
use crate::jobs::failure::JobError;
use crate::jobs::ids::JobId;
use crate::jobs::job::{JobResult, JobState};
use crate::jobs::store::{Change, EndedWithout, Ending, Finish, Lease, StoreFailure, codec};
use crate::jobs::submission::Caller;
use crate::storage::NewBlob;
use sqlx::{Row, SqliteConnection};

pub async fn finish(
    connection: &mut SqliteConnection,
    lease: Lease,
    ending: &Ending,
    now: Timestamp,
) -> Result<Finish, StoreFailure> {
    let held = sqlx::query(
        "UPDATE jobs SET stage = coalesce(?, stage), timings = ? WHERE id = ? AND attempt = ? AND state = 'running' \
         RETURNING retention_ms",
    )
    .bind(ending.stage.map(|stage| stage.name()))
    .bind(codec::timings(&ending.timings).to_string())
    .bind(lease.job.to_bytes().to_vec())
    .bind(i64::from(lease.attempt))
    .fetch_optional(&mut *connection)
    .await?;
    let Some(held) = held else { return Ok(Finish::Fenced) };
    let kept = match &ending.outcome {
        Ok((result, files)) => {
            let expires_at = Timestamp(now.0.saturating_add(held.try_get("retention_ms")?));
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
    connection: &mut SqliteConnection,
    id: JobId,
    result: &JobResult,
    files: &[NewBlob],
    now: Timestamp,
    expires_at: Timestamp,
) -> Result<Vec<String>, StoreFailure> {
    let kept = rows::name_blobs(connection, files, now).await?;
    rows::hold_blobs(connection, id, files.iter().map(|file| file.sha256)).await?;
    sqlx::query(
        "UPDATE jobs SET state = 'succeeded', progress = 100, finished_at = ?, expires_at = ?, result = ?, \
         worker = NULL, lease_until = NULL WHERE id = ?",
    )
    .bind(now.0)
    .bind(expires_at.0)
    .bind(codec::result(result).to_string())
    .bind(id.to_bytes().to_vec())
    .execute(&mut *connection)
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
    connection: &mut SqliteConnection,
    id: JobId,
    state: JobState,
    error: Option<&JobError>,
    now: Timestamp,
) -> Result<(), StoreFailure> {
    sqlx::query(
        "UPDATE jobs SET state = ?, error = ?, finished_at = ?, worker = NULL, lease_until = NULL \
         WHERE id = ? AND state IN ('queued', 'running')",
    )
    .bind(state.name())
    .bind(error.map(|error| codec::error(error).to_string()))
    .bind(now.0)
    .bind(id.to_bytes().to_vec())
    .execute(&mut *connection)
    .await?;
    append(connection, id, now, &[EventKind::Done { state, error: error.cloned() }]).await
}

/// A waiting job ends at once; a running one is asked to. Asking twice is asking once.
pub async fn cancel(
    connection: &mut SqliteConnection,
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
            sqlx::query("UPDATE jobs SET cancel_requested = 1 WHERE id = ?")
                .bind(id.to_bytes().to_vec())
                .execute(connection)
                .await?;
            Ok(Change::Requested)
        }
        Some(JobState::Canceled) => Ok(Change::Done),
        Some(state) => Ok(Change::State(state)),
    }
}

pub async fn delete(connection: &mut SqliteConnection, caller: &Caller, id: JobId) -> Result<Change, StoreFailure> {
    match rows::standing(connection, id, caller).await? {
        None => Ok(Change::NotFound),
        Some(JobState::Running) => Ok(Change::State(JobState::Running)),
        Some(_) => {
            sqlx::query("DELETE FROM jobs WHERE id = ?").bind(id.to_bytes().to_vec()).execute(connection).await?;
            Ok(Change::Done)
        }
    }
}
