//! Making rigs: from an upload, from an asset, under an id of the caller's, and a check without a job.

use super::App;
use super::artifacts::{self, FileBytes};
use super::authenticate::Identity;
use super::check_views::CheckView;
use super::error::{ApiError, Code};
use super::idempotency;
use super::negotiate::{self, Answer, WAIT_MAX};
use super::outermost::AboutJob;
use super::receive;
use super::request_views::{CreateView, OptionsView, WishesParameters};
use super::rigs::{after, job_response, note_wait, why_none};
use super::segments::Segments;
use super::views::{JobView, job_path};
use crate::jobs::{Job, Output, Submitted};
use crate::server::orders::{self, Terms};
use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use utoipa::ToSchema;

/// A form with the mesh and what belongs to it.
#[derive(ToSchema)]
#[schema(as = RigForm)]
pub struct FormView {
    /// The mesh to rig.
    #[schema(value_type = String, format = Binary)]
    pub file: FileBytes,
    /// Options as one JSON object. Each option may be a field of its own instead. Every further part with a file name
    /// is a file that the mesh refers to (buffers, materials, textures), under the name that the mesh uses.
    #[schema(required = false)]
    pub options: OptionsView,
}

/// Rig a mesh.
///
/// Send the mesh as the body, or in a form together with the files it refers to, or JSON that names an asset. Answers at once with a job to look
/// at; with `Prefer: wait=N`, up to N seconds later with the job as it then is. `Accept: model/gltf-binary` waits (60 s
/// unless `Prefer` says otherwise) and answers with the rigged file itself.
#[utoipa::path(
    post, path = "/v1/rigs", tag = "rigs",
    params(
        OptionsView,
        WishesParameters,
        ("Idempotency-Key" = Option<String>, Header, description = "The same key with the same request gives the same job, for 24 hours", example = "7b0c1f0e-hero-v3"),
        ("Cache-Control" = Option<String>, Header, description = "`no-cache`: do the work even if an equal job has a result", example = "no-cache"),
        ("file_name" = Option<String>, Query, description = "Name of the mesh sent as the body; its extension helps to tell the format", example = "hero.obj"),
        ("Prefer" = Option<String>, Header, description = "`wait=N`: answer when the job is over, or after N seconds (at most 60)", example = "wait=30"),
        ("Accept" = Option<String>, Header, description = "`application/json` or `model/gltf-binary`", example = "application/json"),
    ),
    request_body(description = "The mesh, 100 MiB at most by default", content(
        (FileBytes = "model/gltf-binary"), (FileBytes = "model/gltf+json"), (FileBytes = "model/obj"),
        (FileBytes = "model/ply"), (FileBytes = "model/stl"), (FileBytes = "model/fbx"), (FileBytes = "application/zip"),
        (FileBytes = "application/octet-stream"), (FormView = "multipart/form-data"), (CreateView = "application/json"),
    )),
    responses(
        (status = 200, description = "The job is over, or was there before by its key; `state` says how it ended. With `Accept: model/gltf-binary`, the rigged file", content(
            (JobView = "application/json"), (FileBytes = "model/gltf-binary"),
        ), headers(
            ("Location" = String, description = "Where the job lives"),
            ("Server-Timing" = String, description = "Milliseconds in the queue and per stage"),
            ("Idempotency-Replayed" = String, description = "`true` when an earlier request made the job"),
        )),
        (status = 202, description = "The job is queued or running", body = JobView, headers(
            ("Location" = String, description = "Where to look"),
            ("Retry-After" = u64, description = "Seconds after which to look"),
        )),
    ),
    extensions(("x-curl" = json!("# the rigged file itself\ncurl -H 'Accept: model/gltf-binary' -H 'Content-Type: model/gltf-binary' \\\n  --data-binary @hero.glb $HOST/v1/rigs --output hero.rigged.glb\n\n# a job, with options and the files that belong to the mesh\ncurl -H 'Prefer: wait=30' -F file=@hero.obj -F mtl=@hero.mtl -F skin=@skin.png \\\n  -F 'options={\"detail\": 0.7, \"outputs\": [\"glb\", \"rig_json\"]}' $HOST/v1/rigs"))),
)]
pub async fn create_rig(State(app): State<App>, identity: Identity, request: Request) -> Result<Response, ApiError> {
    create(&app, identity, request, None).await
}

