//! Skeletons of FBX files: bones in any orientation, with or without weights, kept as they are.

use super::*;
use glam::{DMat4, DVec3};
use rigsmith::formats::gltf::{EncodeOptions, JointNames, encode_glb};
use rigsmith::formats::{OldRig, read_fbx_skeleton};
use rigsmith::rig::{Influence, Rig, SkinWeights};
use serde_json::Value;

fn node(id: u32, name: &str, kind: &str, properties: &str) -> String {
    let attribute = match kind {
        "LimbNode" => format!(
            "\tNodeAttribute: {}, \"NodeAttribute::{name}\", \"LimbNode\" {{\n\t\tTypeFlags: \"Skeleton\"\n\t}}\n",
            id + 500
        ),
        _ => String::new(),
    };
    format!(
        "{attribute}\tModel: {id}, \"Model::{name}\", \"{kind}\" {{\n\t\tVersion: 232\n\t\tProperties70:  {{\n{properties}\t\t}}\n\t}}\n"
    )
}

fn vector(name: &str, value: [i32; 3]) -> String {
    let [x, y, z] = value;
    format!("\t\t\tP: \"{name}\", \"{name}\", \"\", \"A\",{x},{y},{z}\n")
}

/// An armature with a hip that is turned about the vertical, a spine on it, a socket that is no bone, and an IK target; z up, in
/// centimetres, as the board is.
fn bones() -> (String, String) {
    let at = |place| vector("Lcl Translation", place);
    let objects = [
        node(5000, "Armature", "Null", ""),
        node(5001, "Hip", "LimbNode", &(at([50, 0, 100]) + &vector("Lcl Rotation", [0, 0, 90]))),
        node(5002, "Spine", "LimbNode", &at([0, 0, 75])),
        node(5003, "Socket", "Null", &at([0, 10, 0])),
        node(5004, "IK_target", "LimbNode", &at([100, 0, 0])),
    ];
    let links = "\tC: \"OO\",5000,0\n\tC: \"OO\",5001,5000\n\tC: \"OO\",5501,5001\n\tC: \"OO\",5002,5001\n\tC: \"OO\",5502,5002\n\
                 \tC: \"OO\",5003,5002\n\tC: \"OO\",5004,5000\n\tC: \"OO\",5504,5004\n";
    (objects.concat(), links.to_owned())
}

/// A skin that binds the upper edge to the spine; `lift` is how far above its place the mesh was when it was bound.
fn skinned(lift: i32) -> Vec<u8> {
    let (objects, links) = bones();
    // Rows of a matrix with the translation last. The spine is at (50, 0, 175), turned by 90 degrees; the board's node at z = 100.
    let to_bone = format!("0,-1,0,0,1,0,0,0,0,0,1,0,0,50,{},1", lift - 75);
    let skin = format!(
        "\tDeformer: 6000, \"Deformer::Skin\", \"Skin\" {{\n\t\tVersion: 101\n\t}}\n\
         \tDeformer: 6001, \"SubDeformer::Spine\", \"Cluster\" {{\n\t\tVersion: 100\n\
         \t\tIndexes: *3 {{\n\t\t\ta: 2,3,4\n\t\t}}\n\t\tWeights: *3 {{\n\t\t\ta: 1,1,0.5\n\t\t}}\n\
         \t\tTransform: *16 {{\n\t\t\ta: {to_bone}\n\t\t}}\n\
         \t\tTransformLink: *16 {{\n\t\t\ta: 0,1,0,0,-1,0,0,0,0,0,1,0,50,0,175,1\n\t\t}}\n\t}}\n"
    );
    let bound = "\tC: \"OO\",6000,1000\n\tC: \"OO\",6001,6000\n\tC: \"OO\",5002,6001\n";
    ascii_fbx(&(objects + &skin), &(links + bound))
}

fn reskin(bytes: &[u8]) -> Asset {
    let options = DecodeOptions { existing_rig: ExistingRigPolicy::Reskin, ..DecodeOptions::default() };
    decode("board.fbx", bytes, &NoSiblings, &Limits::default(), &options).expect("reads")
}

fn names(rig: &OldRig) -> Vec<(&str, Option<usize>)> {
    rig.skeleton.joints.iter().map(|joint| (joint.name.as_str(), joint.parent)).collect()
}

/// The JSON of the GLB that is written with every vertex on joint 0 that deforms.
fn written(asset: &Asset) -> Value {
    let old = asset.old_rig.as_ref().expect("a rig");
    let joint = old.deforms.iter().position(|&deforms| deforms).expect("a joint") as u32;
    let rows = vec![vec![Influence { joint, weight: 1.0 }]; asset.mesh.positions.len()];
    let rig = Rig { skeleton: old.skeleton.clone(), skin: SkinWeights { rows } };
    let options = EncodeOptions { names: JointNames::AsGiven, ..EncodeOptions::default() };
    glb_json(&encode_glb(asset, &rig, &options).expect("written"))
}

