//! Assets: meshes that are uploaded once and rigged, checked or fetched again by id.

use super::App;
use super::artifacts::{FileBytes, serve_file};
use super::asset_views::AssetView;
use super::authenticate::Identity;
use super::error::{ApiError, Code};
use super::idempotency;
use super::negotiate::query;
use super::receive;
use super::segments::Segments;
use crate::jobs::{ArtifactInfo, Asset, Check, JobError, Refusal};
use crate::server::uploads::{self, Kept, asset_id, find, missing};
use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use std::sync::Arc;
use utoipa::ToSchema;

/// A form with a mesh and what belongs to it.
#[derive(ToSchema)]
#[schema(as = AssetForm)]
pub struct AssetFormView {
    /// The mesh. Every further part with a file name is a file that the mesh refers to (buffers, materials, textures),
    /// under the name that the mesh uses.
    #[schema(value_type = String, format = Binary)]
    pub file: FileBytes,
}

/// Keep a mesh.
///
/// Send the mesh as the body, in a form together with the files it refers to, or all in a zip archive. The same files
/// are the same asset: `201` the first time, `200` after that. The answer tells what they hold; of what cannot
/// be read as a mesh a finding tells why. `POST /v1/rigs:check` with the asset's id says what would be rigged.
#[utoipa::path(
    post, path = "/v1/assets", tag = "assets",
    params(
        ("file_name" = Option<String>, Query, description = "Name of the mesh sent as the body; its extension helps to tell the format", example = "hero.obj"),
        ("Idempotency-Key" = Option<String>, Header, description = "The same key with the same files gives the same answer, for 24 hours", example = "hero-v3"),
    ),
    request_body(description = "The mesh, 100 MiB at most by default", content(
        (FileBytes = "model/gltf-binary"), (FileBytes = "model/gltf+json"), (FileBytes = "model/obj"),
        (FileBytes = "model/ply"), (FileBytes = "model/stl"), (FileBytes = "model/fbx"), (FileBytes = "application/zip"),
        (FileBytes = "application/octet-stream"), (AssetFormView = "multipart/form-data"),
    )),
    responses(
        (status = 201, description = "A new asset", body = AssetView, headers(("Location" = String, description = "Where the asset lives"))),
        (status = 200, description = "These files are an asset already", body = AssetView, headers(
            ("Location" = String, description = "Where the asset lives"),
            ("Idempotency-Replayed" = String, description = "`true` when an earlier request with this key made it"),
        )),
    ),
    extensions(("x-curl" = json!("curl -H 'Content-Type: model/gltf-binary' --data-binary @hero.glb $HOST/v1/assets\n\n# then, as often as you like\ncurl -H 'Content-Type: application/json' -d '{\"asset\": \"'$ASSET'\", \"detail\": 0.7}' $HOST/v1/rigs"))),
)]
pub async fn create_asset(State(app): State<App>, identity: Identity, request: Request) -> Result<Response, ApiError> {
    let key = idempotency::key(request.headers())?;
    let received = receive::asset(&app, request).await?;
    let Kept { asset, created, replayed } = uploads::keep(&app, &identity, received, key).await?;
    let check = looked_at(&app, &asset).await?;
    let status = if created { StatusCode::CREATED } else { StatusCode::OK };
    let mut response = asset_response(&asset, check.as_deref(), status)?;
    if replayed {
        idempotency::note_replay(&mut response);
    }
    Ok(response)
}

fn asset_response(asset: &Asset, check: Result<&Check, &JobError>, status: StatusCode) -> Result<Response, ApiError> {
    let view = AssetView::new(asset, check);
    let location = HeaderValue::from_str(&view.links.this).map_err(|error| ApiError::internal(&error))?;
    Ok((status, [(header::LOCATION, location)], Json(view)).into_response())
}

/// What the asset holds. The files of a rig request are an asset too, although nobody has read them yet: they may be unreadable.
async fn looked_at(app: &App, asset: &Asset) -> Result<Result<Arc<Check>, JobError>, ApiError> {
    match app.jobs.check_asset(asset).await {
        Ok(check) => Ok(Ok(check)),
        Err(Refusal::Check(error)) => Ok(Err(error)),
        Err(refusal) => Err(refusal.into()),
    }
}

