//! Assets, and rigs made of them.

use super::scripted::{Answer, Service, form, request};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde_json::{Value, json};
use std::sync::atomic::Ordering;

const JSON: (&str, &str) = ("content-type", "application/json");
const OBJ: (&str, &str) = ("content-type", "model/obj");

async fn upload(service: &Service, script: &str) -> Answer {
    service.send(request("POST", "/v1/assets?file_name=hero.obj", &[OBJ], script)).await
}

async fn create(service: &Service, headers: &[(&str, &str)], body: &Value) -> Answer {
    let mut fields = vec![JSON];
    fields.extend(headers);
    service.send(request("POST", "/v1/rigs", &fields, &body.to_string())).await
}

#[tokio::test]
async fn the_same_files_are_the_same_asset() {
    let service = Service::new();
    let made = upload(&service, "ok").await;
    assert_eq!(made.status, 201, "{}", made.text());
    let asset = made.json();
    assert!(asset["id"].as_str().is_some_and(|id| id.starts_with("ast_")), "{asset}");
    assert_eq!(made.header("location"), asset["links"]["self"]);
    assert_eq!((&asset["bytes"], &asset["files"][0]["name"]), (&json!(2), &json!("hero.obj")));
    assert!(asset["expires_at"].as_str() > asset["created_at"].as_str());
    let again = upload(&service, "ok").await;
    assert_eq!((again.status.as_u16(), &again.json()["id"]), (200, &asset["id"]));
    assert_ne!(upload(&service, "sleep 1").await.json()["id"], asset["id"]);
    let path = made.header("location");
    assert_eq!(service.get(path).await.json()["sha256"], asset["sha256"]);
}

#[tokio::test]
async fn the_bytes_come_back_as_they_were_sent_until_they_are_deleted() {
    let service = Service::new();
    let path = upload(&service, "sleep 0 and more").await.header("location").to_owned();
    let content = format!("{path}/content");
    let whole = service.get(&content).await;
    assert_eq!(whole.bytes, b"sleep 0 and more");
    assert_eq!(whole.header("content-disposition"), "attachment; filename=\"hero.obj\"");
    let part = service.send(request("GET", &content, &[("range", "bytes=0-4")], "")).await;
    assert_eq!((part.status.as_u16(), &part.bytes[..]), (206, &b"sleep"[..]));
    let known = [("if-none-match", whole.header("etag"))];
    assert_eq!(service.send(request("GET", &content, &known, "")).await.status, 304);
    assert_eq!(service.send(request("DELETE", &path, &[], "")).await.status, 204);
    for path in [&path, &content] {
        service.get(path).await.refused(404, "not_found");
    }
    service.send(request("DELETE", &path, &[], "")).await.refused(404, "not_found");
    service.keeps(0);
}

#[tokio::test]
async fn an_asset_of_several_files_gives_each_by_name() {
    let service = Service::new();
    let parts = [("file", Some("hero.obj"), "ok"), ("a", Some("maps/\"skin\".png"), "png")];
    let made = service.send(form("/v1/assets", &[], &parts[..1])).await;
    assert_eq!(made.status, 201, "{}", made.text());
    let parts = [parts[0], ("a", Some("maps/skin.png"), "png")];
    let made = service.send(form("/v1/assets", &[], &parts)).await;
    assert_eq!(made.json()["files"][1]["name"], "maps/skin.png");
    let content = made.json()["links"]["content"].as_str().expect("a link").to_owned();
    let problem = service.get(&content).await.refused(400, "invalid_parameter");
    assert!(problem["detail"].as_str().is_some_and(|detail| detail.contains("maps/skin.png")));
    let skin = service.get(&format!("{content}?file=maps%2Fskin.png")).await;
    assert_eq!(
        (&skin.bytes[..], skin.header("content-disposition")),
        (&b"png"[..], "attachment; filename=\"skin.png\"")
    );
    service.get(&format!("{content}?file=other.png")).await.refused(404, "not_found");
    let with_options = [parts[0], ("detail", None, "0.5")];
    service.send(form("/v1/assets", &[], &with_options)).await.refused(400, "unknown_field");
    service.send(request("POST", "/v1/assets", &[JSON], "{}")).await.refused(415, "unsupported_media_type");
    service.send(request("POST", "/v1/assets?detail=1", &[OBJ], "ok")).await.refused(400, "unknown_field");
}

