//! The real program, killed while it works: the small sister of `tests/reliability/kills.py`.

use serde_json::Value;
use sha2::{Digest, Sha256};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

struct Service {
    child: Child,
    base: String,
}

impl Service {
    fn start(data: &Path, port: u16) -> Self {
        let child = Command::new(env!("CARGO_BIN_EXE_rigsmith"))
            .args(["serve", "--listen", &format!("127.0.0.1:{port}"), "--workers", "1"])
            .arg("--data")
            .arg(data)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        let service = Self { child, base: format!("http://127.0.0.1:{port}") };
        let until = Instant::now() + Duration::from_secs(120);
        while service.get("/readyz").is_none_or(|(status, _)| status != 200) {
            assert!(Instant::now() < until, "the service did not start");
            std::thread::sleep(Duration::from_millis(50));
        }
        service
    }

    fn agent() -> ureq::Agent {
        let config =
            ureq::Agent::config_builder().http_status_as_error(false).timeout_global(Some(Duration::from_secs(20)));
        config.build().into()
    }

    fn get(&self, path: &str) -> Option<(u16, Vec<u8>)> {
        let mut answer = Self::agent().get(format!("{}{path}", self.base)).call().ok()?;
        Some((answer.status().as_u16(), answer.body_mut().read_to_vec().ok()?))
    }

    fn submit(&self, mesh: &str) -> Option<Value> {
        let post = Self::agent().post(format!("{}/v1/rigs", self.base)).header("content-type", "model/obj");
        let mut answer = post.send(mesh).ok()?;
        assert_eq!(answer.status().as_u16(), 202);
        serde_json::from_str(&answer.body_mut().read_to_string().ok()?).ok()
    }

    /// Posts `body`; the answer when it is JSON.
    fn post(&self, path: &str, media_type: &str, body: &str) -> Value {
        let post = Self::agent().post(format!("{}{path}", self.base)).header("content-type", media_type);
        let mut answer = post.send(body).expect("an answer");
        serde_json::from_str(&answer.body_mut().read_to_string().expect("a body")).expect("JSON")
    }

    fn kill(mut self) {
        self.child.kill().expect("is killed");
        self.child.wait().expect("ends");
    }
}

/// A figure of boxes: a body, a head, two arms and two legs, of `size`.
fn figure(size: f64) -> String {
    let boxes = [
        ([0.0, 1.1, 0.0], [0.25, 0.35, 0.15]),
        ([0.0, 1.65, 0.0], [0.15, 0.2, 0.15]),
        ([-0.6, 1.35, 0.0], [0.4, 0.08, 0.08]),
        ([0.6, 1.35, 0.0], [0.4, 0.08, 0.08]),
        ([-0.15, 0.4, 0.0], [0.1, 0.4, 0.1]),
        ([0.15, 0.4, 0.0], [0.1, 0.4, 0.1]),
    ];
    let corners = [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]];
    let faces = [[1, 4, 3, 2], [5, 6, 7, 8], [1, 2, 6, 5], [2, 3, 7, 6], [3, 4, 8, 7], [4, 1, 5, 8]];
    let mut text = String::new();
    for (index, (centre, half)) in boxes.iter().enumerate() {
        for corner in corners {
            let place = |axis: usize| size * (centre[axis] + half[axis] * f64::from(corner[axis]));
            text += &format!("v {:.5} {:.5} {:.5}\n", place(0), place(1), place(2));
        }
        for face in faces {
            let corner: Vec<String> = face.iter().map(|corner| (corner + 8 * index).to_string()).collect();
            text += &format!("f {}\n", corner.join(" "));
        }
    }
    text
}

