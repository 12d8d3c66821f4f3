//! The verbs of one rig: `POST /v1/rigs/{id}:verb`.

use super::App;
use super::authenticate::Identity;
use super::error::{ApiError, Code};
use super::negotiate::{self, query, query_pairs};
use super::outermost::AboutJob;
use super::request_views::{ExportView, OptionsView, WishesParameters};
use super::rigs::{after, cancel, find, job_response, note_wait};
use super::segments::Segments;
use super::tickets::ticket_rig;
use super::views::{JobView, hex, job_path};
use super::wishes::WishesReader;
use super::{idempotency, receive};
use crate::jobs::{Artifact, Job, JobState, Output, Submitted};
use crate::server::orders::{Reskin, Terms};
use crate::server::uploads;
use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde_json::Value;
use sha2::{Digest, Sha256};

/// Finds the verb.
pub async fn rig_verb(
    State(app): State<App>,
    Segments(id_and_verb): Segments<String>,
    identity: Identity,
    request: Request,
) -> Result<Response, ApiError> {
    match id_and_verb.split_once(':') {
        Some((id, "cancel")) => cancel_rig(&app, identity, id, request).await,
        Some((id, "export")) => export_rig(&app, identity, id, request).await,
        Some((id, "reskin")) => reskin_rig(&app, identity, id, request).await,
        Some((id, "ticket")) => ticket_rig(&app, identity, id, request).await,
        Some((_, verb)) => {
            let verb: String = verb.chars().take(40).collect();
            Err(ApiError::not_found(&format!("verb {verb:?}"))
                .hint("there are {id}:cancel, {id}:export, {id}:reskin and {id}:ticket"))
        }
        None => Err(ApiError::new(Code::MethodNotAllowed, format!("{} is not for one rig", Method::POST))
            .header(header::ALLOW, "GET, HEAD, PUT, DELETE")
            .hint("POST the mesh to /v1/rigs; POST to {id}:cancel cancels")),
    }
}

/// Cancel a rig.
///
/// A waiting job ends at once. A running one yields within about two seconds; until then it is `running` with
/// `cancel_requested`. Asking again changes nothing.
#[utoipa::path(
    post, path = "/v1/rigs/{id}:cancel", tag = "rigs",
    params(("id" = String, Path, description = "Id of the rig", example = "rig_01jdf5fj63fh5ra1njpy75fmyg")),
    responses((status = 200, description = "The job", body = JobView)),
    extensions(("x-curl" = json!("curl -X POST $HOST/v1/rigs/$ID:cancel"))),
)]
async fn cancel_rig(app: &App, identity: Identity, id: &str, request: Request) -> Result<Response, ApiError> {
    query(request.uri(), &[])?;
    let job = cancel(app, &identity.caller, id).await?;
    Ok(Json(JobView::from(&job)).into_response())
}

/// Write a rig in another form.
///
/// From the `rig.json` that the job made and the mesh that was sent; no network runs, and no job is made. The answer is the
/// file.
#[utoipa::path(
    post, path = "/v1/rigs/{id}:export", tag = "rigs",
    params(("id" = String, Path, description = "Id of the rig", example = "rig_01jdf5fj63fh5ra1njpy75fmyg")),
    request_body(description = "Which form", content((ExportView = "application/json"))),
    responses((status = 200, description = "The file", content_type = "application/octet-stream", body = super::artifacts::FileBytes, headers(
        ("ETag" = String, description = "SHA-256 of the file, quoted"),
        ("Content-Disposition" = String, description = "The file's name"),
    ))),
    extensions(("x-curl" = json!("curl -H 'Content-Type: application/json' -d '{\"output\": \"gltf\", \"max_influences\": 2}' \\\n  $HOST/v1/rigs/$ID:export --output hero.gltf"))),
)]
async fn export_rig(app: &App, identity: Identity, id: &str, request: Request) -> Result<Response, ApiError> {
    query(request.uri(), &[])?;
    let job = find(app, &identity.caller, id).await?;
    let wanted = receive::json_body(app, request).await?;
    let (output, max_influences) = export_wish(&wanted, app)?;
    finished(&job, "exported")?;
    let Artifact { name, media_type, bytes } = app.jobs.export(&job, output, max_influences).await?;
    let etag = format!("\"{}\"", hex(&Sha256::digest(&bytes)));
    let disposition = format!("attachment; filename=\"{name}\"");
    let fields = [
        (header::CONTENT_TYPE, media_type.to_owned()),
        (header::ETAG, etag),
        (header::CONTENT_DISPOSITION, disposition),
    ];
    let mut response = (fields, bytes).into_response();
    response.extensions_mut().insert(AboutJob(job.id));
    Ok(response)
}

