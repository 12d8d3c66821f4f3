//! Batches: many rigs that are ordered together. They wait behind everything else.

use super::App;
use super::authenticate::Identity;
use super::batch_items;
use super::batch_views::{BatchItemView, BatchListView, BatchResultView, BatchView, CreateBatchView};
use super::error::{ApiError, Code};
use super::idempotency;
use super::negotiate::query;
use super::receive;
use super::rigs::{PAGE_SIZE, page_size};
use super::segments::Segments;
use crate::jobs::{BatchId, Caller};
use crate::server::batch_orders::{self, LINES_BYTES_MAX, Ordered};
use crate::server::uploads;
use axum::Json;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::{HeaderValue, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

/// Pages of results ahead of a slow reader.
const PAGES_AHEAD: usize = 2;

/// Order many rigs.
///
/// As JSON with up to 1,000 items, or as `application/jsonl` with an item in each of up to 50,000 lines. Items are named by
/// assets, become jobs of low priority as the queue has room, and count among your unfinished jobs. One that cannot be a job
/// fails alone.
#[utoipa::path(
    post, path = "/v1/batches", tag = "batches",
    params(
        ("Idempotency-Key" = Option<String>, Header, description = "The same key with the same batch gives the same answer, for 24 hours", example = "knights-2026-11-26"),
    ),
    request_body(description = "Items", content(
        (CreateBatchView = "application/json"), (BatchItemView = "application/jsonl"),
    )),
    responses(
        (status = 202, description = "The batch is written down", body = BatchView, headers(
            ("Location" = String, description = "Where it lives"),
            ("Idempotency-Replayed" = String, description = "`true` when an earlier request with this key made it"),
        )),
    ),
    extensions(("x-curl" = json!("curl -H 'Content-Type: application/json' -d '{\"items\": [{\"custom_id\": \"knight-17\", \"request\": {\"asset\": \"'$ASSET'\"}}]}' \\\n  $HOST/v1/batches\n\n# one item per line\ncurl -H 'Content-Type: application/jsonl' --data-binary @items.jsonl $HOST/v1/batches"))),
)]
pub async fn create_batch(State(app): State<App>, identity: Identity, request: Request) -> Result<Response, ApiError> {
    query(request.uri(), &[])?;
    let key = idempotency::key(request.headers())?;
    let declared = request.headers().get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok());
    let essence = declared.unwrap_or_default().split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    let Ordered { batch, replayed } = match essence.as_str() {
        "application/jsonl" | "application/x-ndjson" => {
            let _permit = uploads::permit(&app)?;
            let lines = receive::body_bytes(&app, request, LINES_BYTES_MAX).await?;
            let items = batch_items::of_lines(&lines, &Default::default())?;
            batch_orders::place(&app, &identity, items, key, lines).await?
        }
        "application/json" => {
            let members = receive::json_body(&app, request).await?;
            batch_orders::place_members(&app, &identity, members, key).await?
        }
        other => {
            let other: String = other.chars().take(80).collect();
            return Err(batch_items::unsupported(&other));
        }
    };
    let view = BatchView::from(&batch);
    let location = HeaderValue::from_str(&view.links.this).map_err(|error| ApiError::internal(&error))?;
    let mut response = (StatusCode::ACCEPTED, [(header::LOCATION, location)], Json(view)).into_response();
    if replayed {
        idempotency::note_replay(&mut response);
    }
    Ok(response)
}

/// Look at a batch.
#[utoipa::path(
    get, path = "/v1/batches/{id}", tag = "batches",
    params(("id" = String, Path, description = "Id of the batch", example = "bat_01jdf5fj63fh5ra1njpy75fmyg")),
    responses((status = 200, description = "How many of its items are in which state", body = BatchView)),
    extensions(("x-curl" = json!("curl $HOST/v1/batches/$BATCH"))),
)]
pub async fn get_batch(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    uri: Uri,
) -> Result<Json<BatchView>, ApiError> {
    query(&uri, &[])?;
    Ok(Json(BatchView::from(&batch_orders::find(&app, &identity.caller, &id).await?)))
}

