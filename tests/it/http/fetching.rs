//! Meshes that are fetched: from where, how large, how long, and that nothing inside is ever asked.

use super::scripted::{Answer, Service, request};
use axum::Router;
use axum::body::Body;
use axum::http::{HeaderMap, StatusCode};
use axum::response::IntoResponse;
use axum::routing::get;
use rigsmith::outgoing::{Names, Outgoing};
use rigsmith::server::app;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::future::Future;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use tokio::net::TcpListener;

/// Names of a network that is not there. `changing.test` is public the first time, and inside ever after.
#[derive(Default)]
struct Book {
    asked: AtomicUsize,
}

impl Names for Book {
    fn resolve(&self, name: &str) -> Pin<Box<dyn Future<Output = io::Result<Vec<IpAddr>>> + Send>> {
        self.asked.fetch_add(1, Ordering::SeqCst);
        let addresses: &[&str] = match name {
            "files.test" | "loopback.test" | "localhost" | "localhost." => &["127.0.0.1"],
            "private.test" => &["10.1.2.3"],
            "mapped.test" => &["::ffff:127.0.0.1"],
            "six.test" => &["::1"],
            "local.test" => &["fd00::1"],
            "metadata.google.internal" => &["169.254.169.254"],
            "mixed.test" => &["1.1.1.1", "192.168.0.9"],
            _ => &[],
        };
        let addresses = addresses.iter().map(|address| address.parse().expect("an address")).collect();
        Box::pin(async move { Ok(addresses) })
    }
}

/// A place on loopback with files, and how often it was asked.
async fn place() -> (SocketAddr, Arc<AtomicUsize>) {
    let asked = Arc::new(AtomicUsize::new(0));
    let counted = asked.clone();
    let to = |to: &'static str| move || async move { (StatusCode::FOUND, [("location", to)], "ok").into_response() };
    let router = Router::new()
        .route("/hero.obj", get(|| async { "ok 5" }))
        .route("/typed", get(|| async { ([("content-type", "model/obj")], "ok 6") }))
        .route("/large.obj", get(|| async { "v".repeat(2000) }))
        .route(
            "/endless.obj",
            get(|| async {
                Body::from_stream(tokio_stream::iter(std::iter::repeat_with(|| Ok::<_, io::Error>("vvvvvvvv"))))
            }),
        )
        .route("/slow.obj", get(|| async { tokio::time::sleep(Duration::from_secs(60)).await }))
        .route("/empty.obj", get(|| async {}))
        .route("/program.obj", get(|| async { "\u{7f}ELF and more of a program" }))
        .route("/inside.obj", get(to("http://127.0.0.1:1/secret")))
        .route("/again.obj", get(to("/hero.obj")))
        .route("/headers", get(|headers: HeaderMap| async move { format!("ok {headers:?}") }))
        .layer(axum::middleware::map_request(move |request: axum::extract::Request| {
            counted.fetch_add(1, Ordering::SeqCst);
            async move { request }
        }));
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = listener.local_addr().expect("an address");
    tokio::spawn(async move { axum::serve(listener, router).await });
    (address, asked)
}

fn fetching(book: &Arc<Book>, trusted: &[&str]) -> Service {
    let mut service = Service::with(|_, limits| limits.upload_bytes_max = 1000);
    let trusted: Vec<String> = trusted.iter().map(|&host| host.to_owned()).collect();
    let outgoing = Outgoing::new(book.clone(), &trusted).expect("a client");
    service.state = service.state.clone().with_outgoing(outgoing);
    service.router = app(service.state.clone());
    service
}

