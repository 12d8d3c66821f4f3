//! Rigs: create, look, list, cancel, delete, and check without a job.

use super::App;
use super::artifacts::{self, FileBytes};
use super::error::{ApiError, Code, ProblemView, denied};
use super::negotiate::{self, Answer, PREFERENCE_APPLIED, WAIT_MAX, query};
use super::receive;
use super::segments::Segments;
use super::views::{JobListView, JobView, OptionsView, job_path, timings_ms};
use crate::jobs::{Caller, ErrorCode, Job, JobFilter, JobId, JobState, NoPage, Output, Source, Submission};
use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use serde_json::{Map, Value};
use std::time::Duration;
use utoipa::ToSchema;

pub const SERVER_TIMING: HeaderName = HeaderName::from_static("server-timing");
const PAGE_SIZE: usize = 20;
const PAGE_SIZE_MAX: usize = 100;

/// A form with the mesh and what belongs to it.
#[derive(ToSchema)]
#[schema(as = RigForm)]
pub struct FormView {
    /// The mesh to rig.
    #[schema(value_type = String, format = Binary)]
    pub file: FileBytes,
    /// Options as one JSON object. Each option may be a field of its own instead. Every further part with a file name
    /// is a file that the mesh refers to (buffers, materials, textures), under the name that the mesh uses.
    pub options: OptionsView,
}

/// Rig a mesh.
///
/// Send the mesh as the body, or in a form together with the files it refers to. Answers at once with a job to look
/// at; with `Prefer: wait=N`, up to N seconds later with the job as it then is. `Accept: model/gltf-binary` waits (60 s
/// unless `Prefer` says otherwise) and answers with the rigged file itself.
#[utoipa::path(
    post, path = "/v1/rigs", tag = "rigs",
    params(
        OptionsView,
        ("file_name" = Option<String>, Query, description = "Name of the mesh sent as the body; its extension helps to tell the format", example = "hero.obj"),
        ("Prefer" = Option<String>, Header, description = "`wait=N`: answer when the job is over, or after N seconds (at most 60)", example = "wait=30"),
        ("Accept" = Option<String>, Header, description = "`application/json` or `model/gltf-binary`", example = "application/json"),
    ),
    request_body(description = "The mesh, 100 MiB at most by default", content(
        (FileBytes = "model/gltf-binary"), (FileBytes = "model/gltf+json"), (FileBytes = "model/obj"),
        (FileBytes = "model/ply"), (FileBytes = "model/stl"), (FileBytes = "model/fbx"), (FileBytes = "application/zip"),
        (FileBytes = "application/octet-stream"), (FormView = "multipart/form-data"),
    )),
    responses(
        (status = 200, description = "The job is over; `state` says how it ended. With `Accept: model/gltf-binary`, the rigged file", content(
            (JobView = "application/json"), (FileBytes = "model/gltf-binary"),
        ), headers(
            ("Location" = String, description = "Where the job lives"),
            ("Server-Timing" = String, description = "Milliseconds in the queue and per stage"),
        )),
        (status = 202, description = "The job is queued or running", body = JobView, headers(
            ("Location" = String, description = "Where to look"),
            ("Retry-After" = u64, description = "Seconds after which to look"),
        )),
        (status = 400, description = "`unknown_field`, `invalid_parameter`, `invalid_json`, `invalid_multipart`, `upload_incomplete`", body = ProblemView, content_type = "application/problem+json"),
        (status = 406, description = "`not_acceptable`", body = ProblemView, content_type = "application/problem+json"),
        (status = 408, description = "`upload_timeout`", body = ProblemView, content_type = "application/problem+json"),
        (status = 409, description = "`canceled`, while waiting for the file", body = ProblemView, content_type = "application/problem+json"),
        (status = 413, description = "`too_large`; while waiting for the file also `too_many_faces`, `too_many_vertices`, `zip_bomb`", body = ProblemView, content_type = "application/problem+json"),
        (status = 415, description = "`unsupported_media_type`", body = ProblemView, content_type = "application/problem+json"),
        (status = 422, description = "`unreadable_mesh`; while waiting for the file also every other code of a refused mesh", body = ProblemView, content_type = "application/problem+json"),
        (status = 429, description = "`queue_full`", body = ProblemView, content_type = "application/problem+json", headers(
            ("Retry-After" = u64, description = "Seconds after which to try again"),
        )),
        (status = 500, description = "`internal`; while waiting for the file also `numerical_failure`, `output_invalid`", body = ProblemView, content_type = "application/problem+json"),
        (status = 503, description = "`starting`, `draining`, `model_unavailable`", body = ProblemView, content_type = "application/problem+json"),
        (status = 504, description = "`timeout`, while waiting for the file", body = ProblemView, content_type = "application/problem+json"),
    ),
    extensions(("x-curl" = json!("# the rigged file itself\ncurl -H 'Accept: model/gltf-binary' -H 'Content-Type: model/gltf-binary' \\\n  --data-binary @hero.glb $HOST/v1/rigs --output hero.rigged.glb\n\n# a job, with options and the files that belong to the mesh\ncurl -H 'Prefer: wait=30' -F file=@hero.obj -F mtl=@hero.mtl -F skin=@skin.png \\\n  -F 'options={\"detail\": 0.7, \"outputs\": [\"glb\", \"rig_json\"]}' $HOST/v1/rigs"))),
)]
pub async fn create_rig(State(app): State<App>, request: Request) -> Result<Response, ApiError> {
    let headers = request.headers().clone();
    let answer = negotiate::answer(&headers)?;
    let wait = negotiate::wait(&headers)?.or((answer == Answer::Glb).then_some(WAIT_MAX));
    let receive::Order { received, options } = receive::order(&app, request).await?;
    if answer == Answer::Glb && !options.outputs.contains(&Output::Glb) {
        return Err(ApiError::new(Code::NotAcceptable, "Accept asks for model/gltf-binary, but outputs leaves it out"));
    }
    let submission = Submission::new(Caller::anonymous(), Source::Upload(received), options);
    let job = app.jobs.submit(submission).await?.job;
    let job = after(&app, job, wait).await?;
    let mut response = match answer {
        Answer::Glb if job.state.is_final() => rigged_file(&app, &job).await,
        _ => job_response(&job, StatusCode::ACCEPTED),
    };
    let fields = response.headers_mut();
    fields
        .insert(header::LOCATION, HeaderValue::from_str(&job_path(&job)).map_err(|error| ApiError::internal(&error))?);
    note_wait(fields, &headers, wait);
    Ok(response)
}

