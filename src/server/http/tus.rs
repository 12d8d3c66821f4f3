//! Uploads that can be taken up where they broke: tus 1.0 (<https://tus.io/protocols/resumable-upload>) with creation, checksum,
//! expiration and termination. A complete upload is an asset.

use super::App;
use super::authenticate::Identity;
use super::error::{ApiError, Code, Limit};
use super::idempotency::{self, Turn};
use super::negotiate::query;
use super::segments::Segments;
use super::tus_headers::{
    self as fields, Checksum, Metadata, OFFSET_BODY, TUS_CHECKSUM_ALGORITHM, TUS_EXTENSION, TUS_MAX_SIZE,
    TUS_RESUMABLE, TUS_VERSION, UPLOAD_DEFER_LENGTH, UPLOAD_LENGTH, UPLOAD_OFFSET, VERSION, X_HTTP_METHOD_OVERRIDE,
    has_offset_body,
};
use super::tus_receive::{Incoming, elsewhere, expired, too_long};
use super::upload_views::{UploadView, upload_path};
use crate::jobs::{ErrorCode, NewResumable, Resumable, ResumableState, UploadId};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header};
use axum::middleware::{Next, from_fn};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use std::time::Duration;

/// When a caller with too many open uploads may have fewer.
const OPEN_RETRY: Duration = Duration::from_secs(60);

pub fn routes() -> Router<App> {
    let one = get(get_upload).head(head_upload).patch(patch_upload).delete(delete_upload).post(post_upload);
    Router::new()
        .route("/v1/uploads", post(create_upload).options(upload_options))
        .route("/v1/uploads/{id}", one.options(upload_options))
        .route_layer(from_fn(versioned))
}

/// Refuses other versions of the protocol, where a request is one of the protocol's, and tells ours.
async fn versioned(request: Request, next: Next) -> Response {
    let is_plain = [Method::OPTIONS, Method::GET].contains(request.method());
    let told = request.headers().get(TUS_RESUMABLE);
    let mut response = if is_plain || told.is_some_and(|version| version == VERSION) {
        next.run(request).await
    } else {
        ApiError::new(
            Code::UnsupportedVersion,
            format!("Tus-Resumable is not {VERSION}, the one version that is spoken here"),
        )
        .header(TUS_VERSION, VERSION)
        .hint("send Tus-Resumable: 1.0.0, or POST the file to /v1/assets in one piece")
        .into_response()
    };
    response.headers_mut().insert(TUS_RESUMABLE, HeaderValue::from_static(VERSION));
    response
}

/// Ask what resumable uploads can do here.
#[utoipa::path(
    options, path = "/v1/uploads", tag = "uploads",
    responses((status = 204, description = "Versions, extensions and limits of tus", headers(
        ("Tus-Version" = String, description = "`1.0.0`"),
        ("Tus-Extension" = String, description = "What is spoken beyond the core"),
        ("Tus-Max-Size" = u64, description = "Bytes of the largest upload"),
        ("Tus-Checksum-Algorithm" = String, description = "What checksums may be made by"),
    ))),
    extensions(("x-curl" = json!("curl -i -X OPTIONS $HOST/v1/uploads"))),
)]
pub async fn upload_options(State(app): State<App>) -> Response {
    let mut response = StatusCode::NO_CONTENT.into_response();
    let told = response.headers_mut();
    told.insert(TUS_VERSION, HeaderValue::from_static(VERSION));
    told.insert(TUS_EXTENSION, HeaderValue::from_static(fields::EXTENSIONS));
    told.insert(TUS_MAX_SIZE, app.limits.upload_bytes_max.into());
    if let Ok(algorithms) = HeaderValue::from_str(&fields::algorithms()) {
        told.insert(TUS_CHECKSUM_ALGORITHM, algorithms);
    }
    response
}

