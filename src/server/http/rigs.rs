//! Rigs: look, list, delete.

use super::App;
use super::authenticate::Identity;
use super::error::{ApiError, Code, denied};
use super::negotiate::{self, PREFERENCE_APPLIED, query};
use super::outermost::AboutJob;
use super::segments::Segments;
use super::views::{JobListView, JobView, timings_ms};
use super::wishes;
use super::words::StateName;
use crate::jobs::{Caller, Denied, ErrorCode, Job, JobFilter, JobId, JobState, NoPage, Page};
use crate::server::orders;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use std::time::Duration;

pub const SERVER_TIMING: HeaderName = HeaderName::from_static("server-timing");
pub const PAGE_SIZE: usize = 20;
const PAGE_SIZE_MAX: usize = 100;

/// Look at a rig.
///
/// `Prefer: wait=N` answers when the job is over, or after N seconds.
#[utoipa::path(
    get, path = "/v1/rigs/{id}", tag = "rigs",
    params(
        ("id" = String, Path, description = "Id of the rig", example = "rig_01jdf5fj63fh5ra1njpy75fmyg"),
        ("Prefer" = Option<String>, Header, description = "`wait=N`, N at most 60", example = "wait=30"),
    ),
    responses(
        (status = 200, description = "The job", body = JobView, headers(
            ("Server-Timing" = String, description = "Once the job is over: milliseconds in the queue and per stage"),
        )),
    ),
    extensions(("x-curl" = json!("curl -H 'Prefer: wait=30' $HOST/v1/rigs/$ID"))),
)]
pub async fn get_rig(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    query(&uri, &[])?;
    let wait = negotiate::wait(&headers)?;
    let job = find(&app, &identity.caller, &id).await?;
    let job = after(&app, &identity.caller, job, wait).await?;
    let mut response = job_response(&job, StatusCode::OK);
    note_wait(response.headers_mut(), &headers, wait);
    Ok(response)
}

/// List rigs, newest first.
#[utoipa::path(
    get, path = "/v1/rigs", tag = "rigs",
    params(
        ("state" = Option<StateName>, Query, description = "Only rigs in this state", example = "succeeded"),
        ("label" = Option<String>, Query, description = "Only rigs with this label, as `name=value`", example = "project=knights"),
        ("page_size" = Option<u32>, Query, description = "1 to 100; 20 unless given", minimum = 1, maximum = 100, example = 20),
        ("page_token" = Option<String>, Query, description = "`next_page_token` of the page before"),
    ),
    responses(
        (status = 200, description = "One page", body = JobListView),
    ),
    extensions(("x-curl" = json!("curl \"$HOST/v1/rigs?state=succeeded&page_size=5\""))),
)]
pub async fn list_rigs(State(app): State<App>, identity: Identity, uri: Uri) -> Result<Json<JobListView>, ApiError> {
    let (mut page_token, mut filter, mut count) = (None, JobFilter::default(), PAGE_SIZE);
    for (name, value) in query(&uri, &["state", "label", "page_size", "page_token"])? {
        match name.as_str() {
            "state" => filter.state = Some(state_named(&value)?),
            "label" => filter.label = Some(label_named(&value)?),
            "page_size" => count = page_size(&value)?,
            _ => page_token = Some(value),
        }
    }
    let page = page(&app, &identity.caller, &filter, page_token.as_deref(), count).await?;
    let data = page.jobs.iter().map(JobView::from).collect();
    Ok(Json(JobListView { object: "list", data, next_page_token: page.next_page_token }))
}

pub fn state_named(name: &str) -> Result<JobState, ApiError> {
    let names = || JobState::ALL.map(JobState::name).join(", ");
    let state = JobState::ALL.into_iter().find(|state| state.name() == name);
    state.ok_or_else(|| ApiError::field("state", format!("{name:?} is not one of {}", names())))
}

pub fn label_named(text: &str) -> Result<(String, String), ApiError> {
    let pair = text.split_once('=').ok_or_else(|| format!("{text:?} is not name=value"));
    pair.and_then(|(name, value)| wishes::label(name, value)).map_err(|detail| ApiError::field("label", detail))
}

/// One page of the caller's jobs.
pub async fn page(
    app: &App,
    caller: &Caller,
    filter: &JobFilter,
    page_token: Option<&str>,
    page_size: usize,
) -> Result<Page, ApiError> {
    app.jobs.list(caller, filter, page_token, page_size).await.map_err(|error| match error {
        NoPage::BadToken => ApiError::field("page_token", format!("{error}")),
        NoPage::Unavailable(error) => error.into(),
    })
}

pub fn page_size(text: &str) -> Result<usize, ApiError> {
    let size = text.parse().ok().filter(|size| (1..=PAGE_SIZE_MAX).contains(size));
    size.ok_or_else(|| {
        ApiError::field("page_size", format!("{text:?} is not a whole number from 1 to {PAGE_SIZE_MAX}"))
    })
}

