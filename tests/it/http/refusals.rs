//! What is refused, how, and that it leaves nothing.

use super::scripted::{Service, form, request};
use axum::body::Body;
use axum::http::Request;
use rigsmith::jobs::Readiness;
use serde_json::json;
use std::convert::Infallible;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

const OBJ: (&str, &str) = ("content-type", "model/obj");

#[tokio::test]
async fn wrong_options_are_named_field_by_field() {
    let service = Service::new();
    let problem = service.rig("?detail=2&max_influences=0", &[], "ok").await.refused(400, "invalid_parameter");
    assert_eq!(problem["errors"][0]["field"], "detail");
    assert_eq!(problem["errors"][1]["field"], "max_influences");
    let problem = service.rig("?colour=red", &[], "ok").await.refused(400, "unknown_field");
    assert!(problem["errors"][0]["detail"].as_str().expect("detail").contains("max_influences"));
    service.rig("?detail=0.5&bandwidth=0.05", &[], "ok").await.refused(400, "invalid_parameter");
    let problem = service.rig("?method=magic", &[], "ok").await.refused(400, "invalid_parameter");
    assert!(problem["detail"].as_str().expect("detail").contains("auto, rignet"));
    service.rig("?method=volumetric_nets", &[], "ok").await.refused(503, "model_unavailable");
    service.rig("?file_name=../a.obj", &[], "ok").await.refused(400, "invalid_parameter");
    service.rig("", &[("prefer", "wait=long")], "ok").await.refused(400, "invalid_parameter");
    service.keeps(0);
}