/// Begin an upload in parts.
///
/// Says how long the file is (`Upload-Length`) and what it is called (`filename` of `Upload-Metadata`, in base64; `filetype` will do).
/// The first bytes may come along. An upload that nobody goes on with is kept as long as an asset, and then is gone.
#[utoipa::path(
    post, path = "/v1/uploads", tag = "uploads",
    params(
        ("Tus-Resumable" = String, Header, description = "`1.0.0`", example = "1.0.0"),
        ("Upload-Length" = u64, Header, description = "Bytes of the whole file", example = 482_113),
        ("Upload-Metadata" = Option<String>, Header, description = "Pairs of a key and a value in base64, separated by commas", example = "filename aGVyby5nbGI="),
        ("Upload-Checksum" = Option<String>, Header, description = "Of the bytes that come along: `sha1`, `sha256` or `sha512`, and the digest in base64"),
        ("Idempotency-Key" = Option<String>, Header, description = "The same key with the same length and metadata gives the same upload, for 24 hours", example = "hero-v3-upload"),
    ),
    responses((status = 201, description = "It is begun", headers(
        ("Location" = String, description = "Where to send the parts"),
        ("Upload-Offset" = u64, description = "Bytes that are here"),
        ("Upload-Expires" = String, description = "When the parts go, unless more comes before"),
        ("Asset-Id" = String, description = "The asset, if all of it came along"),
    ))),
    extensions(("x-curl" = json!("curl -i -X POST -H 'Tus-Resumable: 1.0.0' -H \"Upload-Length: $(wc -c < hero.glb)\" \\\n  -H \"Upload-Metadata: filename $(printf hero.glb | base64)\" $HOST/v1/uploads"))),
)]
pub async fn create_upload(State(app): State<App>, identity: Identity, request: Request) -> Result<Response, ApiError> {
    query(request.uri(), &[])?;
    let headers = request.headers();
    if headers.contains_key(UPLOAD_DEFER_LENGTH) {
        return Err(ApiError::field(UPLOAD_DEFER_LENGTH.as_str(), "is not spoken here; say Upload-Length"));
    }
    let (length, max) = (fields::bytes(headers, &UPLOAD_LENGTH)?, app.limits.upload_bytes_max);
    if length == 0 {
        return Err(ApiError::field(UPLOAD_LENGTH.as_str(), "is 0, and a mesh has bytes"));
    }
    if length > max {
        return Err(ApiError::too_large(max, Some(length)));
    }
    let Metadata { raw, file_name } = Metadata::of(headers)?;
    let key = idempotency::key(headers)?;
    let checksum = Checksum::of(headers)?;
    let brings_bytes = has_offset_body(headers);
    let open_max = app.limits.open_uploads_max;
    let new = NewResumable { caller: identity.caller.clone(), file_name, metadata: raw, length, open_max };
    // Detached: what came is kept even if the caller hangs up.
    let begun = tokio::spawn(async move {
        let (mut upload, replayed) = begin(&app, &identity, new, key).await?;
        if brings_bytes && !replayed {
            let id = upload.id;
            let incoming = Incoming::new(app.clone(), identity.caller.clone(), upload, checksum);
            if let Err(error) = incoming.receive(request.into_body()).await {
                // The caller does not learn where it is.
                app.jobs.delete_resumable(&identity.caller, id).await?;
                return Err(error);
            }
            upload = find(&app, &identity, &id.to_string()).await?;
        }
        Ok::<_, ApiError>((upload, replayed))
    });
    let (upload, replayed) = begun.await.map_err(|error| ApiError::internal(&error))??;
    let location = HeaderValue::from_str(&upload_path(&upload)).map_err(|error| ApiError::internal(&error))?;
    let mut response = (StatusCode::CREATED, [(header::LOCATION, location)]).into_response();
    fields::standing(response.headers_mut(), &upload);
    if replayed {
        idempotency::note_replay(&mut response);
    }
    Ok(response)
}

/// The upload, and whether an earlier request with the same key made it.
async fn begin(
    app: &App,
    identity: &Identity,
    new: NewResumable,
    key: Option<String>,
) -> Result<(Resumable, bool), ApiError> {
    let Some(key) = key else { return Ok((make(app, new).await?, false)) };
    let (length, metadata) = (new.length.to_le_bytes(), new.metadata.clone().unwrap_or_default());
    let said: [&[u8]; 3] = [b"POST /v1/uploads", &length, metadata.as_bytes()];
    if let Turn::Again(id) = idempotency::turn(app, &identity.caller, &key, &said).await? {
        let known = find(app, identity, &String::from_utf8_lossy(&id)).await;
        if let Some(known) = idempotency::still_there(known)? {
            return Ok((known, true));
        }
    }
    let made = make(app, new).await;
    let id = made.as_ref().ok().map(|upload| upload.id.to_string());
    app.jobs.remember(&identity.caller, &key, id.as_deref().map(str::as_bytes)).await?;
    Ok((made?, false))
}

