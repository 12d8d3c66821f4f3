//! Batches: many rigs that are ordered together. They wait behind everything else.

use super::App;
use super::authenticate::Identity;
use super::batch_items;
use super::batch_views::{BatchItemView, BatchListView, BatchResultView, BatchView, CreateBatchView};
use super::error::{ApiError, Code};
use super::idempotency::{self, Turn};
use super::negotiate::query;
use super::receive;
use super::rigs::{PAGE_SIZE, page_size, why_none};
use super::segments::Segments;
use super::views::{JobErrorView, JobView};
use crate::jobs::{BatchId, BatchItem, Caller, ErrorCode, ItemState, JobState, Missing, NewBatch, NewItem};
use crate::server::uploads;
use axum::Json;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::{HeaderValue, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use serde_json::Value;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

/// The body of lines; about 640 bytes each.
const LINES_BYTES_MAX: u64 = 32 << 20;
/// Results that are looked up at a time, and pages of them ahead of a slow reader.
const PAGE: usize = 100;
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
    let (body, items) = items(&app, &identity, request).await?;
    // Detached: once the key is taken, the answer is remembered even if the caller hangs up.
    let made = tokio::spawn(async move { keep(&app, identity, items, key, &body).await });
    made.await.map_err(|error| ApiError::internal(&error))?
}

/// The body, and the items that it holds.
async fn items(app: &App, identity: &Identity, request: Request) -> Result<(Vec<u8>, Vec<NewItem>), ApiError> {
    let declared = request.headers().get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok());
    let essence = declared.unwrap_or_default().split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    match essence.as_str() {
        "application/jsonl" | "application/x-ndjson" => {
            let _permit = uploads::permit(app)?;
            let body = receive::body_bytes(app, request, LINES_BYTES_MAX).await?;
            let items = batch_items::of_lines(&body, &Default::default())?;
            Ok((body, items))
        }
        "application/json" => {
            let members = receive::json_body(app, request).await?;
            let body = Value::from(members.clone()).to_string().into_bytes();
            let wanted = batch_items::Wanted::read(members, app.jobs.settings())?;
            let items = match wanted.items {
                batch_items::Items::Inline(items) => batch_items::of_values(items, &wanted.defaults)?,
                batch_items::Items::Asset(id) => {
                    let lines = lines_of(app, &identity.caller, &id).await?;
                    batch_items::of_lines(&lines, &wanted.defaults)?
                }
            };
            Ok((body, items))
        }
        other => {
            let other: String = other.chars().take(80).collect();
            Err(batch_items::unsupported(&other))
        }
    }
}

/// The only file of an asset.
async fn lines_of(app: &App, caller: &Caller, id: &str) -> Result<bytes::Bytes, ApiError> {
    let asset = app.jobs.asset(caller, uploads::asset_id(id)?).await?.ok_or_else(uploads::missing)?;
    if asset.files.len() != 1 {
        let detail = format!("the asset has {} files; one with the lines is needed", asset.files.len());
        return Err(ApiError::field("items", detail));
    }
    if asset.bytes() > LINES_BYTES_MAX {
        return Err(ApiError::too_large(LINES_BYTES_MAX, Some(asset.bytes())));
    }
    let mut files = app.jobs.load_files(&asset.files, Missing::Asset).await?;
    Ok(files.swap_remove(0).bytes)
}

async fn keep(
    app: &App,
    identity: Identity,
    items: Vec<NewItem>,
    key: Option<String>,
    body: &[u8],
) -> Result<Response, ApiError> {
    let caller = identity.caller.clone();
    if let Some(key) = &key
        && let Turn::Again(id) = idempotency::turn(app, &caller, key, &[b"POST /v1/batches", body]).await?
    {
        let id = String::from_utf8_lossy(&id);
        let mut response = accepted(&find(app, &caller, &id).await?.1)?;
        idempotency::note_replay(&mut response);
        return Ok(response);
    }
    let new = NewBatch { caller: caller.clone(), jobs_max: identity.jobs_max, items };
    let made = app.jobs.create_batch(new).await.map_err(ApiError::from);
    if let Some(key) = &key {
        let id = made.as_ref().ok().map(BatchId::to_string);
        app.jobs.remember(&caller, key, id.as_deref().map(str::as_bytes)).await?;
    }
    app.batch_came.notify_one();
    accepted(&find(app, &caller, &made?.to_string()).await?.1)
}

fn accepted(batch: &BatchView) -> Result<Response, ApiError> {
    let location = HeaderValue::from_str(&batch.links.this).map_err(|error| ApiError::internal(&error))?;
    Ok((StatusCode::ACCEPTED, [(header::LOCATION, location)], Json(batch)).into_response())
}

async fn find(app: &App, caller: &Caller, id: &str) -> Result<(BatchId, BatchView), ApiError> {
    let missing = || ApiError::not_found("such batch");
    let id: BatchId = id.parse().map_err(|error| missing().hint(format!("{error}")))?;
    let batch = app.jobs.batch(caller, id).await?.ok_or_else(missing)?;
    Ok((id, BatchView::from(&batch)))
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
    Ok(Json(find(&app, &identity.caller, &id).await?.1))
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
    let (id, _) = find(app, &identity.caller, id).await?;
    if !app.jobs.cancel_batch(&identity.caller, id).await? {
        return Err(ApiError::not_found("such batch"));
    }
    Ok(Json(find(app, &identity.caller, &id.to_string()).await?.1).into_response())
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
    let (id, _) = find(&app, &identity.caller, &id).await?;
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
    let items = app.jobs.batch_items(id, first, PAGE).await?;
    let next = items.last().filter(|_| items.len() == PAGE).map(|item| item.position + 1);
    let mut text = String::new();
    for item in items {
        let over = matches!(item.state, ItemState::Job(state) if state.is_final());
        if over {
            let result = result(app, caller, item).await?;
            text += &serde_json::to_string(&result).map_err(|error| ApiError::internal(&error))?;
            text.push('\n');
        }
    }
    Ok((text, next))
}

async fn result(app: &App, caller: &Caller, item: BatchItem) -> Result<BatchResultView, ApiError> {
    let BatchItem { custom_id, state, job, error, .. } = item;
    let job = match job {
        Some(id) => app.jobs.get(caller, id).await?,
        None => None,
    };
    let refused = error.map(|error| serde_json::from_str(&error)).transpose();
    let refused: Option<Value> = refused.map_err(|error| ApiError::internal(&error))?;
    let (rig, error, rig_id) = match job {
        Some(job) if matches!(job.state, JobState::Succeeded | JobState::Expired) => {
            (Some(JobView::from(&job)), None, None)
        }
        Some(job) => (None, Some(told(&why_none(&job))?), Some(job.id.to_string())),
        None => (None, Some(refused.map_or_else(|| told(&gone(state)), Ok)?), None),
    };
    Ok(BatchResultView { custom_id, rig, error, rig_id })
}

fn told(error: &ApiError) -> Result<Value, ApiError> {
    serde_json::to_value(JobErrorView::from(error)).map_err(|error| ApiError::internal(&error))
}

/// Why an item without a job and without a refusal has no rig.
fn gone(state: ItemState) -> ApiError {
    match state {
        ItemState::Job(JobState::Canceled) => ApiError::new(Code::Work(ErrorCode::Canceled), "the batch was canceled"),
        _ => ApiError::not_found("such job any more; it was deleted, or is forgotten"),
    }
}
