//! Feeding the queue with the items of batches, a few at a time: most of the queue stays free for requests that somebody
//! waits for, and each caller has no more jobs than its key allows.

use super::App;
use super::http::authenticate::Identity;
use super::http::error::{ApiError, Code};
use super::http::receive::Order;
use super::http::views::JobErrorView;
use super::http::wishes::WishesReader;
use super::orders::{self, Terms};
use super::uploads::asset_id;
use crate::jobs::{
    BatchId, Denied, ErrorCode, OpenBatch, PendingItem, Priority, Settled, Source, StoreFailure, Submitted,
};
use serde_json::{Map, Value};
use std::time::Duration;

/// Items of one batch that are looked at before the next batch has its turn.
const TURN: usize = 8;
/// How often the queue is looked at while a batch is open, and while none is.
const BUSY_LOOK: Duration = Duration::from_millis(200);
const IDLE_LOOK: Duration = Duration::from_secs(2);

/// Feeds the queue until the service closes. Any number of processes may do so: an item is one job, whoever makes it.
pub async fn feed(app: App) {
    let mut closing = app.closing.subscribe();
    loop {
        let look = match round(&app).await {
            Ok(true) => BUSY_LOOK,
            Ok(false) => IDLE_LOOK,
            Err(error) => {
                tracing::error!(%error, "batches could not be looked at");
                IDLE_LOOK
            }
        };
        tokio::select! {
            () = tokio::time::sleep(look) => {}
            () = app.batch_came.notified() => {}
            _ = closing.wait_for(|closing| *closing) => return,
        }
    }
}

/// Gives each open batch its turn. Whether there is any.
async fn round(app: &App) -> Result<bool, StoreFailure> {
    let open = app.jobs.open_batches().await?;
    if open.is_empty() {
        return Ok(false);
    }
    for id in app.jobs.conclude_batches().await? {
        tracing::info!(batch.id = %id, "a batch is over");
    }
    if app.jobs.ready().is_err() {
        return Ok(true);
    }
    for batch in open {
        let settings = app.jobs.settings();
        let waiting = app.jobs.counts().await?.queued;
        // Half of the queue is for batches.
        let room = (settings.queue_max / 2).max(1).saturating_sub(waiting);
        for item in app.jobs.pending_items(batch.id, room.min(TURN)).await? {
            if !place(app, &batch, item).await? {
                break;
            }
        }
    }
    Ok(true)
}

/// Makes a job of an item, or notes why it will be none. `false`: it must wait.
async fn place(app: &App, batch: &OpenBatch, item: PendingItem) -> Result<bool, StoreFailure> {
    let PendingItem { position, request } = item;
    let identity = Identity { caller: batch.caller.clone(), jobs_max: batch.jobs_max, key_id: None };
    let settled = match order(app, &identity, batch.id, position, &request).await {
        Ok(Submitted { job, .. }) => Settled::Job(job.id),
        Err(error) if must_wait(error.code) => return Ok(false),
        Err(error) => Settled::Refused(written(&error)),
    };
    let noted = app.jobs.settle_item(batch.id, position, &settled).await?;
    if let (false, Settled::Job(job)) = (noted, &settled)
        && let Err(Denied::Unavailable(error)) = app.jobs.cancel(&batch.caller, *job).await
    {
        // The batch was canceled meanwhile, and its job with it.
        return Err(error);
    }
    Ok(true)
}

async fn order(
    app: &App,
    identity: &Identity,
    batch: BatchId,
    position: usize,
    request: &str,
) -> Result<Submitted, ApiError> {
    let mut members: Map<String, Value> = serde_json::from_str(request).map_err(|error| ApiError::internal(&error))?;
    let source = source(members.shift_remove("asset"))?;
    let mut wishes = reader(&members).finish(app.jobs.settings())?;
    wishes.priority = Priority::Low;
    // Callers cannot send this character, so no key of theirs is the same.
    let key = format!("\u{1}{batch} {position}");
    let terms = Terms { client_id: None, idempotency_key: Some(key), use_cache: true, deadline: None };
    orders::place(app, identity, Order { source, wishes }, terms).await
}

/// The mesh of an item.
pub fn source(asset: Option<Value>) -> Result<Source, ApiError> {
    match asset {
        Some(Value::String(id)) => asset_id(&id).map(Source::Asset),
        Some(_) => Err(ApiError::field("asset", "is not the id of an asset")
            .hint("POST the mesh to /v1/assets and name its id; items of a batch hold no meshes")),
        None => Err(ApiError::field("asset", "is missing").hint("POST the mesh to /v1/assets and name its id")),
    }
}

/// A reader of the options of an item, or of those that all items share.
pub fn reader(members: &Map<String, Value>) -> WishesReader {
    let mut reader = WishesReader::default();
    for (name, value) in members {
        if name == "priority" {
            reader.refuse("priority", "batches wait behind everything else".to_owned());
        } else {
            reader.json(name, value);
        }
    }
    reader
}

/// Refusals that pass.
fn must_wait(code: Code) -> bool {
    matches!(
        code,
        Code::QueueFull
            | Code::QuotaExceeded
            | Code::Starting
            | Code::StoreUnavailable
            | Code::Work(ErrorCode::Draining | ErrorCode::Internal)
    )
}

/// A refusal as it is kept with its item.
pub fn written(error: &ApiError) -> String {
    serde_json::to_string(&JobErrorView::from(error)).unwrap_or_default()
}
