//! What time brings: lost workers, deadlines, the end of results, records and keys.

use super::ending::end;
use super::{Columns, Connection, Lock, int, messages, millis, resumable, rows, sql, work};
use crate::jobs::clock::Timestamp;
use crate::jobs::failure::{ErrorCode, JobError};
use crate::jobs::job::JobState;
use crate::jobs::store::{BlobPlace, Duty, LOSSES_MAX, Memory, StoreFailure, Swept};
use sqlx::AssertSqlSafe;
use std::time::Duration;

/// Of an asset: no item of a batch waits to be rigged from it.
const NOT_AWAITED: &str = "NOT EXISTS (SELECT 1 FROM batch_items i WHERE i.asset = assets.id AND i.state = 'pending')";

/// Whether [`sweep`] would change anything.
pub async fn anything_due(
    connection: &mut impl Connection,
    memory: Memory,
    now: Timestamp,
) -> Result<bool, StoreFailure> {
    let due = sql(AssertSqlSafe(format!(
        "SELECT CAST(CASE WHEN EXISTS (SELECT 1 FROM jobs WHERE state = 'running' AND lease_until < $1) \
         OR EXISTS (SELECT 1 FROM jobs WHERE state = 'queued' AND deadline_at <= $1) \
         OR EXISTS (SELECT 1 FROM jobs WHERE state = 'succeeded' AND expires_at <= $1) \
         OR EXISTS (SELECT 1 FROM assets WHERE expires_at <= $1 AND {NOT_AWAITED}) \
         OR EXISTS (SELECT 1 FROM idempotency WHERE expires_at <= $1) \
         OR EXISTS (SELECT 1 FROM uploads WHERE is_open = 1 AND expires_at <= $1) \
         OR EXISTS (SELECT 1 FROM uploads WHERE expires_at <= $2) \
         OR EXISTS (SELECT 1 FROM jobs WHERE finished_at <= $2) \
         OR EXISTS (SELECT 1 FROM batches WHERE finished_at <= $2) \
         OR EXISTS (SELECT 1 FROM webhook_messages WHERE at <= $4) \
         OR (SELECT count(*) FROM (SELECT 1 FROM jobs LIMIT $3) known) >= $3 \
         THEN 1 ELSE 0 END AS BIGINT) AS due"
    )))
    .bind(now.0)
    .bind(now.0.saturating_sub(millis(memory.records_time)))
    .bind(int(memory.records_max as u64).saturating_add(1))
    .bind(messages::forgotten_before(now))
    .one(connection)
    .await?;
    Ok(due.get::<i64>("due")? != 0)
}

pub async fn sweep(connection: &mut impl Connection, memory: Memory, now: Timestamp) -> Result<Swept, StoreFailure> {
    let mut swept = Swept::default();
    if !connection.lock(Lock::Upkeep).await? {
        return Ok(swept);
    }
    lose(connection, now, now, &mut swept).await?;
    give_up_waiting(connection, now, &mut swept).await?;
    let expired = sql("UPDATE jobs SET state = 'expired' WHERE state = 'succeeded' AND expires_at <= $1 RETURNING id")
        .bind(now.0)
        .all(connection)
        .await?;
    for row in &expired {
        swept.changed.push(rows::job_id(row)?);
    }
    let assets = sql(AssertSqlSafe(format!("DELETE FROM assets WHERE expires_at <= $1 AND {NOT_AWAITED}")))
        .bind(now.0)
        .execute(connection)
        .await?;
    sql("DELETE FROM idempotency WHERE expires_at <= $1").bind(now.0).execute(connection).await?;
    messages::forget(connection, now).await?;
    let uploads = resumable::expire(connection, now).await?;
    let forgotten = forget(connection, memory, now).await?;
    swept.freed |= !expired.is_empty() || assets > 0 || uploads > 0 || forgotten > 0;
    Ok(swept)
}