#[tokio::test]
async fn an_asset_is_rigged_and_checked_by_its_id() {
    let service = Service::new();
    let asset = upload(&service, "ok").await.json()["id"].clone();
    let body =
        json!({"asset": asset, "detail": 0.75, "labels": {"project": "x"}, "priority": "high", "timeout_seconds": 60});
    let done = create(&service, &[("prefer", "wait=10")], &body).await;
    assert_eq!(done.status, 200, "{}", done.text());
    let job = done.json();
    assert_eq!((&job["state"], &job["asset"]), (&json!("succeeded"), &asset));
    assert_eq!(job["request"]["detail"], 0.75);
    assert_eq!((&job["request"]["priority"], &job["request"]["timeout_seconds"]), (&json!("high"), &json!(60)));
    assert_eq!(job["request"]["labels"], json!({"project": "x"}));
    let check = service.send(request("POST", "/v1/rigs:check", &[JSON], &json!({"asset": asset}).to_string())).await;
    assert_eq!(check.json()["riggable"], "yes");
    let inline = json!({"inline": {"media_type": "model/obj", "base64": BASE64_STANDARD.encode("ok")}});
    let done = create(&service, &[("prefer", "wait=10")], &json!({"asset": inline})).await;
    assert_eq!(done.json()["state"], "succeeded", "{}", done.text());
}

#[tokio::test]
async fn what_json_asks_for_in_vain_is_refused_by_name() {
    let service = Service::new();
    let asset = upload(&service, "ok").await.json()["id"].clone();
    let unknown = "ast_00000000000000000000000000";
    for (body, status, code, said) in [
        (json!({}), 400, "invalid_parameter", "asset: is missing"),
        (json!({"asset": 3}), 400, "invalid_parameter", "neither"),
        (json!({"asset": unknown}), 404, "not_found", "asset"),
        (json!({"asset": "nonsense"}), 404, "not_found", "asset"),
        (json!({"asset": {"url": "https://example.com/a.glb"}}), 400, "invalid_parameter", "fetches nothing"),
        (json!({"asset": {"inline": {"media_type": "model/obj", "base64": "%"}}}), 400, "invalid_parameter", "base64"),
        (
            json!({"asset": {"inline": {"media_type": "image/png", "base64": "b2s="}}}),
            415,
            "unsupported_media_type",
            "png",
        ),
        (json!({"asset": asset, "priorty": "low"}), 400, "unknown_field", "did you mean priority?"),
        (json!({"asset": asset, "fallback": []}), 400, "unknown_field", "not supported by this version"),
        (json!({"asset": asset, "webhook": {}}), 400, "invalid_parameter", "has no url"),
        (json!({"asset": asset, "detail": 2}), 400, "invalid_parameter", "detail"),
        (json!({"asset": asset, "timeout_seconds": 9999}), 400, "invalid_parameter", "300"),
        (json!([]), 400, "invalid_json", "object"),
    ] {
        let problem = create(&service, &[], &body).await.refused(status, code);
        assert!(problem["detail"].as_str().is_some_and(|detail| detail.contains(said)), "{body}: {problem:#}");
    }
    service.send(request("POST", "/v1/rigs", &[JSON], "{")).await.refused(400, "invalid_json");
    let huge = json!({"asset": "x".repeat(7 << 20)});
    create(&service, &[], &huge).await.refused(413, "too_large");
}

