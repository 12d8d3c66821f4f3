//! What a running service makes of real characters: skeletons with nodes of their own, and bodies of boxes.

use super::examples::Served;
use super::reskin::{assert_same_skeleton, glb_json, turned_with_socket, weights, with_json};
use serde_json::{Value, json};

/// The job that a request with these arguments of curl is answered by, once it has ended well.
fn job(served: &Served, arguments: &str) -> Value {
    let said = served.run(&format!("curl -sS --fail-with-body -H 'Prefer: wait=60' {arguments}"));
    let job: Value = serde_json::from_str(&said).expect("JSON");
    assert_eq!(job["state"], "succeeded", "{job}");
    job
}

fn path(job: &Value) -> &str {
    job["links"]["self"].as_str().expect("a link")
}

#[test]
fn an_export_holds_the_nodes_of_a_skeleton_that_came_apart_from_the_mesh() {
    let served = Served::start();
    served.run("rigsmith rig hero.glb --skin-method geodesic_heat -o rigged.glb");
    let rigged = served.file("rigged.glb");
    let turned = turned_with_socket(&rigged);
    served.put("turned.glb", &with_json(&rigged, &turned));

    let glb = "-H 'Content-Type: model/gltf-binary'";
    let first = job(&served, &format!("{glb} --data-binary @hero.glb \"$HOST/v1/rigs?skin_method=geodesic_heat\""));
    let reskin = format!("\"$HOST{}:reskin?skin_method=geodesic_heat\"", path(&first));
    let reskinned = job(&served, &format!("{glb} --data-binary @turned.glb {reskin}"));
    let export = |job: &Value, wish: &str, name: &str| {
        let to = format!("\"$HOST{}:export\"", path(job));
        served
            .run(&format!("curl -sS --fail-with-body -o {name} -H 'Content-Type: application/json' -d '{wish}' {to}"));
        served.file(name)
    };
    let exported = export(&reskinned, r#"{"output": "glb"}"#, "exported.glb");
    assert_same_skeleton(&turned, &glb_json(&exported));
    let gltf = export(&reskinned, r#"{"output": "gltf", "max_influences": 1}"#, "exported.gltf");
    assert_same_skeleton(&turned, &serde_json::from_slice(&gltf).expect("JSON"));

    // The rig file that an export writes is a skeleton for the next request, with the same nodes.
    let rig = export(&reskinned, r#"{"output": "rig_json"}"#, "exported.rig.json");
    let skeleton: Value = serde_json::from_slice(&rig).expect("JSON");
    let nodes = skeleton["nodes"].as_array().expect("nodes");
    assert!(nodes.iter().any(|node| node["name"] == "Socket"), "{nodes:?}");
    let said = served.run(
        "curl -sS --fail-with-body -H 'Content-Type: model/gltf-binary' --data-binary @hero.glb \"$HOST/v1/assets\"",
    );
    let asset: Value = serde_json::from_str(&said).expect("JSON");
    let request = json!({"asset": asset["id"], "skin_method": "geodesic_heat", "skeleton": skeleton});
    served.put("request.json", request.to_string().as_bytes());
    let again = job(&served, "-H 'Content-Type: application/json' --data-binary @request.json \"$HOST/v1/rigs\"");
    assert_eq!(again["result"]["skeleton"]["given"], true);
    assert!(export(&again, r#"{"output": "glb"}"#, "again.glb") == exported, "the same skeleton, the same file");
}

#[test]
fn boxes_move_as_a_whole_unless_a_method_is_asked_for_and_the_answer_says_which() {
    let served = Served::start();
    let rig = |wishes: &str| {
        let job = job(
            &served,
            &format!("-H 'Content-Type: model/obj' --data-binary @hero.obj \"$HOST/v1/rigs?front=z&{wishes}\""),
        );
        served.run(&format!("curl -sS --fail-with-body -o rig.json \"$HOST{}/artifacts/rig.json\"", path(&job)));
        let rig: Value = serde_json::from_slice(&served.file("rig.json")).expect("JSON");
        let codes: Vec<&str> =
            job["warnings"].as_array().expect("warnings").iter().filter_map(|found| found["code"].as_str()).collect();
        let rigid = weights(&rig).iter().all(|row| row.values().copied().eq([1.0]));
        (job["result"]["skin"].clone(), codes.contains(&"made_of_boxes"), rigid)
    };
    let (skin, is_said, rigid) = rig("");
    assert_eq!((&skin["method"], &skin["max_influences"]), (&json!("rigid_boxes"), &json!(1)), "{skin}");
    assert_eq!(skin["reason"], "each box of the character moves as a whole");
    assert!(is_said && rigid);
    let (skin, is_said, rigid) = rig("skin_method=geodesic_heat");
    assert_eq!(skin["method"], "geodesic_heat", "{skin}");
    assert!(is_said && !rigid);
    let (skin, is_said, _) = rig("boxes=off");
    assert_eq!((&skin["method"], is_said), (&json!("heter_skin_net"), false), "{skin}");
    let (skin, ..) = rig("smooth=0.5");
    assert_eq!(skin["method"], "heter_skin_net", "{skin}");
}
