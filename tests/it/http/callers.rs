//! Keys: who may ask, and how often.

use super::scripted::{Service, request};
use rigsmith::server::app;
use rigsmith::server::keys::{self, Keys, OwnQuota, Quota};
use serde_json::json;

struct Locked {
    service: Service,
    key: String,
    other: String,
    keys: Keys,
    folder: tempfile::TempDir,
}

/// A service that asks for keys, and two callers' keys.
fn locked(quota: Quota) -> Locked {
    let mut service = Service::new();
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("keys.toml");
    let key = keys::add(&path, "studio", OwnQuota::default()).expect("a key");
    let other =
        keys::add(&path, "farm", OwnQuota { requests_per_minute: Some(5), ..OwnQuota::default() }).expect("a key");
    let known = Keys::open(&path, quota).expect("keys");
    service.state = service.state.clone().with_keys(known.clone()).expect("a guard");
    service.router = app(service.state.clone());
    Locked { service, key, other, keys: known, folder }
}

const QUOTA: Quota = Quota { requests_per_minute: 100, jobs: 4, upload_bytes_per_hour: 36_000 };

#[tokio::test]
async fn without_a_known_key_only_pages_and_probes_answer() {
    let locked = locked(QUOTA);
    let service = &locked.service;
    for path in
        ["/", "/docs", "/livez", "/readyz", "/startupz", "/version", "/v1/openapi.json", "/v1/problems/internal"]
    {
        assert_eq!(service.get(path).await.status, 200, "{path}");
    }
    for path in ["/v1/rigs", "/v1/methods", "/v1/rigs/rig_00000000000000000000000000", "/v1/nowhere"] {
        let refused = service.get(path).await;
        assert_eq!(refused.header("www-authenticate"), "Bearer realm=\"rigsmith\"");
        assert_eq!(refused.refused(401, "unauthenticated")["retryable"], false);
    }
    let wrong = format!("Bearer {}x", locked.key);
    for field in ["Basic dXNlcjpwYXNz", "Bearer", "Bearer ", wrong.as_str()] {
        let refused = service.send(request("GET", "/v1/rigs", &[("authorization", field)], "")).await;
        let problem = refused.refused(401, "unauthenticated");
        assert!(!problem.to_string().contains(&locked.key), "a refusal repeats no key");
    }
    service.rig("", &[], "ok").await.refused(401, "unauthenticated");
    assert_eq!(service.files(), 0);
}

#[tokio::test]
async fn a_known_key_opens_and_is_told_what_is_left() {
    let locked = locked(QUOTA);
    let (service, bearer) = (&locked.service, format!("bearer {}", locked.key));
    let done = service.rig("", &[("authorization", &bearer), ("prefer", "wait=10")], "ok").await;
    assert_eq!(done.status, 200, "{}", done.text());
    let policy = "\"requests\";q=100;w=60, \"uploads\";q=36000;w=3600;qu=\"content-bytes\"";
    assert_eq!(done.header("ratelimit-policy"), policy);
    assert!(done.header("ratelimit").starts_with("\"requests\";r=99;t="), "{}", done.header("ratelimit"));
}

#[tokio::test]
async fn a_key_that_asks_too_often_is_told_when_to_come_back_and_others_are_not() {
    let locked = locked(QUOTA);
    let service = &locked.service;
    let ask = |key: &str| request("GET", "/v1/methods", &[("authorization", &format!("Bearer {key}"))], "");
    for _ in 0..5 {
        assert_eq!(service.send(ask(&locked.other)).await.status, 200);
    }
    let refused = service.send(ask(&locked.other)).await;
    let wait: u64 = refused.header("retry-after").parse().expect("seconds");
    assert!((1..=12).contains(&wait), "one request comes back every 12 seconds: {wait}");
    assert!(refused.header("ratelimit").starts_with("\"requests\";r=0;"));
    assert_eq!(refused.refused(429, "rate_limited")["retryable"], true);
    assert_eq!(service.send(ask(&locked.key)).await.status, 200);
}

#[tokio::test]
async fn what_belongs_to_one_caller_is_not_there_for_another() {
    let locked = locked(QUOTA);
    let service = &locked.service;
    let bearer = |key: &str| format!("Bearer {key}");
    let (mine, theirs) = (bearer(&locked.key), bearer(&locked.other));
    let made = service.rig("", &[("authorization", &mine), ("prefer", "wait=10")], "ok").await;
    let path = made.header("location").to_owned();
    let get = |path: &str, bearer: &str| request("GET", path, &[("authorization", bearer)], "");
    assert_eq!(service.send(get(&path, &mine)).await.status, 200);
    for path in [path.clone(), format!("{path}/events"), format!("{path}/artifacts/rigged.glb")] {
        service.send(get(&path, &theirs)).await.refused(404, "not_found");
    }
    assert_eq!(service.send(get("/v1/rigs", &theirs)).await.json()["data"], serde_json::json!([]));
}

