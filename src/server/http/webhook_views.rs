//! Webhooks as JSON.

use super::batch_views::BatchView;
use super::timestamp::rfc3339;
use super::views::JobView;
use super::words::{DeliveryStateName, EventName, MessageTypeName};
use crate::jobs::EndpointId;
use crate::jobs::webhooks::{Attempt, Delivery, Endpoint};
use serde::Serialize;
use serde_json::{Map, Value};
use utoipa::ToSchema;

/// A place that is told what happens to your rigs and batches.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookEndpoint)]
pub struct EndpointView {
    #[schema(example = "whe_01jdf5fj63fh5ra1njpy75fmyg")]
    pub id: String,
    #[schema(example = "webhook_endpoint")]
    pub object: &'static str,
    /// `null`: what requests want told by `webhook` is signed with its secret, and stands in its log.
    #[schema(example = "https://studio.example/hooks/rigs")]
    pub url: Option<String>,
    #[schema(example = "asset pipeline")]
    pub description: String,
    /// What it is told.
    #[schema(value_type = Vec<EventName>, example = json!(["rig.succeeded", "rig.failed"]))]
    pub events: Vec<&'static str>,
    /// It is told nothing while this is `false`.
    #[schema(example = true)]
    pub enabled: bool,
    /// Why the service has disabled it.
    #[schema(example = json!(null))]
    pub disabled_reason: Option<String>,
    /// Since when nothing was taken there; `null`: the last message was.
    #[schema(example = json!(null), format = DateTime)]
    pub failing_since: Option<String>,
    #[schema(example = "2026-11-26T10:20:07.042Z", format = DateTime)]
    pub created_at: String,
    /// What signs its messages. Shown when it is made, and never again.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "whsec_C2FVsBQIhrscChlQIMV+b5sSYspob7oDJGGKXQ8pYwY=")]
    pub secret: Option<String>,
    pub links: EndpointLinksView,
}

#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookEndpointLinks)]
pub struct EndpointLinksView {
    #[schema(example = "/v1/webhook-endpoints/whe_01jdf5fj63fh5ra1njpy75fmyg")]
    #[serde(rename = "self")]
    pub this: String,
    /// What it was told, and what is to be told.
    #[schema(example = "/v1/webhook-endpoints/whe_01jdf5fj63fh5ra1njpy75fmyg/deliveries")]
    pub deliveries: String,
}

/// Endpoints, oldest first.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookEndpointList)]
pub struct EndpointListView {
    #[schema(example = "list")]
    pub object: &'static str,
    pub data: Vec<EndpointView>,
}

/// Where you want to be told, and what.
#[derive(ToSchema)]
#[schema(as = CreateWebhookEndpoint)]
pub struct CreateEndpointView {
    /// `https`, on the public internet. Left out in the one endpoint that signs what requests want told by `webhook`.
    #[schema(required = false, example = "https://studio.example/hooks/rigs")]
    pub url: String,
    /// Everything unless given; not without `url`.
    #[schema(required = false, value_type = Vec<EventName>, example = json!(["rig.succeeded", "rig.failed"]))]
    pub events: Vec<String>,
    /// A word of your own, of 256 bytes at most.
    #[schema(required = false, example = "asset pipeline")]
    pub description: String,
}

/// What is to be different; what is not given stays.
#[derive(ToSchema)]
#[schema(as = ChangeWebhookEndpoint)]
pub struct ChangeEndpointView {
    #[schema(required = false, example = "https://studio.example/hooks/rigs")]
    pub url: String,
    #[schema(required = false, value_type = Vec<EventName>, example = json!(["rig.succeeded", "rig.failed"]))]
    pub events: Vec<String>,
    #[schema(required = false, example = "asset pipeline")]
    pub description: String,
    /// `true` also for an endpoint that the service has disabled.
    #[schema(required = false, example = true)]
    pub enabled: bool,
}

/// What became of a message at one endpoint.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookDelivery)]
pub struct DeliveryView {
    /// Of the message: its `webhook-id`, the same at every endpoint and every time that it is sent.
    #[schema(example = "evt_01jdf5fj63fh5ra1njpy75fmyg")]
    pub id: String,
    #[schema(example = "webhook_delivery")]
    pub object: &'static str,
    #[schema(value_type = MessageTypeName, example = "rig.succeeded")]
    pub r#type: &'static str,
    #[schema(value_type = DeliveryStateName, example = "pending")]
    pub state: &'static str,
    /// When it happened.
    #[schema(example = "2026-11-26T10:20:07.042Z", format = DateTime)]
    pub created_at: String,
    /// `null` unless pending.
    #[schema(example = "2026-11-26T10:25:12.042Z", format = DateTime)]
    pub next_attempt_at: Option<String>,
    /// The newest 32, in order.
    pub attempts: Vec<AttemptView>,
    pub links: DeliveryLinksView,
}

