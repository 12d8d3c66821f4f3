//! Batches and their items.

use super::{Columns, Connection, int, messages, rows, sql};
use crate::jobs::batch::{
    Batch, BatchCounts, BatchItem, ItemState, NewBatch, NewItem, OpenBatch, PendingItem, Settled,
};
use crate::jobs::clock::Timestamp;
use crate::jobs::ids::{BatchId, JobId};
use crate::jobs::job::JobState;
use crate::jobs::store::{StoreFailure, codec};
use crate::jobs::submission::Caller;
use sqlx::AssertSqlSafe;
use std::time::SystemTime;

/// Items written by one statement.
const ROWS: usize = 200;
const COLUMNS: usize = 7;

/// Writes a batch down, whole.
pub async fn create(connection: &mut impl Connection, new: &NewBatch, now: Timestamp) -> Result<BatchId, StoreFailure> {
    let id = BatchId::new();
    sql("INSERT INTO batches (id, caller, jobs_max, created_at) VALUES ($1, $2, $3, $4)")
        .bind(id.to_bytes())
        .bind(new.caller.name())
        .bind(new.jobs_max.map(|jobs| int(jobs as u64)))
        .bind(now.0)
        .execute(connection)
        .await?;
    for (chunk, items) in new.items.chunks(ROWS).enumerate() {
        let row = |row: usize| {
            let values: Vec<String> = (1..=COLUMNS).map(|column| format!("${}", row * COLUMNS + column)).collect();
            format!("({})", values.join(", "))
        };
        let rows: Vec<String> = (0..items.len()).map(row).collect();
        let text = format!(
            "INSERT INTO batch_items (batch, position, custom_id, request, asset, state, error) VALUES {}",
            rows.join(", ")
        );
        let mut statement = sql(AssertSqlSafe(text));
        for (position, item) in (chunk * ROWS..).zip(items) {
            let NewItem { custom_id, request, asset, error } = item;
            statement = statement
                .bind(id.to_bytes())
                .bind(int(position as u64))
                .bind(custom_id.as_str())
                .bind(request.as_str())
                .bind(asset.map(|asset| asset.to_bytes()))
                .bind(if error.is_some() { "failed" } else { "pending" })
                .bind(error.as_deref());
        }
        statement.execute(connection).await?;
    }
    Ok(id)
}

const BATCH: &str = "SELECT id, created_at, canceled_at, finished_at FROM batches ";

pub async fn batch(
    connection: &mut impl Connection,
    caller: &Caller,
    id: BatchId,
) -> Result<Option<Batch>, StoreFailure> {
    let row = sql(AssertSqlSafe(format!("{BATCH}WHERE id = $1 AND caller = $2")))
        .bind(id.to_bytes())
        .bind(caller.name())
        .optional(connection)
        .await?;
    match row {
        Some(row) => read(connection, &row).await.map(Some),
        None => Ok(None),
    }
}

/// Newest first, older than `before`.
pub async fn list<C: Connection>(
    connection: &mut C,
    caller: &Caller,
    before: Option<BatchId>,
    count: usize,
) -> Result<Vec<Batch>, StoreFailure> {
    let last = before.map_or([u8::MAX; 16], BatchId::to_bytes);
    let rows = sql(AssertSqlSafe(format!("{BATCH}WHERE caller = $1 AND id < $2 ORDER BY id DESC LIMIT $3")))
        .bind(caller.name())
        .bind(last)
        .bind(int(count as u64))
        .all(connection)
        .await?;
    let mut batches = Vec::with_capacity(rows.len());
    for row in &rows {
        batches.push(read(connection, row).await?);
    }
    Ok(batches)
}

