//! Keys: who may ask, and how often.

use super::scripted::{Service, request};
use rigsmith::server::app;
use rigsmith::server::keys::{self, Keys, Quota};

struct Locked {
    service: Service,
    key: String,
    other: String,
    _folder: tempfile::TempDir,
}

/// A service that asks for keys, and two callers' keys.
fn locked(quota: Quota) -> Locked {
    let mut service = Service::new();
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("keys.toml");
    let key = keys::add(&path, "studio", None, None).expect("a key");
    let other = keys::add(&path, "farm", Some(5), None).expect("a key");
    service.state = service.state.clone().with_keys(Keys::open(&path, quota).expect("keys"));
    service.router = app(service.state.clone());
    Locked { service, key, other, _folder: folder }
}

const QUOTA: Quota = Quota { requests_per_minute: 100, jobs: 4 };

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
    assert_eq!(done.header("ratelimit-policy"), "\"requests\";q=100;w=60");
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
    let locked = locked(Quota { requests_per_minute: 100, jobs: 2 });
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