/// The GLB of a job that is over, or why there is none.
async fn rigged_file(app: &App, job: &Job) -> Response {
    let made = job.result.iter().flat_map(|result| &result.artifacts);
    let glb = made.clone().find(|artifact| artifact.media_type == "model/gltf-binary");
    let served = match (glb, &job.error) {
        (Some(artifact), _) => artifacts::serve(app, job, artifact, &HeaderMap::new()).await,
        (None, Some(error)) => Err(error.clone().into()),
        (None, None) => Err(ApiError::new(Code::Work(ErrorCode::Canceled), format!("the job is {}", job.state.name()))),
    };
    served.unwrap_or_else(IntoResponse::into_response)
}

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
        (status = 400, description = "`unknown_field`, `invalid_parameter`", body = ProblemView, content_type = "application/problem+json"),
        (status = 404, description = "`not_found`", body = ProblemView, content_type = "application/problem+json"),
    ),
    extensions(("x-curl" = json!("curl -H 'Prefer: wait=30' $HOST/v1/rigs/$ID"))),
)]
pub async fn get_rig(
    State(app): State<App>,
    Segments(id): Segments<String>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    query(&uri, &[])?;
    let wait = negotiate::wait(&headers)?;
    let job = find(&app, &id).await?;
    let job = after(&app, job, wait).await?;
    let mut response = job_response(&job, StatusCode::OK);
    note_wait(response.headers_mut(), &headers, wait);
    Ok(response)
}