async fn read<C: Connection>(connection: &mut C, row: &C::Row) -> Result<Batch, StoreFailure> {
    let time = |column| Ok::<_, StoreFailure>(row.get::<Option<i64>>(column)?.map(Timestamp).map(SystemTime::from));
    let id = batch_id(row)?;
    let created_at = SystemTime::from(Timestamp(row.get("created_at")?));
    let (canceled_at, finished_at) = (time("canceled_at")?, time("finished_at")?);
    Ok(Batch { id, created_at, canceled_at, finished_at, counts: counts(connection, id).await? })
}

fn batch_id(row: &impl Columns) -> Result<BatchId, StoreFailure> {
    Ok(BatchId::from_bytes(rows::bytes(row.get("id")?)?))
}

async fn counts(connection: &mut impl Connection, id: BatchId) -> Result<BatchCounts, StoreFailure> {
    let rows = sql("SELECT i.state AS state, j.state AS job_state, count(*) AS items FROM batch_items i \
         LEFT JOIN jobs j ON j.id = i.job AND i.state = 'job' WHERE i.batch = $1 GROUP BY i.state, j.state")
    .bind(id.to_bytes())
    .all(connection)
    .await?;
    let mut counts = BatchCounts::default();
    for row in &rows {
        counts.add(state(row)?, usize::try_from(row.get::<i64>("items")?).unwrap_or(0));
    }
    Ok(counts)
}

/// The state of an item, with that of its job beside it. A job that was deleted has failed its item.
fn state(row: &impl Columns) -> Result<ItemState, StoreFailure> {
    Ok(match row.get::<&str>("state")? {
        "pending" => ItemState::Pending,
        "job" => {
            let job = row.get::<Option<&str>>("job_state")?.map(codec::state_from).transpose()?;
            ItemState::Job(job.unwrap_or(JobState::Failed))
        }
        ended => ItemState::Job(codec::state_from(ended)?),
    })
}

/// Items from `first` on, in order.
pub async fn items<C: Connection>(
    connection: &mut C,
    id: BatchId,
    first: usize,
    count: usize,
) -> Result<Vec<BatchItem>, StoreFailure> {
    let rows = sql("SELECT i.position, i.custom_id, i.state AS state, i.job, i.error, j.state AS job_state \
         FROM batch_items i LEFT JOIN jobs j ON j.id = i.job AND i.state = 'job' \
         WHERE i.batch = $1 AND i.position >= $2 ORDER BY i.position LIMIT $3")
    .bind(id.to_bytes())
    .bind(int(first as u64))
    .bind(int(count as u64))
    .all(connection)
    .await?;
    let item = |row: &C::Row| {
        let job = row.get::<Option<&[u8]>>("job")?.map(rows::bytes).transpose()?.map(JobId::from_bytes);
        Ok(BatchItem {
            position: position(row)?,
            custom_id: row.get("custom_id")?,
            state: state(row)?,
            job,
            error: row.get("error")?,
        })
    };
    rows.iter().map(item).collect()
}

fn position(row: &impl Columns) -> Result<usize, StoreFailure> {
    Ok(usize::try_from(row.get::<i64>("position")?).unwrap_or(0))
}

/// Batches that are not over, oldest first.
pub async fn open<C: Connection>(connection: &mut C) -> Result<Vec<OpenBatch>, StoreFailure> {
    let rows =
        sql("SELECT id, caller, jobs_max FROM batches WHERE finished_at IS NULL ORDER BY id").all(connection).await?;
    let open = |row: &C::Row| {
        let jobs_max = row.get::<Option<i64>>("jobs_max")?;
        Ok(OpenBatch {
            id: batch_id(row)?,
            caller: Caller::named(row.get("caller")?),
            jobs_max: jobs_max.and_then(|jobs| usize::try_from(jobs).ok()),
        })
    };
    rows.iter().map(open).collect()
}

