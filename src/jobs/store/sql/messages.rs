//! Messages: written in the transaction of the change that they tell of.

use super::endpoints::{endpoint_id, events_from};
use super::{Columns, Connection, batches, reading, rows, sql};
use crate::jobs::clock::Timestamp;
use crate::jobs::event::EventKind;
use crate::jobs::ids::{BatchId, EndpointId, JobId, MessageId};
use crate::jobs::job::JobState;
use crate::jobs::store::{StoreFailure, snapshot};
use crate::jobs::submission::Caller;
use crate::jobs::webhooks::{KEEP_TIME, MessageType, Subject};

/// What is told of an event of a job.
fn told_of(kind: &EventKind) -> Option<MessageType> {
    match kind {
        // Work that begins anew, because its worker went away, is not told again.
        EventKind::State { state: JobState::Running, attempt: 1 } => Some(MessageType::RigStarted),
        EventKind::Done { state, .. } => MessageType::of_end(*state),
        _ => None,
    }
}

/// Where a message goes: to an endpoint, and there to where one job says.
type Place = (EndpointId, Option<String>);

/// Tells of events of a job that were just appended.
pub async fn of_job(
    connection: &mut impl Connection,
    id: JobId,
    kinds: &[EventKind],
    now: Timestamp,
) -> Result<(), StoreFailure> {
    for kind in kinds.iter().filter_map(told_of) {
        let endpoints = sql("SELECT e.id, e.events, e.url, j.webhook FROM jobs j JOIN webhook_endpoints e \
             ON e.caller = j.caller AND e.enabled = 1 WHERE j.id = $1 ORDER BY e.id")
        .bind(id.to_bytes())
        .all(connection)
        .await?;
        let mut places = wanting(&endpoints, kind)?;
        for endpoint in &endpoints {
            let asked = if endpoint.get::<Option<&str>>("url")?.is_none() { rows::webhook(endpoint)? } else { None };
            if let Some(asked) = asked.filter(|asked| asked.events.contains(&kind)) {
                places.push((endpoint_id(endpoint, "id")?, Some(asked.url)));
            }
        }
        if !places.is_empty()
            && let Some(job) = reading::snapshot(connection, id).await?
        {
            write(connection, kind, &Subject::Rig(Box::new(job)), &places, now).await?;
        }
    }
    Ok(())
}

/// Tells that a batch of `caller` is over.
pub async fn of_batch(
    connection: &mut impl Connection,
    caller: &Caller,
    id: BatchId,
    now: Timestamp,
) -> Result<(), StoreFailure> {
    let kind = MessageType::BatchCompleted;
    let endpoints = sql("SELECT id, events, url FROM webhook_endpoints WHERE enabled = 1 AND caller = $1 ORDER BY id")
        .bind(caller.name())
        .all(connection)
        .await?;
    let places = wanting(&endpoints, kind)?;
    if !places.is_empty()
        && let Some(batch) = batches::batch(connection, caller, id).await?
    {
        write(connection, kind, &Subject::Batch(Box::new(batch)), &places, now).await?;
    }
    Ok(())
}

/// Those of `endpoints` that are somewhere and want to hear of `kind`.
fn wanting(endpoints: &[impl Columns], kind: MessageType) -> Result<Vec<Place>, StoreFailure> {
    let mut places = Vec::new();
    for endpoint in endpoints {
        let somewhere = endpoint.get::<Option<&str>>("url")?.is_some();
        if somewhere && events_from(endpoint.get("events")?)?.contains(&kind) {
            places.push((endpoint_id(endpoint, "id")?, None));
        }
    }
    Ok(places)
}

/// Writes a message down, to be sent to `places` at once.
pub async fn write(
    connection: &mut impl Connection,
    kind: MessageType,
    subject: &Subject,
    places: &[Place],
    now: Timestamp,
) -> Result<MessageId, StoreFailure> {
    let id = MessageId::new();
    sql("INSERT INTO webhook_messages (id, type, at, subject) VALUES ($1, $2, $3, $4)")
        .bind(id.to_bytes())
        .bind(kind.name())
        .bind(now.0)
        .bind(snapshot::subject(subject).to_string())
        .execute(connection)
        .await?;
    for (endpoint, url) in places {
        sql("INSERT INTO webhook_deliveries (endpoint, message, url, state, due_at, attempts, tries, log) \
             VALUES ($1, $2, $3, 'pending', $4, 0, 0, '[]')")
        .bind(endpoint.to_bytes())
        .bind(id.to_bytes())
        .bind(url.as_deref())
        .bind(now.0)
        .execute(connection)
        .await?;
    }
    Ok(id)
}

/// Forgets messages that were kept long enough, with what became of them.
pub async fn forget(connection: &mut impl Connection, now: Timestamp) -> Result<(), StoreFailure> {
    sql("DELETE FROM webhook_messages WHERE at <= $1").bind(forgotten_before(now)).execute(connection).await?;
    Ok(())
}

/// Messages of this time and before are forgotten.
pub fn forgotten_before(now: Timestamp) -> i64 {
    now.0.saturating_sub(super::millis(KEEP_TIME))
}
