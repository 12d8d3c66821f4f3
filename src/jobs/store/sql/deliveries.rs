//! Deliveries: what is due, who has it, and what became of it.

use super::endpoints::endpoint_id;
use super::{Columns, Connection, int, messages, millis, rows, sql};
use crate::jobs::clock::Timestamp;
use crate::jobs::ids::{EndpointId, MessageId};
use crate::jobs::store::webhooks::{ATTEMPTS_KEPT, TOGETHER};
use crate::jobs::store::{StoreFailure, codec, snapshot};
use crate::jobs::webhooks::{
    self, Attempt, Delivery, DeliveryState, DueDelivery, Message, MessageType, Secret, Subject, Tried, Verdict,
};
use serde_json::{Value, json};
use sqlx::AssertSqlSafe;
use std::time::Duration;

/// A delivery, by its endpoint and its message.
type Key = (EndpointId, MessageId);

/// Deliveries that are due, those that wait longest first, at most `count`.
pub async fn due<C: Connection>(connection: &mut C, count: usize, now: Timestamp) -> Result<Vec<Key>, StoreFailure> {
    let rows = sql(AssertSqlSafe(format!(
        "WITH ready AS (SELECT d.endpoint, d.message, d.due_at, e.failing_since, \
         row_number() OVER (PARTITION BY d.endpoint ORDER BY d.message) AS turn \
         FROM webhook_endpoints e JOIN webhook_deliveries d ON d.endpoint = e.id \
         WHERE e.enabled = 1 AND (e.held_until IS NULL OR e.held_until <= $1) \
         AND d.state = 'pending' AND d.due_at <= $1 AND NOT EXISTS (SELECT 1 FROM webhook_deliveries u \
         WHERE u.endpoint = e.id AND u.lease_until > $1)) \
         SELECT endpoint, message FROM ready WHERE turn <= CASE WHEN failing_since IS NULL THEN {TOGETHER} ELSE 1 END \
         ORDER BY due_at, message, endpoint LIMIT $2"
    )))
    .bind(now.0)
    .bind(int(count as u64))
    .all(connection)
    .await?;
    rows.iter().map(|row| Ok((endpoint_id(row, "endpoint")?, message_id(row)?))).collect()
}

fn message_id(row: &impl Columns) -> Result<MessageId, StoreFailure> {
    Ok(MessageId::from_bytes(rows::bytes(row.get("message")?)?))
}

/// Takes those of `due` that nobody else has taken.
pub async fn claim(
    connection: &mut impl Connection,
    mut due: Vec<Key>,
    now: Timestamp,
    lease_until: Timestamp,
) -> Result<Vec<DueDelivery>, StoreFailure> {
    // In one order for all, so that no two transactions wait for each other.
    due.sort_unstable();
    let mut claimed = Vec::with_capacity(due.len());
    for (endpoint, message) in due {
        let taken = sql("UPDATE webhook_deliveries SET lease_until = $1, attempts = attempts + 1, tries = tries + 1 \
             WHERE endpoint = $2 AND message = $3 AND state = 'pending' AND due_at <= $4 \
             AND (lease_until IS NULL OR lease_until <= $4) RETURNING attempts")
        .bind(lease_until.0)
        .bind(endpoint.to_bytes())
        .bind(message.to_bytes())
        .bind(now.0)
        .optional(connection)
        .await?;
        let Some(taken) = taken else { continue };
        let attempt = u32::try_from(taken.get::<i64>("attempts")?).unwrap_or(u32::MAX);
        match whole(connection, (endpoint, message), attempt, now).await {
            Ok(due) => claimed.push(due),
            Err(error) => {
                // Nobody who reads it again would know more.
                tracing::error!(%error, webhook.id = %message, "a message cannot be read and is given up");
                end(connection, (endpoint, message), DeliveryState::Failed).await?;
            }
        }
    }
    Ok(claimed)
}

async fn whole(
    connection: &mut impl Connection,
    (endpoint, message): Key,
    attempt: u32,
    now: Timestamp,
) -> Result<DueDelivery, StoreFailure> {
    let row = sql("SELECT m.type, m.at, m.subject, e.secret, coalesce(d.url, e.url) AS url, d.url AS own_url, \
         CASE WHEN e.previous_until > $1 THEN e.previous_secret END AS previous_secret \
         FROM webhook_deliveries d JOIN webhook_messages m ON m.id = d.message \
         JOIN webhook_endpoints e ON e.id = d.endpoint WHERE d.endpoint = $2 AND d.message = $3")
    .bind(now.0)
    .bind(endpoint.to_bytes())
    .bind(message.to_bytes())
    .one(connection)
    .await?;
    let newest = Some(row.get::<&[u8]>("secret")?);
    let secrets = [newest, row.get("previous_secret")?].into_iter().flatten();
    Ok(DueDelivery {
        message: Message {
            id: message,
            kind: kind(row.get("type")?)?,
            at: Timestamp(row.get("at")?).into(),
            subject: snapshot::subject_from(&codec::parse(row.get("subject")?, "a message")?)?,
        },
        endpoint,
        attempt,
        url: row.get("url")?,
        of_one_job: row.get::<Option<&str>>("own_url")?.is_some(),
        secrets: secrets
            .map(|bytes| Ok(Secret::from_bytes(rows::bytes(bytes)?)))
            .collect::<Result<_, StoreFailure>>()?,
    })
}