/// The first items that are no job yet.
pub async fn pending(
    connection: &mut impl Connection,
    id: BatchId,
    count: usize,
) -> Result<Vec<PendingItem>, StoreFailure> {
    let rows = sql("SELECT position, request FROM batch_items WHERE batch = $1 AND state = 'pending' \
         ORDER BY position LIMIT $2")
    .bind(id.to_bytes())
    .bind(int(count as u64))
    .all(connection)
    .await?;
    rows.iter().map(|row| Ok(PendingItem { position: position(row)?, request: row.get("request")? })).collect()
}

/// What became of an item; nothing changes when that is known already, or when the batch was canceled. `false`: so it was.
pub async fn settle(
    connection: &mut impl Connection,
    id: BatchId,
    position: usize,
    settled: &Settled,
) -> Result<bool, StoreFailure> {
    let (state, job, error) = match settled {
        Settled::Job(job) => ("job", Some(job.to_bytes()), None),
        Settled::Refused(error) => ("failed", None, Some(error.as_str())),
    };
    let changed = sql("UPDATE batch_items SET state = $1, job = $2, error = $3 \
         WHERE batch = $4 AND position = $5 AND state = 'pending'")
    .bind(state)
    .bind(job)
    .bind(error)
    .bind(id.to_bytes())
    .bind(int(position as u64))
    .execute(connection)
    .await?;
    Ok(changed > 0)
}

/// No pending item becomes a job any more. The jobs that are not over; `None`: there is no such batch.
pub async fn cancel(
    connection: &mut impl Connection,
    caller: &Caller,
    id: BatchId,
    now: Timestamp,
) -> Result<Option<Vec<JobId>>, StoreFailure> {
    let found = sql("UPDATE batches SET canceled_at = COALESCE(canceled_at, $1) WHERE id = $2 AND caller = $3 \
         AND finished_at IS NULL")
    .bind(now.0)
    .bind(id.to_bytes())
    .bind(caller.name())
    .execute(connection)
    .await?;
    if found == 0 {
        let known = batch(connection, caller, id).await?;
        return Ok(known.map(|_| Vec::new()));
    }
    sql("UPDATE batch_items SET state = 'canceled' WHERE batch = $1 AND state = 'pending'")
        .bind(id.to_bytes())
        .execute(connection)
        .await?;
    let rows = sql("SELECT j.id AS id FROM batch_items i JOIN jobs j ON j.id = i.job \
         WHERE i.batch = $1 AND i.state = 'job' AND j.state IN ('queued', 'running')")
    .bind(id.to_bytes())
    .all(connection)
    .await?;
    rows.iter().map(rows::job_id).collect::<Result<_, _>>().map(Some)
}

/// Items whose jobs are over end as they did; batches without open items are over. Gives those.
pub async fn conclude(connection: &mut impl Connection, now: Timestamp) -> Result<Vec<BatchId>, StoreFailure> {
    sql("UPDATE batch_items SET state = (SELECT CASE j.state WHEN 'expired' THEN 'succeeded' ELSE j.state END \
         FROM jobs j WHERE j.id = batch_items.job) WHERE state = 'job' AND EXISTS (SELECT 1 FROM jobs j \
         WHERE j.id = batch_items.job AND j.state NOT IN ('queued', 'running'))")
    .execute(connection)
    .await?;
    sql("UPDATE batch_items SET state = 'failed' WHERE state = 'job' \
         AND NOT EXISTS (SELECT 1 FROM jobs j WHERE j.id = batch_items.job)")
    .execute(connection)
    .await?;
    let over = sql("UPDATE batches SET finished_at = $1 WHERE finished_at IS NULL AND NOT EXISTS (SELECT 1 \
         FROM batch_items i WHERE i.batch = batches.id AND i.state IN ('pending', 'job')) RETURNING id, caller")
    .bind(now.0)
    .all(connection)
    .await?;
    let mut ids = Vec::with_capacity(over.len());
    for row in &over {
        let id = batch_id(row)?;
        messages::of_batch(connection, &Caller::named(row.get("caller")?), id, now).await?;
        ids.push(id);
    }
    Ok(ids)
}
