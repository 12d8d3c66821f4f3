//! What webhook endpoints were told, and telling it again.

use super::App;
use super::authenticate::Identity;
use super::error::{ApiError, Code};
use super::negotiate::query;
use super::rigs::{PAGE_SIZE, page_size};
use super::segments::Segments;
use super::webhook_views::{DeliveryListView, DeliveryView};
use super::webhooks::{find, way_out};
use super::words::DeliveryStateName;
use crate::jobs::webhooks::DeliveryState;
use crate::jobs::{EndpointId, MessageId};
use axum::Json;
use axum::extract::State;
use axum::http::{Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};

/// Send a test message to a webhook endpoint.
///
/// A message of type `webhook.test`, signed like all others and tried once. The answer is its delivery, to be looked at again.
#[utoipa::path(
    post, path = "/v1/webhook-endpoints/{id}:test", tag = "webhooks",
    params(("id" = String, Path, description = "Id of the endpoint", example = "whe_01jdf5fj63fh5ra1njpy75fmyg")),
    responses((status = 202, description = "It is on its way", body = DeliveryView)),
    extensions(("x-curl" = json!("curl -X POST $HOST/v1/webhook-endpoints/$ENDPOINT:test"))),
)]
pub(super) async fn test_endpoint(app: &App, identity: Identity, id: &str, uri: &Uri) -> Result<Response, ApiError> {
    query(uri, &[])?;
    let endpoint = find(app, &identity.caller, id).await?;
    way_out(app)?;
    if endpoint.url.is_none() {
        return Err(ApiError::new(
            Code::Conflict,
            "the endpoint is nowhere: requests say where what they want told goes",
        )
        .hint("send a request with webhook"));
    }
    if !endpoint.enabled {
        return Err(ApiError::new(Code::Conflict, "the endpoint is disabled")
            .hint("PATCH it with {\"enabled\": true}, then test it"));
    }
    let message = app.jobs.test_endpoint(endpoint.id).await?;
    on_its_way(app, endpoint.id, message).await
}

async fn on_its_way(app: &App, endpoint: EndpointId, message: MessageId) -> Result<Response, ApiError> {
    let delivery = app.jobs.delivery(endpoint, message).await?.ok_or_else(missing)?;
    Ok((StatusCode::ACCEPTED, Json(DeliveryView::new(endpoint, &delivery))).into_response())
}

fn missing() -> ApiError {
    ApiError::not_found("such delivery to this endpoint")
}

fn message_id(id: &str) -> Result<MessageId, ApiError> {
    id.parse().map_err(|error| missing().hint(format!("{error}")))
}

/// List what a webhook endpoint was told, newest first.
///
/// Kept for 15 days.
#[utoipa::path(
    get, path = "/v1/webhook-endpoints/{id}/deliveries", tag = "webhooks",
    params(
        ("id" = String, Path, description = "Id of the endpoint", example = "whe_01jdf5fj63fh5ra1njpy75fmyg"),
        ("state" = Option<DeliveryStateName>, Query, description = "Only those in this state", example = "failed"),
        ("page_size" = Option<u32>, Query, description = "1 to 100; 20 unless given", minimum = 1, maximum = 100, example = 20),
        ("page_token" = Option<String>, Query, description = "`next_page_token` of the page before"),
    ),
    responses((status = 200, description = "One page", body = DeliveryListView)),
    extensions(("x-curl" = json!("curl \"$HOST/v1/webhook-endpoints/$ENDPOINT/deliveries?state=delivered\""))),
)]
pub async fn list_deliveries(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    uri: Uri,
) -> Result<Json<DeliveryListView>, ApiError> {
    let (mut state, mut before, mut count) = (None, None, PAGE_SIZE);
    for (name, value) in query(&uri, &["state", "page_size", "page_token"])? {
        match name.as_str() {
            "state" => {
                let names = || DeliveryState::ALL.map(DeliveryState::name).join(", ");
                let known = DeliveryState::named(&value);
                state = Some(known.ok_or_else(|| {
                    let value: String = value.chars().take(60).collect();
                    ApiError::field("state", format!("{value:?} is not one of {}", names()))
                })?);
            }
            "page_size" => count = page_size(&value)?,
            _ => {
                let token = value.parse::<MessageId>();
                let detail = "the page token was not given by this service for this list";
                before = Some(token.map_err(|_| ApiError::field("page_token", detail))?);
            }
        }
    }
    let endpoint = find(&app, &identity.caller, &id).await?.id;
    let mut deliveries = app.jobs.deliveries(endpoint, state, before, count + 1).await?;
    let more = deliveries.len() > count;
    deliveries.truncate(count);
    let next_page_token = deliveries.last().filter(|_| more).map(|delivery| delivery.message.to_string());
    let data = deliveries.iter().map(|delivery| DeliveryView::new(endpoint, delivery)).collect();
    Ok(Json(DeliveryListView { object: "list", data, next_page_token }))
}