#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookDeliveryLinks)]
pub struct DeliveryLinksView {
    #[schema(
        example = "/v1/webhook-endpoints/whe_01jdf5fj63fh5ra1njpy75fmyg/deliveries/evt_01jdf5fj63fh5ra1njpy75fmyg"
    )]
    #[serde(rename = "self")]
    pub this: String,
    /// POST here to have it sent again.
    #[schema(
        example = "/v1/webhook-endpoints/whe_01jdf5fj63fh5ra1njpy75fmyg/deliveries/evt_01jdf5fj63fh5ra1njpy75fmyg:redeliver"
    )]
    pub redeliver: String,
}

/// One try to deliver a message.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookAttempt)]
pub struct AttemptView {
    #[schema(example = 1)]
    pub number: u32,
    #[schema(example = "2026-11-26T10:20:07.311Z", format = DateTime)]
    pub at: String,
    #[schema(example = 84)]
    pub duration_ms: u64,
    /// What the endpoint answered; `null`: nothing.
    #[schema(example = 500)]
    pub status: Option<u16>,
    /// Why that is no delivery.
    #[schema(example = "it answered 500")]
    pub error: Option<String>,
}

/// Deliveries, newest first.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookDeliveryList)]
pub struct DeliveryListView {
    #[schema(example = "list")]
    pub object: &'static str,
    pub data: Vec<DeliveryView>,
    /// Give it as `page_token` for the next page; `null` on the last one.
    pub next_page_token: Option<String>,
}

/// The body of a webhook.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookMessage)]
pub struct MessageView {
    #[schema(value_type = MessageTypeName, example = "rig.succeeded")]
    pub r#type: &'static str,
    /// When it happened.
    #[schema(example = "2026-11-26T10:20:07.042Z", format = DateTime)]
    pub timestamp: String,
    /// Of two messages about the same rig, the later one has the higher number.
    #[schema(example = 17)]
    pub sequence: u64,
    /// The rig or batch as it was then; 20,000 bytes at most.
    #[schema(value_type = MessageDataView)]
    pub data: Map<String, Value>,
    /// Members of `data` that made it too large; the rig itself has them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false, example = json!([]))]
    pub left_out: Vec<&'static str>,
}

/// What a message is about.
#[derive(Serialize, ToSchema)]
#[serde(untagged)]
#[schema(as = WebhookMessageData)]
pub enum MessageDataView {
    Rig(Box<JobView>),
    Batch(BatchView),
    Test(TestView),
}

/// What a test message tells.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookTest)]
pub struct TestView {
    #[schema(example = "webhook_test")]
    pub object: &'static str,
    #[schema(example = "whe_01jdf5fj63fh5ra1njpy75fmyg")]
    pub endpoint: String,
}

impl TestView {
    pub fn new(endpoint: EndpointId) -> Self {
        Self { object: "webhook_test", endpoint: endpoint.to_string() }
    }
}

/// Where an endpoint lives.
pub fn endpoint_path(id: EndpointId) -> String {
    format!("/v1/webhook-endpoints/{id}")
}

impl From<&Endpoint> for EndpointView {
    fn from(endpoint: &Endpoint) -> Self {
        let path = endpoint_path(endpoint.id);
        Self {
            id: endpoint.id.to_string(),
            object: "webhook_endpoint",
            url: endpoint.url.clone(),
            description: endpoint.description.clone(),
            events: endpoint.events.iter().map(|event| event.name()).collect(),
            enabled: endpoint.enabled,
            disabled_reason: endpoint.disabled_reason.clone(),
            failing_since: endpoint.failing_since.map(rfc3339),
            created_at: rfc3339(endpoint.created_at),
            secret: None,
            links: EndpointLinksView { deliveries: format!("{path}/deliveries"), this: path },
        }
    }
}

impl EndpointView {
    /// For the moment in which its secret is made.
    pub fn with_secret(endpoint: &Endpoint) -> Self {
        Self { secret: Some(endpoint.secret.text()), ..Self::from(endpoint) }
    }
}

impl DeliveryView {
    pub fn new(endpoint: EndpointId, delivery: &Delivery) -> Self {
        let path = format!("{}/deliveries/{}", endpoint_path(endpoint), delivery.message);
        Self {
            id: delivery.message.to_string(),
            object: "webhook_delivery",
            r#type: delivery.kind.name(),
            state: delivery.state.name(),
            created_at: rfc3339(delivery.at),
            next_attempt_at: delivery.next_attempt_at.map(rfc3339),
            attempts: delivery.attempts.iter().map(AttemptView::from).collect(),
            links: DeliveryLinksView { redeliver: format!("{path}:redeliver"), this: path },
        }
    }
}

impl From<&Attempt> for AttemptView {
    fn from(attempt: &Attempt) -> Self {
        Self {
            number: attempt.number,
            at: rfc3339(attempt.at),
            duration_ms: attempt.duration.as_millis() as u64,
            status: attempt.status,
            error: attempt.error.clone(),
        }
    }
}