#[tokio::test]
async fn the_same_key_is_the_same_job_and_another_request_under_it_is_refused() {
    let service = Service::new();
    let key = [("idempotency-key", "k-1")];
    let first = service.rig("?seed=1", &key, "sleep 300").await;
    assert_eq!((first.status.as_u16(), first.header("idempotency-replayed")), (202, ""));
    let again = service.rig("?seed=1", &key, "sleep 300").await;
    assert_eq!((again.status.as_u16(), again.header("idempotency-replayed")), (200, "true"));
    assert_eq!(again.json()["id"], first.json()["id"]);
    service.rig("?seed=2", &key, "sleep 300").await.refused(422, "idempotency_mismatch");
    service.rig("?seed=1", &key, "ok").await.refused(422, "idempotency_mismatch");
    service.rig("", &[("idempotency-key", &"k".repeat(256))], "ok").await.refused(400, "invalid_parameter");
    assert_eq!(service.get("/v1/rigs").await.json()["data"].as_array().map(Vec::len), Some(1));
    let keep = |script: &'static str| request("POST", "/v1/assets", &[OBJ, ("idempotency-key", "a-1")], script);
    let made = service.send(keep("ok")).await;
    let again = service.send(keep("ok")).await;
    assert_eq!((made.status.as_u16(), again.status.as_u16()), (201, 200));
    assert_eq!((&again.json()["id"], again.header("idempotency-replayed")), (&made.json()["id"], "true"));
    service.send(keep("other")).await.refused(422, "idempotency_mismatch");
    assert_eq!(service.send(request("DELETE", made.header("location"), &[], "")).await.status, 204);
    let anew = service.send(keep("ok")).await;
    assert_eq!((anew.status.as_u16(), anew.header("idempotency-replayed")), (201, ""), "what is gone is made again");
    assert_eq!(service.send(keep("ok")).await.json()["id"], anew.json()["id"]);
}

#[tokio::test]
async fn a_rig_under_an_id_of_the_caller_is_made_once_and_found_by_it() {
    let service = Service::new();
    let put =
        |id: &str, query: &str| request("PUT", &format!("/v1/rigs/{id}{query}"), &[OBJ, ("prefer", "wait=10")], "ok");
    let made = service.send(put("hero-v3", "?detail=0.7")).await;
    assert_eq!((made.status.as_u16(), &made.json()["client_id"]), (200, &json!("hero-v3")));
    let again = service.send(put("hero-v3", "?detail=0.7")).await;
    assert_eq!((again.status.as_u16(), again.header("idempotency-replayed")), (200, "true"));
    assert_eq!(again.json()["id"], made.json()["id"]);
    service.send(put("hero-v3", "?detail=0.1")).await.refused(409, "conflict");
    assert_eq!(service.get("/v1/rigs/hero-v3").await.json()["id"], made.json()["id"]);
    assert_eq!(service.get("/v1/rigs/hero-v3/artifacts").await.json()["data"].as_array().map(Vec::len), Some(2));
    assert!(service.get("/v1/rigs/hero-v3/events").await.text().contains("event: done"));
    for id in ["rig_mine", "a%20b", &"x".repeat(65), "a:b"] {
        service.send(put(id, "")).await.refused(400, "invalid_parameter");
    }
    assert_eq!(service.send(request("DELETE", "/v1/rigs/hero-v3", &[], "")).await.status, 204);
    service.get("/v1/rigs/hero-v3").await.refused(404, "not_found");
}

#[tokio::test]
async fn an_equal_request_is_answered_at_once_unless_the_caller_says_no() {
    let service = Service::new();
    let ask = |fields: &[(&str, &str)]| {
        let mut all = vec![OBJ, ("prefer", "wait=10")];
        all.extend(fields);
        request("POST", "/v1/rigs", &all, "ok")
    };
    let first = service.send(ask(&[])).await.json();
    let second = service.send(ask(&[("prefer", "wait=0")])).await;
    assert_eq!(second.status, 200, "there is nothing to wait for");
    let second = second.json();
    assert_eq!((&first["provenance"]["cached"], &second["provenance"]["cached"]), (&json!(false), &json!(true)));
    assert_ne!(first["id"], second["id"]);
    assert_eq!(first["result"]["artifacts"][0]["sha256"], second["result"]["artifacts"][0]["sha256"]);
    let third = service.send(ask(&[("cache-control", "no-cache")])).await.json();
    assert_eq!(third["provenance"]["cached"], false);
    assert_eq!(service.rigger.seen.lock().expect("not poisoned").len(), 2);
}