/// Look at one delivery.
#[utoipa::path(
    get, path = "/v1/webhook-endpoints/{id}/deliveries/{message}", tag = "webhooks",
    params(
        ("id" = String, Path, description = "Id of the endpoint", example = "whe_01jdf5fj63fh5ra1njpy75fmyg"),
        ("message" = String, Path, description = "Id of the message", example = "evt_01jdf5fj63fh5ra1njpy75fmyg"),
    ),
    responses((status = 200, description = "What became of the message there", body = DeliveryView)),
    extensions(("x-curl" = json!("curl $HOST/v1/webhook-endpoints/$ENDPOINT/deliveries/$MESSAGE"))),
)]
pub async fn get_delivery(
    State(app): State<App>,
    Segments((id, message)): Segments<(String, String)>,
    identity: Identity,
    uri: Uri,
) -> Result<Json<DeliveryView>, ApiError> {
    query(&uri, &[])?;
    let endpoint = find(&app, &identity.caller, &id).await?.id;
    let delivery = app.jobs.delivery(endpoint, message_id(&message)?).await?.ok_or_else(missing)?;
    Ok(Json(DeliveryView::new(endpoint, &delivery)))
}

/// Finds the verb.
pub async fn delivery_verb(
    State(app): State<App>,
    Segments((id, message_and_verb)): Segments<(String, String)>,
    identity: Identity,
    uri: Uri,
) -> Result<Response, ApiError> {
    match message_and_verb.split_once(':') {
        Some((message, "redeliver")) => redeliver(&app, identity, &id, message, &uri).await,
        Some((_, verb)) => {
            let verb: String = verb.chars().take(40).collect();
            Err(ApiError::not_found(&format!("verb {verb:?}")).hint("there is {message}:redeliver"))
        }
        None => Err(ApiError::new(Code::MethodNotAllowed, format!("{} is not for one delivery", Method::POST))
            .header(header::ALLOW, "GET, HEAD")
            .hint("POST to {message}:redeliver sends it again")),
    }
}

/// Send a message again.
///
/// The same message, whatever became of it: tried now, and by the whole schedule if it is not taken.
#[utoipa::path(
    post, path = "/v1/webhook-endpoints/{id}/deliveries/{message}:redeliver", tag = "webhooks",
    params(
        ("id" = String, Path, description = "Id of the endpoint", example = "whe_01jdf5fj63fh5ra1njpy75fmyg"),
        ("message" = String, Path, description = "Id of the message", example = "evt_01jdf5fj63fh5ra1njpy75fmyg"),
    ),
    responses((status = 202, description = "It is on its way", body = DeliveryView)),
    extensions(("x-curl" = json!("curl -X POST $HOST/v1/webhook-endpoints/$ENDPOINT/deliveries/$MESSAGE:redeliver"))),
)]
async fn redeliver(app: &App, identity: Identity, id: &str, message: &str, uri: &Uri) -> Result<Response, ApiError> {
    query(uri, &[])?;
    let endpoint = find(app, &identity.caller, id).await?;
    way_out(app)?;
    let message = message_id(message)?;
    if !app.jobs.redeliver(endpoint.id, message).await? {
        return Err(missing());
    }
    on_its_way(app, endpoint.id, message).await
}
