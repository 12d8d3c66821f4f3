//! Uploads in parts, by the rules of tus 1.0.

use super::scripted::{Answer, Service, request};
use super::socket::start;
use axum::body::Body;
use axum::http::Request;
use bytes::Bytes;
use rigsmith::storage::hex;
use sha2::{Digest, Sha256};
use std::time::Duration;
use tokio_stream::StreamExt;

const TUS: (&str, &str) = ("tus-resumable", "1.0.0");
const PART: (&str, &str) = ("content-type", "application/offset+octet-stream");
/// `hero.obj`.
const NAMED: (&str, &str) = ("upload-metadata", "filename aGVyby5vYmo=");
/// What [`rigsmith::server::http`] writes down at a time.
const PART_BYTES: usize = 8 << 20;

async fn begin(service: &Service, length: usize) -> String {
    let length = length.to_string();
    let made = service.send(request("POST", "/v1/uploads", &[TUS, NAMED, ("upload-length", &length)], "")).await;
    assert_eq!((made.status.as_u16(), made.header("upload-offset")), (201, "0"), "{}", made.text());
    made.header("location").to_owned()
}

async fn patch(service: &Service, path: &str, offset: usize, more: &[(&str, &str)], body: &str) -> Answer {
    let offset = offset.to_string();
    let mut fields = vec![TUS, PART, ("upload-offset", offset.as_str())];
    fields.extend(more);
    service.send(request("PATCH", path, &fields, body)).await
}

async fn head(service: &Service, path: &str) -> Answer {
    service.send(request("HEAD", path, &[TUS], "")).await
}

/// Asserts that there is nothing to go on with, which HEAD tells by the status alone.
async fn assert_gone(service: &Service, path: &str, status: u16) {
    let gone = head(service, path).await;
    assert_eq!((gone.status.as_u16(), gone.header("upload-offset")), (status, ""));
}

#[tokio::test]
async fn parts_become_an_asset_that_can_be_rigged() {
    let service = Service::new();
    let path = begin(&service, 8).await;
    let stands = head(&service, &path).await;
    assert_eq!(
        [stands.header("upload-offset"), stands.header("upload-length"), stands.header("upload-metadata")],
        ["0", "8", NAMED.1]
    );
    assert_eq!((stands.header("cache-control"), stands.header("tus-resumable")), ("no-store", "1.0.0"));
    assert!(stands.header("upload-expires").ends_with(" GMT"), "{}", stands.header("upload-expires"));
    let first = patch(&service, &path, 0, &[], "sleep").await;
    assert_eq!((first.status.as_u16(), first.header("upload-offset"), first.header("asset-id")), (204, "5", ""));
    assert!(first.header("upload-expires").ends_with(" GMT"));
    assert_eq!(service.get(&path).await.json()["offset"], 5);
    let last = patch(&service, &path, 5, &[], " 12").await;
    assert_eq!((last.status.as_u16(), last.header("upload-offset"), last.header("upload-expires")), (204, "8", ""));
    let told = service.get(&path).await.json();
    assert_eq!((&told["asset"], &told["expires_at"]), (&last.header("asset-id").into(), &serde_json::Value::Null));
    assert_eq!(head(&service, &path).await.header("asset-id"), last.header("asset-id"));
    let asset = service.get(told["links"]["asset"].as_str().expect("a link")).await.json();
    assert_eq!(asset["sha256"], hex(&Sha256::digest("sleep 12")));
    assert_eq!(asset["files"][0]["name"], "hero.obj");
    let body = serde_json::json!({"asset": told["asset"]}).to_string();
    let fields = [("content-type", "application/json"), ("prefer", "wait=10")];
    let rig = service.send(request("POST", "/v1/rigs", &fields, &body)).await.json();
    assert_eq!(rig["state"], "succeeded", "{rig}");
    // The upload may go, and what it has become stays.
    assert_eq!(service.send(request("DELETE", &path, &[TUS], "")).await.status, 204);
    assert!(service.get(asset["links"]["self"].as_str().expect("a link")).await.status.is_success());
}