fn glb_json(file: &[u8]) -> Value {
    let length = u32::from_le_bytes(file[12..16].try_into().expect("four bytes")) as usize;
    serde_json::from_slice(&file[20..20 + length]).expect("JSON chunk")
}

/// Name, name of the parent and world transform of every node without a mesh, in the order of the document.
fn nodes(json: &Value) -> Vec<(String, Option<String>, DMat4)> {
    let nodes = json["nodes"].as_array().expect("nodes");
    let name = |index: usize| nodes[index]["name"].as_str().expect("a name").to_owned();
    let parent = |index: usize| {
        let is_child = |node: &Value| {
            node["children"]
                .as_array()
                .is_some_and(|children| children.iter().any(|child| child.as_u64() == Some(index as u64)))
        };
        nodes.iter().position(is_child)
    };
    let numbers = |node: &Value, key: &str| -> Option<Vec<f64>> {
        node.get(key)?.as_array()?.iter().map(Value::as_f64).collect()
    };
    let local = |index: usize| {
        let node = &nodes[index];
        let translation = numbers(node, "translation").map_or(DVec3::ZERO, |numbers| DVec3::from_slice(&numbers));
        let rotation =
            numbers(node, "rotation").map_or(glam::DQuat::IDENTITY, |numbers| glam::DQuat::from_slice(&numbers));
        let scale = numbers(node, "scale").map_or(DVec3::ONE, |numbers| DVec3::from_slice(&numbers));
        assert!((scale - DVec3::ONE).abs().max_element() < 1e-6, "{} is scaled", name(index));
        DMat4::from_rotation_translation(rotation, translation)
    };
    let world = |index: usize| {
        let mut matrix = local(index);
        let mut above = parent(index);
        while let Some(node) = above {
            matrix = local(node) * matrix;
            above = parent(node);
        }
        matrix
    };
    let bare = (0..nodes.len()).filter(|&index| nodes[index].get("mesh").is_none());
    bare.map(|index| (name(index), parent(index).map(name), world(index))).collect()
}

#[test]
fn bones_keep_name_order_parent_orientation_and_what_hangs_on_them() {
    let (objects, links) = bones();
    for bytes in [ascii_fbx(&objects, &links), binary_fbx(&ascii_fbx(&objects, &links))] {
        let asset = reskin(&bytes);
        let rig = asset.old_rig.as_ref().expect("a rig");
        // Without a skin all bones are joints; the armature holds the two trees.
        assert_eq!(names(rig), [("Armature", None), ("Hip", Some(0)), ("IK_target", Some(0)), ("Spine", Some(1))]);
        assert_eq!(rig.deforms, [false, true, true, true]);
        assert!(rig.rows.iter().all(Vec::is_empty) && rig.rows.len() == 5);
        let json = written(&asset);
        let kept = nodes(&json);
        let tree: Vec<_> = kept.iter().map(|(name, parent, _)| (name.as_str(), parent.as_deref())).collect();
        let expected = [
            ("Armature", None),
            ("Hip", Some("Armature")),
            ("IK_target", Some("Armature")),
            ("Spine", Some("Hip")),
            ("Socket", Some("Spine")),
        ];
        assert_eq!(tree, expected);
        let near = |a: DVec3, b: [f64; 3]| a.distance(b.into()) < 1e-6;
        let world = |name: &str| kept.iter().find(|node| node.0 == name).expect("a node").2;
        // x right, z up, y to the back: the vertical is y here, and what was y is -z.
        let hip = world("Hip");
        assert!(near(hip.w_axis.truncate(), [0.5, 1.0, 0.0]), "{hip}");
        assert!(near(hip.x_axis.truncate(), [0.0, 0.0, -1.0]) && near(hip.z_axis.truncate(), [0.0, 1.0, 0.0]), "{hip}");
        assert!(near(world("Spine").w_axis.truncate(), [0.5, 1.75, 0.0]));
        assert!(near(world("Socket").w_axis.truncate(), [0.4, 1.75, 0.0]), "{}", world("Socket"));
        for (joint, name) in [(1, "Hip"), (2, "IK_target"), (3, "Spine")] {
            assert!(near(world(name).w_axis.truncate(), rig.skeleton.joints[joint].position.to_array()), "{name}");
        }
        let listed: Vec<&str> = json["skins"][0]["joints"]
            .as_array()
            .expect("joints")
            .iter()
            .map(|joint| json["nodes"][joint.as_u64().expect("index") as usize]["name"].as_str().expect("a name"))
            .collect();
        assert_eq!(listed, ["Hip", "IK_target", "Spine"]);
    }
}

