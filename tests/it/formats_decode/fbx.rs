//! FBX, read by `ufbx`.

use super::*;
use base64::Engine;

#[test]
fn fbx_is_placed_in_the_world_in_metres_with_y_up() {
    let asset = accept("board.fbx", &ascii_fbx("", ""));
    let axes = asset.axes.expect("axes are in the file");
    assert_eq!(format!("{axes:?}"), "Axes { up: PosY, front: PosZ }");
    let near = |row: usize, expected: [f64; 3]| {
        let distance = asset.mesh.positions[row].distance(expected.into());
        assert!(distance < 1e-9, "{:?} is not {expected:?}", asset.mesh.positions[row]);
    };
    near(0, [0.0, 1.0, 0.0]);
    near(1, [1.0, 1.0, 0.0]);
    near(4, [0.5, 2.5, 0.0]);
    assert_eq!(asset.mesh.triangles, [[0, 1, 2], [0, 2, 3], [3, 2, 4]]);
    assert!(asset.existing_rig.is_none());
    let node = &scene(&asset).nodes[0];
    assert_eq!((node.name.as_str(), node.primitives.len(), asset.parts.len()), ("Board", 2, 1));
    let normal = node.primitives[0].normals.as_ref().expect("normals")[0];
    assert!((normal[2] - 1.0).abs() < 1e-6, "{normal:?} faces the viewer");
    assert_eq!(scene(&asset).materials[0].base_color, [1.0, 0.0, 0.0, 1.0]);
    assert_eq!(node.primitives[0].texture_coordinates.as_ref().expect("coordinates")[0], [0.0, 1.0]);
    assert!(codes(&asset).contains(&"missing_texture"));
}

#[test]
fn binary_and_ascii_fbx_give_the_same() {
    let ascii = accept("board.fbx", &ascii_fbx("", ""));
    let binary = accept("board.fbx", &binary_fbx(&ascii_fbx("", "")));
    assert_eq!(format!("{ascii:?}"), format!("{binary:?}"));
}

#[test]
fn fbx_takes_its_texture_from_the_upload() {
    let upload = files([("paint.png", PNG)]);
    let asset = read_with("board.fbx", &ascii_fbx("", ""), &upload).expect("reads");
    let scene = scene(&asset);
    assert_eq!(scene.images[scene.materials[1].base_color_texture.expect("a texture")].bytes, PNG);
}

#[test]
fn fbx_takes_its_texture_from_inside_itself() {
    let content = base64::prelude::BASE64_STANDARD.encode(PNG);
    let video = format!(
        "\tVideo: 4100, \"Video::Paint\", \"Clip\" {{\n\t\tType: \"Clip\"\n\t\tFilename: \"C:\\paint.png\"\n\
         \t\tRelativeFilename: \"..\\paint.png\"\n\t\tContent: , \"{content}\"\n\t}}\n"
    );
    let asset = accept("board.fbx", &ascii_fbx(&video, "\tC: \"OO\",4100,4000\n"));
    let scene = scene(&asset);
    let image = &scene.images[scene.materials[1].base_color_texture.expect("a texture")];
    assert_eq!((image.name.as_str(), image.bytes.as_slice()), ("paint.png", PNG));
    assert!(!codes(&asset).contains(&"missing_texture"));
}

#[test]
fn fbx_instances_become_parts_of_their_own() {
    let second = "\tModel: 2001, \"Model::Twin\", \"Mesh\" {\n\t\tVersion: 232\n\t}\n";
    let links = "\tC: \"OO\",2001,0\n\tC: \"OO\",1000,2001\n\tC: \"OO\",3001,2001\n";
    let asset = accept("board.fbx", &ascii_fbx(second, links));
    let parts: Vec<_> = asset.parts.iter().map(|part| (part.name.as_str(), part.mesh, part.vertices.clone())).collect();
    assert_eq!(parts, [("Board", 0, 0..5), ("Twin", 1, 5..10)]);
    assert!((asset.mesh.positions[0].y - asset.mesh.positions[5].y - 1.0).abs() < 1e-9, "each has its own place");
    assert_eq!(scene(&asset).nodes.len(), 2);
}

#[test]
fn fbx_of_a_mirrored_node_keeps_its_outside() {
    let text = String::from_utf8(ascii_fbx("", "")).expect("text").replace(
        "P: \"Lcl Translation\", \"Lcl Translation\", \"\", \"A\",0,0,100",
        "P: \"Lcl Scaling\", \"Lcl Scaling\", \"\", \"A\",-1,1,1",
    );
    let asset = accept("board.fbx", text.as_bytes());
    let normal = |triangle: [u32; 3]| {
        let [a, b, c] = triangle.map(|corner| asset.mesh.positions[corner as usize]);
        (b - a).cross(c - a)
    };
    assert!(asset.mesh.triangles.iter().all(|&triangle| normal(triangle).z > 0.0));
    assert!(asset.mesh.positions[1].x < 0.0);
}

