//! The examples of the OpenAPI document, run with curl against a service on a socket.

use super::scripted::{Service, request};
use super::socket::start;
use rigsmith::outgoing::{Outgoing, SystemNames};
use rigsmith::server::app;
use serde_json::Value;
use std::process::Command;
use std::sync::Arc;

/// Ids of a webhook endpoint and of a message that it is told.
async fn told(service: &Service) -> (String, String) {
    let nobody = r#"{"url": "http://127.0.0.1:9/"}"#;
    let made = request("POST", "/v1/webhook-endpoints", &[("content-type", "application/json")], nobody);
    let id = |answer: Value| answer["id"].as_str().expect("an id").to_owned();
    let endpoint = id(service.send(made).await.json());
    let test = request("POST", &format!("/v1/webhook-endpoints/{endpoint}:test"), &[], "");
    (endpoint, id(service.send(test).await.json()))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_example_of_the_description_answers_well() {
    let mut service = Service::with(|settings, limits| {
        settings.workers = 4;
        limits.open_uploads_max = 100;
    });
    let outgoing = Outgoing::new(Arc::new(SystemNames), &["127.0.0.1".to_owned()]).expect("a client");
    service.state = service.state.clone().with_outgoing(outgoing);
    service.router = app(service.state.clone());
    let running = start(&service).await;
    let folder = tempfile::tempdir().expect("folder");
    for name in ["hero.glb", "hero.obj", "hero.mtl", "skin.png"] {
        std::fs::write(folder.path().join(name), "ok").expect("writes");
    }
    let edited = r#"{"format": "rigsmith.rig/1", "joints": [{"name": "hips", "parent": null, "position": [0, 1, 0]}]}"#;
    std::fs::write(folder.path().join("edited.rig.json"), edited).expect("writes");
    let items = r#"{"custom_id": "a", "request": {"asset": "ast_00000000000000000000000000"}}"#;
    std::fs::write(folder.path().join("items.jsonl"), items).expect("writes");
    let document = service.get("/v1/openapi.json").await.json();
    let mut ran = 0;
    for (path, operations) in document["paths"].as_object().expect("paths") {
        for (verb, operation) in operations.as_object().expect("operations") {
            let example = operation["x-curl"].as_str().unwrap_or_else(|| panic!("{verb} {path} has no example"));
            if path.ends_with(":export") {
                // Needs a rig that is one: run with the program, by docs/api.md.
                continue;
            }
            let script = if path.ends_with(":cancel") { "hang" } else { "ok" };
            let job = service.rig("", &[("prefer", if script == "ok" { "wait=10" } else { "wait=0" })], script).await;
            let asset = service.send(request("POST", "/v1/assets", &[("content-type", "model/obj")], "ok")).await;
            let batch = request("POST", "/v1/batches", &[("content-type", "application/jsonl")], items);
            let batch = service.send(batch).await;
            let fields = [("tus-resumable", "1.0.0"), ("upload-length", "2")];
            let upload = service.send(request("POST", "/v1/uploads", &fields, "")).await;
            let (_, upload) = upload.header("location").rsplit_once('/').expect("a path");
            let (endpoint, message) = told(&service).await;
            let id = |answer: &Value| answer["id"].as_str().expect("an id").to_owned();
            let output = Command::new("bash")
                .args([
                    "-euo",
                    "pipefail",
                    "-c",
                    &format!("curl() {{ command curl -sS --fail-with-body \"$@\"; }}\n{example}"),
                ])
                .current_dir(folder.path())
                .env("HOST", &running.base)
                .env("ID", id(&job.json()))
                .env("ASSET", id(&asset.json()))
                .env("BATCH", id(&batch.json()))
                .env("UPLOAD", upload)
                .env("ENDPOINT", &endpoint)
                .env("MESSAGE", &message)
                .output()
                .expect("bash");
            let said = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "{verb} {path}\n{example}\n{said}");
            // A caller may have only so many.
            let done = request("DELETE", &format!("/v1/webhook-endpoints/{endpoint}"), &[], "");
            service.send(done).await;
            ran += 1;
        }
    }
    assert!(ran >= 20, "{ran} examples");
}