/// Look at an asset.
#[utoipa::path(
    get, path = "/v1/assets/{id}", tag = "assets",
    params(("id" = String, Path, description = "Id of the asset", example = "ast_01jdf5fj5rfxm8s1m2q1d2zt8v")),
    responses((status = 200, description = "The asset", body = AssetView)),
    extensions(("x-curl" = json!("curl $HOST/v1/assets/$ASSET"))),
)]
pub async fn get_asset(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    uri: Uri,
) -> Result<Json<AssetView>, ApiError> {
    query(&uri, &[])?;
    let asset = find(&app, &identity, &id).await?;
    let check = looked_at(&app, &asset).await?;
    Ok(Json(AssetView::new(&asset, check.as_deref())))
}

/// Delete an asset.
///
/// Rigs made of it keep what they need.
#[utoipa::path(
    delete, path = "/v1/assets/{id}", tag = "assets",
    params(("id" = String, Path, description = "Id of the asset", example = "ast_01jdf5fj5rfxm8s1m2q1d2zt8v")),
    responses((status = 204, description = "Gone")),
    extensions(("x-curl" = json!("curl -X DELETE $HOST/v1/assets/$ASSET"))),
)]
pub async fn delete_asset(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    uri: Uri,
) -> Result<StatusCode, ApiError> {
    query(&uri, &[])?;
    if app.jobs.delete_asset(&identity.caller, asset_id(&id)?).await? {
        Ok(StatusCode::NO_CONTENT)
    } else {
        Err(missing())
    }
}

/// Download the bytes that were uploaded.
///
/// An asset of several files needs `file`. Ranges and conditions work as for artifacts.
#[utoipa::path(
    get, path = "/v1/assets/{id}/content", tag = "assets",
    params(
        ("id" = String, Path, description = "Id of the asset", example = "ast_01jdf5fj5rfxm8s1m2q1d2zt8v"),
        ("file" = Option<String>, Query, description = "Name of one of its files", example = "hero.mtl"),
        ("Range" = Option<String>, Header, description = "One range of bytes", example = "bytes=0-1023"),
        ("If-Range" = Option<String>, Header, description = "Send the range only if this is still the `ETag`"),
        ("If-None-Match" = Option<String>, Header, description = "Answer 304 if this is still the `ETag`"),
    ),
    responses(
        (status = 200, description = "The bytes", content_type = "application/octet-stream", body = FileBytes, headers(
            ("ETag" = String, description = "SHA-256 of the file, quoted"),
            ("Repr-Digest" = String, description = "SHA-256 of the file (RFC 9530)"),
            ("Content-Disposition" = String, description = "The file's name"),
            ("Accept-Ranges" = String, description = "`bytes`"),
        )),
        (status = 206, description = "The range", content_type = "application/octet-stream", body = FileBytes, headers(
            ("Content-Range" = String, description = "Which bytes these are"),
        )),
        (status = 304, description = "The caller has it"),
    ),
    extensions(("x-curl" = json!("curl -OJ $HOST/v1/assets/$ASSET/content"))),
)]
pub async fn get_asset_content(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let wanted = query(&uri, &["file"])?.into_iter().next_back().map(|(_, name)| name);
    let asset = find(&app, &identity, &id).await?;
    let file = match (&wanted, &asset.files[..]) {
        (None, [only]) => only,
        (None, files) => {
            let names: Vec<&str> = files.iter().map(|file| file.name.as_str()).take(20).collect();
            return Err(ApiError::field(
                "file",
                format!("is needed, since the asset has several: {}", names.join(", ")),
            ));
        }
        (Some(name), files) => {
            let found = files.iter().find(|file| file.name == *name);
            found.ok_or_else(|| ApiError::not_found("such file of this asset"))?
        }
    };
    let name = file.name.rsplit('/').next().unwrap_or_default();
    let plain = |letter: char| if letter.is_ascii_alphanumeric() || ".-_".contains(letter) { letter } else { '_' };
    let served = ArtifactInfo {
        name: name.chars().map(plain).collect(),
        media_type: "application/octet-stream".to_owned(),
        bytes: file.bytes,
        sha256: file.sha256,
    };
    serve_file(&app, &served, &headers, || ApiError::new(Code::Expired, "the files of this asset are no longer kept"))
        .await
}
