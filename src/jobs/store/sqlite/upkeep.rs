//! What time brings: lost workers, deadlines, the end of results, records and keys.

use super::ending::end;
use super::{millis, rows, work};
use crate::jobs::clock::Timestamp;
use crate::jobs::failure::{ErrorCode, JobError};
use crate::jobs::job::JobState;
use crate::jobs::store::{BlobPlace, LOSSES_MAX, Memory, StoreFailure, Swept};
use sqlx::sqlite::SqlitePool;
use sqlx::{Row, SqliteConnection};

/// Whether [`sweep`] would change anything.
pub async fn anything_due(readers: &SqlitePool, memory: Memory, now: Timestamp) -> Result<bool, StoreFailure> {
    let due: i64 = sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM jobs WHERE state = 'running' AND lease_until < ?1) \
         OR EXISTS (SELECT 1 FROM jobs WHERE state = 'queued' AND deadline_at <= ?1) \
         OR EXISTS (SELECT 1 FROM jobs WHERE state = 'succeeded' AND expires_at <= ?1) \
         OR EXISTS (SELECT 1 FROM assets WHERE expires_at <= ?1) \
         OR EXISTS (SELECT 1 FROM idempotency WHERE expires_at <= ?1) \
         OR EXISTS (SELECT 1 FROM jobs WHERE finished_at <= ?2) \
         OR (SELECT count(*) FROM jobs) > ?3",
    )
    .bind(now.0)
    .bind(now.0.saturating_sub(millis(memory.records_time)))
    .bind(super::int(memory.records_max as u64))
    .fetch_one(readers)
    .await?;
    Ok(due != 0)
}

pub async fn sweep(connection: &mut SqliteConnection, memory: Memory, now: Timestamp) -> Result<Swept, StoreFailure> {
    let mut swept = Swept::default();
    lose(connection, now, now, &mut swept).await?;
    give_up_waiting(connection, now, &mut swept).await?;
    let expired =
        sqlx::query("UPDATE jobs SET state = 'expired' WHERE state = 'succeeded' AND expires_at <= ? RETURNING id")
            .bind(now.0)
            .fetch_all(&mut *connection)
            .await?;
    for row in &expired {
        swept.changed.push(rows::job_id(row)?);
    }
    let assets = sqlx::query("DELETE FROM assets WHERE expires_at <= ?").bind(now.0).execute(&mut *connection).await?;
    sqlx::query("DELETE FROM idempotency WHERE expires_at <= ?").bind(now.0).execute(&mut *connection).await?;
    let forgotten = forget(connection, memory, now).await?;
    swept.freed |= !expired.is_empty() || assets.rows_affected() > 0 || forgotten > 0;
    Ok(swept)
}

/// Jobs whose lease ends before `before` have lost their worker.
pub async fn lose(
    connection: &mut SqliteConnection,
    before: Timestamp,
    now: Timestamp,
    swept: &mut Swept,
) -> Result<(), StoreFailure> {
    let lost = sqlx::query(
        "SELECT id, attempt, losses, cancel_requested FROM jobs WHERE state = 'running' AND lease_until < ?",
    )
    .bind(before.0)
    .fetch_all(&mut *connection)
    .await?;
    for row in &lost {
        let id = rows::job_id(row)?;
        let losses = row.try_get::<i64, _>("losses")? + 1;
        if row.try_get::<i64, _>("cancel_requested")? != 0 {
            end(connection, id, JobState::Canceled, None, now).await?;
        } else if losses >= i64::from(LOSSES_MAX) {
            end(connection, id, JobState::Failed, Some(&worker_lost()), now).await?;
        } else {
            let attempt = u32::try_from(row.try_get::<i64, _>("attempt")?).unwrap_or(u32::MAX);
            work::requeue(connection, id, attempt, 1, now).await?;
            swept.requeued += 1;
        }
        swept.changed.push(id);
        swept.freed = true;
    }
    Ok(())
}

fn worker_lost() -> JobError {
    JobError::new(ErrorCode::WorkerLost, format!("{LOSSES_MAX} workers in turn ended before they had done the job"))
        .hint("send the request again; if it fails so again, report this as a bug, with the file")
}

