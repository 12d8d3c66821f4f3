//! Many rigs at once.

use super::scripted::{Answer, Service, request};
use super::socket::{Running, start};
use rigsmith::server::app;
use rigsmith::server::keys::{self, Keys, OwnQuota, Quota};
use serde_json::{Value, json};
use std::time::Duration;

const JSON: (&str, &str) = ("content-type", "application/json");
const LINES: (&str, &str) = ("content-type", "application/jsonl");

async fn asset(service: &Service, script: &str) -> String {
    let kept = service.send(request("POST", "/v1/assets", &[("content-type", "model/obj")], script)).await.json();
    kept["id"].as_str().expect("an id").to_owned()
}

async fn create(service: &Service, batch: &Value) -> Answer {
    service.send(request("POST", "/v1/batches", &[JSON], &batch.to_string())).await
}

async fn over(service: &Service, path: &str) -> Value {
    for _ in 0..1000 {
        let batch = service.get(path).await.json();
        if !batch["finished_at"].is_null() {
            return batch;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("the batch is not over: {}", service.get(path).await.text());
}

async fn results(service: &Service, path: &str) -> Vec<Value> {
    let answer = service.get(&format!("{path}/results")).await;
    assert_eq!((answer.status.as_u16(), answer.header("content-type")), (200, "application/jsonl"));
    let text = String::from_utf8(answer.bytes).expect("text");
    text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect()
}

/// A service that feeds its queue, and how it runs.
async fn running() -> (Service, Running) {
    let service = Service::new();
    let running = start(&service).await;
    (service, running)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn items_keep_their_order_and_a_bad_one_fails_alone() {
    let (service, _running) = running().await;
    let (good, bad) = (asset(&service, "ok 1").await, asset(&service, "fail no_joints_found").await);
    let item = |name: &str, request: Value| json!({"custom_id": name, "request": request});
    let made = create(
        &service,
        &json!({"defaults": {"seed": 9, "labels": {"project": "x"}}, "items": [
            item("first", json!({"asset": good})),
            item("broken", json!({"asset": bad})),
            item("range", json!({"asset": good, "detail": 7})),
            item("nowhere", json!({"asset": "ast_00000000000000000000000000"})),
            item("urgent", json!({"asset": good, "priority": "high"})),
            item("inline", json!({"asset": {"inline": {"media_type": "model/obj", "base64": ""}}})),
            item("first", json!({"asset": good})),
            json!({"custom_id": "odd", "request": {"asset": good}, "more": 1}),
            item("last", json!({"asset": good, "seed": 10})),
        ]}),
    )
    .await;
    assert_eq!(made.status, 202, "{}", made.text());
    let path = made.header("location").to_owned();
    let batch = over(&service, &path).await;
    let counts = json!({"queued": 0, "running": 0, "succeeded": 2, "failed": 7, "canceled": 0});
    assert_eq!((&batch["state"], &batch["counts"], &batch["total"]), (&json!("completed"), &counts, &json!(9)));
    let results = results(&service, &path).await;
    let said: Vec<(&str, &str)> = results
        .iter()
        .map(|line| (line["custom_id"].as_str().expect("a name"), line["error"]["code"].as_str().unwrap_or("")))
        .collect();
    let expected = [
        ("first", ""),
        ("broken", "no_joints_found"),
        ("range", "invalid_parameter"),
        ("nowhere", "not_found"),
        ("urgent", "invalid_parameter"),
        ("inline", "invalid_parameter"),
        ("first", "invalid_parameter"),
        ("odd", "unknown_field"),
        ("last", ""),
    ];
    assert_eq!(said, expected);
    let rig = &results[0]["rig"];
    assert_eq!((&rig["request"]["seed"], &rig["request"]["priority"]), (&json!(9), &json!("low")));
    assert_eq!(results[8]["rig"]["request"]["seed"], 10);
    assert_eq!(rig["request"]["labels"]["project"], "x");
    assert!(results[1]["rig_id"].as_str().is_some_and(|id| id.starts_with("rig_")), "{:#}", results[1]);
    assert!(results[2]["error"]["message"].as_str().is_some_and(|said| said.contains("7 is outside 0 to 1")));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn lines_come_as_the_body_or_as_an_asset_and_never_fill_the_queue() {
    let service = Service::with(|settings, _| settings.queue_max = 10);
    let _running = start(&service).await;
    let meshes = [asset(&service, "sleep 10").await, asset(&service, "ok 2").await];
    let line = |number: usize| {
        let request = json!({"asset": meshes[number % 2], "seed": number});
        json!({"custom_id": format!("item {number}"), "request": request}).to_string()
    };
    let lines: Vec<String> = (0..60).map(line).collect();
    let made = service.send(request("POST", "/v1/batches", &[LINES], &lines.join("\n"))).await;
    assert_eq!(made.status, 202, "{}", made.text());
    let path = made.header("location").to_owned();
    while service.get(&path).await.json()["finished_at"].is_null() {
        let counts = service.state.jobs.counts().await.expect("counts");
        assert!(counts.queued <= 5, "half of the queue is for others: {counts:?}");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let names: Vec<Value> = results(&service, &path).await.iter().map(|line| line["custom_id"].clone()).collect();
    assert_eq!(names, (0..60).map(|number| json!(format!("item {number}"))).collect::<Vec<_>>());
    let kept = service
        .send(request(
            "POST",
            "/v1/assets?file_name=items.jsonl",
            &[("content-type", "application/octet-stream")],
            &lines[..3].join("\n"),
        ))
        .await;
    let made = create(&service, &json!({"items": kept.json()["id"], "defaults": {"detail": 0.1}})).await;
    let path = made.header("location").to_owned();
    over(&service, &path).await;
    let results = results(&service, &path).await;
    assert!(results.iter().all(|line| line["rig"]["request"]["detail"] == 0.1), "{results:#?}");
    assert_eq!(results.len(), 3);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn canceling_stops_what_waits_and_what_runs() {
    let (service, _running) = running().await;
    let hang = asset(&service, "hang").await;
    let items: Vec<Value> = (0..30)
        .map(|number| json!({"custom_id": number.to_string(), "request": {"asset": hang, "seed": number}}))
        .collect();
    let path = create(&service, &json!({"items": items})).await.header("location").to_owned();
    while service.get(&path).await.json()["counts"]["running"] != 2 {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    let canceled = service.send(request("POST", &format!("{path}:cancel"), &[], "")).await;
    assert_eq!((canceled.status.as_u16(), &canceled.json()["state"]), (200, &json!("canceled")));
    let batch = over(&service, &path).await;
    assert_eq!(batch["counts"]["canceled"], 30);
    let results = results(&service, &path).await;
    assert!(results.len() == 30 && results.iter().all(|line| line["error"]["code"] == "canceled"), "{results:#?}");
    assert!(batch["links"]["cancel"].is_null());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn batches_that_make_no_sense_are_refused_whole() {
    let service = Service::new();
    let item = json!({"custom_id": "a", "request": {"asset": "ast_00000000000000000000000000"}});
    for (batch, code) in [
        (json!({}), "invalid_parameter"),
        (json!({"items": []}), "invalid_parameter"),
        (json!({"items": 5}), "invalid_parameter"),
        (json!({"items": vec![item.clone(); 1001]}), "invalid_parameter"),
        (json!({"items": [item], "more": 1}), "unknown_field"),
        (json!({"items": [item], "defaults": {"colour": "red"}}), "unknown_field"),
        (json!({"items": [item], "defaults": {"detail": 9}}), "invalid_parameter"),
        (json!({"items": [item], "defaults": 9}), "invalid_parameter"),
    ] {
        create(&service, &batch).await.refused(400, code);
    }
    create(&service, &json!({"items": "ast_00000000000000000000000000"})).await.refused(404, "not_found");
    service.send(request("POST", "/v1/batches", &[JSON], "[")).await.refused(400, "invalid_json");
    service.send(request("POST", "/v1/batches", &[LINES], "\n\n")).await.refused(400, "invalid_parameter");
    service
        .send(request("POST", "/v1/batches", &[("content-type", "text/csv")], "a"))
        .await
        .refused(415, "unsupported_media_type");
    service.get("/v1/batches/bat_00000000000000000000000000").await.refused(404, "not_found");
    service.get("/v1/batches/rig_1/results").await.refused(404, "not_found");
    service.send(request("POST", "/v1/batches/bat_1:stop", &[], "")).await.refused(404, "not_found");
    service.send(request("POST", "/v1/batches/bat_1", &[], "")).await.refused(405, "method_not_allowed");
    service.get("/v1/batches?page_token=x").await.refused(400, "invalid_parameter");
    assert_eq!(service.get("/v1/batches").await.json()["data"], json!([]));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_batch_sent_twice_under_a_key_is_one_and_pages_list_them_all() {
    let (service, _running) = running().await;
    let mesh = asset(&service, "ok").await;
    let batch =
        |seed: u64| json!({"items": [{"custom_id": "a", "request": {"asset": mesh, "seed": seed}}]}).to_string();
    let send = async |key: &str, body: &str| {
        service.send(request("POST", "/v1/batches", &[JSON, ("idempotency-key", key)], body)).await
    };
    let first = send("k", &batch(1)).await;
    let again = send("k", &batch(1)).await;
    assert_eq!((first.header("location"), again.header("idempotency-replayed")), (again.header("location"), "true"));
    send("k", &batch(2)).await.refused(422, "idempotency_mismatch");
    let second = send("other", &batch(2)).await;
    let page = service.get("/v1/batches?page_size=1").await.json();
    assert_eq!(page["data"][0]["links"]["self"], second.header("location"));
    let token = page["next_page_token"].as_str().expect("another page");
    let rest = service.get(&format!("/v1/batches?page_size=1&page_token={token}")).await.json();
    assert_eq!(
        (&rest["data"][0]["links"]["self"], &rest["next_page_token"]),
        (&json!(first.header("location")), &Value::Null)
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_batch_has_no_more_jobs_than_its_key_may_and_is_its_callers_own() {
    let mut service = Service::new();
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("keys.toml");
    let bearer = format!(
        "Bearer {}",
        keys::add(&path, "studio", OwnQuota { jobs: Some(1), ..OwnQuota::default() }).expect("a key")
    );
    let other = format!("Bearer {}", keys::add(&path, "farm", OwnQuota::default()).expect("a key"));
    let quota = Quota { requests_per_minute: 10_000, jobs: 4, upload_bytes_per_hour: 1 << 30 };
    service.state = service.state.clone().with_keys(Keys::open(&path, quota).expect("keys")).expect("a secret");
    service.router = app(service.state.clone());
    let _running = start(&service).await;
    let mine = ("authorization", bearer.as_str());
    let kept = service.send(request("POST", "/v1/assets", &[("content-type", "model/obj"), mine], "sleep 20")).await;
    let item = |number: usize| json!({"custom_id": number.to_string(), "request": {"asset": kept.json()["id"], "seed": number}});
    let batch = json!({"items": (0..6).map(item).collect::<Vec<_>>()}).to_string();
    let made = service.send(request("POST", "/v1/batches", &[JSON, mine], &batch)).await;
    let path = made.header("location").to_owned();
    loop {
        let now = service.send(request("GET", &path, &[mine], "")).await.json();
        let counts = service.state.jobs.counts().await.expect("counts");
        assert!(counts.queued + counts.running <= 1, "{counts:?}");
        if now["state"] == "completed" {
            assert_eq!(now["counts"]["succeeded"], 6);
            break;
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let theirs = ("authorization", other.as_str());
    service.send(request("GET", &path, &[theirs], "")).await.refused(404, "not_found");
    service.send(request("GET", &format!("{path}/results"), &[theirs], "")).await.refused(404, "not_found");
    service.send(request("POST", &format!("{path}:cancel"), &[theirs], "")).await.refused(404, "not_found");
}
