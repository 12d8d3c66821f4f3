//! Idempotency keys of requests that make no job.

use super::{Columns, Connection, Lock, rows, sql};
use crate::jobs::clock::Timestamp;
use crate::jobs::store::{ANSWER_TIME, IDEMPOTENCY_TIME, Remembered, StoreFailure};
use crate::jobs::submission::Caller;
use sqlx::AssertSqlSafe;

pub async fn recall(
    connection: &mut impl Connection,
    caller: &Caller,
    key: &str,
    fingerprint: &[u8; 32],
    now: Timestamp,
) -> Result<Remembered, StoreFailure> {
    connection.lock(Lock::Name { kind: "key", caller: caller.name(), name: key }).await?;
    let row =
        sql("SELECT fingerprint, job, answer FROM idempotency WHERE caller = $1 AND key = $2 AND expires_at > $3")
            .bind(caller.name())
            .bind(key)
            .bind(now.0)
            .optional(connection)
            .await?;
    if let Some(row) = row {
        let known: [u8; 32] = rows::bytes(row.get("fingerprint")?)?;
        if known != *fingerprint {
            return Ok(Remembered::Mismatch);
        }
        return Ok(row.get::<Option<Vec<u8>>>("answer")?.map_or(Remembered::InProgress, Remembered::Answer));
    }
    sql("INSERT INTO idempotency (caller, key, fingerprint, expires_at) VALUES ($1, $2, $3, $4) \
         ON CONFLICT (caller, key) DO UPDATE SET fingerprint = excluded.fingerprint, job = NULL, answer = NULL, \
         expires_at = excluded.expires_at")
    .bind(caller.name())
    .bind(key)
    .bind(*fingerprint)
    .bind(now.after(ANSWER_TIME).0)
    .execute(connection)
    .await?;
    Ok(Remembered::Fresh)
}

pub async fn remember(
    connection: &mut impl Connection,
    caller: &Caller,
    key: &str,
    answer: Option<&[u8]>,
    now: Timestamp,
) -> Result<(), StoreFailure> {
    const OF_ANSWERS: &str = "WHERE caller = $1 AND key = $2 AND job IS NULL";
    let statement = match answer {
        Some(answer) => sql(AssertSqlSafe(format!("UPDATE idempotency SET answer = $3, expires_at = $4 {OF_ANSWERS}")))
            .bind(caller.name())
            .bind(key)
            .bind(answer.to_vec())
            .bind(now.after(IDEMPOTENCY_TIME).0),
        None => sql(AssertSqlSafe(format!("DELETE FROM idempotency {OF_ANSWERS} AND answer IS NULL")))
            .bind(caller.name())
            .bind(key),
    };
    statement.execute(connection).await?;
    Ok(())
}

/// The process that would have answered is gone.
pub async fn forget_unanswered(connection: &mut impl Connection) -> Result<(), StoreFailure> {
    sql("DELETE FROM idempotency WHERE job IS NULL AND answer IS NULL").execute(connection).await?;
    Ok(())
}