#[tokio::test]
async fn bytes_belong_where_the_upload_ends() {
    let service = Service::new();
    let path = begin(&service, 4).await;
    assert_eq!(patch(&service, &path, 0, &[], "ok").await.status, 204);
    for offset in [0, 1, 3, 4] {
        patch(&service, &path, offset, &[], "x").await.refused(409, "conflict");
    }
    let problem = patch(&service, &path, 2, &[], "xyz").await.refused(413, "too_large");
    assert_eq!((&problem["limit"]["name"], &problem["limit"]["max"]), (&"upload_length".into(), &4.into()));
    // The same where the length is not told beforehand.
    let body = Body::from_stream(tokio_stream::iter(["xy", "z"].map(Ok::<_, std::io::Error>)));
    let mut undeclared = request("PATCH", &path, &[TUS, PART, ("upload-offset", "2")], "");
    *undeclared.body_mut() = body;
    service.send(undeclared).await.refused(413, "too_large");
    assert_eq!(head(&service, &path).await.header("upload-offset"), "2");
    assert_eq!(patch(&service, &path, 2, &[], "").await.header("upload-offset"), "2", "nothing is added to nothing");
    assert_ne!(patch(&service, &path, 2, &[], "ay").await.header("asset-id"), "");
    patch(&service, &path, 3, &[], "x").await.refused(409, "conflict");
    assert_eq!(patch(&service, &path, 4, &[], "").await.status, 204, "it is complete, and nothing is missing");
    service.keeps(1);
}

#[tokio::test]
async fn only_version_one_is_spoken() {
    let service = Service::new();
    let path = begin(&service, 2).await;
    for (method, path) in [("POST", "/v1/uploads"), ("PATCH", &path), ("DELETE", &path), ("HEAD", &path)] {
        for version in [&[][..], &[("tus-resumable", "0.2.2")]] {
            let refused = service.send(request(method, path, version, "")).await;
            if method != "HEAD" {
                refused.refused(412, "unsupported_version");
            }
            assert_eq!(refused.status, 412);
            assert_eq!((refused.header("tus-version"), refused.header("tus-resumable")), ("1.0.0", "1.0.0"));
        }
    }
    let told = service.send(request("OPTIONS", "/v1/uploads", &[], "")).await;
    assert_eq!((told.status.as_u16(), told.header("tus-version")), (204, "1.0.0"));
    assert_eq!(told.header("tus-extension"), "creation,creation-with-upload,checksum,expiration,termination");
    assert_eq!(
        (told.header("tus-max-size"), told.header("tus-checksum-algorithm")),
        ("104857600", "sha1,sha256,sha512")
    );
}

#[tokio::test]
async fn what_has_another_checksum_is_not_kept() {
    let service = Service::new();
    let path = begin(&service, 3).await;
    // SHA-1 of "abc".
    let sum = ("upload-checksum", "sha1 qZk+NkcGgWq6PiVxeFDCbJzQ2J0=");
    let problem = patch(&service, &path, 0, &[sum], "abd").await.refused(460, "checksum_mismatch");
    assert_eq!(problem["retryable"], true);
    assert_eq!(head(&service, &path).await.header("upload-offset"), "0");
    patch(&service, &path, 0, &[("upload-checksum", "md5 kAFQmDzST7DWlj99KOF/cg==")], "abc")
        .await
        .refused(400, "invalid_parameter");
    assert_eq!(patch(&service, &path, 0, &[sum], "abc").await.header("upload-offset"), "3");
    service.keeps(1);
}

#[tokio::test]
async fn the_first_bytes_may_come_with_the_beginning() {
    let service = Service::new();
    let create = |more: &[(&str, &str)], body: &str| {
        let mut fields = vec![TUS, NAMED, PART, ("upload-length", "4")];
        fields.extend(more);
        request("POST", "/v1/uploads", &fields, body)
    };
    let some = service.send(create(&[], "ok")).await;
    assert_eq!((some.status.as_u16(), some.header("upload-offset")), (201, "2"), "{}", some.text());
    assert_ne!(patch(&service, some.header("location"), 2, &[], " 1").await.header("asset-id"), "");
    let all = service.send(create(&[], "ok 2")).await;
    assert_eq!((all.status.as_u16(), all.header("upload-offset")), (201, "4"));
    assert!(all.header("asset-id").starts_with("ast_"));
    service.send(create(&[], "ok 33")).await.refused(413, "too_large");
    service
        .send(create(&[("upload-checksum", "sha1 qZk+NkcGgWq6PiVxeFDCbJzQ2J0=")], "abd"))
        .await
        .refused(460, "checksum_mismatch");
    service.keeps(2);
    // What did not come is gone, and its key with it.
    let key = ("idempotency-key", "hero");
    let wrong = create(&[key, ("upload-checksum", "sha1 qZk+NkcGgWq6PiVxeFDCbJzQ2J0=")], "ok 4");
    service.send(wrong).await.refused(460, "checksum_mismatch");
    let right = service.send(create(&[key], "ok 4")).await;
    assert_eq!((right.status.as_u16(), right.header("upload-offset")), (201, "4"), "{}", right.text());
}