async fn make(app: &App, new: NewResumable) -> Result<Resumable, ApiError> {
    let max = new.open_max;
    app.jobs.begin_resumable(new).await?.ok_or_else(|| {
        ApiError::new(Code::QuotaExceeded, format!("{max} of your uploads are not complete, and no more may be"))
            .retry_after(OPEN_RETRY)
            .limit(Limit { name: "open_uploads".to_owned(), max: max as u64, actual: None })
            .hint("complete one of them, or DELETE one")
    })
}

/// An upload of the caller's that has not expired.
async fn find(app: &App, identity: &Identity, id: &str) -> Result<Resumable, ApiError> {
    let missing = || ApiError::not_found("such upload");
    let id: UploadId = id.parse().map_err(|error| missing().hint(format!("{error}")))?;
    let upload = app.jobs.resumable(&identity.caller, id).await?.ok_or_else(missing)?;
    if upload.state == ResumableState::Expired { Err(expired()) } else { Ok(upload) }
}

/// Look at an upload.
#[utoipa::path(
    get, path = "/v1/uploads/{id}", tag = "uploads",
    params(("id" = String, Path, description = "Id of the upload", example = "upl_01jdf5fj5rfxm8s1m2q1d2zt8v")),
    responses((status = 200, description = "How far it is, and the asset that it has become", body = UploadView)),
    extensions(("x-curl" = json!("curl $HOST/v1/uploads/$UPLOAD"))),
)]
pub async fn get_upload(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    uri: Uri,
) -> Result<Json<UploadView>, ApiError> {
    query(&uri, &[])?;
    Ok(Json(UploadView::from(&find(&app, &identity, &id).await?)))
}

/// Ask where to go on.
#[utoipa::path(
    head, path = "/v1/uploads/{id}", tag = "uploads",
    params(
        ("id" = String, Path, description = "Id of the upload", example = "upl_01jdf5fj5rfxm8s1m2q1d2zt8v"),
        ("Tus-Resumable" = String, Header, description = "`1.0.0`", example = "1.0.0"),
    ),
    responses((status = 200, description = "It is there", headers(
        ("Upload-Offset" = u64, description = "Bytes that are here"),
        ("Upload-Length" = u64, description = "Bytes of the whole"),
        ("Upload-Metadata" = String, description = "As it was said"),
        ("Upload-Expires" = String, description = "When the parts go, unless more comes before"),
        ("Asset-Id" = String, description = "The asset, once all of it is here"),
    ))),
    extensions(("x-curl" = json!("curl -I -H 'Tus-Resumable: 1.0.0' $HOST/v1/uploads/$UPLOAD"))),
)]
pub async fn head_upload(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    uri: Uri,
) -> Result<Response, ApiError> {
    query(&uri, &[])?;
    let upload = find(&app, &identity, &id).await?;
    let mut response = StatusCode::OK.into_response();
    fields::standing(response.headers_mut(), &upload);
    fields::description(response.headers_mut(), &upload);
    Ok(response)
}

