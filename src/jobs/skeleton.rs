//! A skeleton that comes with a request: read once, at the door, so that a faulty one never enters the queue.

use super::failure::{ErrorCode, JobError};
use super::options::GivenSkeleton;
use crate::formats::rig_json::{self, RigFileError};
use crate::formats::{Limits, gltf, is_fbx, read_fbx_skeleton};
use std::sync::Arc;

/// Reads a skeleton for [`super::RigOptions::skeleton`] from a `rigsmith.rig/1` file, from a GLB file with a skin or from an FBX
/// file with bones. Weights are read of the first alone, and kept where joints are to be locked (`with_weights`); positions are in
/// the space of the upload that the skeleton is for.
pub fn read_skeleton(bytes: &[u8], with_weights: bool) -> Result<Arc<GivenSkeleton>, JobError> {
    let bare = |(skeleton, nodes)| GivenSkeleton { skeleton, nodes: Some(nodes), rows: Vec::new() };
    let read = if gltf::is_glb(bytes) {
        gltf::read_skeleton(bytes, &Limits::default()).map(bare)
    } else if is_fbx(bytes) {
        read_fbx_skeleton(bytes, &Limits::default()).map(bare)
    } else {
        rig_json::read(bytes).map(|file| {
            let given = GivenSkeleton::from(file);
            if with_weights { given } else { GivenSkeleton { rows: Vec::new(), ..given } }
        })
    };
    read.map(Arc::new).map_err(|error| refusal(&error))
}

/// The same skeleton as the shortest file that holds it: what two senders mean alike is alike.
pub fn canonical_skeleton(bytes: &[u8], with_weights: bool) -> Result<Vec<u8>, JobError> {
    Ok(read_skeleton(bytes, with_weights)?.to_json().to_string().into_bytes())
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
        assert_eq!(read_skeleton(file, false).expect("reads").skeleton.joints[0].name, "hips");
        let canonical = canonical_skeleton(file, false).expect("reads");
        assert_eq!(canonical_skeleton(&canonical, false).as_ref(), Ok(&canonical), "the shortest file is its own");
        assert_eq!(read_skeleton(&canonical, false), read_skeleton(file, false));
        let error = read_skeleton(b"{}", false).expect_err("refused");
        assert_eq!(error.code, ErrorCode::SkeletonInvalid);
        assert!(!error.hint.is_empty());
    }

    #[test]
    fn weights_stay_only_where_they_are_wanted() {
        let file =
            br#"{"format": "rigsmith.rig/1", "joints": [{"name": "hips", "parent": null, "position": [0, 1, 0]}],
            "skins": [{"joints": [[0], [0]], "weights": [[1], [1]]}], "report": {"a": 1}}"#;
        assert_eq!(read_skeleton(file, true).expect("reads").rows.len(), 2);
        assert!(read_skeleton(file, false).expect("reads").rows.is_empty());
        let canonical = canonical_skeleton(file, true).expect("reads");
        assert_eq!(read_skeleton(&canonical, true), read_skeleton(file, true));
    }
}
