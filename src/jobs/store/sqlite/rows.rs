//! Rows of the tables as the values that they hold.

use super::int;
use crate::jobs::clock::Timestamp;
use crate::jobs::ids::{AssetId, JobId};
use crate::jobs::job::{Job, JobRequest, JobState};
use crate::jobs::options::RigOptions;
use crate::jobs::stage::Stage;
use crate::jobs::store::{BlobPlace, StoreFailure, codec};
use crate::jobs::submission::{Caller, Priority};
use crate::storage::NewBlob;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

/// All columns that [`job`] reads.
pub const JOB: &str = "SELECT id, caller, client_id, options, labels, files, skeleton, asset, priority, timeout_ms, \
     retention_ms, deadline_at, state, stage, progress, cancel_requested, sequence, attempt, created_at, started_at, \
     finished_at, expires_at, queue_ms, timings, result, error, cached FROM jobs ";

pub fn bytes<const N: usize>(bytes: &[u8]) -> Result<[u8; N], StoreFailure> {
    bytes.try_into().map_err(|_| StoreFailure::new(&"an id or a digest cannot be read back"))
}

pub fn job_id(row: &SqliteRow) -> Result<JobId, StoreFailure> {
    Ok(JobId::from_bytes(bytes(row.try_get("id")?)?))
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
pub fn job(row: &SqliteRow) -> Result<Job, StoreFailure> {
    let time =
        |column| Ok::<_, StoreFailure>(row.try_get::<Option<i64>, _>(column)?.map(Timestamp).map(SystemTime::from));
    let json = |column| row.try_get::<Option<&str>, _>(column)?.map(|text| codec::parse(text, column)).transpose();
    let state = codec::state_from(row.try_get("state")?)?;
    let result = json("result")?.map(|result| codec::result_from(&result)).transpose()?;
    let stage = row.try_get::<Option<&str>, _>("stage")?.and_then(Stage::named);
    let created_at = SystemTime::from(Timestamp(row.try_get("created_at")?));
    Ok(Job {
        id: job_id(row)?,
        caller: Caller::named(row.try_get("caller")?),
        state,
        stage,
        progress: u8::try_from(row.try_get::<i64, _>("progress")?).unwrap_or(0),
        queue_position: None,
        cancel_requested: row.try_get::<i64, _>("cancel_requested")? != 0,
        attempt: u32::try_from(row.try_get::<i64, _>("attempt")?).unwrap_or(u32::MAX),
        created_at,
        started_at: time("started_at")?,
        finished_at: time("finished_at")?,
        expires_at: time("expires_at")?,
        request: Arc::new(request(row)?),
        queue_time: row.try_get::<Option<i64>, _>("queue_ms")?.map(duration),
        timings: json("timings")?.map(|timings| codec::timings_from(&timings)).unwrap_or_default(),
        result: result.map(Arc::new),
        error: json("error")?.map(|error| codec::error_from(&error)),
        cached: row.try_get::<i64, _>("cached")? != 0,
        sequence: u64::try_from(row.try_get::<i64, _>("sequence")?).unwrap_or(0),
    })
}

fn request(row: &SqliteRow) -> Result<JobRequest, StoreFailure> {
    let json = |column: &str| codec::parse(row.try_get(column)?, column);
    let asset = row.try_get::<Option<&[u8]>, _>("asset")?.map(bytes).transpose()?.map(AssetId::from_bytes);
    let deadline = row.try_get::<Option<i64>, _>("deadline_at")?.map(Timestamp).map(SystemTime::from);
    // Options that this version does not know any more: the job stays readable, and is not worked on.
    let options = codec::options_from(&json("options")?).unwrap_or_else(|_| RigOptions::default());
    Ok(JobRequest {
        options,
        files: codec::files_from(&json("files")?)?,
        asset,
        priority: priority_from(row.try_get("priority")?),
        labels: codec::labels_from(&json("labels")?),
        timeout: duration(row.try_get("timeout_ms")?),
        deadline,
        retention: duration(row.try_get("retention_ms")?),
        client_id: row.try_get("client_id")?,
        skeleton_given: row.try_get::<Option<&[u8]>, _>("skeleton")?.is_some(),
    })
}

/// The state of a job and its attempt, before it is changed.
pub async fn standing(
    connection: &mut SqliteConnection,
    id: JobId,
    caller: &Caller,
) -> Result<Option<JobState>, StoreFailure> {
    let state: Option<String> = sqlx::query_scalar("SELECT state FROM jobs WHERE id = ? AND caller = ?")
        .bind(id.to_bytes().to_vec())
        .bind(caller.name())
        .fetch_optional(connection)
        .await?;
    state.map(|state| codec::state_from(&state)).transpose()
}

pub async fn blob(connection: &mut SqliteConnection, sha256: &[u8; 32]) -> Result<Option<BlobPlace>, StoreFailure> {
    let row = sqlx::query("SELECT location, bytes FROM blobs WHERE sha256 = ?")
        .bind(sha256.to_vec())
        .fetch_optional(connection)
        .await?;
    row.map(|row| place(&row)).transpose()
}

pub fn place(row: &SqliteRow) -> Result<BlobPlace, StoreFailure> {
    let bytes = u64::try_from(row.try_get::<i64, _>("bytes")?).unwrap_or(0);
    Ok(BlobPlace { location: row.try_get("location")?, bytes })
}

/// Names blobs that are on the disk. Gives the locations that are in use now; equal content that was named before
/// keeps its place.
pub async fn name_blobs(
    connection: &mut SqliteConnection,
    files: &[NewBlob],
    now: Timestamp,
) -> Result<Vec<String>, StoreFailure> {
    let mut kept = Vec::new();
    for file in files {
        let named = sqlx::query(
            "INSERT INTO blobs (sha256, bytes, location, created_at) VALUES (?, ?, ?, ?) ON CONFLICT (sha256) DO NOTHING",
        )
        .bind(file.sha256.to_vec())
        .bind(int(file.bytes))
        .bind(&file.location)
        .bind(now.0)
        .execute(&mut *connection)
        .await?;
        if named.rows_affected() > 0 {
            kept.push(file.location.clone());
        }
    }
    Ok(kept)
}

/// A job reads or has made these blobs.
pub async fn hold_blobs(
    connection: &mut SqliteConnection,
    id: JobId,
    digests: impl Iterator<Item = [u8; 32]>,
) -> Result<(), StoreFailure> {
    for sha256 in digests {
        sqlx::query("INSERT INTO job_blobs (job, sha256) VALUES (?, ?) ON CONFLICT DO NOTHING")
            .bind(id.to_bytes().to_vec())
            .bind(sha256.to_vec())
            .execute(&mut *connection)
            .await?;
    }
    Ok(())
}
