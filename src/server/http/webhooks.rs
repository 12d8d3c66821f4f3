//! Webhook endpoints: who is told what happens, and where.

use super::App;
use super::authenticate::Identity;
use super::error::{ApiError, Code};
use super::idempotency::{self, Turn};
use super::negotiate::query;
use super::receive;
use super::segments::Segments;
use super::webhook_deliveries::test_endpoint;
use super::webhook_views::{ChangeEndpointView, CreateEndpointView, EndpointListView, EndpointView, endpoint_path};
use crate::jobs::webhooks::{ENDPOINTS_MAX, Endpoint, EndpointChange, MessageType, NewEndpoint, NewEndpointIs, Secret};
use crate::jobs::{Caller, EndpointId, FieldError, FieldProblem, JobWebhook};
use crate::outgoing::Outgoing;
use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderValue, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use serde_json::{Map, Value};

const DESCRIPTION_BYTES_MAX: usize = 256;
const NEW_FIELDS: &[&str] = &["url", "events", "description"];
const CHANGE_FIELDS: &[&str] = &["url", "events", "description", "enabled"];

/// Have a place told what happens.
///
/// Your rigs and batches are told of by POST to `url`, signed as Standard Webhooks 1.0 has it with the `secret` that this answer
/// shows, and no other. Only where the operator lets the service make requests. An endpoint without `url`, of which you may have
/// one, signs what single requests want told by `webhook`.
#[utoipa::path(
    post, path = "/v1/webhook-endpoints", tag = "webhooks",
    params(
        ("Idempotency-Key" = Option<String>, Header, description = "The same key with the same request gives the same answer, for 24 hours", example = "hooks-v1"),
    ),
    request_body(description = "Where, and what", content((CreateEndpointView = "application/json"))),
    responses(
        (status = 201, description = "The endpoint, with its secret", body = EndpointView, headers(
            ("Location" = String, description = "Where it lives"),
            ("Idempotency-Replayed" = String, description = "`true` when an earlier request with this key made it"),
        )),
    ),
    extensions(("x-curl" = json!("curl -H 'Content-Type: application/json' -d '{\"url\": \"https://studio.example/hooks/rigs\", \"events\": [\"rig.succeeded\", \"rig.failed\"]}' \\\n  $HOST/v1/webhook-endpoints"))),
)]
pub async fn create_endpoint(
    State(app): State<App>,
    identity: Identity,
    request: Request,
) -> Result<Response, ApiError> {
    query(request.uri(), &[])?;
    let key = idempotency::key(request.headers())?;
    let outgoing = way_out(&app)?.clone();
    let members = receive::json_body(&app, request).await?;
    let EndpointChange { url, events, description, .. } = read(&members, NEW_FIELDS, Some(&outgoing))?;
    let events = match (&url, events) {
        (Some(_), events) => events.unwrap_or_else(|| MessageType::ALL.to_vec()),
        (None, None) => Vec::new(),
        (None, Some(_)) => return Err(ApiError::field("events", "without url, requests say what they want told")),
    };
    let description = description.unwrap_or_default();
    let new = NewEndpoint { caller: identity.caller, url, description, events, secret: new_secret()? };
    let body = Value::from(members).to_string();
    // Detached: once the key is taken, the answer is remembered even if the caller hangs up.
    let made = tokio::spawn(async move { keep(&app, new, key, body.as_bytes()).await });
    made.await.map_err(|error| ApiError::internal(&error))?
}

