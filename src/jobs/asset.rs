//! Uploaded meshes that outlive one request: the same files of the same caller are the same asset.

use super::ids::AssetId;
use super::job::FileInfo;
use std::time::SystemTime;

/// An upload that is kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Asset {
    pub id: AssetId,
    /// Of the file when there is one; of the lines `sha256  name` when there are several.
    pub sha256: [u8; 32],
    /// The main file first.
    pub files: Vec<FileInfo>,
    pub created_at: SystemTime,
    /// When it goes unless it is used again.
    pub expires_at: SystemTime,
}

impl Asset {
    pub fn bytes(&self) -> u64 {
        self.files.iter().map(|file| file.bytes).sum()
    }
}

/// An asset and whether it was made just now.
#[derive(Clone, Debug)]
pub struct PutAsset {
    pub asset: Asset,
    pub created: bool,
}
