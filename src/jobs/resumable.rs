//! Uploads that arrive in parts, each by a request of its own, and perhaps to another process. The last byte makes an asset of
//! them, in one step: an upload is complete exactly when there is its asset.

use super::ids::{AssetId, UploadId};
use super::submission::Caller;
use std::time::SystemTime;

/// An upload to be begun.
#[derive(Clone, Debug)]
pub struct NewResumable {
    pub caller: Caller,
    /// As the mesh is called in its asset.
    pub file_name: String,
    /// What the caller wants to be told again, as it was said.
    pub metadata: Option<String>,
    /// Bytes of the file, above zero.
    pub length: u64,
    /// Open uploads that the caller may have, with this one.
    pub open_max: usize,
}

/// An upload at one moment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Resumable {
    pub id: UploadId,
    pub file_name: String,
    pub metadata: Option<String>,
    pub length: u64,
    /// Bytes that are here, from the first on.
    pub received: u64,
    pub state: ResumableState,
    pub created_at: SystemTime,
    /// When the parts of an open one go, unless more comes before.
    pub expires_at: SystemTime,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResumableState {
    /// More is to come.
    Open,
    Complete(AssetId),
    /// Its parts are gone.
    Expired,
}

/// Why bytes were not added.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NotAdded {
    /// The upload does not end where they begin.
    Elsewhere,
    /// There is no such upload any more.
    Gone,
}