#[tokio::test]
async fn wrong_forms_are_refused() {
    let service = Service::new();
    let obj = ("file", Some("a.obj"), "ok");
    for (parts, code) in [
        (&[("options", None, "{"), obj][..], "invalid_json"),
        (&[("options", None, "[1]"), obj], "invalid_json"),
        (&[("options", None, r#"{"colour": 1}"#), obj], "unknown_field"),
        (&[("colour", None, "red"), obj], "unknown_field"),
        (&[("options", None, r#"{"detail": "high"}"#), obj], "invalid_parameter"),
        (&[obj, obj], "invalid_parameter"),
        (&[("a", Some("a.obj"), "ok"), ("b", Some("b.obj"), "ok")], "invalid_parameter"),
        (&[("a", Some("a.png"), "p"), ("b", Some("b.png"), "p")], "invalid_parameter"),
        (&[("file", Some("../a.obj"), "ok")], "invalid_parameter"),
        (&[("detail", None, "0.5")], "invalid_parameter"),
    ] {
        service.send(form("/v1/rigs", &[], parts)).await.refused(400, code);
    }
    let fields = [("content-type", "multipart/form-data; boundary=edge")];
    for body in
        ["", "no form at all", "--edge\r\nContent-Disposition: form-data; name=\"file\"; filename=\"a.obj\"\r\n\r\nok"]
    {
        service.send(request("POST", "/v1/rigs", &fields, body)).await.refused(400, "invalid_multipart");
    }
    let no_boundary = [("content-type", "multipart/form-data")];
    service.send(request("POST", "/v1/rigs", &no_boundary, "x")).await.refused(400, "invalid_multipart");
    service.keeps(0);
}

#[tokio::test]
async fn files_that_are_no_meshes_are_named_by_what_they_hold() {
    let service = Service::new();
    let png = "\u{89}PNG";
    for (content, seen) in [("BLENDER-v402", "a Blender 4.2 file"), ("<!DOCTYPE html><p>", "a web page")] {
        let problem = service.rig("", &[], content).await.refused(415, "unsupported_media_type");
        assert!(problem["detail"].as_str().expect("detail").contains(seen), "{problem:#}");
        let parts = [("file", Some("hero.obj"), content), ("skin", Some("skin.png"), png)];
        service.send(form("/v1/rigs", &[], &parts)).await.refused(415, "unsupported_media_type");
    }
    let endless = Body::new(Endless { chunks: vec![b"BLENDER-v402"], breaks: false });
    service.send(post(&[OBJ], endless)).await.refused(415, "unsupported_media_type");
    service.keeps(0);
}

#[tokio::test]
async fn other_media_types_are_named() {
    let service = Service::new();
    for media_type in ["text/html", "image/png", "application/xml"] {
        let problem = service.send(request("POST", "/v1/rigs", &[("content-type", media_type)], "{}")).await;
        let problem = problem.refused(415, "unsupported_media_type");
        assert!(problem["detail"].as_str().expect("detail").contains(media_type));
    }
    service.rig("", &[("accept", "image/png")], "ok").await.refused(406, "not_acceptable");
    service.rig("?outputs=rig_json", &[("accept", "model/gltf-binary")], "ok").await.refused(406, "not_acceptable");
    service.rig("", &[], "").await.refused(422, "unreadable_mesh");
    service.send(form("/v1/rigs", &[], &[("file", Some("a.obj"), "")])).await.refused(422, "unreadable_mesh");
    service.keeps(0);
}

/// A body that gives its chunks and then never ends, or breaks.
struct Endless {
    chunks: Vec<&'static [u8]>,
    breaks: bool,
}

impl axum::body::HttpBody for Endless {
    type Data = bytes::Bytes;
    type Error = std::io::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        _: &mut Context,
    ) -> Poll<Option<Result<http_body::Frame<bytes::Bytes>, std::io::Error>>> {
        match self.chunks.pop() {
            Some(chunk) => Poll::Ready(Some(Ok(http_body::Frame::data(chunk.into())))),
            None if self.breaks => Poll::Ready(Some(Err(std::io::ErrorKind::ConnectionReset.into()))),
            None => Poll::Pending,
        }
    }
}

fn post(headers: &[(&str, &str)], body: Body) -> Request<Body> {
    let mut request = Request::post("/v1/rigs");
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    request.body(body).expect("a request")
}

#[tokio::test]
async fn uploads_that_stall_or_break_leave_nothing() {
    let service = Service::new();
    let multipart = ("content-type", "multipart/form-data; boundary=edge");
    let start = b"--edge\r\nContent-Disposition: form-data; name=\"file\"; filename=\"a.obj\"\r\n\r\nok".as_slice();
    for (field, chunk) in [(OBJ, b"ok".as_slice()), (multipart, start)] {
        let stalled = Body::new(Endless { chunks: vec![chunk], breaks: false });
        service.send(post(&[field], stalled)).await.refused(408, "upload_timeout");
    }
    let slow = Service::with(|_, limits| limits.upload_time_max = Duration::from_millis(50));
    let refused = slow.send(post(&[OBJ], Body::new(Endless { chunks: vec![b"ok"], breaks: false }))).await;
    let problem = refused.refused(408, "upload_timeout");
    assert_eq!(problem["detail"], "the upload took too long");
    let broken = Body::new(Endless { chunks: vec![b"ok"], breaks: true });
    service.send(post(&[OBJ], broken)).await.refused(400, "upload_incomplete");
    let abandoned = Body::new(Endless { chunks: vec![b"ok"], breaks: false });
    let sending = service.send(post(&[OBJ], abandoned));
    assert!(tokio::time::timeout(Duration::from_millis(50), sending).await.is_err(), "the caller hangs up");
    service.keeps(0);
    assert_eq!(service.get("/v1/rigs").await.json()["data"], json!([]));
}

#[tokio::test]
async fn too_large_uploads_are_refused_by_their_declared_length_and_by_what_arrives() {
    let service = Service::with(|_, limits| limits.upload_bytes_max = 1000);
    let unread = Body::new(Endless { chunks: Vec::new(), breaks: false });
    let problem = service.send(post(&[OBJ, ("content-length", "10000000000")], unread)).await;
    let problem = problem.refused(413, "too_large");
    assert_eq!(problem["limit"], json!({"name": "upload_bytes", "max": 1000, "actual": 10_000_000_000_u64}));
    let big = "x".repeat(1001);
    let problem = service.rig("", &[], &big).await.refused(413, "too_large");
    assert_eq!(problem["limit"]["actual"], json!(null));
    let parts = [("file", Some("a.obj"), big.as_str())];
    service.send(form("/v1/rigs", &[], &parts)).await.refused(413, "too_large");
    assert_eq!(service.rig("", &[], &"x".repeat(1000)).await.status, 202);
    service
        .until(service.get("/v1/rigs").await.json()["data"][0]["links"]["self"].as_str().expect("a link"), "failed")
        .await;
    service.keeps(0);
}

#[tokio::test]
async fn a_full_queue_refuses_before_the_body_is_read() {
    let service = Service::with(|settings, _| (settings.workers, settings.queue_max) = (1, 2));
    let running = service.rig("", &[], "hang").await.header("location").to_owned();
    service.until(&running, "running").await;
    for _ in 0..2 {
        assert_eq!(service.rig("", &[], "ok").await.status, 202);
    }
    let unread = Body::new(Endless { chunks: Vec::new(), breaks: false });
    let refused = service.send(post(&[OBJ], unread)).await;
    assert_eq!(refused.refused(429, "queue_full")["retryable"], true);
    assert!(refused.header("retry-after").parse::<u64>().expect("seconds") >= 1);
    service.keeps(2);
    service.send(request("POST", &format!("{running}:cancel"), &[], "")).await;
    service.until(&running, "canceled").await;
    assert_eq!(service.rig("", &[("prefer", "wait=10")], "ok").await.status, 200);
}

#[tokio::test]
async fn only_so_many_uploads_arrive_at_once() {
    let service = Service::with(|_, limits| limits.uploads_max = 1);
    let stalled = service.send(post(&[OBJ], Body::new(Endless { chunks: vec![b"ok"], breaks: false })));
    let second = async {
        tokio::time::sleep(Duration::from_millis(50)).await;
        service.rig("", &[], "ok").await
    };
    let (first, second) = tokio::join!(stalled, second);
    first.refused(408, "upload_timeout");
    second.refused(429, "queue_full");
    assert_eq!(service.rig("", &[], "ok").await.status, 202);
}

#[tokio::test]
async fn a_service_that_is_not_ready_says_so() {
    let service = Service::new();
    for (readiness, code) in [
        (Readiness::Starting, "starting"),
        (Readiness::Unavailable { reason: "no networks here".to_owned() }, "model_unavailable"),
    ] {
        *service.rigger.readiness.lock().expect("not poisoned") = readiness;
        let probe = service.get("/readyz").await;
        assert_eq!(probe.header("retry-after"), "5");
        probe.refused(503, code);
        service.rig("", &[], "ok").await.refused(503, code);
        assert_eq!(service.get("/livez").await.status, 200);
    }
    *service.rigger.readiness.lock().expect("not poisoned") = Readiness::Ready;
    assert_eq!(service.get("/readyz").await.status, 200);
}

#[tokio::test]
async fn unknown_paths_methods_ids_and_parameters_are_refused() -> Result<(), Infallible> {
    let service = Service::new();
    service.get("/v2/rigs").await.refused(404, "not_found");
    for id in ["rig_00000000000000000000000000", "nonsense", "%ff"] {
        service.get(&format!("/v1/rigs/{id}")).await.refused(404, "not_found");
        service.send(request("DELETE", &format!("/v1/rigs/{id}"), &[], "")).await.refused(404, "not_found");
        service.send(request("POST", &format!("/v1/rigs/{id}:cancel"), &[], "")).await.refused(404, "not_found");
    }
    service.get("/v1/problems/nonsense").await.refused(404, "not_found");
    let wrong_method = service.send(request("PUT", "/v1/rigs", &[], "")).await;
    assert_eq!(wrong_method.header("allow"), "GET,HEAD,POST");
    wrong_method.refused(405, "method_not_allowed");
    let job = service.rig("", &[("prefer", "wait=10")], "ok").await.header("location").to_owned();
    let posted = service.send(request("POST", &job, &[], "")).await;
    assert_eq!(posted.header("allow"), "GET, HEAD, PUT, DELETE");
    posted.refused(405, "method_not_allowed");
    service.send(request("POST", &format!("{job}:explode"), &[], "")).await.refused(404, "not_found");
    for path in
        [format!("{job}?x=1"), format!("{job}/artifacts?x=1"), "/v1/rigs?x=1".to_owned(), "/v1/methods?x=1".to_owned()]
    {
        service.get(&path).await.refused(400, "unknown_field");
    }
    for query in ["state=lost", "page_size=0", "page_size=101", "page_token=x"] {
        service.get(&format!("/v1/rigs?{query}")).await.refused(400, "invalid_parameter");
    }
    Ok(())
}

/// An option is one whether its value was typed or is a file of the sender's; what is no option is a file that the mesh needs.
#[tokio::test]
async fn options_that_are_sent_as_files_are_read() {
    let service = Service::new();
    let skeleton =
        r#"{"format": "rigsmith.rig/1", "joints": [{"name": "hips", "parent": null, "position": [0, 1, 0]}]}"#;
    let mesh = ("file", Some("hero.obj"), "ok");
    let parts = [mesh, ("skeleton", Some("own.rig.json"), skeleton), ("detail", Some("detail.txt"), "0.3")];
    let told = service.send(form("/v1/rigs", &[("prefer", "wait=10")], &parts)).await.json();
    assert_eq!(
        (&told["request"]["skeleton"], &told["request"]["detail"]),
        (&"1 joints".into(), &0.3.into()),
        "{told:#}"
    );
    let spaces = " ".repeat(100_000);
    let long = [mesh, ("skeleton", None, &format!("{skeleton}{spaces}"))];
    assert_eq!(service.send(form("/v1/rigs", &[], &long)).await.status, 202, "a rig.json with its weights is long");
    let problem =
        service.send(form("/v1/rigs", &[], &[mesh, ("detail", None, &spaces)])).await.refused(400, "invalid_parameter");
    assert!(!problem["hint"].to_string().contains("file name"), "{problem:#}");
}

#[tokio::test]
async fn a_file_name_that_is_no_text_is_refused_by_that() {
    let body =
        b"--edge\r\nContent-Disposition: form-data; name=\"file\"; filename=\"h\xe9ro.obj\"\r\n\r\nok\r\n--edge--\r\n";
    let request = Request::post("/v1/rigs").header("content-type", "multipart/form-data; boundary=edge");
    let request = request.body(Body::from(body.to_vec())).expect("a request");
    let problem = Service::new().send(request).await.refused(400, "invalid_multipart");
    assert!(problem["detail"].to_string().contains("UTF-8"), "{problem:#}");
}

#[tokio::test]
async fn ids_that_nobody_can_give_are_not_found() {
    let service = Service::new();
    for id in ["%00", "a%00b", "%20", "a%2Fb"] {
        service.get(&format!("/v1/rigs/{id}")).await.refused(404, "not_found");
    }
    let problem = service.send(request("DELETE", "/v1/rigs/nobody", &[], "")).await.refused(404, "not_found");
    assert!(problem["hint"].is_null(), "{problem:#}");
}