fn kind(name: &str) -> Result<MessageType, StoreFailure> {
    let known = Some(MessageType::Test).filter(|test| test.name() == name).or_else(|| MessageType::named(name));
    known.ok_or_else(|| StoreFailure::new(&"the type of a message is of another version"))
}

/// The process that held all leases is gone.
pub async fn lose_all(connection: &mut impl Connection) -> Result<(), StoreFailure> {
    sql("UPDATE webhook_deliveries SET lease_until = NULL WHERE lease_until IS NOT NULL").execute(connection).await?;
    Ok(())
}

/// A delivery is over.
async fn end(
    connection: &mut impl Connection,
    (endpoint, message): Key,
    state: DeliveryState,
) -> Result<(), StoreFailure> {
    sql("UPDATE webhook_deliveries SET state = $1, due_at = NULL, lease_until = NULL \
         WHERE endpoint = $2 AND message = $3")
    .bind(state.name())
    .bind(endpoint.to_bytes())
    .bind(message.to_bytes())
    .execute(connection)
    .await?;
    Ok(())
}

/// What follows from an attempt; `None`: it is not the current one any more.
pub async fn note<C: Connection>(
    connection: &mut C,
    due: &DueDelivery,
    tried: &Tried,
    now: Timestamp,
) -> Result<Option<Verdict>, StoreFailure> {
    let key = (due.endpoint, due.message.id);
    let current = format!(
        "SELECT tries, log FROM webhook_deliveries WHERE endpoint = $1 AND message = $2 AND attempts = $3 \
         AND lease_until IS NOT NULL{}",
        C::FOR_UPDATE
    );
    let current = sql(AssertSqlSafe(current))
        .bind(due.endpoint.to_bytes())
        .bind(due.message.id.to_bytes())
        .bind(i64::from(due.attempt))
        .optional(connection)
        .await?;
    let Some(current) = current else { return Ok(None) };
    let tries = usize::try_from(current.get::<i64>("tries")?).unwrap_or(1).max(1);
    let verdict = tried.verdict(due.message.kind, tries, webhooks::chance(due.message.id, due.endpoint, tries));
    let log = codec::parse(current.get("log")?, "a log of attempts")?;
    sql("UPDATE webhook_deliveries SET log = $1 WHERE endpoint = $2 AND message = $3")
        .bind(logged(log, due.attempt, tried, now).to_string())
        .bind(due.endpoint.to_bytes())
        .bind(due.message.id.to_bytes())
        .execute(connection)
        .await?;
    match verdict {
        Verdict::Delivered => end(connection, key, DeliveryState::Delivered).await?,
        Verdict::GivenUp | Verdict::Gone => end(connection, key, DeliveryState::Failed).await?,
        Verdict::Again(time) => again(connection, key, now.after(time)).await?,
    }
    if !due.of_one_job {
        note_on_endpoint(connection, due.endpoint, tried, verdict, now).await?;
    }
    Ok(Some(verdict))
}

async fn again(
    connection: &mut impl Connection,
    (endpoint, message): Key,
    due_at: Timestamp,
) -> Result<(), StoreFailure> {
    sql("UPDATE webhook_deliveries SET due_at = $1, lease_until = NULL WHERE endpoint = $2 AND message = $3")
        .bind(due_at.0)
        .bind(endpoint.to_bytes())
        .bind(message.to_bytes())
        .execute(connection)
        .await?;
    Ok(())
}

async fn note_on_endpoint(
    connection: &mut impl Connection,
    id: EndpointId,
    tried: &Tried,
    verdict: Verdict,
    now: Timestamp,
) -> Result<(), StoreFailure> {
    let statement = match verdict {
        Verdict::Delivered => {
            sql("UPDATE webhook_endpoints SET failing_since = NULL, held_until = NULL WHERE id = $1 \
             AND (failing_since IS NOT NULL OR held_until IS NOT NULL)")
            .bind(id.to_bytes())
        }
        Verdict::Gone => sql("UPDATE webhook_endpoints SET enabled = 0, disabled_reason = $1, \
             failing_since = coalesce(failing_since, $2) WHERE id = $3")
        .bind("it answered 410 (Gone)")
        .bind(now.0)
        .bind(id.to_bytes()),
        Verdict::Again(_) | Verdict::GivenUp => {
            sql("UPDATE webhook_endpoints SET failing_since = coalesce(failing_since, $1), \
                 held_until = coalesce($2, held_until) WHERE id = $3")
            .bind(now.0)
            .bind(tried.rest().map(|time| now.after(time).0))
            .bind(id.to_bytes())
        }
    };
    statement.execute(connection).await?;
    Ok(())
}