/// Delete a rig and its files.
#[utoipa::path(
    delete, path = "/v1/rigs/{id}", tag = "rigs",
    params(("id" = String, Path, description = "Id of the rig", example = "rig_01jdf5fj63fh5ra1njpy75fmyg")),
    responses(
        (status = 204, description = "Gone"),
    ),
    extensions(("x-curl" = json!("curl -X DELETE $HOST/v1/rigs/$ID"))),
)]
pub async fn delete_rig(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    uri: Uri,
) -> Result<StatusCode, ApiError> {
    query(&uri, &[])?;
    delete(&app, &identity.caller, &id).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Forgets a job and its files.
pub async fn delete(app: &App, caller: &Caller, id: &str) -> Result<(), ApiError> {
    let id = resolve(app, caller, id).await?;
    let deleted = app.jobs.delete(caller, id).await;
    deleted.map_err(|error| match error {
        Denied::State(_) => denied(error, Code::Conflict).hint("POST to {id}:cancel first"),
        error => denied(error, Code::Conflict),
    })
}

/// Ends a job that waits, or asks a running one to end.
pub async fn cancel(app: &App, caller: &Caller, id: &str) -> Result<Job, ApiError> {
    let id = resolve(app, caller, id).await?;
    app.jobs.cancel(caller, id).await.map_err(|error| denied(error, Code::NotCancelable))
}

/// The id of a job, by its own id or by the one that the caller gave it.
pub async fn resolve(app: &App, caller: &Caller, id: &str) -> Result<JobId, ApiError> {
    match id.parse() {
        Ok(id) => Ok(id),
        Err(_) => find(app, caller, id).await.map(|job| job.id),
    }
}

pub async fn find(app: &App, caller: &Caller, id: &str) -> Result<Job, ApiError> {
    let missing = || ApiError::not_found("such job");
    match id.parse::<JobId>() {
        Ok(id) => app.jobs.get(caller, id).await?.ok_or_else(missing),
        Err(error) if id.starts_with("rig_") => Err(missing().hint(format!("{error}"))),
        Err(_) if orders::client_id("id", id.to_owned()).is_err() => Err(missing()),
        Err(_) => app.jobs.get_by_client_id(caller, id).await?.ok_or_else(missing),
    }
}

/// The job, after waiting for its end for a time.
pub async fn after(app: &App, caller: &Caller, job: Job, wait: Option<Duration>) -> Result<Job, ApiError> {
    match wait {
        Some(wait) if !wait.is_zero() && !job.state.is_final() => {
            let mut closing = app.closing.subscribe();
            let waited = tokio::select! {
                waited = app.jobs.wait(caller, job.id, wait) => waited?,
                // Who waits is told of the job while the service can still say it.
                () = async { _ = closing.wait_for(|closing| *closing).await } => app.jobs.get(caller, job.id).await?,
            };
            waited.ok_or_else(|| ApiError::not_found("such job any more; it was deleted"))
        }
        _ => Ok(job),
    }
}

/// Why a job that is over has no result.
pub fn why_none(job: &Job) -> ApiError {
    match &job.error {
        Some(error) => error.clone().into(),
        None => ApiError::new(Code::Work(ErrorCode::Canceled), format!("the job is {}", job.state.name())),
    }
}

/// The job as JSON: 200 when it is over, else `unfinished`.
pub fn job_response(job: &Job, unfinished: StatusCode) -> Response {
    let status = if job.state.is_final() { StatusCode::OK } else { unfinished };
    let mut response = (status, [(header::CACHE_CONTROL, "no-store")], Json(JobView::from(job))).into_response();
    if let Some(timing) = server_timing(job) {
        response.headers_mut().insert(SERVER_TIMING, timing);
    }
    if !job.state.is_final() {
        response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(1));
    }
    response.extensions_mut().insert(AboutJob(job.id));
    response
}

/// Milliseconds in the queue and per stage of a job that is over.
pub fn server_timing(job: &Job) -> Option<HeaderValue> {
    if !job.state.is_final() {
        return None;
    }
    let entries: Vec<String> = timings_ms(job).map(|(name, ms)| format!("{name};dur={ms}")).collect();
    HeaderValue::from_str(&entries.join(", ")).ok().filter(|value| !value.is_empty())
}

pub fn note_wait(fields: &mut HeaderMap, asked: &HeaderMap, wait: Option<Duration>) {
    if let Some(wait) = wait.filter(|_| asked.contains_key(negotiate::PREFER))
        && let Ok(applied) = HeaderValue::from_str(&format!("wait={}", wait.as_secs()))
    {
        fields.insert(PREFERENCE_APPLIED, applied);
    }
}
