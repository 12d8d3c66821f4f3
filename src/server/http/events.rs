//! What happens to a job, as it happens: server-sent events (HTML Living Standard, section 9.2).

use super::App;
use super::authenticate::{Identity, TICKET};
use super::error::ApiError;
use super::negotiate::{query, text_header};
use super::outermost::AboutJob;
use super::rigs::find;
use super::segments::Segments;
use super::timestamp::rfc3339;
use super::views::{ArtifactView, FindingView, JobErrorView, JobView};
use crate::jobs::{Event, EventKind, Events, Job};
use axum::body::{Body, HttpBody};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use http_body::Frame;
use serde_json::{Value, json};
use std::convert::Infallible;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::time::timeout;
use utoipa::ToSchema;

const LAST_EVENT_ID: HeaderName = HeaderName::from_static("last-event-id");
const X_ACCEL_BUFFERING: HeaderName = HeaderName::from_static("x-accel-buffering");
/// After so long without an event, a comment shows that the connection lives.
const HEARTBEAT: Duration = Duration::from_secs(15);
/// What a client is told to wait before it connects again.
const RETRY_MS: u64 = 2000;
/// The same when the service stops, which takes a while to come back.
const STOPPING_RETRY_MS: u64 = 5000;
/// Events written ahead of a slow reader.
const EVENTS_AHEAD: usize = 16;

/// One event of the stream.
#[derive(ToSchema)]
#[schema(as = Event)]
pub struct EventView {
    /// Rises from event to event.
    #[schema(example = "7")]
    pub id: String,
    /// `snapshot`, `state`, `progress`, `warning`, `artifact` or `done`.
    #[schema(example = "progress")]
    pub event: String,
    /// JSON: the job for `snapshot`, else what happened, and when.
    #[schema(example = "{\"stage\":\"skin\",\"progress\":70,\"at\":\"2026-11-24T15:20:09.500Z\"}")]
    pub data: String,
}

/// Follow a rig.
///
/// Server-sent events, each with a rising `id`: `snapshot` (the job as it is) first, then `state`, `progress` (at most
/// four a second), `warning`, `artifact`, and `done`, after which the stream ends. `Last-Event-ID` takes up where an
/// earlier connection stopped; when nothing more will come, the answer is `204`, which tells browsers not to ask again.
/// A comment every 15 s keeps the connection open. A browser's `EventSource` shows a ticket in place of a key.
#[utoipa::path(
    get, path = "/v1/rigs/{id}/events", tag = "rigs",
    params(
        ("id" = String, Path, description = "Id of the rig", example = "rig_01jdf5fj63fh5ra1njpy75fmyg"),
        ("Last-Event-ID" = Option<String>, Header, description = "The `id` of the event received last", example = "7"),
        ("ticket" = Option<String>, Query, description = "In place of a key, from `POST /v1/rigs/{id}:ticket`"),
    ),
    responses(
        (status = 200, description = "Events to the end of the job", content_type = "text/event-stream", body = EventView),
        (status = 204, description = "The job is over, and its last event is known to the caller"),
    ),
    extensions(("x-curl" = json!("curl -N $HOST/v1/rigs/$ID/events"))),
)]
pub async fn rig_events(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    // Who asks is found out before this; here the ticket is only no unknown field.
    query(&uri, &[TICKET])?;
    let after = text_header(&headers, &LAST_EVENT_ID)?.map(str::trim).filter(|id| !id.is_empty());
    let after = after.map(|id| {
        id.parse::<u64>().map_err(|_| ApiError::field("Last-Event-ID", format!("{id:?} is not an id of these events")))
    });
    let job = find(&app, &identity.caller, &id).await?;
    let events = app.jobs.events(&identity.caller, job.id, after.transpose()?).await?;
    let events = events.ok_or_else(|| ApiError::not_found("such job any more; it was deleted"))?;
    if events.is_over() {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let (lines, received) = mpsc::channel(EVENTS_AHEAD);
    let about = AboutJob(job.id);
    tokio::spawn(follow(events, job, app.closing.subscribe(), lines));
    let mut response = Body::new(Stream(received)).into_response();
    response.extensions_mut().insert(about);
    let fields = response.headers_mut();
    fields.insert(header::CONTENT_TYPE, HeaderValue::from_static("text/event-stream"));
    fields.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    fields.insert(X_ACCEL_BUFFERING, HeaderValue::from_static("no"));
    Ok(response)
}

/// Writes events as they come, until there are no more, nobody listens, or the service stops.
async fn follow(mut events: Events, job: Job, mut closing: watch::Receiver<bool>, lines: mpsc::Sender<Bytes>) {
    if lines.send(format!("retry: {RETRY_MS}\n\n").into()).await.is_err() {
        return;
    }
    loop {
        let next = tokio::select! {
            next = timeout(HEARTBEAT, events.next()) => next,
            () = async { _ = closing.wait_for(|closing| *closing).await } => {
                // Nobody may be there to hear it.
                let _ = lines.send(format!("retry: {STOPPING_RETRY_MS}\n\n").into()).await;
                return;
            }
            () = lines.closed() => return,
        };
        let line = match next {
            Err(_) => ": still here\n\n".to_owned(),
            Ok(Ok(Some(event))) => line(&event, &job),
            Ok(Ok(None)) => return,
            Ok(Err(error)) => {
                // The client connects again and takes up where it was.
                tracing::error!(%error, "events could not be read");
                return;
            }
        };
        if lines.send(line.into()).await.is_err() {
            return;
        }
    }
}

/// One event on the wire.
fn line(event: &Event, job: &Job) -> String {
    let mut data = data(&event.kind, job);
    if let Value::Object(members) = &mut data
        && !matches!(event.kind, EventKind::Snapshot(_))
    {
        members.insert("at".to_owned(), rfc3339(event.at).into());
    }
    format!("id: {}\nevent: {}\ndata: {data}\n\n", event.sequence, event.kind.name())
}

fn data(kind: &EventKind, job: &Job) -> Value {
    let written = |value: Result<Value, serde_json::Error>| value.unwrap_or_default();
    match kind {
        EventKind::Snapshot(job) => written(serde_json::to_value(JobView::from(&**job))),
        EventKind::State { state, attempt } => json!({"state": state.name(), "attempt": attempt}),
        EventKind::Progress { stage, progress } => json!({"stage": stage.name(), "progress": progress}),
        EventKind::Warning(notice) => written(serde_json::to_value(FindingView::from(notice))),
        EventKind::Artifact(artifact) => written(serde_json::to_value(ArtifactView::new(job, artifact))),
        EventKind::Done { state, error } => {
            let error = error.as_ref().map(JobErrorView::from);
            json!({"state": state.name(), "error": written(serde_json::to_value(error))})
        }
    }
}

/// A body of lines without an end that is known beforehand.
struct Stream(mpsc::Receiver<Bytes>);

impl HttpBody for Stream {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        let line = ready!(self.0.poll_recv(context));
        Poll::Ready(line.map(|line| Ok(Frame::data(line))))
    }
}
