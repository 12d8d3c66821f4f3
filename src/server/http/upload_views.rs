//! Uploads in parts as JSON.

use super::timestamp::rfc3339;
use crate::jobs::{Resumable, ResumableState};
use serde::Serialize;
use utoipa::ToSchema;

/// A file that arrives in parts.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Upload)]
pub struct UploadView {
    #[schema(example = "upl_01jdf5fj5rfxm8s1m2q1d2zt8v")]
    pub id: String,
    #[schema(example = "upload")]
    pub object: &'static str,
    #[schema(example = "hero.glb")]
    pub file_name: String,
    /// Bytes of the whole file.
    #[schema(example = 482_113)]
    pub length: u64,
    /// Bytes that are here.
    #[schema(example = 262_144)]
    pub offset: u64,
    /// What became of it, once all of it is here.
    #[schema(example = json!(null))]
    pub asset: Option<String>,
    #[schema(example = "2026-11-24T15:20:07.042Z", format = DateTime)]
    pub created_at: String,
    /// When its parts go, unless more comes before; `null` when it is complete.
    #[schema(example = "2026-11-25T15:20:07.042Z", format = DateTime)]
    pub expires_at: Option<String>,
    pub links: UploadLinksView,
}

#[derive(Debug, Serialize, ToSchema)]
#[schema(as = UploadLinks)]
pub struct UploadLinksView {
    #[schema(example = "/v1/uploads/upl_01jdf5fj5rfxm8s1m2q1d2zt8v")]
    #[serde(rename = "self")]
    pub this: String,
    /// The asset, once there is one.
    #[schema(example = json!(null))]
    pub asset: Option<String>,
}

/// Where an upload lives.
pub fn upload_path(upload: &Resumable) -> String {
    format!("/v1/uploads/{}", upload.id)
}

impl From<&Resumable> for UploadView {
    fn from(upload: &Resumable) -> Self {
        let asset = match upload.state {
            ResumableState::Complete(asset) => Some(asset.to_string()),
            ResumableState::Open | ResumableState::Expired => None,
        };
        Self {
            id: upload.id.to_string(),
            object: "upload",
            file_name: upload.file_name.clone(),
            length: upload.length,
            offset: upload.received,
            created_at: rfc3339(upload.created_at),
            expires_at: asset.is_none().then(|| rfc3339(upload.expires_at)),
            links: UploadLinksView {
                this: upload_path(upload),
                asset: asset.as_ref().map(|asset| format!("/v1/assets/{asset}")),
            },
            asset,
        }
    }
}
