//! The description of the interface, for machines at `/v1/openapi.json` and for people at `/docs`.

use super::authenticate::TICKET;
use super::error::{Code, ProblemView};
use super::request_views::RequestView;
use super::webhook_views::MessageView;
use super::{
    artifacts, assets, batches, create, events, rigs, service, tickets, tus, verbs, webhook_deliveries, webhooks,
};
use crate::jobs::ErrorCode;
use crate::jobs::webhooks::MessageType;
use axum::Json;
use axum::http::header;
use axum::response::{Html, IntoResponse};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::sync::LazyLock;
use utoipa::OpenApi;

#[derive(OpenApi)]
#[openapi(
    info(
        title = "Rigsmith",
        description = "Rigs characters: send a mesh, get the same file back with a skeleton and skin weights. The same port speaks gRPC \
                       (rigsmith.v1.RigService, described by reflection).",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0"),
    ),
    servers((url = "/", description = "This service")),
    tags(
        (name = "rigs", description = "A mesh in, a rig out."),
        (name = "assets", description = "Meshes that are kept, to be rigged more than once."),
        (name = "uploads", description = "Files that arrive in parts and can be taken up where they broke (tus 1.0). A complete one is an asset."),
        (name = "batches", description = "Many rigs at once, behind everything else."),
        (name = "webhooks", description = "Being told what happens, instead of asking."),
        (name = "artifacts", description = "The files that were made."),
        (name = "service", description = "What runs here, and how it is."),
    ),
    paths(
        create::create_rig, create::put_rig, create::check_rig,
        rigs::get_rig, rigs::list_rigs, rigs::delete_rig, events::rig_events,
        verbs::cancel_rig, verbs::export_rig, verbs::reskin_rig, tickets::ticket_rig,
        assets::create_asset, assets::get_asset, assets::delete_asset, assets::get_asset_content,
        tus::upload_options, tus::create_upload, tus::get_upload, tus::head_upload, tus::patch_upload, tus::delete_upload,
        artifacts::list_artifacts, artifacts::get_artifact,
        batches::create_batch, batches::get_batch, batches::list_batches, batches::cancel_batch, batches::get_batch_results,
        webhooks::create_endpoint, webhooks::list_endpoints, webhooks::get_endpoint, webhooks::change_endpoint,
        webhooks::delete_endpoint, webhooks::rotate_secret, webhook_deliveries::test_endpoint,
        webhook_deliveries::list_deliveries, webhook_deliveries::get_delivery, webhook_deliveries::redeliver,
        service::list_methods, service::list_problems, service::get_problem,
        service::livez, service::readyz, service::startupz, service::version,
    ),
    components(schemas(ProblemView, RequestView, MessageView)),
)]
struct Description;