async fn keep(app: &App, new: NewEndpoint, key: Option<String>, body: &[u8]) -> Result<Response, ApiError> {
    let caller = new.caller.clone();
    if let Some(key) = &key
        && let Turn::Again(id) = idempotency::turn(app, &caller, key, &[b"POST /v1/webhook-endpoints", body]).await?
    {
        let known = find(app, &caller, &String::from_utf8_lossy(&id)).await;
        if let Some(known) = idempotency::still_there(known)? {
            let mut response = created(&known)?;
            idempotency::note_replay(&mut response);
            return Ok(response);
        }
    }
    let made = app.jobs.create_endpoint(new).await;
    if let Some(key) = &key {
        let id = match &made {
            Ok(NewEndpointIs::Made(endpoint)) => Some(endpoint.id.to_string()),
            _ => None,
        };
        app.jobs.remember(&caller, key, id.as_deref().map(str::as_bytes)).await?;
    }
    match made? {
        NewEndpointIs::Made(endpoint) => created(&endpoint),
        NewEndpointIs::TooMany => {
            let detail = format!("you have {ENDPOINTS_MAX} endpoints, and no more may be");
            Err(ApiError::new(Code::Conflict, detail).hint("delete one, or let one hear more events"))
        }
        NewEndpointIs::Second(first) => {
            let detail = format!("you have an endpoint without url already: {first}");
            Err(ApiError::new(Code::Conflict, detail).hint("POST to {id}:rotate-secret shows a new secret of it"))
        }
    }
}

fn created(endpoint: &Endpoint) -> Result<Response, ApiError> {
    let location = HeaderValue::from_str(&endpoint_path(endpoint.id)).map_err(|error| ApiError::internal(&error))?;
    let view = EndpointView::with_secret(endpoint);
    let fields = [(header::LOCATION, location), (header::CACHE_CONTROL, HeaderValue::from_static("no-store"))];
    Ok((StatusCode::CREATED, fields, Json(view)).into_response())
}

fn new_secret() -> Result<Secret, ApiError> {
    Secret::new().map_err(|error| ApiError::internal(&error))
}

/// The way out, where the operator has opened it.
pub fn way_out(app: &App) -> Result<&Outgoing, ApiError> {
    app.outgoing.as_ref().ok_or_else(|| {
        ApiError::new(Code::Conflict, "this service sends no webhooks")
            .hint("the operator allows them by --outgoing; until then, follow links.events, or ask with Prefer: wait")
    })
}

/// Refuses what one job wants told when it cannot be: where it is to go, or who is to sign it.
pub async fn admit(app: &App, caller: &Caller, webhook: &JobWebhook) -> Result<(), ApiError> {
    let url = url(&Value::from(webhook.url.as_str()), app.outgoing.as_ref());
    url.map_err(|detail| ApiError::field("webhook.url", detail))?;
    if app.jobs.endpoints(caller).await?.iter().any(|endpoint| endpoint.url.is_none() && endpoint.enabled) {
        return Ok(());
    }
    Err(ApiError::new(
        Code::Conflict,
        "webhook: there is no endpoint yet whose secret signs what single requests want told",
    )
    .hint("POST {} to /v1/webhook-endpoints once, and keep the secret that the answer shows"))
}

/// What a request says of an endpoint. All that is wrong with it is told at once.
fn read(members: &Map<String, Value>, known: &[&str], outgoing: Option<&Outgoing>) -> Result<EndpointChange, ApiError> {
    let mut errors = Vec::new();
    let mut refuse =
        |field: &str, problem, detail| errors.push(FieldError { field: field.to_owned(), problem, detail });
    let mut change = EndpointChange::default();
    for (name, value) in members {
        if !known.contains(&name.as_str()) {
            let name: String = name.chars().take(60).collect();
            refuse(&name, FieldProblem::Unknown, format!("no such field; there are {}", known.join(", ")));
            continue;
        }
        let read = match name.as_str() {
            "url" => url(value, outgoing).map(|url| change.url = Some(url)),
            "events" => events(value, &MessageType::ALL).map(|events| change.events = Some(events)),
            "description" => description(value).map(|description| change.description = Some(description)),
            _ => truth(value).map(|enabled| change.enabled = Some(enabled)),
        };
        if let Err(detail) = read {
            refuse(name, FieldProblem::Invalid, detail);
        }
    }
    if errors.is_empty() { Ok(change) } else { Err(ApiError::fields(errors)) }
}