#[tokio::test]
async fn a_caller_has_so_many_unfinished_jobs_and_no_more() {
    let locked = locked(Quota { jobs: 2, ..QUOTA });
    let (service, bearer) = (&locked.service, format!("Bearer {}", locked.key));
    for _ in 0..2 {
        assert_eq!(service.rig("", &[("authorization", &bearer)], "hang").await.status, 202);
    }
    let refused = service.rig("", &[("authorization", &bearer)], "hang").await;
    assert!(refused.header("retry-after").parse::<u64>().is_ok_and(|seconds| seconds >= 1));
    refused.refused(429, "quota_exceeded");
    let other = format!("Bearer {}", locked.other);
    assert_eq!(service.rig("", &[("authorization", &other)], "ok").await.status, 202);
}

#[tokio::test]
async fn a_key_may_send_so_many_bytes_an_hour_and_what_was_refused_does_not_count() {
    let locked = locked(Quota { upload_bytes_per_hour: 36_000, ..QUOTA });
    let (service, bearer) = (&locked.service, format!("Bearer {}", locked.key));
    let send = |length: usize| {
        let headers = [("authorization", bearer.as_str()), ("content-type", "model/obj"), ("content-length", "")];
        let (length, script) = (length.to_string(), format!("{:<length$}", "ok"));
        let mut headers = headers;
        headers[2].1 = &length;
        request("POST", "/v1/rigs?detail=0.1", &headers, &script)
    };
    let left = |answer: &super::scripted::Answer| {
        let (_, bytes) = answer.header("ratelimit").split_once("\"uploads\";r=").expect("bytes are told");
        bytes.split(';').next().expect("a number").parse::<u64>().expect("a number")
    };
    let taken = service.send(send(20_000)).await;
    assert!(taken.status.is_success(), "{}", taken.text());
    assert!((15_900..16_200).contains(&left(&taken)), "{}", taken.header("ratelimit"));
    let refused = service.send(send(20_000)).await;
    let wait: u64 = refused.header("retry-after").parse().expect("seconds");
    assert!((300..=400).contains(&wait), "ten bytes come back each second: {wait}");
    let problem = refused.refused(429, "quota_exceeded");
    assert_eq!(
        (&problem["limit"]["name"], &problem["limit"]["max"]),
        (&json!("upload_bytes_per_hour"), &json!(36_000))
    );
    assert_eq!(problem["retryable"], true);
    // Refused before it was read: what did not come is given back.
    let unread = [("authorization", bearer.as_str()), ("content-type", "text/html"), ("content-length", "9000")];
    service.send(request("POST", "/v1/rigs", &unread, "")).await.refused(415, "unsupported_media_type");
    let smaller = service.send(send(10_000)).await;
    assert!(smaller.status.is_success(), "{}", smaller.text());
    assert!((5_900..6_300).contains(&left(&smaller)), "{}", smaller.header("ratelimit"));
}

#[tokio::test]
async fn a_ticket_opens_the_events_of_its_rig_and_nothing_else() {
    let locked = locked(QUOTA);
    let service = &locked.service;
    let (mine, theirs) = (format!("Bearer {}", locked.key), format!("Bearer {}", locked.other));
    let rig = async |script: &str| {
        let done = service.rig("", &[("authorization", &mine), ("prefer", "wait=10")], script).await;
        done.header("location").to_owned()
    };
    let (path, other) = (rig("ok").await, rig("ok other").await);
    let ask = |path: &str, bearer: &str| request("POST", &format!("{path}:ticket"), &[("authorization", bearer)], "");
    service.send(ask(&path, &theirs)).await.refused(404, "not_found");
    let ticket = service.send(ask(&path, &mine)).await;
    assert_eq!((ticket.status.as_u16(), ticket.header("cache-control")), (200, "no-store"));
    let url = ticket.json()["url"].as_str().expect("a link").to_owned();
    let watched = service.get(&url).await;
    assert_eq!((watched.status.as_u16(), watched.header("content-type")), (200, "text/event-stream"));
    assert!(watched.text().contains("event: done"), "{}", watched.text());
    let (_, query) = url.split_once('?').expect("a ticket");
    for path in [format!("{other}/events"), path.clone(), format!("{path}/artifacts"), "/v1/rigs".to_owned()] {
        service.get(&format!("{path}?{query}")).await.refused(401, "unauthenticated");
    }
    service.send(request("DELETE", &format!("{path}/events?{query}"), &[], "")).await.refused(401, "unauthenticated");
    service.get(&format!("{url}x")).await.refused(401, "unauthenticated");
    let wrong = request("GET", &url, &[("authorization", "Bearer nobody")], "");
    service.send(wrong).await.refused(401, "unauthenticated");
    let keys_file = locked.folder.path().join("keys.toml");
    let id = keys::entries(&keys_file).expect("reads")[0].id.clone();
    assert!(keys::remove(&keys_file, &id).expect("writes"));
    locked.keys.refresh();
    service.get(&url).await.refused(401, "unauthenticated");
}

#[tokio::test]
async fn where_no_key_is_asked_for_a_ticket_is_the_plain_address() {
    let service = Service::new();
    let path = service.rig("", &[("prefer", "wait=10")], "ok").await.header("location").to_owned();
    let ticket = service.send(request("POST", &format!("{path}:ticket"), &[], "")).await.json();
    assert_eq!(ticket["url"], format!("{path}/events"));
    assert_eq!(service.get(&format!("{path}/events?ticket=any")).await.status, 200);
}