/// List rigs, newest first.
#[utoipa::path(
    get, path = "/v1/rigs", tag = "rigs",
    params(
        ("state" = Option<String>, Query, description = "Only rigs in this state", example = "succeeded"),
        ("page_size" = Option<u32>, Query, description = "1 to 100; 20 unless given", minimum = 1, maximum = 100, example = 20),
        ("page_token" = Option<String>, Query, description = "`next_page_token` of the page before"),
    ),
    responses(
        (status = 200, description = "One page", body = JobListView),
        (status = 400, description = "`unknown_field`, `invalid_parameter`", body = ProblemView, content_type = "application/problem+json"),
    ),
    extensions(("x-curl" = json!("curl '$HOST/v1/rigs?state=succeeded&page_size=5'"))),
)]
pub async fn list_rigs(State(app): State<App>, uri: Uri) -> Result<Json<JobListView>, ApiError> {
    let (mut page_token, mut filter, mut count) = (None, JobFilter::default(), PAGE_SIZE);
    for (name, value) in query(&uri, &["state", "page_size", "page_token"])? {
        match name.as_str() {
            "state" => filter.state = Some(state_named(&value)?),
            "page_size" => count = page_size(&value)?,
            _ => page_token = Some(value),
        }
    }
    let page = app.jobs.list(&Caller::anonymous(), &filter, page_token.as_deref(), count).await;
    let page = page.map_err(|error| match error {
        NoPage::BadToken => ApiError::field("page_token", format!("{error}")),
        NoPage::Unavailable(error) => error.into(),
    })?;
    let data = page.jobs.iter().map(JobView::from).collect();
    Ok(Json(JobListView { object: "list", data, next_page_token: page.next_page_token }))
}

fn state_named(name: &str) -> Result<JobState, ApiError> {
    let names = || JobState::ALL.map(JobState::name).join(", ");
    let state = JobState::ALL.into_iter().find(|state| state.name() == name);
    state.ok_or_else(|| ApiError::field("state", format!("{name:?} is not one of {}", names())))
}

fn page_size(text: &str) -> Result<usize, ApiError> {
    let size = text.parse().ok().filter(|size| (1..=PAGE_SIZE_MAX).contains(size));
    size.ok_or_else(|| {
        ApiError::field("page_size", format!("{text:?} is not a whole number from 1 to {PAGE_SIZE_MAX}"))
    })
}

/// Cancel a rig.
///
/// A waiting job ends at once. A running one yields within about two seconds; until then it is `running` with
/// `cancel_requested`. Asking again changes nothing.
#[utoipa::path(
    post, path = "/v1/rigs/{id}:cancel", tag = "rigs",
    params(("id" = String, Path, description = "Id of the rig", example = "rig_01jdf5fj63fh5ra1njpy75fmyg")),
    responses(
        (status = 200, description = "The job", body = JobView),
        (status = 400, description = "`unknown_field`", body = ProblemView, content_type = "application/problem+json"),
        (status = 404, description = "`not_found`", body = ProblemView, content_type = "application/problem+json"),
        (status = 409, description = "`not_cancelable`", body = ProblemView, content_type = "application/problem+json"),
    ),
    extensions(("x-curl" = json!("curl -X POST $HOST/v1/rigs/$ID:cancel"))),
)]
pub async fn cancel_rig(app: &App, id: &str) -> Result<Json<JobView>, ApiError> {
    let job =
        app.jobs.cancel(&Caller::anonymous(), parse(id)?).await.map_err(|error| denied(error, Code::NotCancelable))?;
    Ok(Json((&job).into()))
}

/// The verbs of one rig: `POST /v1/rigs/{id}:verb`.
pub async fn rig_verb(
    State(app): State<App>,
    Segments(id_and_verb): Segments<String>,
    uri: Uri,
) -> Result<Json<JobView>, ApiError> {
    match id_and_verb.split_once(':') {
        Some((id, "cancel")) => {
            query(&uri, &[])?;
            cancel_rig(&app, id).await
        }
        Some((_, verb)) => {
            Err(ApiError::not_found(&format!("verb {verb:?}")).hint("rigs can be canceled: {id}:cancel"))
        }
        None => Err(ApiError::new(Code::MethodNotAllowed, "one rig takes GET and DELETE")
            .header(header::ALLOW, "GET, HEAD, DELETE")
            .hint("POST the mesh to /v1/rigs; POST to {id}:cancel cancels")),
    }
}

/// Delete a rig and its files.
#[utoipa::path(
    delete, path = "/v1/rigs/{id}", tag = "rigs",
    params(("id" = String, Path, description = "Id of the rig", example = "rig_01jdf5fj63fh5ra1njpy75fmyg")),
    responses(
        (status = 204, description = "Gone"),
        (status = 400, description = "`unknown_field`", body = ProblemView, content_type = "application/problem+json"),
        (status = 404, description = "`not_found`", body = ProblemView, content_type = "application/problem+json"),
        (status = 409, description = "`conflict`: it is running; cancel it first", body = ProblemView, content_type = "application/problem+json"),
    ),
    extensions(("x-curl" = json!("curl -X DELETE $HOST/v1/rigs/$ID"))),
)]
pub async fn delete_rig(
    State(app): State<App>,
    Segments(id): Segments<String>,
    uri: Uri,
) -> Result<StatusCode, ApiError> {
    query(&uri, &[])?;
    let deleted = app.jobs.delete(&Caller::anonymous(), parse(&id)?).await;
    deleted.map_err(|error| denied(error, Code::Conflict).hint("POST to {id}:cancel first"))?;
    Ok(StatusCode::NO_CONTENT)
}

