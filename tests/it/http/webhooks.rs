//! Webhooks from end to end: a service that sends, an endpoint that answers, and a clock that goes when it is told to.

use super::receiver::{Receiver, Reply};
use super::scripted::{Answer, Scripted, Service, request};
use super::socket::{Running, start};
use axum::http::HeaderMap;
use rigsmith::jobs::clock::{ManualClock, Timestamp};
use rigsmith::jobs::store::LEASE;
use rigsmith::jobs::store::sqlite::SqliteStore;
use rigsmith::jobs::webhooks::{ENDPOINTS_MAX, SCHEDULE};
use rigsmith::jobs::{Jobs, Settings};
use rigsmith::outgoing::{Names, Outgoing, OutgoingError};
use rigsmith::server::keys::{self, Keys, OwnQuota, Quota};
use rigsmith::server::{App, Limits, app};
use rigsmith::storage::Store;
use serde_json::{Value, json};
use std::future::Future;
use std::io;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};
use tempfile::TempDir;

const ENDPOINTS: &str = "/v1/webhook-endpoints";
const JSON: (&str, &str) = ("content-type", "application/json");
/// Longer than anybody waits for an answer.
const LONG: Duration = Duration::from_secs(600);

/// `hooks.test` is on loopback, `inside.test` in a private network.
struct Book;

impl Names for Book {
    fn resolve(&self, name: &str) -> Pin<Box<dyn Future<Output = io::Result<Vec<IpAddr>>> + Send>> {
        let address = if name == "hooks.test" { "127.0.0.1" } else { "10.1.2.3" };
        Box::pin(async move { Ok(vec![address.parse().expect("an address")]) })
    }
}

/// A service that sends to `hooks.test`, and its clock.
async fn sending() -> (Service, Arc<ManualClock>) {
    let folder = TempDir::new().expect("folder");
    let rigger = Arc::new(Scripted::default());
    let clock = Arc::new(ManualClock::at(Timestamp::from(SystemTime::now())));
    let store = Store::open(folder.path(), 1 << 30).expect("store");
    let written = SqliteStore::open(&folder.path().join("jobs.db"), clock.clone(), LEASE).await.expect("opens");
    let settings = Settings { workers: 1, ..Settings::default() };
    let jobs = Jobs::start_on(rigger.clone(), store, Arc::new(written), settings).expect("workers");
    let outgoing = Outgoing::new(Arc::new(Book), &["hooks.test".to_owned()]).expect("a client");
    let state = App::new(jobs, Limits::default()).with_outgoing(outgoing);
    (Service { router: app(state.clone()), rigger, state, folder }, clock)
}

async fn running() -> (Service, Arc<ManualClock>, Running) {
    let (service, clock) = sending().await;
    let running = start(&service).await;
    (service, clock, running)
}

async fn post(service: &Service, path: &str, body: Value) -> Answer {
    service.send(request("POST", path, &[JSON], &body.to_string())).await
}

/// An endpoint at `url` that wants `events`.
async fn endpoint(service: &Service, url: &str, events: &[&str]) -> Value {
    let made = post(service, ENDPOINTS, json!({"url": url, "events": events})).await;
    assert_eq!(made.status, 201, "{}", made.text());
    made.json()
}

fn path(endpoint: &Value) -> &str {
    endpoint["links"]["self"].as_str().expect("a link")
}