fn url(value: &Value, outgoing: Option<&Outgoing>) -> Result<String, String> {
    let text = value.as_str().ok_or("is not a text")?;
    if text.chars().any(char::is_control) {
        return Err("has a control character in it".to_owned());
    }
    let outgoing = outgoing.ok_or("this service sends no webhooks; the operator allows them by --outgoing")?;
    outgoing.check(text).map_err(|error| error.to_string())?;
    Ok(text.to_owned())
}

pub fn events(value: &Value, known: &[MessageType]) -> Result<Vec<MessageType>, String> {
    let names = || known.iter().map(|event| event.name()).collect::<Vec<_>>().join(", ");
    let given = value.as_array().filter(|given| !given.is_empty());
    let given = given.ok_or_else(|| format!("is not a list of one or more of {}", names()))?;
    let mut events = Vec::new();
    for name in given {
        let event = name.as_str().and_then(MessageType::named).filter(|event| known.contains(event));
        let event = event.ok_or_else(|| {
            let name: String = name.to_string().chars().take(60).collect();
            format!("{name} is not one of {}", names())
        })?;
        if !events.contains(&event) {
            events.push(event);
        }
    }
    Ok(events)
}

fn description(value: &Value) -> Result<String, String> {
    let text = value.as_str().ok_or("is not a text")?;
    if text.len() > DESCRIPTION_BYTES_MAX || text.chars().any(char::is_control) {
        return Err(format!("has more than {DESCRIPTION_BYTES_MAX} bytes, or control characters"));
    }
    Ok(text.to_owned())
}

fn truth(value: &Value) -> Result<bool, String> {
    value.as_bool().ok_or_else(|| "is neither true nor false".to_owned())
}

pub fn missing() -> ApiError {
    ApiError::not_found("such webhook endpoint")
}

pub fn endpoint_id(id: &str) -> Result<EndpointId, ApiError> {
    id.parse().map_err(|error| missing().hint(format!("{error}")))
}

pub async fn find(app: &App, caller: &Caller, id: &str) -> Result<Endpoint, ApiError> {
    app.jobs.endpoint(caller, endpoint_id(id)?).await?.ok_or_else(missing)
}

/// List webhook endpoints, oldest first.
#[utoipa::path(
    get, path = "/v1/webhook-endpoints", tag = "webhooks",
    responses((status = 200, description = "All of yours, 16 at most", body = EndpointListView)),
    extensions(("x-curl" = json!("curl $HOST/v1/webhook-endpoints"))),
)]
pub async fn list_endpoints(
    State(app): State<App>,
    identity: Identity,
    uri: Uri,
) -> Result<Json<EndpointListView>, ApiError> {
    query(&uri, &[])?;
    let endpoints = app.jobs.endpoints(&identity.caller).await?;
    Ok(Json(EndpointListView { object: "list", data: endpoints.iter().map(EndpointView::from).collect() }))
}

/// Look at a webhook endpoint.
#[utoipa::path(
    get, path = "/v1/webhook-endpoints/{id}", tag = "webhooks",
    params(("id" = String, Path, description = "Id of the endpoint", example = "whe_01jdf5fj63fh5ra1njpy75fmyg")),
    responses((status = 200, description = "The endpoint, without its secret", body = EndpointView)),
    extensions(("x-curl" = json!("curl $HOST/v1/webhook-endpoints/$ENDPOINT"))),
)]
pub async fn get_endpoint(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    uri: Uri,
) -> Result<Json<EndpointView>, ApiError> {
    query(&uri, &[])?;
    Ok(Json(EndpointView::from(&find(&app, &identity.caller, &id).await?)))
}