#[tokio::test]
async fn rigs_are_found_by_their_labels() {
    let service = Service::new();
    for labels in ["project=knights,shot=1", "project=dragons", "project=knights,shot=2"] {
        assert_eq!(service.rig(&format!("?labels={labels}"), &[], "ok").await.status, 202);
    }
    let found = |path: &'static str| {
        let service = &service;
        async move { service.get(path).await.json()["data"].as_array().expect("data").len() }
    };
    assert_eq!(found("/v1/rigs").await, 3);
    assert_eq!(found("/v1/rigs?label=project=knights").await, 2);
    assert_eq!(found("/v1/rigs?label=shot=2").await, 1);
    assert_eq!(found("/v1/rigs?label=project=none").await, 0);
    service.get("/v1/rigs?label=project").await.refused(400, "invalid_parameter");
    let page = service.get("/v1/rigs?label=project=knights&page_size=1").await.json();
    let token = page["next_page_token"].as_str().expect("a token");
    let other_list = service.get(&format!("/v1/rigs?label=shot=2&page_token={token}")).await;
    other_list.refused(400, "invalid_parameter");
}

#[tokio::test]
async fn an_asset_tells_what_it_holds_and_is_looked_at_once() {
    let service = Service::new();
    let made = upload(&service, "ok").await.json();
    assert_eq!((&made["mesh"]["faces"], &made["existing"]["morph_targets"]), (&json!(12), &json!(0)));
    let finding =
        json!({"code": "scripted", "severity": "warning", "message": "this is a test", "hint": "", "where": ["Hat"]});
    assert_eq!(made["findings"], json!([finding]));
    let path = made["links"]["self"].as_str().expect("a link");
    assert_eq!(service.get(path).await.json(), made);
    assert_eq!(upload(&service, "ok").await.json()["mesh"], made["mesh"]);
    assert_eq!(service.rigger.checks.load(Ordering::SeqCst), 1);
}

#[tokio::test]
async fn what_cannot_be_read_is_kept_and_says_why() {
    let service = Service::new();
    let asset = upload(&service, "fail no_geometry").await;
    assert_eq!((asset.status.as_u16(), &asset.json()["mesh"]), (201, &Value::Null));
    let finding = &asset.json()["findings"][0];
    assert_eq!((&finding["code"], &finding["severity"]), (&json!("no_geometry"), &json!("error")));
    let again = service.get(&format!("/v1/assets/{}", asset.json()["id"].as_str().expect("an id"))).await;
    assert_eq!((again.status.as_u16(), &again.json()["findings"]), (200, &asset.json()["findings"]));
}

#[tokio::test]
async fn a_check_that_needs_more_memory_than_there_is_is_refused_and_an_asset_says_so() {
    let service = Service::with(|settings, _| settings.memory_bytes_max = Some(1 << 20));
    assert_eq!(upload(&service, "ok").await.json()["findings"][0]["code"], "out_of_memory");
    service.send(request("POST", "/v1/rigs:check", &[OBJ], "ok")).await.refused(413, "out_of_memory");
}

#[tokio::test]
async fn another_engine_version_gives_no_earlier_result() {
    let service = Service::new();
    let rig = async || {
        let done = service.send(request("POST", "/v1/rigs", &[OBJ, ("prefer", "wait=10")], "ok")).await.json();
        assert_eq!(done["state"], "succeeded", "{done}");
        done["provenance"]["cached"].as_bool()
    };
    assert_eq!((rig().await, rig().await), (Some(false), Some(true)));
    "2".clone_into(&mut service.rigger.engine_version.lock().expect("not poisoned"));
    assert_eq!((rig().await, rig().await), (Some(false), Some(true)));
}