#[test]
fn an_fbx_with_bones_is_refused_unless_its_rig_is_to_be_replaced() {
    let bones = "\tNodeAttribute: 5000, \"NodeAttribute::Hip\", \"LimbNode\" {\n\t\tTypeFlags: \"Skeleton\"\n\t}\n\
                 \tModel: 5001, \"Model::Hip\", \"LimbNode\" {\n\t\tVersion: 232\n\t}\n\
                 \tDeformer: 6000, \"Deformer::Skin\", \"Skin\" {\n\t\tVersion: 101\n\t}\n\
                 \tDeformer: 6001, \"SubDeformer::Hip\", \"Cluster\" {\n\t\tVersion: 100\n\t\tIndexes: *1 {\n\t\t\ta: 0\n\t\t}\n\
                 \t\tWeights: *1 {\n\t\t\ta: 1\n\t\t}\n\t}\n";
    let connections = "\tC: \"OO\",5001,0\n\tC: \"OO\",5000,5001\n\tC: \"OO\",6000,1000\n\tC: \"OO\",6001,6000\n\
                       \tC: \"OO\",5001,6001\n";
    let bytes = ascii_fbx(bones, connections);
    assert_eq!(refusal("board.fbx", &bytes), DecodeError::AlreadyRigged { skins: 1, joints: 1 });
    let options = DecodeOptions { existing_rig: ExistingRigPolicy::Replace, ..DecodeOptions::default() };
    let asset = decode("board.fbx", &bytes, &NoSiblings, &Limits::default(), &options).expect("reads");
    assert_eq!(asset.existing_rig.map(|rig| (rig.skins, rig.joints)), Some((1, 1)));
}

#[test]
fn fbx_with_an_index_out_of_range_is_refused() {
    let text = String::from_utf8(ascii_fbx("", "")).expect("text").replace("a: 0,1,2,-4,3,2,-5", "a: 0,1,99,-4,3,2,-5");
    assert_eq!(refusal("board.fbx", text.as_bytes()).code(), "unreadable_mesh");
}

#[test]
fn fbx_nested_too_deeply_is_refused() {
    let mut text = String::from_utf8(ascii_fbx("", "")).expect("text");
    text += &"Deep: {\n".repeat(5000);
    text += &"}\n".repeat(5000);
    assert_eq!(refusal("board.fbx", text.as_bytes()).code(), "unreadable_mesh");
    let chain: String =
        (0..200).map(|i| format!("\tModel: {}, \"Model::n{i}\", \"Null\" {{\n\t}}\n", 7000 + i)).collect();
    let links: String =
        (0..200).map(|i| format!("\tC: \"OO\",{},{}\n", 7000 + i, if i == 0 { 0 } else { 6999 + i })).collect();
    let error = refusal("board.fbx", &ascii_fbx(&chain, &links));
    assert_eq!(error, DecodeError::TooDeep { format: "FBX", what: "the node graph", limit: 64 });
}

#[test]
fn fbx_memory_is_limited() {
    let limits = Limits { fbx_memory_bytes_max: 10_000, ..Limits::default() };
    let error = decode("board.fbx", &ascii_fbx("", ""), &NoSiblings, &limits, &DecodeOptions::default());
    assert_eq!(error.expect_err("refused").code(), "too_large");
}

/// Programs write an animation stack into every file; what nothing moves is no loss.
#[test]
fn fbx_animations_that_are_left_behind_are_told_of() {
    let stack = "\tAnimationStack: 9000, \"AnimStack::Take\", \"\" {\n\t}\n\
                 \tAnimationLayer: 9001, \"AnimLayer::Base\", \"\" {\n\t}\n";
    let layer = "\tC: \"OO\",9001,9000\n";
    let still = accept("still.fbx", &ascii_fbx(stack, layer));
    assert!(!codes(&still).contains(&"fbx_left_behind"), "{:?}", codes(&still));
    let moves = format!("{stack}\tAnimationCurveNode: 9002, \"AnimCurveNode::T\", \"\" {{\n\t}}\n");
    let of_node = format!("{layer}\tC: \"OO\",9002,9001\n\tC: \"OP\",9002,2000, \"Lcl Translation\"\n");
    let moving = accept("moving.fbx", &ascii_fbx(&moves, &of_node));
    let told = moving.findings.iter().find(|finding| finding.code == "fbx_left_behind").expect("a finding");
    assert!(told.message.starts_with("1 animation(s)") && !told.hint.is_empty(), "{told:?}");
}