/// Go on with an upload.
///
/// From the byte that `Upload-Offset` names, which is where the upload ends. What came of a request that breaks off is kept; with
/// `Upload-Checksum`, only what is right. The last bytes make an asset of it, which `Asset-Id` names.
#[utoipa::path(
    patch, path = "/v1/uploads/{id}", tag = "uploads",
    params(
        ("id" = String, Path, description = "Id of the upload", example = "upl_01jdf5fj5rfxm8s1m2q1d2zt8v"),
        ("Tus-Resumable" = String, Header, description = "`1.0.0`", example = "1.0.0"),
        ("Upload-Offset" = u64, Header, description = "Where the bytes belong", example = 0),
        ("Upload-Checksum" = Option<String>, Header, description = "`sha1`, `sha256` or `sha512`, and the digest of the body in base64"),
    ),
    request_body(description = "Bytes", content((super::artifacts::FileBytes = "application/offset+octet-stream"))),
    responses((status = 204, description = "They are kept", headers(
        ("Upload-Offset" = u64, description = "Bytes that are here"),
        ("Upload-Expires" = String, description = "When the parts go, unless more comes before"),
        ("Asset-Id" = String, description = "The asset, once all of it is here"),
    ))),
    extensions(("x-curl" = json!("curl -i -X PATCH -H 'Tus-Resumable: 1.0.0' -H 'Upload-Offset: 0' -H 'Content-Type: application/offset+octet-stream' \\\n  --data-binary @hero.glb $HOST/v1/uploads/$UPLOAD"))),
)]
pub async fn patch_upload(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    request: Request,
) -> Result<Response, ApiError> {
    go_on(app, &id, identity, request).await
}

async fn go_on(app: App, id: &str, identity: Identity, request: Request) -> Result<Response, ApiError> {
    query(request.uri(), &[])?;
    let headers = request.headers();
    if !has_offset_body(headers) {
        let code = Code::Work(ErrorCode::UnsupportedMediaType);
        return Err(ApiError::new(code, format!("the body is not declared as {OFFSET_BODY}"))
            .hint(format!("send Content-Type: {OFFSET_BODY}")));
    }
    let offset = fields::bytes(headers, &UPLOAD_OFFSET)?;
    let checksum = Checksum::of(headers)?;
    let upload = find(&app, &identity, id).await?;
    if offset != upload.received {
        return Err(elsewhere(offset));
    }
    let declared = declared_length(headers);
    if declared.is_some_and(|declared| declared > upload.length - offset) {
        return Err(too_long(&upload, declared.map(|declared| offset.saturating_add(declared))));
    }
    let incoming = Incoming::new(app.clone(), identity.caller.clone(), upload, checksum);
    // Detached: what came is kept even if the caller hangs up.
    let received = tokio::spawn(incoming.receive(request.into_body()));
    received.await.map_err(|error| ApiError::internal(&error))??;
    let mut response = StatusCode::NO_CONTENT.into_response();
    fields::standing(response.headers_mut(), &find(&app, &identity, id).await?);
    Ok(response)
}

fn declared_length(headers: &HeaderMap) -> Option<u64> {
    headers.get(header::CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

/// Give an upload up.
///
/// The asset of a complete one stays.
#[utoipa::path(
    delete, path = "/v1/uploads/{id}", tag = "uploads",
    params(
        ("id" = String, Path, description = "Id of the upload", example = "upl_01jdf5fj5rfxm8s1m2q1d2zt8v"),
        ("Tus-Resumable" = String, Header, description = "`1.0.0`", example = "1.0.0"),
    ),
    responses((status = 204, description = "Gone")),
    extensions(("x-curl" = json!("curl -X DELETE -H 'Tus-Resumable: 1.0.0' $HOST/v1/uploads/$UPLOAD"))),
)]
pub async fn delete_upload(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    uri: Uri,
) -> Result<StatusCode, ApiError> {
    query(&uri, &[])?;
    give_up(&app, &id, &identity).await
}

async fn give_up(app: &App, id: &str, identity: &Identity) -> Result<StatusCode, ApiError> {
    let upload = find(app, identity, id).await?;
    app.jobs.delete_resumable(&identity.caller, upload.id).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// What callers send who can only GET and POST: the method is in `X-HTTP-Method-Override`.
async fn post_upload(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    request: Request,
) -> Result<Response, ApiError> {
    let meant = request.headers().get(X_HTTP_METHOD_OVERRIDE).map(HeaderValue::as_bytes);
    match meant {
        Some(b"PATCH") => go_on(app, &id, identity, request).await,
        Some(b"DELETE") => Ok(give_up(&app, &id, &identity).await?.into_response()),
        _ => Err(ApiError::new(Code::MethodNotAllowed, "POST is not for one upload")
            .header(header::ALLOW, "GET, HEAD, PATCH, DELETE, OPTIONS")
            .hint("send PATCH, or POST with X-HTTP-Method-Override: PATCH")),
    }
}