/// List batches, newest first.
#[utoipa::path(
    get, path = "/v1/batches", tag = "batches",
    params(
        ("page_size" = Option<u32>, Query, description = "1 to 100; 20 unless given", minimum = 1, maximum = 100, example = 20),
        ("page_token" = Option<String>, Query, description = "`next_page_token` of the page before"),
    ),
    responses((status = 200, description = "One page", body = BatchListView)),
    extensions(("x-curl" = json!("curl $HOST/v1/batches"))),
)]
pub async fn list_batches(
    State(app): State<App>,
    identity: Identity,
    uri: Uri,
) -> Result<Json<BatchListView>, ApiError> {
    let (mut before, mut count) = (None, PAGE_SIZE);
    for (name, value) in query(&uri, &["page_size", "page_token"])? {
        if name == "page_size" {
            count = page_size(&value)?;
        } else {
            let token = value.parse::<BatchId>();
            let detail = "the page token was not given by this service for this list";
            before = Some(token.map_err(|_| ApiError::field("page_token", detail))?);
        }
    }
    let mut batches = app.jobs.batches(&identity.caller, before, count + 1).await?;
    let more = batches.len() > count;
    batches.truncate(count);
    let next_page_token = batches.last().filter(|_| more).map(|batch| batch.id.to_string());
    let data = batches.iter().map(BatchView::from).collect();
    Ok(Json(BatchListView { object: "list", data, next_page_token }))
}

/// Finds the verb.
pub async fn batch_verb(
    State(app): State<App>,
    Segments(id_and_verb): Segments<String>,
    identity: Identity,
    request: Request,
) -> Result<Response, ApiError> {
    match id_and_verb.split_once(':') {
        Some((id, "cancel")) => cancel_batch(&app, identity, id, request).await,
        Some((_, verb)) => {
            let verb: String = verb.chars().take(40).collect();
            Err(ApiError::not_found(&format!("verb {verb:?}")).hint("there is {id}:cancel"))
        }
        None => Err(ApiError::new(Code::MethodNotAllowed, format!("{} is not for one batch", Method::POST))
            .header(header::ALLOW, "GET, HEAD")
            .hint("POST items to /v1/batches; POST to {id}:cancel cancels")),
    }
}

/// Cancel a batch.
///
/// No further item becomes a job, and those that wait or run are canceled. Results that are there stay.
#[utoipa::path(
    post, path = "/v1/batches/{id}:cancel", tag = "batches",
    params(("id" = String, Path, description = "Id of the batch", example = "bat_01jdf5fj63fh5ra1njpy75fmyg")),
    responses((status = 200, description = "The batch", body = BatchView)),
    extensions(("x-curl" = json!("curl -X POST $HOST/v1/batches/$BATCH:cancel"))),
)]
async fn cancel_batch(app: &App, identity: Identity, id: &str, request: Request) -> Result<Response, ApiError> {
    query(request.uri(), &[])?;
    let batch = batch_orders::cancel(app, &identity.caller, id).await?;
    Ok(Json(BatchView::from(&batch)).into_response())
}

/// Get the results of a batch.
///
/// One line for each item that is over, in the order of the items: its rig, or why there is none. Complete once the batch is
/// `completed` or `canceled`.
#[utoipa::path(
    get, path = "/v1/batches/{id}/results", tag = "batches",
    params(("id" = String, Path, description = "Id of the batch", example = "bat_01jdf5fj63fh5ra1njpy75fmyg")),
    responses((status = 200, description = "Lines of JSON", content_type = "application/jsonl", body = BatchResultView)),
    extensions(("x-curl" = json!("curl $HOST/v1/batches/$BATCH/results"))),
)]
pub async fn get_batch_results(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    uri: Uri,
) -> Result<Response, ApiError> {
    query(&uri, &[])?;
    let id = batch_orders::find(&app, &identity.caller, &id).await?.id;
    let (lines, pages) = mpsc::channel::<Result<String, ApiError>>(PAGES_AHEAD);
    tokio::spawn(async move {
        let mut first = 0;
        loop {
            let page = page(&app, &identity.caller, id, first).await;
            let next = page.as_ref().ok().and_then(|(_, next)| *next);
            // An error cuts the answer off, so that it cannot be taken for the whole.
            if lines.send(page.map(|(text, _)| text)).await.is_err() {
                return;
            }
            match next {
                Some(next) => first = next,
                None => return,
            }
        }
    });
    let body = Body::from_stream(ReceiverStream::new(pages));
    Ok(([(header::CONTENT_TYPE, "application/jsonl"), (header::CACHE_CONTROL, "no-store")], body).into_response())
}

/// Lines of the items from `first` on, and where the next page begins.
async fn page(app: &App, caller: &Caller, id: BatchId, first: usize) -> Result<(String, Option<usize>), ApiError> {
    let (outcomes, next) = batch_orders::outcomes(app, caller, id, first).await?;
    let mut text = String::new();
    for outcome in outcomes {
        let line = serde_json::to_string(&BatchResultView::from(outcome));
        text += &line.map_err(|error| ApiError::internal(&error))?;
        text.push('\n');
    }
    Ok((text, next))
}