/// Waits until the newest delivery of an endpoint has been tried `attempts` times.
async fn tried(service: &Service, endpoint: &Value, attempts: usize) -> Value {
    for _ in 0..1000 {
        let deliveries = service.get(&format!("{}/deliveries", path(endpoint))).await.json();
        let newest = &deliveries["data"][0];
        if newest["attempts"].as_array().map_or(0, Vec::len) >= attempts {
            return newest.clone();
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    panic!("not tried {attempts} times: {}", service.get(&format!("{}/deliveries", path(endpoint))).await.text());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_happens_to_a_rig_is_told_in_signed_messages() {
    let receiver = Receiver::start().await;
    let (service, _, _running) = running().await;
    let made =
        endpoint(&service, &receiver.url(), &["rig.started", "rig.succeeded", "rig.failed", "rig.canceled"]).await;
    let secret = made["secret"].as_str().expect("a secret");
    assert!(secret.starts_with("whsec_") && secret.len() == "whsec_".len() + 44);
    let job = service.finished("ok").await;
    service.finished("fail no_joints_found").await;
    let mut received = receiver.has(4).await;
    received.sort_by_key(|message| message.header("webhook-id").to_owned());
    let types: Vec<Value> = received.iter().map(|message| message.json()["type"].clone()).collect();
    assert_eq!(types, ["rig.started", "rig.succeeded", "rig.started", "rig.failed"]);
    for message in &received {
        assert!(message.is_signed_by(secret), "{message:?}");
        assert!(!message.is_signed_by("whsec_AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA="));
        assert_eq!(message.header("content-type"), "application/json");
        assert!(message.header("webhook-id").starts_with("evt_"));
        let sent: u64 = message.header("webhook-timestamp").parse().expect("seconds");
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).expect("after 1970").as_secs();
        assert!(now.abs_diff(sent) < 60);
        let members: Vec<String> = message.json().as_object().expect("an object").keys().cloned().collect();
        assert_eq!(members, ["type", "timestamp", "sequence", "data"]);
    }
    let (started, done) = (received[0].json(), received[1].json());
    assert_eq!((&started["data"]["state"], &started["data"]["result"]), (&json!("running"), &Value::Null));
    assert_eq!(done["data"], job, "the rig as it is seen everywhere");
    assert!(started["sequence"].as_u64() < done["sequence"].as_u64());
    assert_eq!(received[3].json()["data"]["error"]["code"], "no_joints_found");
    let delivered = tried(&service, &made, 1).await;
    assert_eq!((&delivered["state"], &delivered["next_attempt_at"]), (&json!("delivered"), &Value::Null));
    assert_eq!((&delivered["attempts"][0]["status"], &delivered["attempts"][0]["error"]), (&json!(204), &Value::Null));
    assert_eq!(delivered["id"], received[3].header("webhook-id"));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_end_of_a_batch_is_told() {
    let receiver = Receiver::start().await;
    let (service, _, _running) = running().await;
    endpoint(&service, &receiver.url(), &["batch.completed"]).await;
    let asset = service.send(request("POST", "/v1/assets", &[("content-type", "model/obj")], "ok")).await.json();
    let item = json!({"custom_id": "a", "request": {"asset": asset["id"]}});
    let batch = post(&service, "/v1/batches", json!({"items": [item]})).await.json();
    let told = receiver.has(1).await[0].json();
    assert_eq!((&told["type"], &told["data"]["id"]), (&json!("batch.completed"), &batch["id"]));
    assert_eq!((&told["data"]["state"], &told["data"]["counts"]["succeeded"]), (&json!("completed"), &json!(1)));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_message_that_is_not_taken_comes_again_by_the_schedule_with_the_same_id_and_body() {
    let receiver = Receiver::start().await;
    let (service, clock, _running) = running().await;
    let made = endpoint(&service, &receiver.url(), &["rig.succeeded"]).await;
    receiver
        .answers([500, 404, 301].map(|status| Reply { location: Some("http://hooks.test/"), ..Reply::with(status) }));
    service.finished("ok").await;
    for (attempts, pause) in SCHEDULE.iter().enumerate().take(5).skip(1) {
        let seen = tried(&service, &made, attempts).await;
        assert_eq!(seen["state"], if attempts == 4 { "delivered" } else { "pending" }, "{seen:#}");
        clock.advance(pause.mul_f64(1.3));
    }
    let received = receiver.has(4).await;
    let ids: Vec<&str> = received.iter().map(|message| message.header("webhook-id")).collect();
    assert_eq!(ids, [ids[0]; 4]);
    assert!(received.iter().all(|message| message.body == received[0].body));
    let seen = tried(&service, &made, 4).await;
    let log: Vec<(&Value, &str)> = seen["attempts"]
        .as_array()
        .expect("a log")
        .iter()
        .map(|attempt| (&attempt["status"], attempt["error"].as_str().unwrap_or("")))
        .collect();
    let redirected = "it answered 301, and redirects are not followed";
    let (a, b, c, d) = (json!(500), json!(404), json!(301), json!(204));
    assert_eq!(log, [(&a, "it answered 500"), (&b, "it answered 404"), (&c, redirected), (&d, "")]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_endpoint_is_heard_when_it_wants_rest_or_is_gone() {
    let receiver = Receiver::start().await;
    let (service, clock, _running) = running().await;
    let made = endpoint(&service, &receiver.url(), &["rig.succeeded"]).await;
    let date: &'static str = httpdate::fmt_http_date(SystemTime::now() + Duration::from_secs(3600)).leak();
    let asks = |status, retry_after| Reply { retry_after: Some(retry_after), ..Reply::with(status) };
    receiver.answers([asks(429, "120"), asks(503, date), Reply::with(410)]);
    service.finished("ok").await;
    for (attempts, (too_soon, rest)) in [(1, (100, 21)), (2, (3400, 300))] {
        tried(&service, &made, attempts).await;
        clock.advance(Duration::from_secs(too_soon));
        // Long enough to be looked at.
        tokio::time::sleep(Duration::from_millis(1200)).await;
        receiver.has(attempts).await;
        clock.advance(Duration::from_secs(rest));
    }
    let gone = tried(&service, &made, 3).await;
    assert_eq!(gone["state"], "failed");
    let seen = service.get(path(&made)).await.json();
    assert_eq!((&seen["enabled"], &seen["disabled_reason"]), (&json!(false), &json!("it answered 410 (Gone)")));
    post(&service, &format!("{}:test", path(&made)), json!({})).await.refused(409, "conflict");
    let enabled = service.send(request("PATCH", path(&made), &[JSON], r#"{"enabled": true}"#)).await;
    assert_eq!((enabled.status.as_u16(), &enabled.json()["disabled_reason"]), (200, &Value::Null));
    let again = service.send(request("POST", gone["links"]["redeliver"].as_str().expect("a link"), &[], "")).await;
    assert_eq!((again.status.as_u16(), &again.json()["state"]), (202, &json!("pending")));
    assert_eq!(tried(&service, &made, 4).await["state"], "delivered");
    let received = receiver.has(4).await;
    assert_eq!(received[3].header("webhook-id"), received[0].header("webhook-id"));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_slow_endpoint_holds_up_neither_others_nor_the_stop() {
    let (slow, quick) = (Receiver::start().await, Receiver::start().await);
    let (service, _, mut running) = running().await;
    let slowly = endpoint(&service, &slow.url(), &["rig.succeeded"]).await;
    let quickly = endpoint(&service, &quick.url(), &["rig.succeeded"]).await;
    slow.answers([Reply { after: LONG, ..Reply::with(200) }]);
    service.finished("ok 1").await;
    slow.has(1).await;
    let began = Instant::now();
    service.finished("ok 2").await;
    quick.has(2).await;
    assert!(began.elapsed() < Duration::from_secs(10));
    assert_eq!(tried(&service, &quickly, 1).await["state"], "delivered");
    running.stop();
    running.ended().await;
    assert!(began.elapsed() < Duration::from_secs(30), "{:?}", began.elapsed());
    let list = service.get(&format!("{}/deliveries", path(&slowly))).await.json();
    assert!(list["data"].as_array().expect("data").iter().all(|delivery| delivery["state"] == "pending"), "{list:#}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_ends_while_the_service_stops_is_still_told() {
    let receiver = Receiver::start().await;
    let (service, _, mut running) = running().await;
    endpoint(&service, &receiver.url(), &["rig.succeeded"]).await;
    let job = service.rig("", &[], "sleep 1000").await.json();
    service.until(job["links"]["self"].as_str().expect("a link"), "running").await;
    running.stop();
    running.ended().await;
    assert_eq!(receiver.has(1).await[0].json()["data"]["id"], job["id"]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_secret_is_shown_when_it_is_made_and_both_sign_while_it_is_replaced() {
    let receiver = Receiver::start().await;
    let (service, clock, _running) = running().await;
    let made = endpoint(&service, &receiver.url(), &["rig.failed"]).await;
    let first = made["secret"].as_str().expect("a secret");
    let rotated = post(&service, &format!("{}:rotate-secret", path(&made)), json!({})).await;
    assert_eq!(rotated.header("cache-control"), "no-store");
    let rotated = rotated.json();
    let second = rotated["secret"].as_str().expect("a secret");
    assert_ne!(first, second);
    for shown in [service.get(path(&made)).await, service.get(ENDPOINTS).await] {
        assert!(!shown.text().contains("whsec_"), "{}", shown.text());
    }
    for signs in [[true, true], [false, true]] {
        let delivery = post(&service, &format!("{}:test", path(&made)), json!({})).await;
        assert_eq!(delivery.status, 202, "{}", delivery.text());
        let count = if signs[0] { 1 } else { 2 };
        let message = receiver.has(count).await.remove(count - 1);
        assert_eq!([first, second].map(|secret| message.is_signed_by(secret)), signs);
        assert_eq!(message.json()["type"], "webhook.test");
        assert_eq!(message.json()["data"], json!({"object": "webhook_test", "endpoint": made["id"]}));
        tried(&service, &made, 1).await;
        clock.advance(Duration::from_secs(24 * 3600));
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_rig_is_told_of_where_its_request_says() {
    let receiver = Receiver::start().await;
    let (service, _, _running) = running().await;
    let url = receiver.url();
    let rig = async |query: &str| service.rig(query, &[("prefer", "wait=10")], "ok").await;
    let query = format!("?webhook={url}");
    let problem = rig(&query).await.refused(409, "conflict");
    assert!(problem["hint"].as_str().is_some_and(|hint| hint.contains("/v1/webhook-endpoints")), "{problem:#}");
    let made = post(&service, ENDPOINTS, json!({})).await;
    assert_eq!((made.status.as_u16(), &made.json()["url"], &made.json()["events"]), (201, &Value::Null, &json!([])));
    let made = made.json();
    let problem = rig("?webhook=https://10.0.0.1/").await.refused(400, "invalid_parameter");
    assert_eq!(problem["errors"][0]["field"], "webhook.url", "{problem:#}");
    let job = rig(&query).await.json();
    let all = json!(["rig.started", "rig.succeeded", "rig.failed", "rig.canceled"]);
    assert_eq!(job["request"]["webhook"], json!({"url": url, "events": all}));
    rig("").await;
    let mut received = receiver.has(2).await;
    received.sort_by_key(|message| message.header("webhook-id").to_owned());
    for (message, kind) in received.iter().zip(["rig.started", "rig.succeeded"]) {
        assert_eq!((&message.json()["type"], &message.json()["data"]["id"]), (&json!(kind), &job["id"]));
        assert!(message.is_signed_by(made["secret"].as_str().expect("a secret")));
    }
    assert_eq!(tried(&service, &made, 1).await["state"], "delivered", "it stands in the log of what signs it");
    // Items of batches and reskinned rigs say so too.
    let asset = service.send(request("POST", "/v1/assets", &[("content-type", "model/obj")], "ok")).await.json();
    let wanted = json!({"asset": asset["id"], "webhook": {"url": url, "events": ["rig.succeeded"]}});
    let batch = json!({"items": [{"custom_id": "a", "request": wanted}]});
    assert_eq!(post(&service, "/v1/batches", batch).await.status, 202);
    receiver.has(3).await;
    let skeleton =
        r#"{"format": "rigsmith.rig/1", "joints": [{"name": "hips", "parent": null, "position": [0, 1, 0]}]}"#;
    let reskin = format!("/v1/rigs/{}:reskin?webhook={url}", job["id"].as_str().expect("an id"));
    let reskinned = service.send(request("POST", &reskin, &[JSON], skeleton)).await;
    assert_eq!(reskinned.status, 202, "{}", reskinned.text());
    receiver.has(5).await;
    // It is there for that, and for nothing else.
    post(&service, ENDPOINTS, json!({})).await.refused(409, "conflict");
    post(&service, &format!("{}:test", path(&made)), json!({})).await.refused(409, "conflict");
    for change in [json!({"url": url}), json!({"events": ["rig.failed"]})] {
        service.send(request("PATCH", path(&made), &[JSON], &change.to_string())).await.refused(409, "conflict");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_leads_inside_is_refused_when_it_is_said_or_when_it_is_sent() {
    let (service, _, _running) = running().await;
    for url in ["https://10.1.2.3/", "https://[::1]/", "http://example.com/", "ftp://hooks.test/", "hooks", ""] {
        let refused = post(&service, ENDPOINTS, json!({"url": url})).await;
        let problem = refused.refused(400, "invalid_parameter");
        assert_eq!(problem["errors"][0]["field"], "url", "{problem:#}");
    }
    // A name is looked up when something is sent.
    let made = endpoint(&service, "https://inside.test/hooks", &["rig.failed"]).await;
    post(&service, &format!("{}:test", path(&made)), json!({})).await;
    let failed = tried(&service, &made, 1).await;
    assert_eq!((&failed["state"], &failed["attempts"][0]["status"]), (&json!("failed"), &Value::Null));
    assert_eq!(failed["attempts"][0]["error"], "inside.test does not lead to the public internet");
    assert!(!service.get(path(&made)).await.json()["failing_since"].is_null());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn only_the_head_of_an_answer_is_awaited_and_not_for_long() {
    let receiver = Receiver::start().await;
    let outgoing = Outgoing::new(Arc::new(Book), &["hooks.test".to_owned()]).expect("a client");
    let told = async |time| outgoing.post(&receiver.url(), HeaderMap::new(), "{}".into(), time).await;
    receiver.answers([Reply { endless: true, ..Reply::with(200) }, Reply { after: LONG, ..Reply::with(200) }]);
    let began = Instant::now();
    assert_eq!(told(LONG).await.expect("a head").status().as_u16(), 200);
    assert!(matches!(told(Duration::from_millis(300)).await, Err(OutgoingError::Late(_))));
    assert!(began.elapsed() < LONG / 2, "{:?}", began.elapsed());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn without_the_operators_word_nothing_is_sent() {
    let service = Service::new();
    let refused = post(&service, ENDPOINTS, json!({"url": "https://example.com/"})).await;
    let problem = refused.refused(409, "conflict");
    assert!(problem["hint"].as_str().is_some_and(|hint| hint.contains("--outgoing")), "{problem:#}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn endpoints_are_made_changed_listed_and_deleted_as_they_are_described() {
    let (service, _) = sending().await;
    for (body, field) in [
        (json!({"events": ["rig.failed"]}), "events"),
        (json!({"url": 5}), "url"),
        (json!({"url": "https://a.example/", "events": []}), "events"),
        (json!({"url": "https://a.example/", "events": ["rig.exploded"]}), "events"),
        (json!({"url": "https://a.example/", "events": ["webhook.test"]}), "events"),
        (json!({"url": "https://a.example/", "description": "x".repeat(257)}), "description"),
    ] {
        let problem = post(&service, ENDPOINTS, body).await.refused(400, "invalid_parameter");
        assert_eq!(problem["errors"][0]["field"], field, "{problem:#}");
    }
    post(&service, ENDPOINTS, json!({"url": "https://a.example/", "enabled": true}))
        .await
        .refused(400, "unknown_field");
    service.send(request("POST", ENDPOINTS, &[JSON], "[]")).await.refused(400, "invalid_json");
    let keyed = || request("POST", ENDPOINTS, &[JSON, ("idempotency-key", "k")], r#"{"url": "https://a.example/"}"#);
    let (made, again) = (service.send(keyed()).await, service.send(keyed()).await);
    assert_eq!((made.header("location"), again.header("idempotency-replayed")), (path(&made.json()), "true"));
    assert_eq!(made.json(), again.json(), "with its secret");
    assert_eq!(service.send(request("DELETE", path(&made.json()), &[], "")).await.status, 204);
    let made = service.send(keyed()).await;
    assert_eq!((made.status.as_u16(), made.header("idempotency-replayed")), (201, ""), "what is gone is made again");
    let nul = json!({"url": "https://a.example/\u{0}"});
    post(&service, ENDPOINTS, nul).await.refused(400, "invalid_parameter");
    assert_eq!(made.json()["events"].as_array().map(Vec::len), Some(5), "everything unless said");
    let made = made.json();
    let change = |body: Value| {
        let request = request("PATCH", path(&made), &[JSON], &body.to_string());
        service.send(request)
    };
    let changed =
        change(json!({"events": ["rig.failed", "rig.failed"], "description": "mine", "enabled": false})).await;
    let changed = changed.json();
    assert_eq!((&changed["events"], &changed["description"]), (&json!(["rig.failed"]), &json!("mine")));
    assert_eq!((&changed["enabled"], &changed["url"]), (&json!(false), &json!("https://a.example/")));
    change(json!({"secret": "whsec_"})).await.refused(400, "unknown_field");
    change(json!({"enabled": "yes"})).await.refused(400, "invalid_parameter");
    change(json!({"url": "https://127.0.0.1/"})).await.refused(400, "invalid_parameter");
    for _ in 1..ENDPOINTS_MAX {
        endpoint(&service, "https://b.example/", &["rig.failed"]).await;
    }
    post(&service, ENDPOINTS, json!({"url": "https://c.example/"})).await.refused(409, "conflict");
    let listed = service.get(ENDPOINTS).await.json();
    assert_eq!((listed["data"].as_array().map(Vec::len), &listed["data"][0]), (Some(ENDPOINTS_MAX), &changed));
    assert_eq!(service.send(request("DELETE", path(&made), &[], "")).await.status, 204);
    for gone in [
        service.get(path(&made)).await,
        service.send(request("DELETE", path(&made), &[], "")).await,
        change(json!({})).await,
        post(&service, &format!("{}:test", path(&made)), json!({})).await,
        post(&service, &format!("{}:rotate-secret", path(&made)), json!({})).await,
        service.get(&format!("{}/deliveries", path(&made))).await,
        service.get(&format!("{ENDPOINTS}/whe_1")).await,
        service.get(&format!("{}/deliveries/evt_1", path(&listed["data"][1]))).await,
        post(&service, &format!("{}:explode", path(&listed["data"][1])), json!({})).await,
    ] {
        gone.refused(404, "not_found");
    }
    post(&service, path(&listed["data"][1]), json!({})).await.refused(405, "method_not_allowed");
    let list = format!("{}/deliveries", path(&listed["data"][1]));
    for query in ["state=lost", "page_size=0", "page_token=x"] {
        service.get(&format!("{list}?{query}")).await.refused(400, "invalid_parameter");
    }
    service.get(&format!("{list}?colour=red")).await.refused(400, "unknown_field");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn deliveries_are_listed_page_by_page_and_each_callers_own() {
    let receiver = Receiver::start().await;
    let (mut service, _) = sending().await;
    let keys_file = service.folder.path().join("keys.toml");
    let [alice, bob] = ["alice", "bob"].map(|name| {
        let key = keys::add(&keys_file, name, OwnQuota::default()).expect("a key");
        format!("Bearer {key}")
    });
    let quota = Quota { requests_per_minute: 10_000, jobs: 100, upload_bytes_per_hour: 1 << 30 };
    let known = Keys::open(&keys_file, quota).expect("keys");
    service.state = service.state.clone().with_keys(known).expect("a guard");
    service.router = app(service.state.clone());
    let _running = start(&service).await;
    let ask = async |key: &str, method: &str, path: &str, body: &str| {
        service.send(request(method, path, &[JSON, ("authorization", key)], body)).await
    };
    let made = ask(&alice, "POST", ENDPOINTS, &json!({"url": receiver.url()}).to_string()).await.json();
    let test = format!("{}:test", path(&made));
    for _ in 0..3 {
        assert_eq!(ask(&alice, "POST", &test, "").await.status, 202);
    }
    receiver.has(3).await;
    let list = format!("{}/deliveries", path(&made));
    let first = ask(&alice, "GET", &format!("{list}?page_size=2"), "").await.json();
    assert_eq!(first["data"].as_array().map(Vec::len), Some(2));
    let token = first["next_page_token"].as_str().expect("there is more");
    let second = ask(&alice, "GET", &format!("{list}?page_size=2&page_token={token}"), "").await.json();
    assert_eq!((second["data"].as_array().map(Vec::len), &second["next_page_token"]), (Some(1), &Value::Null));
    let delivery = second["data"][0]["links"]["self"].as_str().expect("a link");
    assert_eq!(ask(&alice, "GET", delivery, "").await.json()["id"], second["data"][0]["id"]);
    assert_eq!(ask(&bob, "GET", ENDPOINTS, "").await.json()["data"], json!([]));
    for (method, path) in [
        ("GET", path(&made)),
        ("PATCH", path(&made)),
        ("DELETE", path(&made)),
        ("POST", &test),
        ("GET", &list),
        ("GET", delivery),
        ("POST", &format!("{delivery}:redeliver")),
    ] {
        ask(&bob, method, path, "{}").await.refused(404, "not_found");
    }
    let job = service
        .send(request("POST", "/v1/rigs", &[("content-type", "model/obj"), ("authorization", &bob)], "ok"))
        .await;
    assert_eq!(job.status, 202, "{}", job.text());
    tokio::time::sleep(Duration::from_millis(1500)).await;
    receiver.has(3).await;
}