#[test]
fn a_few_kills_lose_no_job_and_break_no_file() {
    const JOBS: usize = 8;
    const KILLS: u64 = 3;
    let folder = tempfile::tempdir().expect("folder");
    let port = TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr()).expect("a port").port();
    let mut service = Service::start(folder.path(), port);
    let mut accepted = Vec::new();
    for kill in 0..=KILLS {
        for number in 0..JOBS / (KILLS as usize + 1) {
            let size = 1.0 + 0.01 * (kill as f64 * 10.0 + number as f64);
            let job = service.submit(&figure(size)).expect("an answer");
            accepted.push(job["links"]["self"].as_str().expect("a link").to_owned());
        }
        if kill < KILLS {
            std::thread::sleep(Duration::from_millis(150 + 400 * kill));
            service.kill();
            service = Service::start(folder.path(), port);
        }
    }
    let until = Instant::now() + Duration::from_secs(300);
    for path in &accepted {
        let job = loop {
            let (status, body) = service.get(path).expect("an answer");
            assert_eq!(status, 200, "an accepted job is there: {path}");
            let job: Value = serde_json::from_slice(&body).expect("JSON");
            if !["queued", "running"].contains(&job["state"].as_str().expect("a state")) {
                break job;
            }
            assert!(Instant::now() < until, "{job:#}");
            std::thread::sleep(Duration::from_millis(100));
        };
        if job["state"] == "failed" {
            // A job may see two kills; then it says so.
            assert_eq!(job["error"]["code"], "worker_lost", "{job:#}");
            continue;
        }
        for artifact in job["result"]["artifacts"].as_array().expect("artifacts") {
            let (status, bytes) = service.get(artifact["url"].as_str().expect("a url")).expect("an answer");
            let digest: String = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
            assert_eq!((status, artifact["sha256"].as_str()), (200, Some(digest.as_str())));
        }
    }
    service.kill();
}

/// The small sister of `tests/reliability/batch.py`.
#[test]
fn a_batch_killed_twice_in_the_middle_ends_whole_and_in_order() {
    const ITEMS: usize = 12;
    let broken = |number: usize| number % 5 == 3;
    let folder = tempfile::tempdir().expect("folder");
    let port = TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr()).expect("a port").port();
    let mut service = Service::start(folder.path(), port);
    let mut lines = String::new();
    for number in 0..ITEMS {
        let mesh = if broken(number) { "v 0 0 0\n".repeat(number) } else { figure(1.0 + 0.01 * number as f64) };
        let asset = service.post("/v1/assets", "model/obj", &mesh);
        lines += &format!("{{\"custom_id\": \"figure-{number}\", \"request\": {{\"asset\": {}}}}}\n", asset["id"]);
    }
    let batch = service.post("/v1/batches", "application/jsonl", &lines);
    let path = batch["links"]["self"].as_str().expect("a link").to_owned();
    let state = |service: &Service| {
        let (_, body) = service.get(&path).expect("an answer");
        serde_json::from_slice::<Value>(&body).expect("JSON")
    };
    let until = Instant::now() + Duration::from_secs(300);
    for over in [2, 6, ITEMS] {
        loop {
            let counts = state(&service)["counts"].clone();
            let ended: u64 = ["succeeded", "failed", "canceled"].iter().filter_map(|name| counts[name].as_u64()).sum();
            if ended >= over as u64 {
                break;
            }
            assert!(Instant::now() < until, "{counts}");
            std::thread::sleep(Duration::from_millis(50));
        }
        if over < ITEMS {
            service.kill();
            service = Service::start(folder.path(), port);
        }
    }
    let (status, body) = service.get(&format!("{path}/results")).expect("an answer");
    assert_eq!(status, 200);
    let body = String::from_utf8(body).expect("text");
    let results: Vec<Value> = body.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    assert_eq!(results.len(), ITEMS);
    for (number, result) in results.iter().enumerate() {
        assert_eq!(result["custom_id"], format!("figure-{number}"));
        if broken(number) {
            assert_eq!(result["error"]["code"], "no_geometry", "{result:#}");
        } else {
            assert_eq!(result["rig"]["state"], "succeeded", "{result:#}");
        }
    }
    let (_, body) = service.get("/v1/rigs?page_size=100").expect("an answer");
    let jobs: Value = serde_json::from_slice(&body).expect("JSON");
    assert_eq!(jobs["data"].as_array().map(Vec::len), Some(ITEMS), "no item became two jobs");
    service.kill();
}
