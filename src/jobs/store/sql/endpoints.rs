//! Endpoints: who is to be told what, and where.

use super::{Columns, Connection, Lock, rows, sql};
use crate::jobs::clock::Timestamp;
use crate::jobs::ids::EndpointId;
use crate::jobs::store::{StoreFailure, codec};
use crate::jobs::submission::Caller;
use crate::jobs::webhooks::{
    ENDPOINTS_MAX, Endpoint, EndpointChange, MessageType, NewEndpoint, NewEndpointIs, ROTATION_TIME, Secret,
};
use sqlx::AssertSqlSafe;
use std::time::SystemTime;

const ENDPOINT: &str = "SELECT id, url, description, events, enabled, disabled_reason, failing_since, created_at, secret \
     FROM webhook_endpoints ";

pub async fn create(
    connection: &mut impl Connection,
    new: &NewEndpoint,
    now: Timestamp,
) -> Result<NewEndpointIs, StoreFailure> {
    let NewEndpoint { caller, url, description, events, secret } = new;
    connection.lock(Lock::Name { kind: "endpoints", caller: caller.name(), name: "" }).await?;
    let known = list(connection, caller).await?;
    if let Some(first) = known.iter().find(|known| known.url.is_none() && url.is_none()) {
        return Ok(NewEndpointIs::Second(first.id));
    }
    if known.len() >= ENDPOINTS_MAX {
        return Ok(NewEndpointIs::TooMany);
    }
    let id = EndpointId::new();
    sql("INSERT INTO webhook_endpoints (id, caller, url, description, events, enabled, secret, created_at) \
         VALUES ($1, $2, $3, $4, $5, 1, $6, $7)")
    .bind(id.to_bytes())
    .bind(caller.name())
    .bind(url.as_deref())
    .bind(description.as_str())
    .bind(codec::message_types(events).to_string())
    .bind(secret.to_bytes())
    .bind(now.0)
    .execute(connection)
    .await?;
    let made = endpoint(connection, caller, id).await?;
    made.map(NewEndpointIs::Made).ok_or_else(|| StoreFailure::new(&"a new endpoint is not there"))
}

pub async fn endpoint(
    connection: &mut impl Connection,
    caller: &Caller,
    id: EndpointId,
) -> Result<Option<Endpoint>, StoreFailure> {
    let row = sql(AssertSqlSafe(format!("{ENDPOINT}WHERE id = $1 AND caller = $2")))
        .bind(id.to_bytes())
        .bind(caller.name())
        .optional(connection)
        .await?;
    row.map(|row| read(&row)).transpose()
}

/// Oldest first.
pub async fn list(connection: &mut impl Connection, caller: &Caller) -> Result<Vec<Endpoint>, StoreFailure> {
    let rows = sql(AssertSqlSafe(format!("{ENDPOINT}WHERE caller = $1 ORDER BY id")))
        .bind(caller.name())
        .all(connection)
        .await?;
    rows.iter().map(read).collect()
}

fn read(row: &impl Columns) -> Result<Endpoint, StoreFailure> {
    Ok(Endpoint {
        id: endpoint_id(row, "id")?,
        url: row.get("url")?,
        description: row.get("description")?,
        events: events_from(row.get("events")?)?,
        enabled: row.get::<i64>("enabled")? != 0,
        disabled_reason: row.get("disabled_reason")?,
        failing_since: row.get::<Option<i64>>("failing_since")?.map(Timestamp).map(SystemTime::from),
        created_at: Timestamp(row.get("created_at")?).into(),
        secret: Secret::from_bytes(rows::bytes(row.get("secret")?)?),
    })
}

pub fn endpoint_id(row: &impl Columns, column: &str) -> Result<EndpointId, StoreFailure> {
    Ok(EndpointId::from_bytes(rows::bytes(row.get(column)?)?))
}

pub fn events_from(text: &str) -> Result<Vec<MessageType>, StoreFailure> {
    Ok(codec::message_types_from(&codec::parse(text, "the events of an endpoint")?))
}

/// Whoever enables an endpoint, or gives it another URL, wants to see it tried now.
pub async fn change(
    connection: &mut impl Connection,
    caller: &Caller,
    id: EndpointId,
    change: &EndpointChange,
) -> Result<Option<Endpoint>, StoreFailure> {
    let EndpointChange { url, description, events, enabled } = change;
    let fresh = *enabled == Some(true) || url.is_some();
    sql("UPDATE webhook_endpoints SET url = coalesce($1, url), description = coalesce($2, description), \
         events = coalesce($3, events), enabled = coalesce($4, enabled), \
         disabled_reason = CASE WHEN $4 IS NULL THEN disabled_reason END, \
         held_until = CASE WHEN $5 = 0 THEN held_until END WHERE id = $6 AND caller = $7")
    .bind(url.as_deref())
    .bind(description.as_deref())
    .bind(events.as_deref().map(|events| codec::message_types(events).to_string()))
    .bind(enabled.map(i64::from))
    .bind(i64::from(fresh))
    .bind(id.to_bytes())
    .bind(caller.name())
    .execute(connection)
    .await?;
    endpoint(connection, caller, id).await
}

pub async fn replace_secret(
    connection: &mut impl Connection,
    caller: &Caller,
    id: EndpointId,
    secret: &Secret,
    now: Timestamp,
) -> Result<Option<Endpoint>, StoreFailure> {
    sql("UPDATE webhook_endpoints SET previous_secret = secret, previous_until = $1, secret = $2 \
         WHERE id = $3 AND caller = $4")
    .bind(now.after(ROTATION_TIME).0)
    .bind(secret.to_bytes())
    .bind(id.to_bytes())
    .bind(caller.name())
    .execute(connection)
    .await?;
    endpoint(connection, caller, id).await
}

pub async fn delete(connection: &mut impl Connection, caller: &Caller, id: EndpointId) -> Result<bool, StoreFailure> {
    let deleted = sql("DELETE FROM webhook_endpoints WHERE id = $1 AND caller = $2")
        .bind(id.to_bytes())
        .bind(caller.name())
        .execute(connection)
        .await?;
    Ok(deleted > 0)
}