async fn give_up_waiting(
    connection: &mut SqliteConnection,
    now: Timestamp,
    swept: &mut Swept,
) -> Result<(), StoreFailure> {
    let late = sqlx::query("SELECT id FROM jobs WHERE state = 'queued' AND deadline_at <= ?")
        .bind(now.0)
        .fetch_all(&mut *connection)
        .await?;
    for row in &late {
        let id = rows::job_id(row)?;
        let error = JobError::new(ErrorCode::Timeout, "the deadline passed while the job waited")
            .hint("send it again with a later deadline");
        end(connection, id, JobState::Failed, Some(&error), now).await?;
        swept.changed.push(id);
        swept.freed = true;
    }
    Ok(())
}

/// Forgets final jobs that are old, and the oldest ones when there are too many. Gives their number.
async fn forget(connection: &mut SqliteConnection, memory: Memory, now: Timestamp) -> Result<u64, StoreFailure> {
    let old = sqlx::query("DELETE FROM jobs WHERE finished_at <= ?")
        .bind(now.0.saturating_sub(millis(memory.records_time)))
        .execute(&mut *connection)
        .await?;
    let surplus = sqlx::query(
        "DELETE FROM jobs WHERE id IN (SELECT id FROM jobs WHERE finished_at IS NOT NULL ORDER BY finished_at, id \
         LIMIT max(0, (SELECT count(*) FROM jobs) - ?))",
    )
    .bind(super::int(memory.records_max as u64))
    .execute(connection)
    .await?;
    Ok(old.rows_affected() + surplus.rows_affected())
}

/// Ends what was kept longest without being used: a result, or an asset that no job needs.
pub async fn expire_oldest(connection: &mut SqliteConnection) -> Result<bool, StoreFailure> {
    let job = sqlx::query(
        "SELECT id, finished_at AS at FROM jobs WHERE state = 'succeeded' ORDER BY finished_at, id LIMIT 1",
    )
    .fetch_optional(&mut *connection)
    .await?;
    let asset = sqlx::query("SELECT id, used_at AS at FROM assets ORDER BY used_at, id LIMIT 1")
        .fetch_optional(&mut *connection)
        .await?;
    let at = |row: &sqlx::sqlite::SqliteRow| row.try_get::<i64, _>("at");
    let query = match (&job, &asset) {
        (None, None) => return Ok(false),
        (Some(job), Some(asset)) if at(asset)? < at(job)? => "DELETE FROM assets WHERE id = ?",
        (Some(_), _) => "UPDATE jobs SET state = 'expired' WHERE id = ?",
        (None, Some(_)) => "DELETE FROM assets WHERE id = ?",
    };
    let row = if query.starts_with("DELETE") { asset } else { job };
    let id: Vec<u8> = row.map(|row| row.try_get("id")).transpose()?.unwrap_or_default();
    sqlx::query(query).bind(id).execute(connection).await?;
    Ok(true)
}

/// Forgets blobs that nothing needs: no asset, no job that waits or runs, and no result that is kept. An upload that
/// came with its job is needed as long as such a job is there.
pub async fn collect(connection: &mut SqliteConnection) -> Result<Vec<BlobPlace>, StoreFailure> {
    sqlx::query(
        "DELETE FROM assets WHERE explicit = 0 AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.asset = assets.id \
         AND jobs.state IN ('queued', 'running', 'succeeded'))",
    )
    .execute(&mut *connection)
    .await?;
    let forgotten = sqlx::query(
        "DELETE FROM blobs WHERE NOT EXISTS (SELECT 1 FROM asset_blobs a WHERE a.sha256 = blobs.sha256) \
         AND NOT EXISTS (SELECT 1 FROM job_blobs b JOIN jobs j ON j.id = b.job \
         WHERE b.sha256 = blobs.sha256 AND j.state IN ('queued', 'running', 'succeeded')) RETURNING location, bytes",
    )
    .fetch_all(connection)
    .await?;
    forgotten.iter().map(rows::place).collect()
}