/// Refusals of what stands in the query and the path,
const ASKING: &[Code] = &[Code::UnknownField, Code::InvalidParameter];
/// of everything that uploads,
const UPLOADING: &[Code] = &[
    Code::UnknownField,
    Code::InvalidParameter,
    Code::InvalidMultipart,
    Code::UploadIncomplete,
    Code::UploadTimeout,
    Code::QueueFull,
    Code::Work(ErrorCode::TooLarge),
    Code::Work(ErrorCode::UnsupportedMediaType),
    Code::Work(ErrorCode::UnreadableMesh),
    Code::Work(ErrorCode::Draining),
];
/// of what needs the networks,
const WORKING: &[Code] = &[Code::InvalidJson, Code::NotFound, Code::Starting, Code::Work(ErrorCode::ModelUnavailable)];
/// of what fetches,
const FETCHING: &[Code] = &[Code::FetchFailed];
/// of what makes jobs and answers with their file,
const CREATING: &[Code] = &[
    Code::Conflict,
    Code::NotAcceptable,
    Code::QuotaExceeded,
    Code::IdempotencyMismatch,
    Code::IdempotencyInProgress,
    Code::Work(ErrorCode::NoJointsFound),
    Code::Work(ErrorCode::DegenerateSkeleton),
    Code::Work(ErrorCode::Timeout),
    Code::Work(ErrorCode::OutOfMemory),
    Code::Work(ErrorCode::NumericalFailure),
    Code::Work(ErrorCode::OutputInvalid),
    Code::Work(ErrorCode::WorkerLost),
    Code::Work(ErrorCode::Canceled),
];
/// and of meshes that are looked into.
const READING: &[Code] = &[
    Code::Work(ErrorCode::TooManyFaces),
    Code::Work(ErrorCode::TooManyVertices),
    Code::Work(ErrorCode::ZipBomb),
    Code::Work(ErrorCode::NoGeometry),
    Code::Work(ErrorCode::NonFiniteVertices),
    Code::Work(ErrorCode::UnsupportedExtension),
    Code::Work(ErrorCode::MissingResource),
    Code::Work(ErrorCode::AlreadyRigged),
    Code::Work(ErrorCode::NotRiggable),
];
/// Refusals of what is sent and read without a job,
const SENDING: &[Code] = &[Code::QuotaExceeded, Code::Work(ErrorCode::OutOfMemory)];
/// of what is written again,
const EXPORTING: &[Code] = &[
    Code::UploadIncomplete,
    Code::UploadTimeout,
    Code::QueueFull,
    Code::Work(ErrorCode::TooLarge),
    Code::Work(ErrorCode::UnsupportedMediaType),
    Code::Work(ErrorCode::UnreadableMesh),
    Code::Work(ErrorCode::OutputInvalid),
    Code::Work(ErrorCode::Draining),
];
/// and weighed again.
const RESKINNING: &[Code] = &[
    Code::Expired,
    Code::QuotaExceeded,
    Code::IdempotencyMismatch,
    Code::IdempotencyInProgress,
    Code::Work(ErrorCode::SkeletonInvalid),
    Code::Work(ErrorCode::OutOfMemory),
];
/// Refusals of what brings many requests at once.
const BATCHING: &[Code] = &[
    Code::InvalidJson,
    Code::UploadIncomplete,
    Code::UploadTimeout,
    Code::NotFound,
    Code::QueueFull,
    Code::IdempotencyMismatch,
    Code::IdempotencyInProgress,
    Code::Work(ErrorCode::TooLarge),
    Code::Work(ErrorCode::UnsupportedMediaType),
    Code::Work(ErrorCode::Draining),
];
/// Refusals of uploads in parts,
const RESUMING: &[Code] = &[Code::UnsupportedVersion, Code::NotFound, Code::Expired];
/// and of their bytes.
const CARRYING: &[Code] = &[
    Code::UploadIncomplete,
    Code::UploadTimeout,
    Code::QueueFull,
    Code::ChecksumMismatch,
    Code::Work(ErrorCode::TooLarge),
    Code::Work(ErrorCode::UnsupportedMediaType),
    Code::Work(ErrorCode::Draining),
];
/// Refusals of what is said of a webhook endpoint.
const DESCRIBING: &[Code] =
    &[Code::InvalidJson, Code::UploadIncomplete, Code::UploadTimeout, Code::Conflict, Code::Work(ErrorCode::TooLarge)];
/// Refusals of whatever asks for a key, and of a service whose jobs cannot be read or written.
const GUARDED: &[Code] =
    &[Code::Unauthenticated, Code::RateLimited, Code::StoreUnavailable, Code::Work(ErrorCode::Internal)];

