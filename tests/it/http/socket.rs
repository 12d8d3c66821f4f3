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

pub struct Running {
    pub base: String,
    stop: Option<oneshot::Sender<()>>,
    ended: JoinHandle<std::io::Result<()>>,
}

impl Running {
    /// Asks the service to stop.
    pub fn stop(&mut self) {
        drop(self.stop.take());
    }

    /// Waits for a clean end.
    pub async fn ended(self) {
        self.ended.await.expect("no panic").expect("a clean end");
    }
}

pub async fn start(service: &Service) -> Running {
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
async fn stopping_tells_those_who_wait_which_job_is_theirs() {
    let service = Service::with(|_, limits| limits.grace = Duration::from_millis(100));
    let mut running = start(&service).await;
    let base = running.base.clone();
    let waiting = tokio::spawn(async move { post(&base, "hang", "wait=60").await });
    tokio::time::sleep(Duration::from_millis(300)).await;
    let began = Instant::now();
    drop(running.stop.take());
    let (status, job) = waiting.await.expect("an answer");
    assert!(status == 202 && job["id"].is_string() && began.elapsed() < Duration::from_secs(5), "{status}: {job:#}");
    running.ended.await.expect("no panic").expect("a clean end");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn stopping_ends_streams_of_events_and_says_when_to_come_back() {
    let service = Service::with(|_, limits| limits.grace = Duration::from_millis(100));
    let mut running = start(&service).await;
    let (_, job) = post(&running.base, "hang", "wait=0").await;
    let path = job["links"]["events"].as_str().expect("a link").to_owned();
    let (base, watched) = (running.base.clone(), path);
    let watching = tokio::spawn(async move { get(&base, &watched).await });
    service.until(job["links"]["self"].as_str().expect("a link"), "running").await;
    tokio::time::sleep(Duration::from_millis(100)).await;
    drop(running.stop.take());
    let (status, text) = watching.await.expect("an end");
    let text = String::from_utf8(text).expect("text");
    assert!(status == 200 && text.contains("event: snapshot") && text.trim_end().ends_with("retry: 5000"), "{text}");
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

/// Sends `bytes` on a connection of its own and gives all that comes back until the service closes it.
async fn exchange(base: &str, bytes: Vec<u8>) -> (String, Duration) {
    let address = base.trim_start_matches("http://").to_owned();
    tokio::task::spawn_blocking(move || {
        let mut socket = TcpStream::connect(address).expect("connects");
        socket.set_read_timeout(Some(Duration::from_secs(5))).expect("a timeout");
        let began = Instant::now();
        // The service may refuse and close before it has read everything.
        let _ = socket.write_all(&bytes);
        let mut answer = Vec::new();
        let _ = socket.read_to_end(&mut answer);
        (String::from_utf8_lossy(&answer).into_owned(), began.elapsed())
    })
    .await
    .expect("a call")
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_header_that_trickles_or_never_comes_is_cut_off() {
    let service = Service::with(|_, limits| limits.connection.header_time_max = Duration::from_millis(200));
    let running = start(&service).await;
    for begun in ["", "GET /livez HTTP/1.1\r\nHost: x\r\nX-Slow: "] {
        let (answer, took) = exchange(&running.base, begun.into()).await;
        assert!(answer.is_empty() || answer.starts_with("HTTP/1.1 408"), "{answer}");
        assert!((Duration::from_millis(150)..Duration::from_secs(2)).contains(&took), "{took:?}");
    }
    assert_eq!(get(&running.base, "/livez").await.0, 200);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn headers_beyond_the_limit_are_refused_and_nonsense_is_too() {
    let service = Service::new();
    let running = start(&service).await;
    let with =
        |field: String| format!("GET /livez HTTP/1.1\r\nHost: x\r\n{field}Connection: close\r\n\r\n").into_bytes();
    let many: String = (0..200).map(|index| format!("X-{index}: y\r\n")).collect();
    for (bytes, status) in [
        (with(format!("X-Big: {}\r\n", "y".repeat(30 * 1024))), "200"),
        (with(format!("X-Big: {}\r\n", "y".repeat(70 * 1024))), "431"),
        (with(many), "431"),
        (b"nonsense\r\n\r\n".to_vec(), "400"),
        (with("Content-Length: 5\r\nContent-Length: 6\r\n".to_owned()), "400"),
        (with("Content-Length: -1\r\n".to_owned()), "400"),
        (b"GET /livez HTTP/1.1\r\nHost: x\r\nBad Name: y\r\n\r\n".to_vec(), "400"),
    ] {
        let (answer, _) = exchange(&running.base, bytes).await;
        assert!(answer.starts_with(&format!("HTTP/1.1 {status}")), "{status}: {}", answer.get(..60).unwrap_or(&answer));
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_caller_who_takes_no_answer_is_left() {
    let service = Service::with(|_, limits| {
        limits.connection.write_pause_max = Duration::from_millis(300);
        limits.connection.connections_max = 1;
    });
    let running = start(&service).await;
    let done = service.rig("", &[("prefer", "wait=10")], "ok").await.json();
    let url = done["result"]["artifacts"][0]["url"].as_str().expect("a url").to_owned();
    let asked = format!("GET {url} HTTP/1.1\r\nHost: x\r\n\r\n").repeat(60);
    let mut socket = TcpStream::connect(running.base.trim_start_matches("http://")).expect("connects");
    socket.write_all(asked.as_bytes()).expect("sends");
    // The only place is free again although the first caller neither reads nor goes.
    let answered = tokio::time::timeout(Duration::from_secs(10), get(&running.base, "/livez")).await;
    assert_eq!(answered.expect("an answer").0, 200);
    drop(socket);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_body_of_another_length_than_declared_is_refused_or_cut() {
    let service = Service::new();
    let running = start(&service).await;
    let post = |fields: &str, body: &str| {
        format!("POST /v1/rigs HTTP/1.1\r\nHost: x\r\nContent-Type: model/obj\r\n{fields}\r\n\r\n{body}").into_bytes()
    };
    // Too short: the sender pauses for longer than it may.
    let (answer, _) = exchange(&running.base, post("Content-Length: 100\r\nConnection: close", "ok")).await;
    assert!(answer.starts_with("HTTP/1.1 408") && answer.contains("upload_timeout"), "{answer}");
    // Too long: what follows the body is another request, and no sound one.
    let (answer, _) = exchange(&running.base, post("Content-Length: 2", "ok and more\r\n\r\n")).await;
    assert!(answer.starts_with("HTTP/1.1 202") && answer.contains("HTTP/1.1 400"), "{answer}");
    for chunks in ["zz\r\nok\r\n0\r\n\r\n", "5\r\nok"] {
        let (answer, _) =
            exchange(&running.base, post("Transfer-Encoding: chunked\r\nConnection: close", chunks)).await;
        assert!(answer.starts_with("HTTP/1.1 4"), "{answer}");
    }
    let both = post("Content-Length: 2\r\nTransfer-Encoding: chunked\r\nConnection: close", "2\r\nok\r\n0\r\n\r\n");
    let (answer, _) = exchange(&running.base, both).await;
    assert!(answer.starts_with("HTTP/1.1 4") || answer.starts_with("HTTP/1.1 2"), "one of the two counts: {answer}");
}
