//! What only gRPC has: streams, operations, health, deadlines, and HTTP/2 itself.

use super::asks::{Door, Over};
use super::grpc::{details, info};
use crate::http::scripted::{GLB_BYTES, Service, request};
use crate::http::socket::start;
use bytes::Bytes;
use http_body_util::{BodyExt, Empty};
use hyper_util::rt::{TokioExecutor, TokioIo};
use prost::Message;
use rigsmith::jobs::Readiness;
use rigsmith::server::grpc::proto::google::longrunning::operation::Result as OperationResult;
use rigsmith::server::grpc::proto::google::longrunning::{
    CancelOperationRequest, DeleteOperationRequest, GetOperationRequest, ListOperationsRequest, WaitOperationRequest,
};
use rigsmith::server::grpc::proto::rigsmith::v1::mesh::Mesh as MeshIs;
use rigsmith::server::grpc::proto::rigsmith::v1::rig::State;
use rigsmith::server::grpc::proto::rigsmith::v1::rig_event::Event;
use rigsmith::server::grpc::proto::rigsmith::v1::rig_service_client::RigServiceClient;
use rigsmith::server::grpc::proto::rigsmith::v1::upload_chunk::Part;
use rigsmith::server::grpc::proto::rigsmith::v1::{
    Batch, BatchItem, CreateBatchRequest, CreateRigRequest, DownloadArtifactRequest, GetRigRequest, InlineMesh, Mesh,
    RigEvent, RigMetadata, UploadChunk, UploadFile, WatchRigRequest,
};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tonic::{Code, Request, Streaming};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

fn door(service: &Service) -> Door<'_> {
    Door { service, key: None, over: Over::Grpc }
}

fn order(script: &str) -> CreateRigRequest {
    let inline = InlineMesh { media_type: "model/obj".to_owned(), data: script.as_bytes().to_vec().into() };
    CreateRigRequest {
        mesh: Some(Mesh { mesh: Some(MeshIs::Inline(inline)) }),
        no_cache: true,
        ..CreateRigRequest::default()
    }
}

/// Queues a script; gives the id of its rig.
async fn create(service: &Service, script: &str) -> String {
    let operation = door(service).rigs().create_rig(order(script)).await.expect("taken").into_inner();
    operation.name.strip_prefix("operations/").expect("a name").to_owned()
}