async fn rig(service: &Service, asset: Value) -> Answer {
    let fields = [("content-type", "application/json"), ("prefer", "wait=10")];
    service.send(request("POST", "/v1/rigs", &fields, &json!({"asset": asset}).to_string())).await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_mesh_is_fetched_whole_and_held_to_its_digest() {
    let (address, _) = place().await;
    let book = Arc::new(Book::default());
    let service = fetching(&book, &["files.test"]);
    let url = |path: &str| format!("http://files.test:{}{path}", address.port());
    for (path, name) in [("/hero.obj", "hero.obj"), ("/typed", "upload.obj")] {
        let done = rig(&service, json!({"url": url(path)})).await;
        assert_eq!(done.json()["state"], "succeeded", "{}", done.text());
        assert_eq!(done.json()["files"][0]["name"], name);
    }
    let sha256: String = Sha256::digest("ok 5").iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(rig(&service, json!({"url": url("/hero.obj"), "sha256": sha256})).await.status, 200);
    assert_eq!(book.asked.load(Ordering::SeqCst), 3, "a name is resolved once for each request");
    rig(&service, json!({"url": url("/typed"), "sha256": sha256})).await.refused(424, "fetch_failed");
    rig(&service, json!({"url": url("/typed"), "sha256": "ab"})).await.refused(400, "invalid_parameter");
    rig(&service, json!({"url": url("/typed"), "colour": "red"})).await.refused(400, "unknown_field");
    rig(&service, json!({"url": 5})).await.refused(400, "invalid_parameter");
    let checked = service
        .send(request(
            "POST",
            "/v1/rigs:check",
            &[("content-type", "application/json")],
            &json!({"asset": {"url": url("/hero.obj")}}).to_string(),
        ))
        .await;
    assert_eq!(checked.json()["riggable"], "yes", "{}", checked.text());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_not_a_mesh_in_time_is_refused_and_leaves_nothing() {
    let (address, _) = place().await;
    let service = fetching(&Arc::default(), &["127.0.0.1"]);
    for (path, status, code) in [
        ("/missing.obj", 424, "fetch_failed"),
        ("/large.obj", 413, "too_large"),
        ("/endless.obj", 413, "too_large"),
        ("/slow.obj", 424, "fetch_failed"),
        ("/empty.obj", 422, "unreadable_mesh"),
        ("/program.obj", 415, "unsupported_media_type"),
        ("/inside.obj", 424, "fetch_failed"),
        ("/again.obj", 424, "fetch_failed"),
    ] {
        let refused = rig(&service, json!({"url": format!("http://{address}{path}")})).await;
        let problem = refused.refused(status, code);
        assert!(!problem.to_string().contains("secret") || path == "/inside.obj", "{problem:#}");
    }
    service.keeps(0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_inside_is_asked_however_it_is_named() {
    let (address, asked) = place().await;
    let service = fetching(&Arc::default(), &[]);
    let port = address.port();
    for host in [
        "127.0.0.1",
        "localhost.",
        "127.1",
        "2130706433",
        "0x7f.0.0.1",
        "0177.0.0.1",
        "[::1]",
        "[::ffff:127.0.0.1]",
        "[::ffff:7f00:1]",
        "0.0.0.0",
        "[::]",
        "10.0.0.1",
        "169.254.169.254",
        "metadata.google.internal",
        "loopback.test",
        "private.test",
        "mapped.test",
        "six.test",
        "local.test",
        "mixed.test",
        "LOOPBACK.test",
        "nowhere.test",
    ] {
        for scheme in ["https", "http"] {
            let refused = rig(&service, json!({"url": format!("{scheme}://{host}:{port}/hero.obj")})).await;
            let problem = refused.refused(424, "fetch_failed");
            assert_eq!(problem["retryable"], false);
        }
    }
    for url in ["ftp://files.test/a", "file:///etc/passwd", "https://user:secret@files.test/a", "nonsense", ""] {
        let problem = rig(&service, json!({"url": url})).await.refused(424, "fetch_failed");
        assert!(!problem.to_string().contains("secret"), "{problem:#}");
    }
    assert_eq!(asked.load(Ordering::SeqCst), 0, "no connection was made");
    service.keeps(0);
}

#[tokio::test]
async fn without_the_operators_word_nothing_is_fetched() {
    let service = Service::new();
    let refused = rig(&service, json!({"url": "https://example.com/a.glb"})).await;
    let problem = refused.refused(400, "invalid_parameter");
    assert!(problem["hint"].as_str().is_some_and(|hint| hint.contains("--outgoing")), "{problem:#}");
}