/// Which refusals each operation may answer with, by its id. Operations that are not here refuse nothing.
const PROBLEMS: &[(&str, &[&[Code]])] = &[
    ("create_rig", &[GUARDED, UPLOADING, WORKING, FETCHING, CREATING, READING]),
    ("put_rig", &[GUARDED, UPLOADING, WORKING, FETCHING, CREATING, READING]),
    ("check_rig", &[GUARDED, UPLOADING, WORKING, FETCHING, READING, SENDING]),
    ("get_rig", &[GUARDED, ASKING, &[Code::NotFound]]),
    ("list_rigs", &[GUARDED, ASKING]),
    ("cancel_rig", &[GUARDED, ASKING, &[Code::NotFound, Code::NotCancelable]]),
    (
        "export_rig",
        &[
            GUARDED,
            ASKING,
            READING,
            EXPORTING,
            &[Code::QuotaExceeded, Code::NotFound, Code::Conflict, Code::Expired, Code::InvalidJson],
        ],
    ),
    ("reskin_rig", &[GUARDED, UPLOADING, WORKING, RESKINNING]),
    ("delete_rig", &[GUARDED, ASKING, &[Code::NotFound, Code::Conflict]]),
    ("rig_events", &[GUARDED, ASKING, &[Code::NotFound]]),
    ("ticket_rig", &[GUARDED, ASKING, &[Code::NotFound]]),
    (
        "create_asset",
        &[
            GUARDED,
            UPLOADING,
            READING,
            SENDING,
            &[Code::IdempotencyMismatch, Code::IdempotencyInProgress, Code::NotFound],
        ],
    ),
    ("get_asset", &[GUARDED, ASKING, &[Code::NotFound]]),
    ("delete_asset", &[GUARDED, ASKING, &[Code::NotFound]]),
    ("get_asset_content", &[GUARDED, ASKING, &[Code::NotFound, Code::Expired, Code::RangeNotSatisfiable]]),
    ("upload_options", &[GUARDED]),
    (
        "create_upload",
        &[
            GUARDED,
            ASKING,
            RESUMING,
            CARRYING,
            &[Code::QuotaExceeded, Code::IdempotencyMismatch, Code::IdempotencyInProgress],
        ],
    ),
    ("get_upload", &[GUARDED, ASKING, &[Code::NotFound, Code::Expired]]),
    ("head_upload", &[GUARDED, ASKING, RESUMING]),
    ("patch_upload", &[GUARDED, ASKING, RESUMING, CARRYING, &[Code::QuotaExceeded, Code::Conflict]]),
    ("delete_upload", &[GUARDED, ASKING, RESUMING]),
    ("list_artifacts", &[GUARDED, ASKING, &[Code::NotFound, Code::Expired]]),
    ("get_artifact", &[GUARDED, ASKING, &[Code::NotFound, Code::Expired, Code::RangeNotSatisfiable]]),
    ("create_batch", &[GUARDED, ASKING, BATCHING]),
    ("get_batch", &[GUARDED, ASKING, &[Code::NotFound]]),
    ("list_batches", &[GUARDED, ASKING]),
    ("cancel_batch", &[GUARDED, ASKING, &[Code::NotFound]]),
    ("get_batch_results", &[GUARDED, ASKING, &[Code::NotFound]]),
    ("create_endpoint", &[GUARDED, ASKING, DESCRIBING, &[Code::IdempotencyMismatch, Code::IdempotencyInProgress]]),
    ("list_endpoints", &[GUARDED, ASKING]),
    ("get_endpoint", &[GUARDED, ASKING, &[Code::NotFound]]),
    ("change_endpoint", &[GUARDED, ASKING, DESCRIBING, &[Code::NotFound]]),
    ("delete_endpoint", &[GUARDED, ASKING, &[Code::NotFound]]),
    ("rotate_secret", &[GUARDED, ASKING, &[Code::NotFound]]),
    ("test_endpoint", &[GUARDED, ASKING, &[Code::NotFound, Code::Conflict]]),
    ("list_deliveries", &[GUARDED, ASKING, &[Code::NotFound]]),
    ("get_delivery", &[GUARDED, ASKING, &[Code::NotFound]]),
    ("redeliver", &[GUARDED, ASKING, &[Code::NotFound, Code::Conflict]]),
    ("list_methods", &[GUARDED, ASKING]),
    ("get_problem", &[&[Code::NotFound]]),
    ("readyz", &[&[Code::Starting, Code::Work(ErrorCode::Draining), Code::Work(ErrorCode::ModelUnavailable)]]),
    ("startupz", &[&[Code::Starting]]),
];

/// The OpenAPI 3.1 document.
pub async fn openapi() -> impl IntoResponse {
    static DOCUMENT: LazyLock<Value> = LazyLock::new(document);
    Json(DOCUMENT.clone())
}

/// The description as JSON.
pub fn document() -> Value {
    let mut document = serde_json::to_value(Description::openapi()).unwrap_or_default();
    let scheme = json!({"type": "http", "scheme": "bearer", "description": "A key made by `rigsmith keys new`; only where the service asks for keys"});
    let ticket = json!({"type": "apiKey", "in": "query", "name": TICKET, "description": "A ticket from `POST /v1/rigs/{id}:ticket`; opens the events of one rig"});
    document["components"]["securitySchemes"] = json!({"key": scheme, "ticket": ticket});
    document["webhooks"] = MessageType::ALL.into_iter().map(|kind| (kind.name().to_owned(), told(kind))).collect();
    let paths = document.get_mut("paths").and_then(Value::as_object_mut);
    let operations = paths.into_iter().flat_map(Map::values_mut).filter_map(Value::as_object_mut);
    for operation in operations.flat_map(Map::values_mut) {
        complete(operation);
    }
    document
}