async fn all(mut events: Streaming<RigEvent>) -> Vec<RigEvent> {
    let mut seen = Vec::new();
    while let Some(event) = events.message().await.expect("an event") {
        seen.push(event);
    }
    seen
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn watching_tells_everything_once_and_resumes_where_it_was() {
    let service = Service::new();
    let id = create(&service, "sleep 200").await;
    let watch = |after_sequence| WatchRigRequest { id: id.clone(), after_sequence };
    let mut rigs = door(&service).rigs();
    let seen = all(rigs.watch_rig(watch(None)).await.expect("a stream").into_inner()).await;
    assert!(matches!(&seen[0].event, Some(Event::Snapshot(rig)) if rig.id == id), "{seen:?}");
    assert!(matches!(&seen.last().expect("events").event, Some(Event::Done(done)) if done.state() == State::Succeeded));
    let whole = all(rigs.watch_rig(watch(Some(0))).await.expect("a stream").into_inner()).await;
    let numbers: Vec<u64> = whole.iter().map(|event| event.sequence).collect();
    assert_eq!(numbers, (1..=numbers.len() as u64).collect::<Vec<_>>());
    assert!(whole.iter().any(|event| matches!(&event.event, Some(Event::Artifact(made)) if made.name == "rigged.glb")));
    assert!(whole.iter().any(|event| matches!(&event.event, Some(Event::Warning(told)) if told.code == "scripted")));
    let rest = all(rigs.watch_rig(watch(Some(numbers[2]))).await.expect("a stream").into_inner()).await;
    assert_eq!(rest, whole[3..]);
    let none = all(rigs.watch_rig(watch(numbers.last().copied())).await.expect("a stream").into_inner()).await;
    assert_eq!(none, []);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn operations_wait_cancel_and_tell_where_the_job_stands() {
    let service = Service::new();
    let id = create(&service, "hang").await;
    let name = format!("operations/{id}");
    let mut operations = door(&service).operations();
    service.until(&format!("/v1/rigs/{id}"), "running").await;
    let timeout = prost_types::Duration { seconds: 0, nanos: 20_000_000 };
    let asked = WaitOperationRequest { name: name.clone(), timeout: Some(timeout) };
    let waited = operations.wait_operation(asked).await.expect("an operation").into_inner();
    let metadata = RigMetadata::decode(&*waited.metadata.expect("metadata").value).expect("metadata");
    assert_eq!((waited.done, metadata.rig.as_str(), metadata.state()), (false, id.as_str(), State::Running));
    operations.cancel_operation(CancelOperationRequest { name: name.clone() }).await.expect("canceled");
    service.until(&format!("/v1/rigs/{id}"), "canceled").await;
    let ended = operations.get_operation(GetOperationRequest { name: name.clone() }).await.expect("one").into_inner();
    use rigsmith::server::grpc::proto::google::longrunning::operation::Result as Ended;
    match ended.result {
        Some(Ended::Error(error)) => {
            assert_eq!((error.code, info(&error.details).reason.as_str()), (Code::Cancelled as i32, "canceled"));
        }
        other => panic!("{other:?}"),
    }
    let listed = operations.list_operations(ListOperationsRequest::default()).await.expect("a list").into_inner();
    assert_eq!(listed.operations.iter().map(|one| one.name.as_str()).collect::<Vec<_>>(), [name.as_str()]);
    let filtered = ListOperationsRequest { filter: "done".to_owned(), ..ListOperationsRequest::default() };
    let refused = operations.list_operations(filtered).await.expect_err("not supported");
    assert_eq!(
        (refused.code(), info(&details(&refused)).reason.as_str()),
        (Code::InvalidArgument, "invalid_parameter")
    );
    let nowhere = operations.get_operation(GetOperationRequest { name: id }).await.expect_err("no name");
    assert_eq!(nowhere.code(), Code::NotFound);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_deadline_of_the_call_is_that_of_the_job_unless_it_has_its_own() {
    let service = Service::new();
    let mut asked = Request::new(order("hang"));
    asked.set_timeout(Duration::from_millis(400));
    let operation = door(&service).rigs().create_rig(asked).await.expect("taken").into_inner();
    let id = operation.name.strip_prefix("operations/").expect("a name").to_owned();
    let failed = service.until(&format!("/v1/rigs/{id}"), "failed").await;
    assert_eq!(failed["error"]["code"], "timeout");
    let mut own = order("sleep 900");
    own.options.get_or_insert_default().timeout_seconds = Some(20);
    let mut asked = Request::new(own);
    asked.set_timeout(Duration::from_millis(400));
    let operation = door(&service).rigs().create_rig(asked).await.expect("taken").into_inner();
    let id = operation.name.strip_prefix("operations/").expect("a name").to_owned();
    service.until(&format!("/v1/rigs/{id}"), "succeeded").await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn health_says_what_readyz_says() {
    let service = Service::new();
    let mut health = HealthClient::new(service.router.clone());
    let ask = |service: &str| HealthCheckRequest { service: service.to_owned() };
    for known in ["", "rigsmith.v1.RigService", "google.longrunning.Operations"] {
        let told = health.check(ask(known)).await.expect("a status").into_inner();
        assert_eq!(told.status(), ServingStatus::Serving, "{known}");
    }
    assert_eq!(health.check(ask("other")).await.expect_err("unknown").code(), Code::NotFound);
    let mut watched = health.watch(ask("")).await.expect("a stream").into_inner();
    assert_eq!(watched.message().await.expect("told").expect("a status").status(), ServingStatus::Serving);
    *service.rigger.readiness.lock().expect("not poisoned") = Readiness::Starting;
    assert_eq!(watched.message().await.expect("told").expect("a status").status(), ServingStatus::NotServing);
    assert_eq!(health.check(ask("")).await.expect("a status").into_inner().status(), ServingStatus::NotServing);
}

#[tokio::test]
async fn what_is_not_there_is_told_in_the_words_of_the_protocol() {
    let service = Service::new();
    for path in ["/rigsmith.v1.RigService/Nothing", "/other.Service/Method"] {
        let answer = service.send(request("POST", path, &[("content-type", "application/grpc")], "")).await;
        let unimplemented = (Code::Unimplemented as i32).to_string();
        assert_eq!((answer.status.as_u16(), answer.header("grpc-status")), (200, unimplemented.as_str()), "{path}");
    }
    service.get("/rigsmith.v1.RigService/GetRig").await.refused(405, "method_not_allowed");
    let refused = door(&service).rigs().get_rig(GetRigRequest { id: "nobody".to_owned() }).await.expect_err("unknown");
    assert!(refused.metadata().contains_key("x-request-id"), "the operator can find it: {refused:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_port_speaks_both_protocols_and_a_stopping_service_says_when_to_come_back() {
    let service = Service::with(|_, limits| limits.grace = Duration::from_millis(100));
    let mut running = start(&service).await;
    let channel = tonic::transport::Endpoint::from_shared(running.base.clone()).expect("an address");
    let mut rigs = RigServiceClient::new(channel.connect().await.expect("a connection"));
    let done = service.finished("ok").await["id"].as_str().expect("an id").to_owned();
    let asked = DownloadArtifactRequest { id: done, name: "rigged.glb".to_owned(), offset: 0 };
    let mut chunks = rigs.download_artifact(asked).await.expect("a stream").into_inner();
    let mut bytes = 0;
    while let Some(chunk) = chunks.message().await.expect("a chunk") {
        bytes += chunk.data.len();
    }
    assert_eq!(bytes, GLB_BYTES);
    let operation = rigs.create_rig(order("hang")).await.expect("taken").into_inner();
    let id = operation.name.strip_prefix("operations/").expect("a name").to_owned();
    let mut events = rigs.watch_rig(WatchRigRequest { id, after_sequence: None }).await.expect("a stream").into_inner();
    assert!(events.message().await.expect("told").is_some());
    running.stop();
    let stopped = loop {
        match events.message().await {
            Ok(Some(_)) => {}
            Ok(None) => panic!("a stream that stops early says so"),
            Err(status) => break status,
        }
    };
    assert_eq!((stopped.code(), info(&details(&stopped)).reason.as_str()), (Code::Unavailable, "draining"));
    running.ended().await;
}

/// An HTTP/2 connection to the service, and the end of it.
async fn http2(base: &str) -> (hyper::client::conn::http2::SendRequest<Empty<Bytes>>, tokio::task::JoinHandle<()>) {
    let stream = tokio::net::TcpStream::connect(base.trim_start_matches("http://")).await.expect("connects");
    let mut client = hyper::client::conn::http2::Builder::new(TokioExecutor::new());
    client.initial_stream_window_size(1024).initial_connection_window_size(1 << 20);
    let (sender, connection) = client.handshake(TokioIo::new(stream)).await.expect("HTTP/2");
    let ended = tokio::spawn(async move {
        // However it ends, it is over.
        let _ = connection.await;
    });
    (sender, ended)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn rest_speaks_http2_too_and_an_answer_that_is_not_taken_is_given_up() {
    let service = Service::with(|_, limits| limits.connection.write_pause_max = Duration::from_millis(300));
    let running = start(&service).await;
    let url = service.finished("ok").await["result"]["artifacts"][0]["url"].as_str().expect("a url").to_owned();
    let (mut sender, ended) = http2(&running.base).await;
    let get = |path: &str| {
        let uri = format!("{}{path}", running.base);
        hyper::Request::get(uri).body(Empty::<Bytes>::new()).expect("a request")
    };
    let ready = sender.send_request(get("/readyz")).await.expect("an answer");
    assert_eq!(ready.status(), 200);
    assert!(ready.into_body().collect().await.is_ok());
    // The window lets 1 KiB through; nothing of the rest is ever asked for.
    let untaken = sender.send_request(get(&url)).await.expect("an answer");
    tokio::time::timeout(Duration::from_secs(5), ended).await.expect("closed").expect("no panic");
    drop(untaken);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn http2_connections_without_requests_or_with_half_a_preface_are_cut_off() {
    let service = Service::with(|_, limits| {
        limits.connection.header_time_max = Duration::from_millis(200);
        limits.connection.connections_max = 1;
    });
    let running = start(&service).await;
    let began = Instant::now();
    let (_sender, ended) = http2(&running.base).await;
    tokio::time::timeout(Duration::from_secs(5), ended).await.expect("closed").expect("no panic");
    let address = running.base.trim_start_matches("http://").to_owned();
    let answer = tokio::task::spawn_blocking(move || {
        let mut socket = TcpStream::connect(address).expect("connects");
        socket.set_read_timeout(Some(Duration::from_secs(5))).expect("a timeout");
        socket.write_all(b"PRI * HTTP/2.0\r\n").expect("sends");
        let mut answer = Vec::new();
        socket.read_to_end(&mut answer).map(|_| answer)
    });
    assert_eq!(answer.await.expect("a call").expect("an end"), b"");
    assert!(began.elapsed() < Duration::from_secs(5), "{:?}", began.elapsed());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_upload_that_pauses_too_long_is_refused_and_leaves_nothing() {
    let service = Service::new();
    let file = UploadFile { name: "hero.obj".to_owned(), main: true };
    let first = UploadChunk { part: Some(Part::File(file)), request_id: String::new() };
    let (sent, chunks) = tokio::sync::mpsc::channel(1);
    sent.send(first).await.expect("sent");
    let chunks = tokio_stream::wrappers::ReceiverStream::new(chunks);
    let refused = door(&service).rigs().upload_asset(chunks).await.expect_err("too slow");
    assert_eq!((refused.code(), info(&details(&refused)).reason.as_str()), (Code::DeadlineExceeded, "upload_timeout"));
    drop(sent);
    service.keeps(0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_file_marked_main_is_the_mesh_and_a_stream_must_make_sense() {
    let service = Service::new();
    let file = |name: &str, main| Some(Part::File(UploadFile { name: name.to_owned(), main }));
    let data = |text: &'static str| Some(Part::Data(text.into()));
    let upload = |parts: Vec<Option<Part>>| {
        let chunks: Vec<_> = parts.into_iter().map(|part| UploadChunk { part, request_id: String::new() }).collect();
        let mut rigs = door(&service).rigs();
        async move { rigs.upload_asset(tokio_stream::iter(chunks)).await }
    };
    let two = vec![file("a.obj", false), data("ok 1"), file("b.obj", true), data("ok 2")];
    assert_eq!(upload(two).await.expect("kept").into_inner().files[0].name, "b.obj");
    for parts in [
        vec![],
        vec![None],
        vec![data("ok")],
        vec![file("a.obj", false), data("ok 1"), file("b.obj", false), data("ok 2")],
        vec![file("a.obj", true), data("ok 1"), file("b.obj", true), data("ok 2")],
    ] {
        let shown = format!("{parts:?}");
        assert_eq!(upload(parts).await.expect_err("refused").code(), Code::InvalidArgument, "{shown}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_batch_is_an_operation_that_can_be_canceled() {
    let service = Service::new();
    let _running = start(&service).await;
    let door = door(&service);
    let kept = service.send(request("POST", "/v1/assets", &[("content-type", "model/obj")], "hang")).await.json();
    let asset = kept["id"].as_str().expect("an id").to_owned();
    let item = |number: u32| BatchItem { custom_id: number.to_string(), asset: asset.clone(), options: None };
    let asked = CreateBatchRequest { items: (0..3).map(item).collect(), ..CreateBatchRequest::default() };
    let operation = door.rigs().create_batch(asked).await.expect("taken").into_inner();
    let batch = Batch::decode(&*operation.metadata.expect("metadata").value).expect("a batch");
    assert_eq!((operation.name.clone(), operation.done), (format!("operations/{}", batch.id), false));
    let name = operation.name;
    let waited = WaitOperationRequest {
        name: name.clone(),
        timeout: Some(Duration::from_millis(20).try_into().expect("a duration")),
    };
    assert!(!door.operations().wait_operation(waited).await.expect("answers").into_inner().done);
    let deleted = door.operations().delete_operation(DeleteOperationRequest { name: name.clone() }).await;
    assert_eq!(deleted.expect_err("it stays").code(), Code::Unimplemented);
    door.operations().cancel_operation(CancelOperationRequest { name: name.clone() }).await.expect("answers");
    let over = WaitOperationRequest { name: name.clone(), timeout: None };
    let over = door.operations().wait_operation(over).await.expect("answers").into_inner();
    let Some(OperationResult::Error(error)) = over.result else { panic!("{over:?}") };
    assert_eq!(info(&error.details).reason, "canceled");
    assert_eq!(Batch::decode(&*over.metadata.expect("metadata").value).expect("a batch").canceled, 3);
    let strange = GetOperationRequest { name: "operations/bat_00000000000000000000000000".to_owned() };
    assert_eq!(door.operations().get_operation(strange).await.expect_err("none").code(), Code::NotFound);
}
