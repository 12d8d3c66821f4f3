//! A skeleton that comes with a request: read once, at the door, so that a faulty one never enters the queue.

use super::failure::{ErrorCode, JobError};
use crate::formats::rig_json::{self, RigFileError};
use crate::formats::{Limits, gltf};
use crate::pipelines::Skeleton;
use std::sync::Arc;

/// Reads a skeleton for [`super::RigOptions::skeleton`] from a `rigsmith.rig/1` file or from a GLB file with a skin. Weights are
/// not looked at beyond their form; positions are in the space of the upload that the skeleton is for.
pub fn read_skeleton(bytes: &[u8]) -> Result<Arc<Skeleton>, JobError> {
    let read = if gltf::is_glb(bytes) {
        gltf::read_skeleton(bytes, &Limits::default())
    } else {
        rig_json::read(bytes).map(|file| file.skeleton)
    };
    read.map(Arc::new).map_err(|error| refusal(&error))
}

/// The same skeleton as the shortest file that holds it: what two senders mean alike is alike.
pub fn canonical_skeleton(bytes: &[u8]) -> Result<Vec<u8>, JobError> {
    let skeleton = read_skeleton(bytes)?;
    Ok(rig_json::skeleton_json(&skeleton).to_string().into_bytes())
}

fn refusal(error: &RigFileError) -> JobError {
    JobError::new(ErrorCode::SkeletonInvalid, error.to_string()).hint(error.hint())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_skeleton_alone_is_enough_and_a_faulty_one_is_refused_by_name() {
        let file =
            br#"{"format": "rigsmith.rig/1", "joints": [{"name": "hips", "parent": null, "position": [0, 1, 0]}]}"#;
        assert_eq!(read_skeleton(file).expect("reads").joints[0].name, "hips");
        let canonical = canonical_skeleton(file).expect("reads");
        assert_eq!(canonical_skeleton(&canonical).as_ref(), Ok(&canonical), "the shortest file is its own");
        assert_eq!(read_skeleton(&canonical), read_skeleton(file));
        let error = read_skeleton(b"{}").expect_err("refused");
        assert_eq!(error.code, ErrorCode::SkeletonInvalid);
        assert!(!error.hint.is_empty());
    }
}
