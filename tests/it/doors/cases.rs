//! The table: what is asked of a service in which state, and what it must say, through either door.

use super::asks::{Ask, Create, Door, Mesh, Over, Said, create, script};
use crate::http::scripted::{Service, request};
use crate::http::socket::start;
use rigsmith::jobs::Readiness;
use rigsmith::outgoing::{Outgoing, SystemNames};
use rigsmith::server::app;
use rigsmith::server::keys::{self, Keys, OwnQuota, Quota};
use serde_json::{Value, json};
use std::sync::Arc;

const SKELETON: &str =
    r#"{"format": "rigsmith.rig/1", "joints": [{"name": "hips", "parent": null, "position": [0, 1, 0]}]}"#;
const NOBODY: &str = "rig_00000000000000000000000000";

/// What is there before anything is asked.
struct World {
    /// Has succeeded, with labels.
    done: String,
    failed: String,
    running: String,
    asset: String,
}

async fn world(service: &Service) -> World {
    let id = |job: &Value| job["id"].as_str().expect("an id").to_owned();
    let done = service.rig("?labels=project=a&seed=1", &[("prefer", "wait=10")], "ok").await.json();
    let failed = service.finished("fail no_joints_found").await;
    let running = service.rig("", &[], "hang").await.json();
    service.until(&format!("/v1/rigs/{}", id(&running)), "running").await;
    let kept = service.send(request("POST", "/v1/assets", &[("content-type", "model/obj")], "ok 7")).await.json();
    World { done: id(&done), failed: id(&failed), running: id(&running), asset: id(&kept) }
}

/// Asks through both doors of services of their own, and gives what both said.
async fn both(change: impl Fn(&mut Service), ask: impl Fn(&World) -> Vec<Ask>) -> Vec<Said> {
    let mut said = Vec::new();
    for over in [Over::Rest, Over::Grpc] {
        let mut service = Service::new();
        let world = world(&service).await;
        change(&mut service);
        // Feeds the queue with the items of batches.
        let _running = start(&service).await;
        let door = Door { service: &service, key: None, over };
        let mut answers = Vec::new();
        for ask in ask(&world) {
            answers.push((format!("{ask:?}"), door.ask(ask).await));
        }
        said.push(answers);
    }
    let grpc = said.pop().expect("two doors");
    let rest = said.pop().expect("two doors");
    for ((asked, rest), (_, grpc)) in rest.iter().zip(&grpc) {
        assert_eq!(rest, grpc, "{asked}");
    }
    rest.into_iter().map(|(_, said)| said).collect()
}

