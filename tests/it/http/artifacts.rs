//! Downloads: whole, in part, or not at all.

use super::scripted::{Answer, Service, glb, request};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use sha2::{Digest, Sha256};

async fn made(service: &Service) -> String {
    service.rig("", &[("prefer", "wait=10")], "ok").await.header("location").to_owned()
}

async fn download(service: &Service, path: &str, headers: &[(&str, &str)]) -> Answer {
    service.send(request("GET", &format!("{path}/artifacts/rigged.glb"), headers, "")).await
}

#[tokio::test]
async fn a_download_carries_its_digest_name_and_length() {
    let service = Service::new();
    let path = made(&service).await;
    let answer = download(&service, &path, &[]).await;
    let digest = Sha256::digest(glb());
    let hex: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(answer.bytes, glb());
    assert_eq!(answer.header("etag"), format!("\"{hex}\""));
    assert_eq!(answer.header("repr-digest"), format!("sha-256=:{}:", BASE64_STANDARD.encode(digest)));
    assert_eq!(answer.header("content-disposition"), "attachment; filename=\"rigged.glb\"");
    assert_eq!(answer.header("content-length"), glb().len().to_string());
    assert_eq!(answer.header("accept-ranges"), "bytes");
    let list = service.get(&format!("{path}/artifacts")).await.json();
    assert_eq!(list["data"][0]["sha256"], hex);
    assert_eq!(list["data"][1]["name"], "rigged.rig.json");
    let head = service.send(request("HEAD", &format!("{path}/artifacts/rigged.glb"), &[], "")).await;
    assert_eq!((head.bytes.len(), head.header("content-length")), (0, answer.header("content-length")));
}

#[tokio::test]
async fn ranges_give_the_bytes_asked_for() {
    let service = Service::new();
    let path = made(&service).await;
    let whole = glb();
    let size = whole.len();
    for (range, from, to) in [("bytes=10-19", 10, 20), ("bytes=-7", size - 7, size), ("bytes=600000-", 600_000, size)] {
        let answer = download(&service, &path, &[("range", range)]).await;
        assert_eq!(answer.status, 206, "{range}");
        assert_eq!(answer.bytes, whole[from..to]);
        assert_eq!(answer.header("content-range"), format!("bytes {from}-{}/{size}", to - 1));
    }
    let beyond = download(&service, &path, &[("range", "bytes=9999999-")]).await;
    beyond.refused(416, "range_not_satisfiable");
    assert_eq!(beyond.header("content-range"), format!("bytes */{size}"));
}

#[tokio::test]
async fn what_the_caller_has_is_not_sent_again() {
    let service = Service::new();
    let path = made(&service).await;
    let etag = download(&service, &path, &[]).await.header("etag").to_owned();
    let known = download(&service, &path, &[("if-none-match", &etag)]).await;
    assert_eq!((known.status.as_u16(), known.bytes.len(), known.header("etag")), (304, 0, etag.as_str()));
    let resumed = download(&service, &path, &[("if-range", &etag), ("range", "bytes=0-9")]).await;
    assert_eq!((resumed.status.as_u16(), resumed.bytes.len()), (206, 10));
    let changed = download(&service, &path, &[("if-range", "\"other\""), ("range", "bytes=0-9")]).await;
    assert_eq!((changed.status.as_u16(), changed.bytes.len()), (200, glb().len()));
}

#[tokio::test]
async fn files_that_are_not_there_are_not_found() {
    let service = Service::new();
    let path = made(&service).await;
    service.get(&format!("{path}/artifacts/other.glb")).await.refused(404, "not_found");
    service.get(&format!("{path}/artifacts/..%2f..%2flock")).await.refused(404, "not_found");
    let running = service.rig("", &[], "hang").await.header("location").to_owned();
    let early = service.get(&format!("{running}/artifacts/rigged.glb")).await.refused(404, "not_found");
    assert!(early["hint"].as_str().is_some_and(|hint| hint.contains("not done yet")));
    assert_eq!(service.get(&format!("{running}/artifacts")).await.json()["data"], serde_json::json!([]));
}
