//! Idempotency keys of requests that make no job.

use super::rows;
use crate::jobs::clock::Timestamp;
use crate::jobs::store::{IDEMPOTENCY_TIME, Remembered, StoreFailure};
use crate::jobs::submission::Caller;
use sqlx::sqlite::SqlitePool;
use sqlx::{Row, SqliteConnection};

pub async fn recall(
    connection: &mut SqliteConnection,
    caller: &Caller,
    key: &str,
    fingerprint: &[u8; 32],
    now: Timestamp,
) -> Result<Remembered, StoreFailure> {
    let row =
        sqlx::query("SELECT fingerprint, job, answer FROM idempotency WHERE caller = ? AND key = ? AND expires_at > ?")
            .bind(caller.name())
            .bind(key)
            .bind(now.0)
            .fetch_optional(&mut *connection)
            .await?;
    if let Some(row) = row {
        let known: [u8; 32] = rows::bytes(row.try_get("fingerprint")?)?;
        if known != *fingerprint {
            return Ok(Remembered::Mismatch);
        }
        return Ok(row.try_get::<Option<Vec<u8>>, _>("answer")?.map_or(Remembered::InProgress, Remembered::Answer));
    }
    sqlx::query(
        "INSERT INTO idempotency (caller, key, fingerprint, expires_at) VALUES (?, ?, ?, ?) \
         ON CONFLICT (caller, key) DO UPDATE SET fingerprint = excluded.fingerprint, job = NULL, answer = NULL, \
         expires_at = excluded.expires_at",
    )
    .bind(caller.name())
    .bind(key)
    .bind(fingerprint.to_vec())
    .bind(now.after(IDEMPOTENCY_TIME).0)
    .execute(connection)
    .await?;
    Ok(Remembered::Fresh)
}

pub async fn remember(
    writer: &SqlitePool,
    caller: &Caller,
    key: &str,
    answer: Option<&[u8]>,
) -> Result<(), StoreFailure> {
    let query = match answer {
        Some(_) => "UPDATE idempotency SET answer = ? WHERE caller = ? AND key = ? AND job IS NULL",
        None => "DELETE FROM idempotency WHERE answer IS ? AND caller = ? AND key = ? AND job IS NULL",
    };
    sqlx::query(query).bind(answer).bind(caller.name()).bind(key).execute(writer).await?;
    Ok(())
}

/// The process that would have answered is gone.
pub async fn forget_unanswered(connection: &mut SqliteConnection) -> Result<(), StoreFailure> {
    sqlx::query("DELETE FROM idempotency WHERE job IS NULL AND answer IS NULL").execute(connection).await?;
    Ok(())
}
