//! What an operator sees of a running service: metrics, traces, log lines, and how it stops.

use super::examples::figure;
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::time::{Duration, Instant};

const TRACE: &str = "4bf92f3577b34da6a3ce929d0e0e4736";

/// A collector of traces: gives each request that it got, head and body.
fn collector() -> (String, mpsc::Receiver<(String, Vec<u8>)>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = format!("http://{}", listener.local_addr().expect("an address"));
    let (sender, received) = mpsc::channel();
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let _ = take(stream, &sender);
        }
    });
    (address, received)
}

fn take(stream: TcpStream, sender: &mpsc::Sender<(String, Vec<u8>)>) -> std::io::Result<()> {
    let mut reader = BufReader::new(stream);
    loop {
        let mut head = String::new();
        while !head.ends_with("\r\n\r\n") {
            if reader.read_line(&mut head)? == 0 {
                return Ok(());
            }
        }
        let head = head.to_lowercase();
        let length = head.lines().find_map(|line| line.strip_prefix("content-length: ")?.trim().parse().ok());
        let mut body = vec![0; length.unwrap_or(0)];
        reader.read_exact(&mut body)?;
        let _ = sender.send((head, body));
        reader.get_mut().write_all(b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n")?;
    }
}

fn free_address() -> String {
    TcpListener::bind("127.0.0.1:0").and_then(|free| free.local_addr()).expect("an address").to_string()
}

fn ended(process: &mut Child) -> bool {
    let until = Instant::now() + Duration::from_secs(60);
    while Instant::now() < until {
        if process.try_wait().expect("a child").is_some() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    false
}

#[test]
fn an_operator_sees_requests_and_jobs_in_metrics_traces_and_the_log() {
    let folder = tempfile::tempdir().expect("folder");
    let (endpoint, traces) = collector();
    let metrics = free_address();
    let log = std::fs::File::create(folder.path().join("log.jsonl")).expect("a log");
    let mut process = Command::new(env!("CARGO_BIN_EXE_rigsmith"))
        .args(["serve", "--listen", "127.0.0.1:0", "--metrics-listen", &metrics, "--log-format", "json"])
        .args(["--otlp-endpoint", &endpoint, "--otlp-headers", "authorization=Bearer s3cret"])
        .current_dir(folder.path())
        .env_remove("ORT_DYLIB_PATH")
        .stdout(Stdio::piped())
        .stderr(log)
        .spawn()
        .expect("the program starts");
    let mut line = String::new();
    BufReader::new(process.stdout.take().expect("output")).read_line(&mut line).expect("a line");
    let host = line.split_whitespace().find(|word| word.starts_with("http://")).expect("an address");
    let agent = ureq::Agent::new_with_defaults();
    let request = agent
        .post(format!("{host}/v1/rigs?file_name=hero.obj"))
        .header("content-type", "model/obj")
        .header("prefer", "wait=60")
        .header("x-request-id", "seen-in-the-log")
        .header("traceparent", format!("00-{TRACE}-00f067aa0ba902b7-01"));
    // The figure names materials that are not sent.
    let mesh = figure().replace("mtllib hero.mtl\nusemtl skin\n", "");
    let job: Value = request.send(mesh.as_bytes()).expect("an answer").body_mut().read_json().expect("JSON");
    assert_eq!(job["state"], "succeeded", "{job:#}");

    let told = agent.get(format!("http://{metrics}/metrics")).call().expect("metrics").body_mut().read_to_string();
    let told = told.expect("text");
    for line in [
        "rigsmith_http_requests_total{route=\"/v1/rigs\",method=\"POST\",status=\"200\"} 1",
        "rigsmith_jobs_total{method=\"rignet\",state=\"succeeded\",error=\"\"} 1",
        "rigsmith_stage_seconds_count{stage=\"geometry\"} 1",
        "rigsmith_jobs_waiting 0",
        "rigsmith_model_self_test_passed{model=\"rignet_skin\"} 1",
        "rigsmith_process_resident_bytes",
    ] {
        assert!(told.contains(line), "{line} in\n{told}");
    }

    Command::new("kill").args(["-TERM", &process.id().to_string()]).status().expect("kill");
    assert!(ended(&mut process), "it stops when it is asked to");
    let (head, body) = traces.recv_timeout(Duration::from_secs(10)).expect("traces arrive");
    assert!(head.starts_with("post /v1/traces ") && head.contains("authorization: bearer s3cret"), "{head}");
    let trace: Vec<u8> = (0..16).map(|at| u8::from_str_radix(&TRACE[2 * at..2 * at + 2], 16).expect("hex")).collect();
    assert!(body.windows(16).any(|window| window == trace), "the caller's trace is taken up");

    let log = std::fs::read_to_string(folder.path().join("log.jsonl")).expect("the log");
    let lines: Vec<Value> = log.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
    let answered = lines.iter().find(|line| line.to_string().contains("answered 200"));
    let answered = answered.expect("a line for the request").to_string();
    assert!(answered.contains(job["id"].as_str().expect("an id")), "{answered}");
    assert!(log.contains("seen-in-the-log") && log.contains(TRACE), "{log}");
    assert!(!log.contains("s3cret"), "secrets are not logged");
}
