//! Batches as messages. A request is read as the JSON that it stands for, so that one key is one batch through both doors.

use super::super::App;
use super::super::batch_orders::{self, Became, Outcome};
use super::super::http::batch_views;
use super::super::http::error::ApiError;
use super::messages::any;
use super::options::members;
use super::proto::google::longrunning::Operation;
use super::proto::google::longrunning::operation::Result as OperationResult;
use super::proto::rigsmith::v1::batch::State;
use super::proto::rigsmith::v1::batch_result::Result as ItemResult;
use super::proto::rigsmith::v1::{Batch, BatchItem, BatchResult, CreateBatchRequest, Rig, RigError};
use super::status::rpc_status;
use crate::jobs::{self, BatchCounts, BatchId, Caller};
use serde_json::{Map, Value};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

pub type Results = ReceiverStream<Result<BatchResult, Status>>;

/// Results read ahead of a slow reader.
const RESULTS_AHEAD: usize = 16;

/// The members of the JSON that a request stands for, and its id.
pub fn read(request: CreateBatchRequest) -> Result<(Map<String, Value>, String), ApiError> {
    let CreateBatchRequest { defaults, items, items_asset, request_id } = request;
    if !items.is_empty() && !items_asset.is_empty() {
        return Err(ApiError::field("items_asset", "stands in place of items; send one of them"));
    }
    let items = if items_asset.is_empty() { items.into_iter().map(item).collect() } else { Value::from(items_asset) };
    let mut read = Map::from_iter([("items".to_owned(), items)]);
    if let Some(defaults) = defaults {
        read.insert("defaults".to_owned(), Value::Object(members(defaults)));
    }
    Ok((read, request_id))
}

fn item(BatchItem { custom_id, asset, options }: BatchItem) -> Value {
    let mut request = members(options.unwrap_or_default());
    if !asset.is_empty() {
        request.insert("asset".to_owned(), Value::from(asset));
    }
    let item = [("custom_id".to_owned(), Value::from(custom_id)), ("request".to_owned(), Value::Object(request))];
    Value::Object(Map::from_iter(item))
}

/// The batch as a long-running operation.
pub fn operation(batch: &jobs::Batch) -> Operation {
    let told = any("rigsmith.v1.Batch", &Batch::from(batch));
    let result = match (batch.finished_at, batch.canceled_at) {
        (None, _) => None,
        (Some(_), None) => Some(OperationResult::Response(told.clone())),
        (Some(_), Some(_)) => Some(OperationResult::Error(rpc_status(&batch_orders::canceled()))),
    };
    Operation {
        name: format!("operations/{}", batch.id),
        metadata: Some(told),
        done: batch.finished_at.is_some(),
        result,
    }
}

impl From<&jobs::Batch> for Batch {
    fn from(batch: &jobs::Batch) -> Self {
        let BatchCounts { queued, running, succeeded, failed, canceled } = batch.counts;
        let state = match batch_views::state(batch) {
            "canceled" => State::Canceled,
            "completed" => State::Completed,
            _ => State::Running,
        };
        Self {
            id: batch.id.to_string(),
            state: state.into(),
            queued: queued as u64,
            running: running as u64,
            succeeded: succeeded as u64,
            failed: failed as u64,
            canceled: canceled as u64,
            create_time: Some(batch.created_at.into()),
            end_time: batch.finished_at.map(Into::into),
        }
    }
}

impl From<Outcome> for BatchResult {
    fn from(Outcome { custom_id, became }: Outcome) -> Self {
        match became {
            Became::Rig(job) => {
                Self { custom_id, result: Some(ItemResult::Rig(Rig::from(&*job))), rig_id: String::new() }
            }
            Became::Nothing { error, job } => Self {
                custom_id,
                result: Some(ItemResult::Error(rig_error(&error))),
                rig_id: job.map(|job| job.to_string()).unwrap_or_default(),
            },
        }
    }
}

/// An error as it is kept with its item.
fn rig_error(error: &Value) -> RigError {
    let text = |name: &str| error[name].as_str().unwrap_or_default().to_owned();
    RigError {
        code: text("code"),
        stage: text("stage"),
        message: text("message"),
        hint: text("hint"),
        retryable: error["retryable"].as_bool().unwrap_or_default(),
    }
}

/// What became of the items of a batch, page by page, until there are no more or nobody listens.
pub fn results(app: &App, caller: Caller, id: BatchId) -> Results {
    let (told, received) = mpsc::channel(RESULTS_AHEAD);
    let app = app.clone();
    tokio::spawn(async move {
        let mut first = 0;
        loop {
            let (outcomes, next) = match batch_orders::outcomes(&app, &caller, id, first).await {
                Ok(page) => page,
                Err(error) => {
                    // Nobody may be there to hear it.
                    let _ = told.send(Err(error.into())).await;
                    return;
                }
            };
            for outcome in outcomes {
                if told.send(Ok(BatchResult::from(outcome))).await.is_err() {
                    return;
                }
            }
            match next {
                Some(next) => first = next,
                None => return,
            }
        }
    });
    ReceiverStream::new(received)
}
