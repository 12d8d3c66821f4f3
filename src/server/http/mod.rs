//! The REST interface, and what every request goes through, gRPC too. A handler extracts, calls [`crate::jobs`], and answers.

pub mod artifacts;
pub mod asset_views;
pub mod assets;
pub mod authenticate;
pub(super) mod batch_items;
pub mod batch_views;
pub mod batches;
pub mod check_views;
pub mod codes;
pub mod create;
pub mod error;
pub mod events;
pub(super) mod fetch;
pub(super) mod idempotency;
pub mod media;
pub(super) mod negotiate;
pub mod openapi;
pub(super) mod outermost;
pub(super) mod receive;
pub mod request_views;
pub mod rigs;
mod segments;
pub mod service;
pub(super) mod sink;
pub mod tickets;
pub(super) mod timestamp;
pub mod tus;
mod tus_headers;
mod tus_receive;
mod upload_views;
pub mod verbs;
pub mod views;
pub mod webhook_deliveries;
pub mod webhook_views;
pub mod webhooks;
pub mod wishes;
mod words;

use self::error::{ApiError, Code};
use super::{App, grpc};
use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::{HeaderMap, Method, Uri};
use axum::middleware::{from_fn, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use tower_http::catch_panic::CatchPanicLayer;

/// Every path of the service.
pub fn routes(app: App) -> Router {
    let endpoint = get(webhooks::get_endpoint).patch(webhooks::change_endpoint).delete(webhooks::delete_endpoint);
    let endpoint = endpoint.post(webhooks::endpoint_verb);
    Router::new()
        .route("/", get(openapi::front))
        .route("/docs", get(openapi::docs))
        .route("/livez", get(service::livez))
        .route("/readyz", get(service::readyz))
        .route("/startupz", get(service::startupz))
        .route("/version", get(service::version))
        .route("/v1/openapi.json", get(openapi::openapi))
        .route("/v1/problems", get(service::list_problems))
        .route("/v1/problems/{code}", get(service::get_problem))
        .route("/v1/methods", get(service::list_methods))
        .route("/v1/assets", post(assets::create_asset))
        .route("/v1/assets/{id}", get(assets::get_asset).delete(assets::delete_asset))
        .route("/v1/assets/{id}/content", get(assets::get_asset_content))
        .route("/v1/batches", get(batches::list_batches).post(batches::create_batch))
        .route("/v1/batches/{id}", get(batches::get_batch).post(batches::batch_verb))
        .route("/v1/batches/{id}/results", get(batches::get_batch_results))
        .route("/v1/rigs", get(rigs::list_rigs).post(create::create_rig))
        .route("/v1/rigs:check", post(create::check_rig))
        .route("/v1/rigs/{id}", get(rigs::get_rig).put(create::put_rig).delete(rigs::delete_rig).post(verbs::rig_verb))
        .route("/v1/rigs/{id}/events", get(events::rig_events))
        .route("/v1/rigs/{id}/artifacts", get(artifacts::list_artifacts))
        .route("/v1/rigs/{id}/artifacts/{name}", get(artifacts::get_artifact))
        .route("/v1/webhook-endpoints", get(webhooks::list_endpoints).post(webhooks::create_endpoint))
        .route("/v1/webhook-endpoints/{id}", endpoint)
        .route("/v1/webhook-endpoints/{id}/deliveries", get(webhook_deliveries::list_deliveries))
        .route(
            "/v1/webhook-endpoints/{id}/deliveries/{message}",
            get(webhook_deliveries::get_delivery).post(webhook_deliveries::delivery_verb),
        )
        .merge(tus::routes())
        .merge(grpc::routes(&app))
        .fallback(no_such_path)
        .method_not_allowed_fallback(no_such_method)
        // Uploads have a limit of their own, in `receive`.
        .layer(DefaultBodyLimit::disable())
        .layer(CatchPanicLayer::custom(outermost::panicked))
        .layer(from_fn_with_state(app.clone(), authenticate::authenticate))
        .layer(from_fn(outermost::outermost))
        .with_state(app)
}

async fn no_such_path(uri: Uri, headers: HeaderMap) -> Response {
    if grpc::is_grpc(&headers) {
        return grpc::no_such_method(uri.path());
    }
    ApiError::not_found(&format!("path {}", uri.path())).hint("/docs lists every path").into_response()
}

/// axum adds `Allow`.
async fn no_such_method(method: Method, uri: Uri) -> ApiError {
    ApiError::new(Code::MethodNotAllowed, format!("{method} is not for {}", uri.path()))
        .hint("Allow names the methods of this path; /docs lists every path")
}