#[tokio::test]
async fn an_upload_says_beforehand_what_it_is_and_not_too_much() {
    let service = Service::with(|_, limits| {
        limits.upload_bytes_max = 1000;
        limits.open_uploads_max = 2;
    });
    let create = async |fields: &[(&str, &str)]| {
        let fields: Vec<_> = [TUS].iter().chain(fields).copied().collect();
        service.send(request("POST", "/v1/uploads", &fields, "")).await
    };
    let problem = create(&[("upload-length", "1001")]).await.refused(413, "too_large");
    assert_eq!(problem["limit"]["max"], 1000);
    for fields in [
        &[][..],
        &[("upload-length", "0")],
        &[("upload-length", "-1")],
        &[("upload-defer-length", "1")],
        &[("upload-length", "1"), ("upload-metadata", "filename Li4vYQ==")],
    ] {
        create(fields).await.refused(400, "invalid_parameter");
    }
    let image = [("upload-length", "1"), ("upload-metadata", "filetype aW1hZ2UvcG5n")];
    create(&image).await.refused(415, "unsupported_media_type");
    let first = begin(&service, 2).await;
    begin(&service, 2).await;
    let problem = create(&[("upload-length", "2")]).await.refused(429, "quota_exceeded");
    assert_eq!(problem["limit"], serde_json::json!({"name": "open_uploads", "max": 2, "actual": null}));
    assert_eq!(service.send(request("DELETE", &first, &[TUS], "")).await.status, 204);
    begin(&service, 2).await;
    let wrong_type = [TUS, ("upload-offset", "0"), ("content-type", "model/obj")];
    let path = "/v1/uploads/upl_01jdf5fj5rfxm8s1m2q1d2zt8v";
    service.send(request("PATCH", path, &wrong_type, "ok")).await.refused(415, "unsupported_media_type");
    patch(&service, path, 0, &[], "ok").await.refused(404, "not_found");
    for path in [path, &first] {
        assert_gone(&service, path, 404).await;
        service.get(path).await.refused(404, "not_found");
    }
}

#[tokio::test]
async fn an_upload_that_nobody_goes_on_with_is_gone() {
    let service = Service::with(|settings, _| settings.keep_time = Duration::from_millis(150));
    let path = begin(&service, 4).await;
    patch(&service, &path, 0, &[], "ok").await;
    service.keeps(0);
    assert_gone(&service, &path, 410).await;
    for gone in [patch(&service, &path, 2, &[], "xx").await, service.get(&path).await] {
        gone.refused(410, "expired");
    }
}

#[tokio::test]
async fn what_is_surely_no_mesh_is_refused_with_its_first_bytes() {
    let service = Service::new();
    let path = begin(&service, 12).await;
    let problem = patch(&service, &path, 0, &[], "BLENDER-v402").await.refused(415, "unsupported_media_type");
    assert!(problem["detail"].as_str().is_some_and(|detail| detail.contains("hero.obj")), "{problem}");
    assert_eq!(head(&service, &path).await.header("upload-offset"), "0");
}

#[tokio::test]
async fn a_key_makes_one_upload_of_two_requests() {
    let service = Service::new();
    let create = async |length: &str| {
        let fields = [TUS, NAMED, ("upload-length", length), ("idempotency-key", "hero")];
        service.send(request("POST", "/v1/uploads", &fields, "")).await
    };
    let (first, again) = (create("4").await, create("4").await);
    assert_eq!((first.status.as_u16(), again.status.as_u16()), (201, 201));
    assert_eq!(first.header("location"), again.header("location"));
    assert_eq!((first.header("idempotency-replayed"), again.header("idempotency-replayed")), ("", "true"));
    create("5").await.refused(422, "idempotency_mismatch");
}

#[tokio::test]
async fn callers_who_can_only_post_say_what_they_mean() {
    let service = Service::new();
    let path = begin(&service, 4).await;
    let fields = [TUS, PART, ("upload-offset", "0"), ("x-http-method-override", "PATCH")];
    assert_eq!(service.send(request("POST", &path, &fields, "ok")).await.header("upload-offset"), "2");
    service.send(request("POST", &path, &[TUS], "")).await.refused(405, "method_not_allowed");
    let delete = [TUS, ("x-http-method-override", "DELETE")];
    assert_eq!(service.send(request("POST", &path, &delete, "")).await.status, 204);
    assert_gone(&service, &path, 404).await;
    service.keeps(0);
}