/// Rig a mesh under an id of your own.
///
/// The same as `POST /v1/rigs`, and idempotent by the id: sent again, it finds the job, whatever became of it. Every
/// path that takes the id of a rig takes this id too.
#[utoipa::path(
    put, path = "/v1/rigs/{id}", tag = "rigs",
    params(
        ("id" = String, Path, description = "1 to 64 letters, digits, `.`, `-` or `_`; not beginning with `rig_`", example = "hero-v3"),
        OptionsView,
        WishesParameters,
        ("file_name" = Option<String>, Query, description = "Name of the mesh sent as the body", example = "hero.obj"),
        ("Prefer" = Option<String>, Header, description = "`wait=N`: answer when the job is over, or after N seconds (at most 60)", example = "wait=30"),
        ("Accept" = Option<String>, Header, description = "`application/json` or `model/gltf-binary`", example = "application/json"),
    ),
    request_body(description = "As for `POST /v1/rigs`", content(
        (FileBytes = "model/gltf-binary"), (FileBytes = "application/octet-stream"), (FormView = "multipart/form-data"),
        (CreateView = "application/json"),
    )),
    responses(
        (status = 200, description = "The job is over, or was there before. With `Accept: model/gltf-binary`, the rigged file", content(
            (JobView = "application/json"), (FileBytes = "model/gltf-binary"),
        ), headers(
            ("Location" = String, description = "Where the job lives"),
            ("Idempotency-Replayed" = String, description = "`true` when the job was there before"),
        )),
        (status = 202, description = "The job is queued or running", body = JobView, headers(
            ("Location" = String, description = "Where to look"),
            ("Retry-After" = u64, description = "Seconds after which to look"),
        )),
    ),
    extensions(("x-curl" = json!("curl -X PUT -H 'Content-Type: model/gltf-binary' --data-binary @hero.glb $HOST/v1/rigs/hero-v3"))),
)]
pub async fn put_rig(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    request: Request,
) -> Result<Response, ApiError> {
    create(&app, identity, request, Some(orders::client_id("id", id)?)).await
}

async fn create(
    app: &App,
    identity: Identity,
    request: Request,
    client_id: Option<String>,
) -> Result<Response, ApiError> {
    let headers = request.headers().clone();
    let answer = negotiate::answer(&headers)?;
    let wait = negotiate::wait(&headers)?.or((answer == Answer::Glb).then_some(WAIT_MAX));
    let idempotency_key = idempotency::key(&headers)?;
    // A request that was answered before is answered again even when no new job would be taken.
    let may_be_known = client_id.is_some() || idempotency_key.is_some();
    let order = receive::order(app, request, may_be_known).await?;
    if answer == Answer::Glb && !order.wishes.options.outputs.contains(&Output::Glb) {
        return Err(ApiError::new(Code::NotAcceptable, "Accept asks for model/gltf-binary, but outputs leaves it out"));
    }
    let use_cache = !negotiate::no_cache(&headers);
    let terms = Terms { client_id, idempotency_key, use_cache, deadline: None };
    let Submitted { job, replayed } = orders::place(app, &identity, order, terms).await?;
    let job = after(app, &identity.caller, job, wait).await?;
    let mut response = match answer {
        Answer::Glb if job.state.is_final() => rigged_file(app, &job).await,
        _ if replayed => job_response(&job, StatusCode::OK),
        _ => job_response(&job, StatusCode::ACCEPTED),
    };
    if replayed {
        idempotency::note_replay(&mut response);
    }
    response.extensions_mut().insert(AboutJob(job.id));
    let fields = response.headers_mut();
    let location = HeaderValue::from_str(&job_path(&job)).map_err(|error| ApiError::internal(&error))?;
    fields.insert(header::LOCATION, location);
    note_wait(fields, &headers, wait);
    Ok(response)
}

/// The GLB of a job that is over, or why there is none.
async fn rigged_file(app: &App, job: &Job) -> Response {
    let made = job.result.iter().flat_map(|result| &result.artifacts);
    let glb = made.clone().find(|artifact| artifact.media_type == "model/gltf-binary");
    let served = match glb {
        Some(artifact) => artifacts::serve(app, job, artifact, &HeaderMap::new()).await,
        None => Err(why_none(job)),
    };
    served.unwrap_or_else(IntoResponse::into_response)
}

/// Check a mesh without rigging it.
///
/// Takes what `POST /v1/rigs` takes; says what would be rigged, what was noticed, and how long it would take.
#[utoipa::path(
    post, path = "/v1/rigs:check", tag = "rigs",
    params(
        OptionsView,
        WishesParameters,
        ("file_name" = Option<String>, Query, description = "Name of the mesh sent as the body", example = "hero.obj"),
    ),
    request_body(description = "As for `POST /v1/rigs`", content(
        (FileBytes = "model/gltf-binary"), (FileBytes = "application/octet-stream"), (FormView = "multipart/form-data"),
        (CreateView = "application/json"),
    )),
    responses(
        (status = 200, description = "What would be rigged", body = CheckView),
    ),
    extensions(("x-curl" = json!("curl -F file=@hero.obj $HOST/v1/rigs:check"))),
)]
pub async fn check_rig(
    State(app): State<App>,
    identity: Identity,
    request: Request,
) -> Result<Json<CheckView>, ApiError> {
    let receive::Order { source, wishes } = receive::order(&app, request, false).await?;
    let check = app.jobs.check(&identity.caller, source, wishes.options).await?;
    Ok(Json(CheckView::from(&check)))
}