/// Check a mesh without rigging it.
///
/// Takes what `POST /v1/rigs` takes; says what would be rigged, what was noticed, and how long it would take.
#[utoipa::path(
    post, path = "/v1/rigs:check", tag = "rigs",
    params(
        OptionsView,
        ("file_name" = Option<String>, Query, description = "Name of the mesh sent as the body", example = "hero.obj"),
    ),
    request_body(description = "As for `POST /v1/rigs`", content(
        (FileBytes = "model/gltf-binary"), (FileBytes = "application/octet-stream"), (FormView = "multipart/form-data"),
    )),
    responses(
        (status = 200, description = "What would be rigged", body = Object, example = json!({"object": "check", "riggable": "yes", "findings": []})),
        (status = 400, description = "`unknown_field`, `invalid_parameter`, `invalid_json`, `invalid_multipart`, `upload_incomplete`", body = ProblemView, content_type = "application/problem+json"),
        (status = 408, description = "`upload_timeout`", body = ProblemView, content_type = "application/problem+json"),
        (status = 413, description = "`too_large`, `too_many_faces`, `too_many_vertices`, `zip_bomb`", body = ProblemView, content_type = "application/problem+json"),
        (status = 415, description = "`unsupported_media_type`", body = ProblemView, content_type = "application/problem+json"),
        (status = 422, description = "Every code of a refused mesh", body = ProblemView, content_type = "application/problem+json"),
        (status = 429, description = "`queue_full`", body = ProblemView, content_type = "application/problem+json"),
        (status = 500, description = "`internal`", body = ProblemView, content_type = "application/problem+json"),
        (status = 503, description = "`starting`, `draining`, `model_unavailable`", body = ProblemView, content_type = "application/problem+json"),
    ),
    extensions(("x-curl" = json!("curl -F file=@hero.obj $HOST/v1/rigs:check"))),
)]
pub async fn check_rig(State(app): State<App>, request: Request) -> Result<Json<Map<String, Value>>, ApiError> {
    let receive::Order { received, options } = receive::order(&app, request).await?;
    let mut checked = Map::from_iter([("object".to_owned(), "check".into())]);
    checked.extend(app.jobs.check(&Caller::anonymous(), Source::Upload(received), options).await?);
    Ok(Json(checked))
}

fn parse(id: &str) -> Result<JobId, ApiError> {
    id.parse().map_err(|error| ApiError::not_found("such job").hint(format!("{error}")))
}

pub async fn find(app: &App, id: &str) -> Result<Job, ApiError> {
    app.jobs.get(&Caller::anonymous(), parse(id)?).await?.ok_or_else(|| ApiError::not_found("such job"))
}

/// The job, after waiting for its end for a time.
async fn after(app: &App, job: Job, wait: Option<Duration>) -> Result<Job, ApiError> {
    match wait {
        Some(wait) if !wait.is_zero() => app
            .jobs
            .wait(&Caller::anonymous(), job.id, wait)
            .await?
            .ok_or_else(|| ApiError::not_found("such job any more; it was deleted")),
        _ => Ok(job),
    }
}

/// The job as JSON: 200 when it is over, else `unfinished`.
fn job_response(job: &Job, unfinished: StatusCode) -> Response {
    let status = if job.state.is_final() { StatusCode::OK } else { unfinished };
    let mut response = (status, [(header::CACHE_CONTROL, "no-store")], Json(JobView::from(job))).into_response();
    if let Some(timing) = server_timing(job) {
        response.headers_mut().insert(SERVER_TIMING, timing);
    }
    if !job.state.is_final() {
        response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(1));
    }
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

fn note_wait(fields: &mut HeaderMap, asked: &HeaderMap, wait: Option<Duration>) {
    if let Some(wait) = wait.filter(|_| asked.contains_key(negotiate::PREFER))
        && let Ok(applied) = HeaderValue::from_str(&format!("wait={}", wait.as_secs()))
    {
        fields.insert(PREFERENCE_APPLIED, applied);
    }
}