/// The form asked for, and how many influences. Read by the reader of options, so that ranges and messages are the same.
fn export_wish(wanted: &serde_json::Map<String, Value>, app: &App) -> Result<(Output, Option<usize>), ApiError> {
    let mut reader = WishesReader::default();
    for (name, value) in wanted {
        match name.as_str() {
            "output" => reader.json("outputs", &Value::from(vec![value.clone()])),
            "max_influences" => reader.json(name, value),
            other => return Err(ApiError::unknown_field(other, "output, max_influences")),
        }
    }
    let options = reader.finish(app.jobs.settings())?.options;
    let output = wanted.get("output").and_then(|_| options.outputs.first().copied());
    let output = output.ok_or_else(|| ApiError::field("output", "is missing: which file is to be written?"))?;
    let given = wanted.get("max_influences").is_some_and(|value| !value.is_null());
    Ok((output, given.then_some(options.max_influences)))
}

/// A job whose files can be worked on.
fn finished(job: &Job, wish: &str) -> Result<(), ApiError> {
    match job.state {
        JobState::Expired => Err(ApiError::new(Code::Expired, "the files of this job are no longer kept")),
        JobState::Succeeded => {
            let made = job.result.iter().flat_map(|result| &result.artifacts);
            let has_rig = made.into_iter().any(|artifact| artifact.name == Output::RigJson.file_name());
            if has_rig {
                return Ok(());
            }
            Err(ApiError::new(Code::Conflict, format!("without a rig.json a rig cannot be {wish}"))
                .hint("rig the mesh again with rig_json among the outputs"))
        }
        state => Err(ApiError::new(Code::Conflict, format!("the job is {}; it cannot be {wish}", state.name()))
            .hint("wait until it has succeeded")),
    }
}

/// Make weights for an edited skeleton.
///
/// Send the `rig.json` of this rig with joints moved, added, removed or renamed; its weights are not looked at. A new job makes
/// weights for that skeleton, which stays as it is, and writes the same files. Options are those of this rig unless the query
/// says otherwise.
#[utoipa::path(
    post, path = "/v1/rigs/{id}:reskin", tag = "rigs",
    params(
        ("id" = String, Path, description = "Id of the rig", example = "rig_01jdf5fj63fh5ra1njpy75fmyg"),
        OptionsView,
        WishesParameters,
        ("Idempotency-Key" = Option<String>, Header, description = "The same key with the same request gives the same job, for 24 hours", example = "7b0c1f0e-hero-v4"),
        ("Prefer" = Option<String>, Header, description = "`wait=N`: answer when the job is over, or after N seconds (at most 60)", example = "wait=30"),
    ),
    request_body(description = "A rig in the form of `rig.json`; joints are enough", content_type = "application/json", content = Object,
        example = json!({"format": "rigsmith.rig/1", "joints": [
            {"name": "hips", "parent": null, "position": [0.0, 0.9, 0.0]}, {"name": "head", "parent": 0, "position": [0.0, 1.5, 0.0]},
        ]})),
    responses(
        (status = 200, description = "The job is over, or was there before by its key", body = JobView, headers(("Location" = String, description = "Where the job lives"))),
        (status = 202, description = "The job is queued or running", body = JobView, headers(
            ("Location" = String, description = "Where to look"),
            ("Retry-After" = u64, description = "Seconds after which to look"),
        )),
    ),
    extensions(("x-curl" = json!("curl -H 'Content-Type: application/json' --data-binary @edited.rig.json $HOST/v1/rigs/$ID:reskin"))),
)]
async fn reskin_rig(app: &App, identity: Identity, id: &str, request: Request) -> Result<Response, ApiError> {
    let headers = request.headers().clone();
    let wait = negotiate::wait(&headers)?;
    let idempotency_key = idempotency::key(&headers)?;
    let job = find(app, &identity.caller, id).await?;
    let mut wishes = WishesReader::default();
    let asked = query_pairs(request.uri())?;
    asked.iter().for_each(|(name, value)| wishes.text(name, value));
    let fields: Vec<&str> = asked.iter().map(|(name, _)| name.as_str()).collect();
    let reskin = Reskin::prepare(app, job, wishes, &fields)?;
    let _permit = uploads::permit(app)?;
    let skeleton = receive::body_bytes(app, request, app.limits.upload_bytes_max).await?;
    let terms = Terms { client_id: None, idempotency_key, use_cache: !negotiate::no_cache(&headers), deadline: None };
    let Submitted { job, replayed } = reskin.place(app, &identity, &skeleton, terms).await?;
    let job = after(app, &identity.caller, job, wait).await?;
    let mut response = job_response(&job, if replayed { StatusCode::OK } else { StatusCode::ACCEPTED });
    if replayed {
        idempotency::note_replay(&mut response);
    }
    let location = HeaderValue::from_str(&job_path(&job)).map_err(|error| ApiError::internal(&error))?;
    response.headers_mut().insert(header::LOCATION, location);
    note_wait(response.headers_mut(), &headers, wait);
    Ok(response)
}