/// `log` with one more attempt, which ended at `now`.
fn logged(log: Value, number: u32, tried: &Tried, now: Timestamp) -> Value {
    let Value::Array(mut attempts) = log else { return log };
    attempts.push(json!({
        "number": number,
        "at": now.0.saturating_sub(millis(tried.duration)),
        "ms": tried.duration.as_millis() as u64,
        "status": tried.status,
        "error": tried.error,
    }));
    let surplus = attempts.len().saturating_sub(ATTEMPTS_KEPT);
    attempts.drain(..surplus);
    Value::Array(attempts)
}

fn attempts_from(log: &Value) -> Vec<Attempt> {
    let attempt = |entry: &Value| {
        Some(Attempt {
            number: u32::try_from(entry.get("number")?.as_u64()?).ok()?,
            at: Timestamp(entry.get("at")?.as_i64()?).into(),
            duration: Duration::from_millis(entry.get("ms")?.as_u64()?),
            status: entry.get("status").and_then(Value::as_u64).and_then(|status| u16::try_from(status).ok()),
            error: entry.get("error").and_then(Value::as_str).map(str::to_owned),
        })
    };
    log.as_array().into_iter().flatten().filter_map(attempt).collect()
}

const DELIVERY: &str = "SELECT d.message, m.type, m.at, d.state, d.due_at, d.log FROM webhook_deliveries d \
     JOIN webhook_messages m ON m.id = d.message WHERE d.endpoint = $1 ";

/// Newest first, older than `before`.
pub async fn list(
    connection: &mut impl Connection,
    endpoint: EndpointId,
    state: Option<DeliveryState>,
    before: Option<MessageId>,
    count: usize,
) -> Result<Vec<Delivery>, StoreFailure> {
    let last = before.map_or([u8::MAX; 16], MessageId::to_bytes);
    let rows = sql(AssertSqlSafe(format!(
        "{DELIVERY}AND d.message < $2 AND ($3 IS NULL OR d.state = $3) ORDER BY d.message DESC LIMIT $4"
    )))
    .bind(endpoint.to_bytes())
    .bind(last)
    .bind(state.map(DeliveryState::name))
    .bind(int(count as u64))
    .all(connection)
    .await?;
    rows.iter().map(read).collect()
}

pub async fn delivery(
    connection: &mut impl Connection,
    endpoint: EndpointId,
    message: MessageId,
) -> Result<Option<Delivery>, StoreFailure> {
    let row = sql(AssertSqlSafe(format!("{DELIVERY}AND d.message = $2")))
        .bind(endpoint.to_bytes())
        .bind(message.to_bytes())
        .optional(connection)
        .await?;
    row.map(|row| read(&row)).transpose()
}

fn read(row: &impl Columns) -> Result<Delivery, StoreFailure> {
    let state = DeliveryState::named(row.get("state")?);
    Ok(Delivery {
        message: message_id(row)?,
        kind: kind(row.get("type")?)?,
        at: Timestamp(row.get("at")?).into(),
        state: state.ok_or_else(|| StoreFailure::new(&"the state of a delivery cannot be read back"))?,
        next_attempt_at: row.get::<Option<i64>>("due_at")?.map(|millis| Timestamp(millis).into()),
        attempts: attempts_from(&codec::parse(row.get("log")?, "a log of attempts")?),
    })
}

/// Makes a delivery due now. While it is being sent, that is its next attempt.
pub async fn redeliver(
    connection: &mut impl Connection,
    endpoint: EndpointId,
    message: MessageId,
    now: Timestamp,
) -> Result<bool, StoreFailure> {
    let found = sql("UPDATE webhook_deliveries SET state = 'pending', due_at = $1, tries = 0 \
         WHERE endpoint = $2 AND message = $3")
    .bind(now.0)
    .bind(endpoint.to_bytes())
    .bind(message.to_bytes())
    .execute(connection)
    .await?;
    Ok(found > 0)
}

/// Writes a message that tells nothing.
pub async fn test(
    connection: &mut impl Connection,
    endpoint: EndpointId,
    now: Timestamp,
) -> Result<MessageId, StoreFailure> {
    messages::write(connection, MessageType::Test, &Subject::Endpoint(endpoint), &[(endpoint, None)], now).await
}
