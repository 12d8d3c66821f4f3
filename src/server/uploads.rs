//! Uploads, the same for every door: how many at a time, which of several files is the mesh, and how one becomes an asset.

use super::App;
use super::http::authenticate::Identity;
use super::http::error::{ApiError, Code};
use super::http::idempotency::{self, Turn};
use super::http::media;
use super::http::sink::Sink;
use crate::jobs::{Asset, AssetId, ErrorCode, Received, asset_sha256};
use bytes::Bytes;
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::sync::SemaphorePermit;

/// A mesh within a request.
pub const INLINE_BYTES_MAX: usize = 4 << 20;
/// Refusing early helps the sender; an upload that is refused after it began is read no further.
const BUSY_RETRY: Duration = Duration::from_secs(2);

/// The right to receive an upload now.
pub fn permit(app: &App) -> Result<SemaphorePermit<'_>, ApiError> {
    app.uploads.try_acquire().map_err(|_| {
        let detail = format!("{} uploads are being received, and no more may be at a time", app.limits.uploads_max);
        ApiError::new(Code::QueueFull, detail).retry_after(BUSY_RETRY)
    })
}

/// Receives a mesh that came within a request.
pub async fn inline(app: &App, name: &str, bytes: Bytes) -> Result<Received, ApiError> {
    if bytes.is_empty() {
        return Err(empty(name));
    }
    if bytes.len() > INLINE_BYTES_MAX {
        return Err(ApiError::too_large(INLINE_BYTES_MAX as u64, Some(bytes.len() as u64)));
    }
    let _permit = permit(app)?;
    let mut sink = Sink::open(app)?;
    sink.begin(name).await?;
    sink.push(bytes).await?;
    sink.refuse_foreign(name)?;
    sink.flush().await?;
    sink.finish(name).await
}

pub fn empty(name: &str) -> ApiError {
    ApiError::new(Code::Work(ErrorCode::UnreadableMesh), format!("the file {name} has no bytes"))
        .hint("with curl, send a file by --data-binary @hero.glb or -F file=@hero.glb")
}

/// The names of the files of one upload, and which of them is to be rigged.
#[derive(Default)]
pub struct Files {
    names: BTreeSet<String>,
    /// Sent as the field `file`, which says that they are the mesh.
    named: Vec<String>,
    /// Have the extension of a mesh format.
    meshes: Vec<String>,
}

impl Files {
    pub fn add(&mut self, field: &str, file_name: &str) -> Result<String, ApiError> {
        let name = media::relative_name(file_name).map_err(|detail| ApiError::field(field, detail))?;
        if !self.names.insert(name.clone()) {
            return Err(ApiError::field(field, format!("a second file is named {name:?}")));
        }
        if field == "file" {
            self.named.push(name.clone());
        }
        if media::is_mesh_name(&name) {
            self.meshes.push(name.clone());
        }
        Ok(name)
    }

    /// The file sent as `file`, when there is one such; else the only one with the extension of a mesh format. A
    /// caller who sends all files as `file` means the mesh among them.
    pub fn main(self) -> Result<String, ApiError> {
        let Self { names, named, meshes } = self;
        if let ([only], _) | (_, [only]) = (&named[..], &meshes[..]) {
            return Ok(only.clone());
        }
        let mut names = names.into_iter();
        match (names.next(), names.next()) {
            (None, _) => Err(ApiError::field("file", "the form has no file")
                .hint("send the mesh as a file, as curl does with -F file=@hero.obj")),
            (Some(only), None) => Ok(only),
            _ if meshes.is_empty() => {
                Err(ApiError::field("file", "none of the files has the extension of a mesh format")
                    .hint("send the mesh in the field file, and the others in fields of another name"))
            }
            _ => Err(ApiError::field("file", format!("which of {} is to be rigged is not clear", meshes.join(", ")))
                .hint("send that one in the field file, and the others in fields of another name")),
        }
    }
}

/// What became of an upload that is to be kept.
pub struct Kept {
    pub asset: Asset,
    /// There was no such asset before.
    pub created: bool,
    /// An earlier request with the same key brought it.
    pub replayed: bool,
}

/// Keeps an upload as an asset.
pub async fn keep(
    app: &App,
    identity: &Identity,
    received: Received,
    idempotency_key: Option<String>,
) -> Result<Kept, ApiError> {
    let (app, identity) = (app.clone(), identity.clone());
    // Detached: once the key is taken, the answer is remembered even if the caller hangs up.
    let kept = tokio::spawn(async move {
        match idempotency_key {
            Some(key) => keep_once(&app, &identity, received, &key).await,
            None => put(&app, &identity, received).await,
        }
    });
    kept.await.map_err(|error| ApiError::internal(&error))?
}

async fn keep_once(app: &App, identity: &Identity, received: Received, key: &str) -> Result<Kept, ApiError> {
    let caller = &identity.caller;
    let said = asset_sha256(&received.files());
    if let Turn::Again(id) = idempotency::turn(app, caller, key, &[b"POST /v1/assets", &said]).await? {
        let known = find(app, identity, &String::from_utf8_lossy(&id)).await;
        if let Some(asset) = idempotency::still_there(known)? {
            return Ok(Kept { asset, created: false, replayed: true });
        }
    }
    let made = put(app, identity, received).await;
    let id = made.as_ref().ok().map(|kept| kept.asset.id.to_string());
    app.jobs.remember(caller, key, id.as_deref().map(str::as_bytes)).await?;
    made
}

async fn put(app: &App, identity: &Identity, received: Received) -> Result<Kept, ApiError> {
    let put = app.jobs.put_asset(&identity.caller, received).await?;
    Ok(Kept { asset: put.asset, created: put.created, replayed: false })
}

/// The caller's asset with this id.
pub async fn find(app: &App, identity: &Identity, id: &str) -> Result<Asset, ApiError> {
    let asset = app.jobs.asset(&identity.caller, asset_id(id)?).await?;
    asset.ok_or_else(missing)
}

pub fn missing() -> ApiError {
    ApiError::not_found("such asset").hint("it may have expired; upload the files again")
}

pub fn asset_id(text: &str) -> Result<AssetId, ApiError> {
    text.parse().map_err(|error| ApiError::not_found("such asset").hint(format!("{error}")))
}
