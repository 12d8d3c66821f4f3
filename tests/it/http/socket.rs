//! The service on a real socket: start, work, stop.

use super::scripted::{Service, glb};
use rigsmith::server::run;
use serde_json::Value;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

struct Running {
    base: String,
    stop: Option<oneshot::Sender<()>>,
    ended: JoinHandle<std::io::Result<()>>,
}

async fn start(service: &Service) -> Running {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let base = format!("http://{}", listener.local_addr().expect("address"));
    let (stop, stopped) = oneshot::channel::<()>();
    let shutdown = async {
        let _ = stopped.await;
    };
    let ended = tokio::spawn(run(listener, shutdown, service.state.clone()));
    Running { base, stop: Some(stop), ended }
}

/// `ureq` blocks, so it gets a thread.
async fn call<T: Send + 'static>(work: impl FnOnce(ureq::Agent) -> T + Send + 'static) -> T {
    let agent: ureq::Agent = ureq::Agent::config_builder().http_status_as_error(false).build().into();
    tokio::task::spawn_blocking(move || work(agent)).await.expect("a call")
}

async fn post(base: &str, script: &'static str, wait: &'static str) -> (u16, Value) {
    let url = format!("{base}/v1/rigs");
    call(move |agent| {
        let mut answer = agent
            .post(&url)
            .header("content-type", "model/obj")
            .header("prefer", wait)
            .send(script)
            .expect("an answer");
        (
            answer.status().as_u16(),
            serde_json::from_str(&answer.body_mut().read_to_string().expect("a body")).expect("JSON"),
        )
    })
    .await
}

async fn get(base: &str, path: &str) -> (u16, Vec<u8>) {
    let url = format!("{base}{path}");
    call(move |agent| {
        let mut answer = agent.get(&url).call().expect("an answer");
        (answer.status().as_u16(), answer.body_mut().read_to_vec().expect("a body"))
    })
    .await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_mesh_goes_in_and_the_rig_comes_out_over_a_socket() {
    let service = Service::new();
    let mut running = start(&service).await;
    let (status, job) = post(&running.base, "ok", "wait=10").await;
    assert_eq!((status, &job["state"]), (200, &"succeeded".into()));
    let (status, bytes) = get(&running.base, job["result"]["artifacts"][0]["url"].as_str().expect("a url")).await;
    assert_eq!((status, bytes), (200, glb()));
    drop(running.stop.take());
    running.ended.await.expect("no panic").expect("a clean end");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_caller_who_hangs_up_within_the_upload_leaves_nothing() {
    let service = Service::new();
    let running = start(&service).await;
    let address = running.base.trim_start_matches("http://").to_owned();
    tokio::task::spawn_blocking(move || {
        let mut socket = TcpStream::connect(address).expect("connects");
        let head = "POST /v1/rigs HTTP/1.1\r\nHost: x\r\nContent-Type: model/obj\r\nContent-Length: 100\r\n\r\nhalf";
        socket.write_all(head.as_bytes()).expect("sends");
        std::thread::sleep(Duration::from_millis(50));
    })
    .await
    .expect("a call");
    for _ in 0..300 {
        if service.files() == 0 {
            return assert_eq!(service.get("/v1/rigs").await.json()["data"], serde_json::json!([]));
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    panic!("the upload is still there");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_body_that_is_too_large_is_refused_before_it_is_sent() {
    let service = Service::with(|_, limits| limits.upload_bytes_max = 1000);
    let running = start(&service).await;
    let address = running.base.trim_start_matches("http://").to_owned();
    let answer = tokio::task::spawn_blocking(move || {
        let mut socket = TcpStream::connect(address).expect("connects");
        socket.set_read_timeout(Some(Duration::from_secs(5))).expect("a timeout");
        let head = "POST /v1/rigs HTTP/1.1\r\nHost: x\r\nContent-Type: model/obj\r\n\
                    Content-Length: 10000000000\r\nExpect: 100-continue\r\n\r\n";
        socket.write_all(head.as_bytes()).expect("sends");
        let mut answer = [0; 12];
        socket.read_exact(&mut answer).expect("an answer");
        String::from_utf8_lossy(&answer).into_owned()
    })
    .await
    .expect("a call");
    assert_eq!(answer, "HTTP/1.1 413");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn stopping_lets_running_jobs_finish_and_keeps_the_waiting_ones() {
    let service = Service::with(|settings, _| settings.workers = 1);
    let mut running = start(&service).await;
    let (_, working) = post(&running.base, "sleep 600", "wait=0").await;
    let path = working["links"]["self"].as_str().expect("a link").to_owned();
    service.until(&path, "running").await;
    let (_, waiting) = post(&running.base, "ok", "wait=0").await;
    drop(running.stop.take());
    tokio::time::sleep(Duration::from_millis(50)).await;
    assert_eq!(get(&running.base, "/readyz").await.0, 503, "callers can still look");
    let (status, refused) = post(&running.base, "ok", "wait=0").await;
    assert_eq!((status, &refused["code"]), (503, &"draining".into()));
    let told = service.get(waiting["links"]["self"].as_str().expect("a link")).await.json();
    assert_eq!((&told["state"], &told["error"]), (&"queued".into(), &Value::Null), "it goes on at the next start");
    service.until(&path, "succeeded").await;
    running.ended.await.expect("no panic").expect("a clean end");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn after_the_grace_running_jobs_go_back_to_the_queue() {
    let service = Service::with(|_, limits| limits.grace = Duration::from_millis(50));
    let mut running = start(&service).await;
    let (_, working) = post(&running.base, "hang", "wait=0").await;
    let path = working["links"]["self"].as_str().expect("a link").to_owned();
    service.until(&path, "running").await;
    let began = Instant::now();
    drop(running.stop.take());
    service.until(&path, "queued").await;
    running.ended.await.expect("no panic").expect("a clean end");
    assert!(began.elapsed() < Duration::from_secs(8));
}
