//! Batches, the same for every door: ordering them, and what came of them.

use super::App;
use super::http::authenticate::Identity;
use super::http::batch_items::{self, Items, Wanted};
use super::http::error::{ApiError, Code};
use super::http::idempotency::{self, Turn};
use super::http::rigs::why_none;
use super::http::views::JobErrorView;
use super::uploads;
use crate::jobs::{
    Batch, BatchId, BatchItem, Caller, ErrorCode, ItemState, Job, JobId, JobState, Missing, NewBatch, NewItem,
};
use serde_json::{Map, Value};
use std::time::{Duration, Instant};

/// Lines of items; about 640 bytes each.
pub const LINES_BYTES_MAX: u64 = 32 << 20;
/// Results that are looked up at a time.
const PAGE: usize = 100;
/// How often a batch is looked at that somebody waits for.
const LOOK: Duration = Duration::from_millis(250);

/// A batch that is written down.
pub struct Ordered {
    pub batch: Batch,
    /// An earlier request with the same key brought it.
    pub replayed: bool,
}

/// Orders what the members of a JSON object say: `defaults` and `items`.
pub async fn place_members(
    app: &App,
    identity: &Identity,
    members: Map<String, Value>,
    key: Option<String>,
) -> Result<Ordered, ApiError> {
    // Whoever writes the same in another order asks for the same.
    let mut said = Value::from(members.clone());
    said.sort_all_objects();
    let Wanted { defaults, items } = Wanted::read(members, app.jobs.settings())?;
    let items = match items {
        Items::Inline(items) => batch_items::of_values(items, &defaults)?,
        Items::Asset(id) => batch_items::of_lines(&lines_of(app, &identity.caller, &id).await?, &defaults)?,
    };
    place(app, identity, items, key, said.to_string().into_bytes()).await
}

/// Orders `items`. `said` is the request, to be told from another one with the same key.
pub async fn place(
    app: &App,
    identity: &Identity,
    items: Vec<NewItem>,
    key: Option<String>,
    said: Vec<u8>,
) -> Result<Ordered, ApiError> {
    let (app, identity) = (app.clone(), identity.clone());
    // Detached: once the key is taken, the answer is remembered even if the caller hangs up.
    let placed = tokio::spawn(async move { keep(&app, identity, items, key, &said).await });
    placed.await.map_err(|error| ApiError::internal(&error))?
}

async fn keep(
    app: &App,
    identity: Identity,
    items: Vec<NewItem>,
    key: Option<String>,
    said: &[u8],
) -> Result<Ordered, ApiError> {
    let caller = identity.caller.clone();
    if let Some(key) = &key
        && let Turn::Again(id) = idempotency::turn(app, &caller, key, &[b"POST /v1/batches", said]).await?
    {
        let batch = find(app, &caller, &String::from_utf8_lossy(&id)).await?;
        return Ok(Ordered { batch, replayed: true });
    }
    let new = NewBatch { caller: caller.clone(), jobs_max: identity.jobs_max, items };
    let made = app.jobs.create_batch(new).await.map_err(ApiError::from);
    if let Some(key) = &key {
        let id = made.as_ref().ok().map(BatchId::to_string);
        app.jobs.remember(&caller, key, id.as_deref().map(str::as_bytes)).await?;
    }
    app.batch_came.notify_one();
    let batch = find(app, &caller, &made?.to_string()).await?;
    Ok(Ordered { batch, replayed: false })
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

/// The caller's batch with this id.
pub async fn find(app: &App, caller: &Caller, id: &str) -> Result<Batch, ApiError> {
    let missing = || ApiError::not_found("such batch");
    let id: BatchId = id.parse().map_err(|error| missing().hint(format!("{error}")))?;
    app.jobs.batch(caller, id).await?.ok_or_else(missing)
}

/// No further item becomes a job, and those that are jobs are canceled.
pub async fn cancel(app: &App, caller: &Caller, id: &str) -> Result<Batch, ApiError> {
    let batch = find(app, caller, id).await?;
    app.jobs.cancel_batch(caller, batch.id).await?;
    find(app, caller, id).await
}

/// The batch, after waiting for its end for a time.
pub async fn after(app: &App, caller: &Caller, mut batch: Batch, wait: Duration) -> Result<Batch, ApiError> {
    let began = Instant::now();
    while batch.finished_at.is_none() && began.elapsed() < wait && !*app.closing.borrow() {
        tokio::time::sleep(LOOK.min(wait.saturating_sub(began.elapsed()))).await;
        batch = find(app, caller, &batch.id.to_string()).await?;
    }
    Ok(batch)
}

/// What became of an item that is over.
pub struct Outcome {
    pub custom_id: String,
    pub became: Became,
}

pub enum Became {
    Rig(Box<Job>),
    /// Why there is none, and the job that has failed or was canceled.
    Nothing {
        error: Value,
        job: Option<JobId>,
    },
}

/// Items that are over, from the item `first` on, in order; and where the next page begins.
pub async fn outcomes(
    app: &App,
    caller: &Caller,
    id: BatchId,
    first: usize,
) -> Result<(Vec<Outcome>, Option<usize>), ApiError> {
    let items = app.jobs.batch_items(id, first, PAGE).await?;
    let next = items.last().filter(|_| items.len() == PAGE).map(|item| item.position + 1);
    let mut outcomes = Vec::with_capacity(items.len());
    for item in items {
        if matches!(item.state, ItemState::Job(state) if state.is_final()) {
            outcomes.push(outcome(app, caller, item).await?);
        }
    }
    Ok((outcomes, next))
}

async fn outcome(app: &App, caller: &Caller, item: BatchItem) -> Result<Outcome, ApiError> {
    let BatchItem { custom_id, state, job, error, .. } = item;
    let job = match job {
        Some(id) => app.jobs.get(caller, id).await?,
        None => None,
    };
    let refused = error.map(|error| serde_json::from_str(&error)).transpose();
    let refused: Option<Value> = refused.map_err(|error| ApiError::internal(&error))?;
    let became = match job {
        Some(job) if matches!(job.state, JobState::Succeeded | JobState::Expired) => Became::Rig(Box::new(job)),
        Some(job) => Became::Nothing { error: told(&why_none(&job))?, job: Some(job.id) },
        None => Became::Nothing { error: refused.map_or_else(|| told(&gone(state)), Ok)?, job: None },
    };
    Ok(Outcome { custom_id, became })
}

fn told(error: &ApiError) -> Result<Value, ApiError> {
    serde_json::to_value(JobErrorView::from(error)).map_err(|error| ApiError::internal(&error))
}

/// Why an item without a job and without a refusal has no rig.
fn gone(state: ItemState) -> ApiError {
    match state {
        ItemState::Job(JobState::Canceled) => canceled(),
        _ => ApiError::not_found("such job any more; it was deleted, or is forgotten"),
    }
}

/// Why a batch, or an item of it, was not worked off.
pub fn canceled() -> ApiError {
    ApiError::new(Code::Work(ErrorCode::Canceled), "the batch was canceled")
}