#[test]
fn joints_of_a_skin_are_those_that_it_names_with_their_weights() {
    let asset = reskin(&skinned(0));
    let rig = asset.old_rig.as_ref().expect("a rig");
    assert_eq!(names(rig), [("Spine", None)]);
    let whole = vec![Influence { joint: 0, weight: 1.0 }];
    assert_eq!(rig.rows, [vec![], vec![], whole.clone(), whole.clone(), whole]);
    let still = accept("board.fbx", &ascii_fbx("", ""));
    assert_eq!(asset.mesh.positions, still.mesh.positions, "a skin at rest moves nothing");
    let kept = nodes(&written(&asset));
    assert_eq!(
        kept.iter().map(|node| node.0.as_str()).collect::<Vec<_>>(),
        ["Armature", "Hip", "IK_target", "Spine", "Socket"]
    );
}

#[test]
fn a_mesh_bound_in_another_pose_comes_as_the_bones_have_it() {
    let asset = reskin(&skinned(10));
    let still = accept("board.fbx", &ascii_fbx("", ""));
    for (row, lifted) in [(0, 0.0), (1, 0.0), (2, 0.1), (3, 0.1), (4, 0.1)] {
        let moved = asset.mesh.positions[row] - still.mesh.positions[row];
        assert!(moved.distance(DVec3::Y * lifted) < 1e-9, "{row}: {moved}");
    }
    let normals = scene(&asset).nodes[0].primitives.iter().flat_map(|primitive| primitive.normals.iter().flatten());
    assert!(normals.into_iter().all(|normal| (normal[2] - 1.0).abs() < 1e-6));
}

#[test]
fn a_skeleton_given_for_another_mesh_is_written_as_the_file_has_it() {
    let (objects, links) = bones();
    let file = ascii_fbx(&(objects + &node(5005, "Lamp", "Null", "")), &(links + "\tC: \"OO\",5005,0\n"));
    let (skeleton, skeleton_nodes) = read_fbx_skeleton(&file, &Limits::default()).expect("reads");
    let asset = accept("board.fbx", &ascii_fbx("", ""));
    let rows = vec![vec![Influence { joint: 3, weight: 1.0 }]; asset.mesh.positions.len()];
    let rig = Rig { skeleton, skin: SkinWeights { rows } };
    let options = EncodeOptions { names: JointNames::AsGiven, nodes: Some(skeleton_nodes), ..EncodeOptions::default() };
    let given = glb_json(&encode_glb(&asset, &rig, &options).expect("written"));
    let mut kept = nodes(&written(&reskin(&file)));
    // What has nothing to do with joints stays behind.
    let all = kept.len();
    kept.retain(|node| node.0 != "Lamp");
    assert_eq!(kept.len(), all - 1);
    let given_nodes = nodes(&given);
    assert_eq!(given_nodes.len(), kept.len());
    for ((name, parent, world), (name_kept, parent_kept, world_kept)) in given_nodes.iter().zip(&kept) {
        assert_eq!((name, parent), (name_kept, parent_kept));
        assert!(world.abs_diff_eq(*world_kept, 1e-9), "{name}: {world_kept} became {world}");
    }
    let joint = |at: usize| given["skins"][0]["joints"][at].as_u64().expect("index") as usize;
    let names: Vec<&str> = (0..4).map(|at| given["nodes"][joint(at)]["name"].as_str().expect("a name")).collect();
    assert_eq!(names, ["Hip", "IK_target", "Spine", "Armature"]);
}

#[test]
fn a_skeleton_is_read_alone_and_files_without_one_are_refused() {
    let (objects, links) = bones();
    let (skeleton, _) = read_fbx_skeleton(&ascii_fbx(&objects, &links), &Limits::default()).expect("reads");
    assert_eq!(
        skeleton.joints.iter().map(|joint| joint.name.as_str()).collect::<Vec<_>>(),
        ["Armature", "Hip", "IK_target", "Spine"]
    );
    let error = read_fbx_skeleton(&ascii_fbx("", ""), &Limits::default()).expect_err("refused");
    assert!(error.to_string().contains("no joints"), "{error}");
    let options = DecodeOptions { existing_rig: ExistingRigPolicy::Reskin, ..DecodeOptions::default() };
    let error =
        decode("board.fbx", &ascii_fbx("", ""), &NoSiblings, &Limits::default(), &options).expect_err("refused");
    assert_eq!(error, DecodeError::NotRigged);
}