/// A request whose body breaks off after `sent` bytes.
fn broken(path: &str, more: &[(&str, &str)], sent: Bytes) -> Request<Body> {
    let mut fields = vec![TUS, PART, ("upload-offset", "0")];
    fields.extend(more);
    let mut request = request("PATCH", path, &fields, "");
    let pieces = [Ok(sent), Err(std::io::Error::other("the connection is gone"))];
    *request.body_mut() = Body::from_stream(tokio_stream::iter(pieces));
    request
}

#[tokio::test]
async fn what_came_before_a_connection_broke_is_kept_unless_a_checksum_is_owed() {
    let service = Service::new();
    let path = begin(&service, 8).await;
    let sum = ("upload-checksum", "sha1 qZk+NkcGgWq6PiVxeFDCbJzQ2J0=");
    service.send(broken(&path, &[sum], Bytes::from("sleep"))).await.refused(400, "upload_incomplete");
    assert_eq!(head(&service, &path).await.header("upload-offset"), "0");
    service.send(broken(&path, &[], Bytes::from("sleep"))).await.refused(400, "upload_incomplete");
    assert_eq!(head(&service, &path).await.header("upload-offset"), "5");
    assert_eq!(patch(&service, &path, 5, &[], " 12").await.header("upload-offset"), "8");
    let asset = service.get(&path).await.json()["asset"].as_str().expect("an asset").to_owned();
    assert_eq!(service.get(&format!("/v1/assets/{asset}/content")).await.bytes, b"sleep 12");
}

#[tokio::test]
async fn a_long_body_is_written_down_part_by_part() {
    let service = Service::new();
    let whole: Vec<u8> = (0..2 * PART_BYTES + 10).map(|index| (index / 7 % 251) as u8 | 0x80).collect();
    let path = begin(&service, whole.len()).await;
    let mut paused = request("PATCH", &path, &[TUS, PART, ("upload-offset", "0")], "");
    // Small pieces, and then silence: the service gives up, and has all that came.
    let pieces: Vec<Bytes> = whole[..PART_BYTES + 20].chunks(65_536).map(Bytes::copy_from_slice).collect();
    let pieces = tokio_stream::iter(pieces.into_iter().map(Ok::<_, std::io::Error>));
    *paused.body_mut() = Body::from_stream(pieces.chain(tokio_stream::pending()));
    service.send(paused).await.refused(408, "upload_timeout");
    let stands = head(&service, &path).await;
    assert_eq!(stands.header("upload-offset"), (PART_BYTES + 20).to_string());
    assert_eq!(service.files(), 2, "one part that was full, and the rest");
    let rest = Bytes::copy_from_slice(&whole[PART_BYTES + 20..]);
    let mut last = request("PATCH", &path, &[TUS, PART, ("upload-offset", stands.header("upload-offset"))], "");
    *last.body_mut() = Body::from(rest);
    let last = service.send(last).await;
    assert_eq!(last.header("upload-offset"), whole.len().to_string(), "{}", last.text());
    let content = service.get(&format!("/v1/assets/{}/content", last.header("asset-id"))).await;
    assert!(content.bytes == whole, "{} bytes", content.bytes.len());
    service.keeps(1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_caller_who_hangs_up_finds_what_had_arrived() {
    use tokio::io::AsyncWriteExt;
    let service = Service::new();
    let running = start(&service).await;
    let path = begin(&service, 8).await;
    let address = running.base.trim_start_matches("http://");
    let mut stream = tokio::net::TcpStream::connect(address).await.expect("connects");
    let header = format!(
        "PATCH {path} HTTP/1.1\r\nHost: {address}\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: 0\r\n\
         Content-Type: application/offset+octet-stream\r\nContent-Length: 8\r\n\r\nsleep"
    );
    stream.write_all(header.as_bytes()).await.expect("writes");
    stream.flush().await.expect("writes");
    // Gone while three bytes are owed.
    tokio::time::sleep(Duration::from_millis(50)).await;
    drop(stream);
    for _ in 0..200 {
        if head(&service, &path).await.header("upload-offset") == "5" {
            break;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!(head(&service, &path).await.header("upload-offset"), "5");
}
