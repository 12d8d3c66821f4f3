#![no_main]
//! Any bytes, read as a skeleton in a file of its own: GLB, FBX or `rig.json`, whichever they look like.

use libfuzzer_sys::fuzz_target;
use rigsmith::formats::{SceneSkeleton, gltf, is_fbx, read_fbx_skeleton, rig_json};
use rigsmith::rig::Skeleton;

#[allow(dead_code, reason = "the targets of meshes use the rest")]
#[path = "upload.rs"]
mod upload;

fuzz_target!(|bytes: &[u8]| {
    let read = if gltf::is_glb(bytes) {
        gltf::read_skeleton(bytes, &upload::LIMITS).map(|(skeleton, nodes)| (skeleton, Some(nodes)))
    } else if is_fbx(bytes) {
        read_fbx_skeleton(bytes, &upload::LIMITS).map(|(skeleton, nodes)| (skeleton, Some(nodes)))
    } else {
        rig_json::read(bytes).map(|file| (file.skeleton, file.nodes))
    };
    match read {
        Ok((skeleton, nodes)) => check(&skeleton, nodes.as_ref()),
        Err(error) => assert!(!error.code().is_empty() && !error.hint().is_empty() && !error.to_string().is_empty()),
    }
});

/// The invariants that the rest of the program trusts, and that a rig file gives the same again.
fn check(skeleton: &Skeleton, nodes: Option<&SceneSkeleton>) {
    assert!((1..=rig_json::JOINTS_MAX).contains(&skeleton.joints.len()));
    for (index, joint) in skeleton.joints.iter().enumerate() {
        assert!(joint.position.as_vec3().is_finite() && joint.parent.map_or(index == 0, |parent| parent < index));
    }
    let Some(nodes) = nodes else { return };
    let mut places: Vec<u32> = nodes.places.iter().flatten().copied().collect();
    places.sort_unstable();
    assert!(places.into_iter().eq(0..skeleton.joints.len() as u32));
    for (index, node) in nodes.nodes.iter().enumerate() {
        assert!(node.local().is_finite() && node.parent.is_none_or(|parent| parent < index));
    }
    let file = rig_json::skeleton_json(skeleton, Some(nodes), &[]).to_string();
    let again = rig_json::read(file.as_bytes()).expect("what was read is written as it can be read");
    assert_eq!((&again.skeleton, again.nodes.as_ref()), (skeleton, Some(nodes)));
}
