//! Tickets to the events of one rig, for browsers.

use super::App;
use super::authenticate::{Identity, TICKET};
use super::error::ApiError;
use super::negotiate::query;
use super::outermost::AboutJob;
use super::rigs::find;
use super::timestamp::rfc3339;
use crate::server::tickets::LIFETIME;
use axum::Json;
use axum::extract::Request;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use std::time::SystemTime;
use utoipa::ToSchema;

/// Opens the events of one rig, and nothing else.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Ticket)]
pub struct TicketView {
    #[schema(example = "ticket")]
    pub object: &'static str,
    /// Where to watch, with the ticket in it.
    #[schema(example = "/v1/rigs/rig_01jdf5fj63fh5ra1njpy75fmyg/events?ticket=q6Z3…")]
    pub url: String,
    #[schema(example = "2026-11-24T15:25:07.042Z", format = DateTime)]
    pub expires_at: String,
}

/// Get a ticket to the events of a rig.
///
/// For a browser's `EventSource`, which can send no key: `url` may be opened without one, for five minutes. The ticket opens
/// the events of this rig and nothing else, and only while your key is known. Where no key is asked for, `url` has no ticket.
#[utoipa::path(
    post, path = "/v1/rigs/{id}:ticket", tag = "rigs",
    params(("id" = String, Path, description = "Id of the rig", example = "rig_01jdf5fj63fh5ra1njpy75fmyg")),
    responses((status = 200, description = "The ticket", body = TicketView)),
    extensions(("x-curl" = json!("curl -X POST $HOST/v1/rigs/$ID:ticket   # in the page: new EventSource(url)"))),
)]
pub(super) async fn ticket_rig(
    app: &App,
    identity: Identity,
    id: &str,
    request: Request,
) -> Result<Response, ApiError> {
    query(request.uri(), &[])?;
    let job = find(app, &identity.caller, id).await?;
    let expires_at = SystemTime::now() + LIFETIME;
    let (rig, mut url) = (job.id.to_string(), format!("/v1/rigs/{}/events", job.id));
    if let (Some(guard), Some(key_id)) = (&app.guard, &identity.key_id) {
        url += &format!("?{TICKET}={}", guard.tickets.issue(&rig, key_id, expires_at));
    }
    let view = TicketView { object: "ticket", url, expires_at: rfc3339(expires_at) };
    let mut response = ([(header::CACHE_CONTROL, "no-store")], Json(view)).into_response();
    response.extensions_mut().insert(AboutJob(job.id));
    Ok(response)
}
