//! Assets over the wire.

use super::check_views::{ExistingView, MeshView};
use super::timestamp::rfc3339;
use super::views::{FileView, FindingView, hex};
use crate::jobs::{Asset, Check, JobError};
use serde::Serialize;
use utoipa::ToSchema;

/// An upload that is kept, to be rigged more than once.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Asset)]
pub struct AssetView {
    #[schema(example = "ast_01jdf5fj5rfxm8s1m2q1d2zt8v")]
    pub id: String,
    #[schema(example = "asset")]
    pub object: &'static str,
    /// Digest of the file sent; of the list of names and digests when there were several.
    #[schema(example = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08")]
    pub sha256: String,
    /// All files together.
    #[schema(example = 482_113)]
    pub bytes: u64,
    /// The one to rig first.
    pub files: Vec<FileView>,
    /// What the files hold; `null` when they cannot be read, and a finding says why.
    pub mesh: Option<MeshView>,
    pub existing: Option<ExistingView>,
    pub findings: Vec<FindingView>,
    #[schema(example = "2026-11-24T15:20:07.042Z", format = DateTime)]
    pub created_at: String,
    /// When it goes, unless it is used again before.
    #[schema(example = "2026-11-25T15:20:07.042Z", format = DateTime)]
    pub expires_at: String,
    pub links: AssetLinksView,
}

#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AssetLinks)]
pub struct AssetLinksView {
    #[schema(example = "/v1/assets/ast_01jdf5fj5rfxm8s1m2q1d2zt8v")]
    #[serde(rename = "self")]
    pub this: String,
    #[schema(example = "/v1/assets/ast_01jdf5fj5rfxm8s1m2q1d2zt8v/content")]
    pub content: String,
}

impl AssetView {
    /// An asset, and what a look at its files gave.
    pub fn new(asset: &Asset, check: Result<&Check, &JobError>) -> Self {
        let path = format!("/v1/assets/{}", asset.id);
        Self {
            id: asset.id.to_string(),
            object: "asset",
            sha256: hex(&asset.sha256),
            bytes: asset.bytes(),
            files: asset.files.iter().map(FileView::from).collect(),
            mesh: check.ok().map(MeshView::from),
            existing: check.ok().map(ExistingView::from),
            findings: match check {
                Ok(check) => check.findings.iter().map(FindingView::from).collect(),
                Err(error) => vec![FindingView::from(error)],
            },
            created_at: rfc3339(asset.created_at),
            expires_at: rfc3339(asset.expires_at),
            links: AssetLinksView { content: format!("{path}/content"), this: path },
        }
    }
}
