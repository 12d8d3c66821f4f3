//! Rows of the tables as the values that they hold.

use super::{Columns, Connection, int, sql};
use crate::jobs::clock::Timestamp;
use crate::jobs::ids::{AssetId, JobId};
use crate::jobs::job::{Job, JobRequest, JobState};
use crate::jobs::options::RigOptions;
use crate::jobs::stage::Stage;
use crate::jobs::store::{BlobPlace, StoreFailure, codec};
use crate::jobs::submission::{Caller, Priority};
use crate::jobs::webhooks::JobWebhook;
use crate::storage::NewBlob;
use sqlx::AssertSqlSafe;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

/// All columns that [`job`] reads.
pub const JOB: &str = "SELECT id, caller, client_id, options, labels, files, skeleton, asset, priority, timeout_ms, \
     retention_ms, deadline_at, state, stage, progress, cancel_requested, sequence, attempt, created_at, started_at, \
     finished_at, expires_at, queue_ms, timings, result, error, cached, webhook FROM jobs ";

pub fn bytes<const N: usize>(bytes: &[u8]) -> Result<[u8; N], StoreFailure> {
    bytes.try_into().map_err(|_| StoreFailure::new(&"an id or a digest cannot be read back"))
}

pub fn job_id(row: &impl Columns) -> Result<JobId, StoreFailure> {
    Ok(JobId::from_bytes(bytes(row.get("id")?)?))
}

pub fn priority_from(number: i64) -> Priority {
    match number {
        ..0 => Priority::Low,
        0 => Priority::Normal,
        1.. => Priority::High,
    }
}

pub fn priority(priority: Priority) -> i64 {
    match priority {
        Priority::Low => -1,
        Priority::Normal => 0,
        Priority::High => 1,
    }
}

fn duration(millis: i64) -> Duration {
    Duration::from_millis(u64::try_from(millis).unwrap_or(0))
}

/// A row of [`JOB`]. Its place in the queue is not in the row.
pub fn job(row: &impl Columns) -> Result<Job, StoreFailure> {
    let time = |column| Ok::<_, StoreFailure>(row.get::<Option<i64>>(column)?.map(Timestamp).map(SystemTime::from));
    let json = |column| row.get::<Option<&str>>(column)?.map(|text| codec::parse(text, column)).transpose();
    let state = codec::state_from(row.get("state")?)?;
    let result = json("result")?.map(|result| codec::result_from(&result)).transpose()?;
    let stage = row.get::<Option<&str>>("stage")?.and_then(Stage::named);
    let created_at = SystemTime::from(Timestamp(row.get("created_at")?));
    Ok(Job {
        id: job_id(row)?,
        caller: Caller::named(row.get("caller")?),
        state,
        stage,
        progress: u8::try_from(row.get::<i64>("progress")?).unwrap_or(0),
        queue_position: None,
        cancel_requested: row.get::<i64>("cancel_requested")? != 0,
        attempt: u32::try_from(row.get::<i64>("attempt")?).unwrap_or(u32::MAX),
        created_at,
        started_at: time("started_at")?,
        finished_at: time("finished_at")?,
        expires_at: time("expires_at")?,
        request: Arc::new(request(row)?),
        queue_time: row.get::<Option<i64>>("queue_ms")?.map(duration),
        timings: json("timings")?.map(|timings| codec::timings_from(&timings)).unwrap_or_default(),
        result: result.map(Arc::new),
        error: json("error")?.map(|error| codec::error_from(&error)),
        cached: row.get::<i64>("cached")? != 0,
        sequence: u64::try_from(row.get::<i64>("sequence")?).unwrap_or(0),
    })
}

fn request(row: &impl Columns) -> Result<JobRequest, StoreFailure> {
    let json = |column: &str| codec::parse(row.get(column)?, column);
    let asset = row.get::<Option<&[u8]>>("asset")?.map(bytes).transpose()?.map(AssetId::from_bytes);
    let deadline = row.get::<Option<i64>>("deadline_at")?.map(Timestamp).map(SystemTime::from);
    // Options that this version does not know any more: the job stays readable, and is not worked on.
    let options = codec::options_from(&json("options")?).unwrap_or_else(|_| RigOptions::default());
    Ok(JobRequest {
        options,
        files: codec::files_from(&json("files")?)?,
        asset,
        priority: priority_from(row.get("priority")?),
        labels: codec::labels_from(&json("labels")?),
        timeout: duration(row.get("timeout_ms")?),
        deadline,
        retention: duration(row.get("retention_ms")?),
        client_id: row.get("client_id")?,
        skeleton_given: row.get::<Option<&[u8]>>("skeleton")?.is_some(),
        webhook: webhook(row)?,
    })
}

/// Where a job wants told what becomes of it.
pub fn webhook(row: &impl Columns) -> Result<Option<JobWebhook>, StoreFailure> {
    let text = row.get::<Option<&str>>("webhook")?;
    Ok(text.map(|text| codec::parse(text, "webhook")).transpose()?.as_ref().and_then(codec::webhook_from))
}

/// The state of a job before it is changed.
pub async fn standing<C: Connection>(
    connection: &mut C,
    id: JobId,
    caller: &Caller,
) -> Result<Option<JobState>, StoreFailure> {
    let query = format!("SELECT state FROM jobs WHERE id = $1 AND caller = $2{}", C::FOR_UPDATE);
    let row = sql(AssertSqlSafe(query)).bind(id.to_bytes()).bind(caller.name()).optional(connection).await?;
    row.map(|row| codec::state_from(row.get("state")?)).transpose()
}

pub async fn blob(connection: &mut impl Connection, sha256: &[u8; 32]) -> Result<Option<BlobPlace>, StoreFailure> {
    let row = sql("SELECT location, bytes FROM blobs WHERE sha256 = $1").bind(*sha256).optional(connection).await?;
    row.map(|row| place(&row)).transpose()
}

pub fn place(row: &impl Columns) -> Result<BlobPlace, StoreFailure> {
    let bytes = u64::try_from(row.get::<i64>("bytes")?).unwrap_or(0);
    Ok(BlobPlace { location: row.get("location")?, bytes })
}

/// Names blobs that are on the disk. Gives the locations that are in use now; equal content that was named before
/// keeps its place.
pub async fn name_blobs(
    connection: &mut impl Connection,
    files: &[NewBlob],
    now: Timestamp,
) -> Result<Vec<String>, StoreFailure> {
    let mut kept = Vec::new();
    // In one order for all, so that no two transactions wait for each other.
    let mut files: Vec<&NewBlob> = files.iter().collect();
    files.sort_by_key(|file| file.sha256);
    for file in files {
        let named = sql(
            "INSERT INTO blobs (sha256, bytes, location, created_at) VALUES ($1, $2, $3, $4) ON CONFLICT (sha256) DO NOTHING",
        )
        .bind(file.sha256)
        .bind(int(file.bytes))
        .bind(file.location.as_str())
        .bind(now.0)
        .execute(connection)
        .await?;
        if named > 0 {
            kept.push(file.location.clone());
        }
    }
    Ok(kept)
}

/// A job reads or has made these blobs.
pub async fn hold_blobs(
    connection: &mut impl Connection,
    id: JobId,
    digests: impl Iterator<Item = [u8; 32]>,
) -> Result<(), StoreFailure> {
    for sha256 in digests {
        sql("INSERT INTO job_blobs (job, sha256) VALUES ($1, $2) ON CONFLICT DO NOTHING")
            .bind(id.to_bytes())
            .bind(sha256)
            .execute(connection)
            .await?;
    }
    Ok(())
}