/// Change a webhook endpoint.
///
/// A disabled endpoint is told nothing: what was to be tried again waits until it is enabled, what happens meanwhile is not told.
#[utoipa::path(
    patch, path = "/v1/webhook-endpoints/{id}", tag = "webhooks",
    params(("id" = String, Path, description = "Id of the endpoint", example = "whe_01jdf5fj63fh5ra1njpy75fmyg")),
    request_body(description = "What is to be different", content((ChangeEndpointView = "application/json"))),
    responses((status = 200, description = "The endpoint as it is now", body = EndpointView)),
    extensions(("x-curl" = json!("curl -X PATCH -H 'Content-Type: application/json' -d '{\"enabled\": false}' \\\n  $HOST/v1/webhook-endpoints/$ENDPOINT"))),
)]
pub async fn change_endpoint(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    request: Request,
) -> Result<Json<EndpointView>, ApiError> {
    query(request.uri(), &[])?;
    let endpoint = find(&app, &identity.caller, &id).await?;
    let change = read(&receive::json_body(&app, request).await?, CHANGE_FIELDS, app.outgoing.as_ref())?;
    if endpoint.url.is_none() && (change.url.is_some() || change.events.is_some()) {
        return Err(ApiError::new(Code::Conflict, "this endpoint is for what requests want told by webhook")
            .hint("make another endpoint for a url of its own"));
    }
    let endpoint = app.jobs.change_endpoint(&identity.caller, endpoint.id, change).await?.ok_or_else(missing)?;
    Ok(Json(EndpointView::from(&endpoint)))
}

/// Delete a webhook endpoint.
///
/// It is told nothing more, and what it was told is forgotten.
#[utoipa::path(
    delete, path = "/v1/webhook-endpoints/{id}", tag = "webhooks",
    params(("id" = String, Path, description = "Id of the endpoint", example = "whe_01jdf5fj63fh5ra1njpy75fmyg")),
    responses((status = 204, description = "Gone")),
    extensions(("x-curl" = json!("curl -X DELETE $HOST/v1/webhook-endpoints/$ENDPOINT"))),
)]
pub async fn delete_endpoint(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    uri: Uri,
) -> Result<StatusCode, ApiError> {
    query(&uri, &[])?;
    if app.jobs.delete_endpoint(&identity.caller, endpoint_id(&id)?).await? {
        Ok(StatusCode::NO_CONTENT)
    } else {
        Err(missing())
    }
}

/// Finds the verb.
pub async fn endpoint_verb(
    State(app): State<App>,
    Segments(id_and_verb): Segments<String>,
    identity: Identity,
    uri: Uri,
) -> Result<Response, ApiError> {
    match id_and_verb.split_once(':') {
        Some((id, "rotate-secret")) => rotate_secret(&app, identity, id, &uri).await,
        Some((id, "test")) => test_endpoint(&app, identity, id, &uri).await,
        Some((_, verb)) => {
            let verb: String = verb.chars().take(40).collect();
            Err(ApiError::not_found(&format!("verb {verb:?}")).hint("there are {id}:rotate-secret and {id}:test"))
        }
        None => Err(ApiError::new(Code::MethodNotAllowed, format!("{} is not for one endpoint", Method::POST))
            .header(header::ALLOW, "GET, HEAD, PATCH, DELETE")
            .hint("PATCH changes it; POST to {id}:test sends a message")),
    }
}

/// Make a new secret for a webhook endpoint.
///
/// This answer shows it, and no other. For 24 hours each message is signed with the secret before it too, so that the receiver
/// can change over; of a third one nothing is left.
#[utoipa::path(
    post, path = "/v1/webhook-endpoints/{id}:rotate-secret", tag = "webhooks",
    params(("id" = String, Path, description = "Id of the endpoint", example = "whe_01jdf5fj63fh5ra1njpy75fmyg")),
    responses((status = 200, description = "The endpoint, with its new secret", body = EndpointView)),
    extensions(("x-curl" = json!("curl -X POST $HOST/v1/webhook-endpoints/$ENDPOINT:rotate-secret"))),
)]
async fn rotate_secret(app: &App, identity: Identity, id: &str, uri: &Uri) -> Result<Response, ApiError> {
    query(uri, &[])?;
    let replaced = app.jobs.replace_secret(&identity.caller, endpoint_id(id)?, new_secret()?).await?;
    let view = EndpointView::with_secret(&replaced.ok_or_else(missing)?);
    Ok(([(header::CACHE_CONTROL, "no-store")], Json(view)).into_response())
}
