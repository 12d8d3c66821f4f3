//! Batches as JSON.

use super::timestamp::rfc3339;
use super::views::{JobErrorView, JobView};
use crate::jobs::{Batch, BatchCounts};
use crate::server::batch_orders::{Became, Outcome};
use serde::Serialize;
use serde_json::Value;
use utoipa::ToSchema;

/// Many rigs that were ordered together.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Batch)]
pub struct BatchView {
    #[schema(example = "bat_01jdf5fj63fh5ra1njpy75fmyg")]
    pub id: String,
    #[schema(example = "batch")]
    pub object: &'static str,
    /// `running`, `completed` or `canceled`. A canceled one may have jobs that have not yielded yet; `finished_at` tells.
    #[schema(example = "running")]
    pub state: &'static str,
    #[schema(example = 500)]
    pub total: usize,
    pub counts: BatchCountsView,
    #[schema(example = "2026-11-26T10:20:07.042Z", format = DateTime)]
    pub created_at: String,
    /// When the last item was over.
    #[schema(example = "2026-11-26T11:02:40.611Z", format = DateTime)]
    pub finished_at: Option<String>,
    pub links: BatchLinksView,
}

/// How many items are in which state.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = BatchCounts)]
pub struct BatchCountsView {
    /// Those that are no job yet included.
    #[schema(example = 312)]
    pub queued: usize,
    #[schema(example = 1)]
    pub running: usize,
    #[schema(example = 180)]
    pub succeeded: usize,
    #[schema(example = 7)]
    pub failed: usize,
    #[schema(example = 0)]
    pub canceled: usize,
}

#[derive(Debug, Serialize, ToSchema)]
#[schema(as = BatchLinks)]
pub struct BatchLinksView {
    #[schema(example = "/v1/batches/bat_01jdf5fj63fh5ra1njpy75fmyg")]
    #[serde(rename = "self")]
    pub this: String,
    #[schema(example = "/v1/batches/bat_01jdf5fj63fh5ra1njpy75fmyg/results")]
    pub results: String,
    /// POST here; `null` once the batch is over.
    #[schema(example = "/v1/batches/bat_01jdf5fj63fh5ra1njpy75fmyg:cancel")]
    pub cancel: Option<String>,
}

/// Batches, newest first.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = BatchList)]
pub struct BatchListView {
    #[schema(example = "list")]
    pub object: &'static str,
    pub data: Vec<BatchView>,
    /// Give it as `page_token` for the next page; `null` on the last one.
    pub next_page_token: Option<String>,
}

impl From<&Batch> for BatchView {
    fn from(batch: &Batch) -> Self {
        let path = format!("/v1/batches/{}", batch.id);
        let BatchCounts { queued, running, succeeded, failed, canceled } = batch.counts;
        Self {
            id: batch.id.to_string(),
            object: "batch",
            state: state(batch),
            total: batch.counts.total(),
            counts: BatchCountsView { queued, running, succeeded, failed, canceled },
            created_at: rfc3339(batch.created_at),
            finished_at: batch.finished_at.map(rfc3339),
            links: BatchLinksView {
                results: format!("{path}/results"),
                cancel: batch.finished_at.is_none().then(|| format!("{path}:cancel")),
                this: path,
            },
        }
    }
}

/// In one word.
pub fn state(batch: &Batch) -> &'static str {
    match (batch.canceled_at, batch.finished_at) {
        (Some(_), _) => "canceled",
        (None, Some(_)) => "completed",
        (None, None) => "running",
    }
}

/// Requests to be worked on together.
#[derive(ToSchema)]
#[schema(as = CreateBatch)]
pub struct CreateBatchView {
    /// Members of every request that does not say otherwise.
    #[schema(value_type = Option<Object>, example = json!({"detail": 0.7, "labels": {"project": "knights"}}))]
    pub defaults: Option<Value>,
    /// At most 1,000 items; or the id of an asset whose only file has such an item in each of its lines.
    pub items: Vec<BatchItemView>,
}

#[derive(ToSchema)]
#[schema(as = BatchItem)]
pub struct BatchItemView {
    /// Your name for it, 1 to 128 characters, once per batch.
    #[schema(example = "knight-17")]
    pub custom_id: String,
    /// As the JSON of `POST /v1/rigs`, with the id of an asset.
    #[schema(value_type = Object, example = json!({"asset": "ast_01jdf5fj5rfxm8s1m2q1d2zt8v", "seed": 1}))]
    pub request: Value,
}

/// What became of one item.
#[derive(Serialize, ToSchema)]
#[schema(as = BatchResult)]
pub struct BatchResultView {
    #[schema(example = "knight-17")]
    pub custom_id: String,
    /// The rig, when there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rig: Option<JobView>,
    /// Why there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<JobErrorView>)]
    pub error: Option<Value>,
    /// The job that has failed, or was canceled.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rig_id: Option<String>,
}

impl From<Outcome> for BatchResultView {
    fn from(Outcome { custom_id, became }: Outcome) -> Self {
        match became {
            Became::Rig(job) => Self { custom_id, rig: Some(JobView::from(&*job)), error: None, rig_id: None },
            Became::Nothing { error, job } => {
                Self { custom_id, rig: None, error: Some(error), rig_id: job.map(|job| job.to_string()) }
            }
        }
    }
}