/// Jobs whose lease ends before `before` have lost their worker.
pub async fn lose<C: Connection>(
    connection: &mut C,
    before: Timestamp,
    now: Timestamp,
    swept: &mut Swept,
) -> Result<(), StoreFailure> {
    let lost = format!(
        "SELECT id, attempt, losses, cancel_requested FROM jobs WHERE state = 'running' AND lease_until < $1{}",
        C::FOR_UPDATE_SKIP_LOCKED
    );
    let lost = sql(AssertSqlSafe(lost)).bind(before.0).all(connection).await?;
    for row in &lost {
        let id = rows::job_id(row)?;
        let losses = row.get::<i64>("losses")? + 1;
        if row.get::<i64>("cancel_requested")? != 0 {
            end(connection, id, JobState::Canceled, None, now).await?;
        } else if losses >= i64::from(LOSSES_MAX) {
            end(connection, id, JobState::Failed, Some(&worker_lost()), now).await?;
        } else {
            let attempt = u32::try_from(row.get::<i64>("attempt")?).unwrap_or(u32::MAX);
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

async fn give_up_waiting<C: Connection>(
    connection: &mut C,
    now: Timestamp,
    swept: &mut Swept,
) -> Result<(), StoreFailure> {
    let late = format!("SELECT id FROM jobs WHERE state = 'queued' AND deadline_at <= $1{}", C::FOR_UPDATE_SKIP_LOCKED);
    let late = sql(AssertSqlSafe(late)).bind(now.0).all(connection).await?;
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
async fn forget(connection: &mut impl Connection, memory: Memory, now: Timestamp) -> Result<u64, StoreFailure> {
    let old = sql("DELETE FROM jobs WHERE finished_at <= $1")
        .bind(now.0.saturating_sub(millis(memory.records_time)))
        .execute(connection)
        .await?;
    sql("DELETE FROM batches WHERE finished_at <= $1")
        .bind(now.0.saturating_sub(millis(memory.records_time)))
        .execute(connection)
        .await?;
    sql("DELETE FROM uploads WHERE expires_at <= $1")
        .bind(now.0.saturating_sub(millis(memory.records_time)))
        .execute(connection)
        .await?;
    // Counted only where there is a bound: a large table takes its time.
    if memory.records_max == usize::MAX {
        return Ok(old);
    }
    let known: i64 = sql("SELECT count(*) AS known FROM jobs").one(connection).await?.get("known")?;
    let surplus = known.saturating_sub(int(memory.records_max as u64));
    if surplus <= 0 {
        return Ok(old);
    }
    let forgotten = sql(
        "DELETE FROM jobs WHERE id IN (SELECT id FROM jobs WHERE finished_at IS NOT NULL ORDER BY finished_at, id \
         LIMIT $1)",
    )
    .bind(surplus)
    .execute(connection)
    .await?;
    Ok(old + forgotten)
}

/// Ends what was kept longest without being used: a result, or an asset that no job needs.
pub async fn expire_oldest<C: Connection>(connection: &mut C) -> Result<bool, StoreFailure> {
    let job = sql("SELECT id, finished_at AS at FROM jobs WHERE state = 'succeeded' ORDER BY finished_at, id LIMIT 1")
        .optional(connection)
        .await?;
    let oldest = format!("SELECT id, used_at AS at FROM assets WHERE {NOT_AWAITED} ORDER BY used_at, id LIMIT 1");
    let asset = sql(AssertSqlSafe(oldest)).optional(connection).await?;
    let at = |row: &C::Row| row.get::<i64>("at");
    let query = match (&job, &asset) {
        (None, None) => return Ok(false),
        (Some(job), Some(asset)) if at(asset)? < at(job)? => "DELETE FROM assets WHERE id = $1",
        (Some(_), _) => "UPDATE jobs SET state = 'expired' WHERE id = $1",
        (None, Some(_)) => "DELETE FROM assets WHERE id = $1",
    };
    let row = if query.starts_with("DELETE") { asset } else { job };
    let id: Vec<u8> = row.map(|row| row.get("id")).transpose()?.unwrap_or_default();
    sql(query).bind(id).execute(connection).await?;
    Ok(true)
}

/// Forgets blobs that nothing needs: no asset, no job that waits or runs, no result that is kept, and no open upload. An upload that
/// came with its job is needed as long as such a job is there.
pub async fn collect(connection: &mut impl Connection) -> Result<Vec<BlobPlace>, StoreFailure> {
    if !connection.lock(Lock::Upkeep).await? {
        return Ok(Vec::new());
    }
    connection.lock(Lock::Forgetting).await?;
    sql(AssertSqlSafe(format!(
        "DELETE FROM assets WHERE explicit = 0 AND {NOT_AWAITED} AND NOT EXISTS (SELECT 1 FROM jobs \
         WHERE jobs.asset = assets.id AND jobs.state IN ('queued', 'running', 'succeeded'))"
    )))
    .execute(connection)
    .await?;
    let forgotten =
        sql("DELETE FROM blobs WHERE NOT EXISTS (SELECT 1 FROM asset_blobs a WHERE a.sha256 = blobs.sha256) \
         AND NOT EXISTS (SELECT 1 FROM upload_parts p WHERE p.sha256 = blobs.sha256) \
         AND NOT EXISTS (SELECT 1 FROM job_blobs b JOIN jobs j ON j.id = b.job \
         WHERE b.sha256 = blobs.sha256 AND j.state IN ('queued', 'running', 'succeeded')) RETURNING location, bytes")
        .all(connection)
        .await?;
    forgotten.iter().map(rows::place).collect()
}

/// Gives the turn at a duty to one process, once in `every`.
pub async fn take_turn(
    connection: &mut impl Connection,
    duty: Duty,
    every: Duration,
    now: Timestamp,
) -> Result<bool, StoreFailure> {
    let taken = sql("INSERT INTO duties (name, due_at) VALUES ($1, $2) \
         ON CONFLICT (name) DO UPDATE SET due_at = excluded.due_at WHERE duties.due_at <= $3")
    .bind(duty.name())
    .bind(now.after(every).0)
    .bind(now.0)
    .execute(connection)
    .await?;
    Ok(taken > 0)
}