/// What an endpoint is asked when it is told of `kind`.
fn told(kind: MessageType) -> Value {
    let header = |name: &str, about: &str| json!({"name": name, "in": "header", "required": true, "description": about, "schema": {"type": "string"}});
    json!({"post": {
        "summary": format!("{} happened", kind.name()),
        "tags": ["webhooks"],
        "parameters": [
            header("webhook-id", "Of the message; the same when it comes again"),
            header("webhook-timestamp", "When it was sent, in seconds since 1970"),
            header("webhook-signature", "`v1,` and an HMAC-SHA256 of `id.timestamp.body` in base64; several while a secret is replaced"),
        ],
        "requestBody": {"required": true, "content": {
            "application/json": {"schema": {"$ref": "#/components/schemas/WebhookMessage"}},
        }},
        "responses": {
            "2XX": {"description": "Taken"},
            "410": {"description": "Send nothing more: the endpoint is disabled"},
            "default": {"description": "Send it again later, not before `Retry-After`"},
        },
    }})
}

/// Adds the refusals of an operation, and whether it asks for a key.
fn complete(operation: &mut Value) {
    let id = operation["operationId"].as_str().unwrap_or_default().to_owned();
    leave_out_or_give(operation);
    let Some((_, groups)) = PROBLEMS.iter().find(|(known, _)| *known == id) else { return };
    let mut by_status: BTreeMap<u16, Vec<&str>> = BTreeMap::new();
    for facts in groups.iter().copied().flatten().map(|code| code.facts()) {
        let codes = by_status.entry(facts.status.as_u16()).or_default();
        if !codes.contains(&facts.code) {
            codes.push(facts.code);
        }
    }
    if groups.contains(&GUARDED) {
        operation["security"] = match id.as_str() {
            "rig_events" => json!([{"key": []}, {"ticket": []}, {}]),
            _ => json!([{"key": []}, {}]),
        };
    }
    for (status, codes) in by_status {
        let named: Vec<String> = codes.iter().map(|code| format!("`{code}`")).collect();
        let problem = json!({"schema": {"$ref": "#/components/schemas/Problem"}});
        let mut response = json!({"description": named.join(", "), "content": {"application/problem+json": problem}});
        if [429, 503].contains(&status) {
            let seconds = json!({"type": "integer", "minimum": 1});
            response["headers"] =
                json!({"Retry-After": {"description": "Seconds after which to try again", "schema": seconds}});
        }
        operation["responses"][status.to_string()] = response;
    }
}

/// A parameter that may be left out cannot be `null`: there is no way to write that in a header or a query.
fn leave_out_or_give(operation: &mut Value) {
    let parameters = operation.get_mut("parameters").and_then(Value::as_array_mut);
    for schema in parameters.into_iter().flatten().filter_map(|parameter| parameter.get_mut("schema")) {
        let given = |kind: &Value| *kind != "null" && kind.get("type").is_none_or(|kind| *kind != "null");
        for several in ["type", "oneOf"] {
            let Some(kinds) = schema.get_mut(several).and_then(Value::as_array_mut) else { continue };
            kinds.retain(given);
            if let [only] = &kinds[..] {
                let only = only.clone();
                match several {
                    "type" => schema["type"] = only,
                    _ => *schema = only,
                }
            }
        }
    }
}

/// The same for people; a page that draws itself from the document and loads nothing else.
pub async fn docs() -> impl IntoResponse {
    page(include_str!("docs.html"))
}

/// A page to try the service with a file.
pub async fn front() -> impl IntoResponse {
    page(include_str!("front.html"))
}

fn page(html: &'static str) -> impl IntoResponse {
    const POLICY: &str = "default-src 'self'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; \
                          img-src 'self' data: blob:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'";
    ([(header::CONTENT_SECURITY_POLICY, POLICY), (header::CACHE_CONTROL, "no-cache")], Html(html))
}