/// The same for asks that stand alone; each must give the code beside it, empty for an answer.
async fn each(cases: impl Fn(&World) -> Vec<(Ask, &'static str)>) {
    let codes = std::sync::Mutex::new(Vec::new());
    let said = both(
        |_| {},
        |world| {
            let (asks, expected): (Vec<_>, Vec<_>) = cases(world).into_iter().unzip();
            *codes.lock().expect("not poisoned") = asks.iter().map(|ask| format!("{ask:?}")).zip(expected).collect();
            asks
        },
    )
    .await;
    for (said, (asked, expected)) in said.iter().zip(codes.into_inner().expect("not poisoned")) {
        assert_eq!(said.code(), expected, "{asked}: {said:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn orders_give_the_same_rigs_and_refusals() {
    let order = |text: &str, options: Value| Ask::Create(create(text, options));
    let inline = |media_type, bytes: &[u8]| {
        Ask::Create(Create { mesh: Mesh::Inline(media_type, bytes.to_vec()), ..create("", json!({})) })
    };
    let of = |id: &str| Ask::Create(Create { mesh: Mesh::Asset(id.to_owned()), ..create("", json!({"seed": 3})) });
    let from = |url: &str| Ask::Create(Create { mesh: Mesh::Url(url.to_owned()), ..create("", json!({})) });
    let keyed = |key: &str, seed: u64| {
        Ask::Create(Create { key: Some(key.to_owned()), ..create("ok 3", json!({"seed": seed})) })
    };
    let named = |id: &str, seed: u64| {
        Ask::Create(Create { client_id: Some(id.to_owned()), ..create("ok 4", json!({"seed": seed})) })
    };
    each(|world| {
        vec![
            (order("ok 1", json!({})), ""),
            (Ask::Create(Create { no_cache: true, ..create("ok 1", json!({})) }), ""),
            (
                order(
                    "ok 2",
                    json!({"detail": 0.7, "symmetry": "off", "fingers": "on", "boxes": "off", "max_influences": 8, "smooth": 0.25, "prune": 0.01, "mirror_weights": "auto",
                "skin_fallback": ["geodesic_heat"], "non_deforming": ["IK_*"], "locked_joints": ["Head"], "seed": 5, "up": "-z",
                "existing_rig": "replace", "outputs": ["glb", "rig_json"], "priority": "low", "timeout_seconds": 20,
                "labels": {"project": "b"}}),
                ),
                "",
            ),
            (order("ok 2", json!({"bandwidth": 0.05})), ""),
            (order("fail no_joints_found", json!({})), ""),
            (order("nonsense", json!({})), ""),
            (of(&world.asset), ""),
            (of("ast_00000000000000000000000000"), "not_found"),
            (of("asset"), "not_found"),
            (from("https://example.com/a.glb"), "invalid_parameter"),
            (order("ok", json!({"detail": 2.0, "max_influences": 99})), "invalid_parameter"),
            (order("ok", json!({"smooth": -0.1, "prune": 0.7})), "invalid_parameter"),
            (order("ok", json!({"detail": 0.5, "bandwidth": 0.05})), "invalid_parameter"),
            (order("ok", json!({"outputs": ["fbx"]})), "invalid_parameter"),
            (
                order("ok", json!({"priority": "urgent", "timeout_seconds": 100_000, "labels": {"a b": "c"}})),
                "invalid_parameter",
            ),
            (order("ok", json!({"skeleton": "{}"})), "invalid_parameter"),
            (order("ok", json!({"webhook": {"url": "https://example.com/"}})), "invalid_parameter"),
            (
                order("ok", json!({"webhook": {"url": "https://example.com/", "events": ["rig.exploded"]}})),
                "invalid_parameter",
            ),
            (order("ok", json!({"method": "magic"})), "invalid_parameter"),
            (order("ok", json!({"method": "volumetric_nets"})), "model_unavailable"),
            (inline("model/obj", b""), "unreadable_mesh"),
            (inline("image/png", b"ok"), "unsupported_media_type"),
            (inline("application/octet-stream", b"\x89PNG\r\n\x1a\n0123"), "unsupported_media_type"),
            (inline("model/obj", &vec![b'v'; (4 << 20) + 1]), "too_large"),
            (keyed("once", 1), ""),
            (keyed("once", 1), ""),
            (keyed("once", 2), "idempotency_mismatch"),
            (keyed(&"k".repeat(256), 1), "invalid_parameter"),
            (named("hero-v3", 1), ""),
            (named("hero-v3", 1), ""),
            (named("hero-v3", 2), "conflict"),
            (Ask::Get("hero-v3".to_owned()), ""),
            (named("rig_mine", 1), "invalid_parameter"),
        ]
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn batches_give_the_same_results_and_refusals() {
    each(|world| {
        let of = |name, options| (name, world.asset.clone(), options);
        let two = vec![of("a", json!({"seed": 3})), of("b", json!({"seed": 4, "labels": {"project": "b"}}))];
        let more = vec![
            of("fine", json!({})),
            of("detail", json!({"detail": 9.5})),
            of("priority", json!({"priority": "high"})),
            ("gone", "ast_00000000000000000000000000".to_owned(), json!({})),
            ("asset", "no id".to_owned(), json!({})),
            of("fine", json!({})),
            of("", json!({})),
        ];
        let ask = |defaults: Value, items: &Vec<_>, key: Option<&str>| {
            Ask::Batch(defaults, items.clone(), key.map(str::to_owned))
        };
        vec![
            (ask(json!({}), &two, None), ""),
            (ask(json!({"detail": 0.2, "outputs": ["rig_json"]}), &two, Some("batch")), ""),
            (ask(json!({"outputs": ["rig_json"], "detail": 0.2}), &two, Some("batch")), ""),
            (ask(json!({"detail": 0.3}), &two, Some("batch")), "idempotency_mismatch"),
            (ask(json!({"detail": 9.5}), &two, None), "invalid_parameter"),
            (ask(json!({}), &more, None), ""),
            (ask(json!({}), &vec![], None), "invalid_parameter"),
            (ask(json!({}), &vec![two[0].clone(); 1001], None), "invalid_parameter"),
        ]
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_one_rig_wants_told_is_taken_alike() {
    let mut said = Vec::new();
    for over in [Over::Rest, Over::Grpc] {
        let mut service = Service::new();
        let outgoing = Outgoing::new(Arc::new(SystemNames), &[]).expect("a client");
        service.state = service.state.clone().with_outgoing(outgoing);
        service.router = app(service.state.clone());
        let door = Door { service: &service, key: None, over };
        let order = |url: &str| Ask::Create(create("ok", json!({"webhook": {"url": url, "events": ["rig.failed"]}})));
        let unsigned = door.ask(order("https://example.com/")).await;
        assert_eq!(unsigned.code(), "conflict", "nobody has a secret yet");
        let signs = request("POST", "/v1/webhook-endpoints", &[("content-type", "application/json")], "{}");
        assert_eq!(service.send(signs).await.status, 201);
        let inside = door.ask(order("https://10.0.0.1/")).await;
        assert_eq!(inside.code(), "invalid_parameter");
        let taken = door.ask(order("https://example.com/")).await;
        let Said::Fine(rig) = &taken else { panic!("{taken:?}") };
        assert_eq!(rig["request"]["webhook"], json!({"url": "https://example.com/", "events": ["rig.failed"]}));
        said.push([unsigned, inside, taken]);
    }
    assert_eq!(said[0], said[1]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn looks_checks_uploads_and_downloads_agree() {
    let text = |id: &str| id.to_owned();
    each(|world| {
        vec![
            (Ask::Get(world.done.clone()), ""),
            (Ask::Get(world.failed.clone()), ""),
            (Ask::Get(text(NOBODY)), "not_found"),
            (Ask::Get(text("rig_!")), "not_found"),
            (Ask::Get(text("nobody")), "not_found"),
            (Ask::List("", "", 0, ""), ""),
            (Ask::List("succeeded", "project=a", 5, ""), ""),
            (Ask::List("failed", "", 0, ""), ""),
            (Ask::List("", "project", 0, ""), "invalid_parameter"),
            (Ask::List("", "", 101, ""), "invalid_parameter"),
            (Ask::List("", "", -1, ""), "invalid_parameter"),
            (Ask::List("", "", 0, "elsewhere"), "invalid_parameter"),
            (Ask::Check(create("ok", json!({"detail": 1.0}))), ""),
            (Ask::Check(create("fail no_geometry", json!({}))), "no_geometry"),
            (Ask::Check(create("ok", json!({"detail": 9.0}))), "invalid_parameter"),
            (Ask::Check(create("panic", json!({}))), "internal"),
            (Ask::Check(Create { mesh: Mesh::Asset(world.asset.clone()), ..create("", json!({})) }), ""),
            (Ask::Upload(vec![("hero.obj", "ok 9")], None), ""),
            (Ask::Upload(vec![("hero.obj", "ok 9"), ("skin.png", "p")], None), ""),
            (Ask::Upload(vec![("hero.obj", "ok 9")], Some(text("up"))), ""),
            (Ask::Upload(vec![("hero.obj", "ok 9")], Some(text("up"))), ""),
            (Ask::Upload(vec![("hero.obj", "ok 8")], Some(text("up"))), "idempotency_mismatch"),
            (Ask::Upload(vec![("../hero.obj", "ok")], None), "invalid_parameter"),
            (Ask::Upload(vec![("hero.obj", "ok"), ("hero.obj", "ok")], None), "invalid_parameter"),
            (Ask::Upload(vec![("hero.obj", "")], None), "unreadable_mesh"),
            (Ask::Upload(vec![("hero.obj", "\u{7f}ELF and more of a program")], None), "unsupported_media_type"),
            (Ask::Download(world.done.clone(), "rigged.glb", 0), ""),
            (Ask::Download(world.done.clone(), "rigged.glb", 699_000), ""),
            (Ask::Download(world.done.clone(), "rigged.glb", 9_000_000), "range_not_satisfiable"),
            (Ask::Download(world.done.clone(), "other.glb", 0), "not_found"),
            (Ask::Download(world.running.clone(), "rigged.glb", 0), "not_found"),
            (Ask::Download(text(NOBODY), "rigged.glb", 0), "not_found"),
        ]
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn changes_agree() {
    let reskin = |id: &str, skeleton, options: Value| Ask::Reskin(id.to_owned(), skeleton, options);
    each(|world| {
        vec![
            (reskin(&world.done, SKELETON, json!({})), ""),
            (reskin(&world.done, SKELETON, json!({"detail": 0.9, "seed": 4})), ""),
            (reskin(&world.done, SKELETON, json!({"bandwidth": 0.04})), ""),
            (reskin(&world.done, SKELETON, json!({"symmetry": "maybe"})), "invalid_parameter"),
            (reskin(&world.done, SKELETON, json!({"skeleton": "{}"})), "invalid_parameter"),
            (reskin(&world.done, "{}", json!({})), "skeleton_invalid"),
            (reskin(NOBODY, SKELETON, json!({})), "not_found"),
            (Ask::Delete(world.running.clone()), "conflict"),
            (Ask::Cancel(world.running.clone()), ""),
            (Ask::Cancel(world.done.clone()), "not_cancelable"),
            (Ask::Cancel(NOBODY.to_owned()), "not_found"),
            (Ask::Delete(world.done.clone()), ""),
            (Ask::Get(world.done.clone()), "not_found"),
            (Ask::Delete(world.done.clone()), "not_found"),
        ]
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_service_that_takes_nothing_says_so_alike() {
    let orders = |_: &World| {
        let keyed = Create { key: Some("k".to_owned()), ..create("ok", json!({})) };
        vec![Ask::Create(create("ok", json!({}))), Ask::Create(keyed), Ask::Check(create("ok", json!({})))]
    };
    let starting =
        both(|service| *service.rigger.readiness.lock().expect("not poisoned") = Readiness::Starting, orders).await;
    assert!(starting.iter().all(|said| said.code() == "starting"), "{starting:?}");
    let unable = Readiness::Unavailable { reason: "no networks".to_owned() };
    let unable = both(|service| *service.rigger.readiness.lock().expect("not poisoned") = unable.clone(), orders).await;
    assert!(unable.iter().all(|said| said.code() == "model_unavailable"), "{unable:?}");
    let draining = both(|service| service.state.jobs.drain(), orders).await;
    assert!(draining.iter().all(|said| said.code() == "draining"), "{draining:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn limits_are_the_same_behind_both_doors() {
    let mut said = Vec::new();
    for over in [Over::Rest, Over::Grpc] {
        let service = Service::with(|settings, limits| {
            (settings.workers, settings.queue_max) = (1, 1);
            limits.upload_bytes_max = 1000;
        });
        let door = Door { service: &service, key: None, over };
        for state in ["running", "queued"] {
            let path = service.rig("", &[], "hang").await.header("location").to_owned();
            service.until(&path, state).await;
        }
        let answers = [
            door.ask(Ask::Create(create("ok", json!({})))).await,
            door.ask(Ask::Upload(vec![("a.obj", "v".repeat(2000).leak())], None)).await,
        ];
        assert_eq!(answers.each_ref().map(Said::code), ["queue_full", "too_large"], "{answers:?}");
        said.push(answers);
    }
    assert_eq!(said[0], said[1]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn keys_open_both_doors_or_neither() {
    let mut said = Vec::new();
    for over in [Over::Rest, Over::Grpc] {
        let mut service = Service::new();
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("keys.toml");
        let studio = keys::add(&path, "studio", OwnQuota::default()).expect("a key");
        let farm =
            keys::add(&path, "farm", OwnQuota { requests_per_minute: Some(2), jobs: Some(1), ..OwnQuota::default() })
                .expect("a key");
        let quota = Quota { requests_per_minute: 100, jobs: 4, upload_bytes_per_hour: 1 << 30 };
        service.state = service.state.clone().with_keys(Keys::open(&path, quota).expect("keys")).expect("a secret");
        service.router = app(service.state.clone());
        let door = |key: Option<&str>| Door { service: &service, key: key.map(str::to_owned), over };
        let answers = [
            door(None).ask(Ask::Get(NOBODY.to_owned())).await,
            door(Some("rsk_wrong")).ask(Ask::Create(create("ok", json!({})))).await,
            door(Some(&studio))
                .ask(Ask::Create(Create {
                    mesh: script("ok"),
                    client_id: Some("mine".to_owned()),
                    ..create("", json!({}))
                }))
                .await,
            door(Some(&farm)).ask(Ask::Get("mine".to_owned())).await,
            door(Some(&farm)).ask(Ask::List("", "", 0, "")).await,
            door(Some(&farm)).ask(Ask::List("", "", 0, "")).await,
        ];
        let codes = ["unauthenticated", "unauthenticated", "", "not_found", "", "rate_limited"];
        assert_eq!(answers.each_ref().map(Said::code), codes, "{answers:?}");
        said.push(answers);
    }
    assert_eq!(said[0], said[1]);
}
