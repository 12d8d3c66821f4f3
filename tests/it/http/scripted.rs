//! A rigger that does what the uploaded file says, and what is needed to talk to it through the router.
//!
//! A script is one line: `ok`, `sleep MS`, `fail CODE`, `panic`, `hang` (until cancelled), `deaf MS` (sleeps, ignoring
//! cancellation), `eat MIB` (holds memory until cancelled) or `names` (a file with a bad name).

use axum::Router;
use axum::body::Body;
use axum::http::{HeaderMap, Request, StatusCode};
use glam::DVec3;
use http_body_util::BodyExt;
use rigsmith::formats::{Contents, Finding, Format, Severity};
use rigsmith::jobs::{
    Artifact, Availability, Check, ErrorCode, JobError, Jobs, MethodInfo, ModelInfo, Outcome, Readiness, RigRequest,
    Riggable, Rigger, Settings, Stage, Watch,
};
use rigsmith::pipelines::orientation::Orientation;
use rigsmith::server::{App, Limits, app};
use rigsmith::storage::Store;
use serde_json::{Map, Value, json};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tower::ServiceExt;

pub struct Scripted {
    pub readiness: Mutex<Readiness>,
    /// Requests performed, newest last.
    pub seen: Mutex<Vec<RigRequest>>,
    /// Calls of `check`.
    pub checks: AtomicUsize,
    pub engine_version: Mutex<String>,
    running: AtomicUsize,
    pub running_most: AtomicUsize,
}

impl Default for Scripted {
    fn default() -> Self {
        Self {
            readiness: Mutex::new(Readiness::Ready),
            seen: Mutex::default(),
            checks: AtomicUsize::new(0),
            engine_version: Mutex::new("1".to_owned()),
            running: AtomicUsize::new(0),
            running_most: AtomicUsize::new(0),
        }
    }
}

pub const GLB_BYTES: usize = 700_000;

/// What the scripted rigger writes: long enough for several chunks.
pub fn glb() -> Vec<u8> {
    (0..GLB_BYTES).map(|index| (index % 251) as u8).collect()
}

fn scripted_finding() -> Finding {
    Finding {
        code: "scripted",
        parts: vec!["Hat".to_owned()],
        severity: Severity::Warning,
        message: "this is a test".to_owned(),
        hint: String::new(),
    }
}

impl Scripted {
    fn act(&self, script: &str, watch: &Watch) -> Result<(), JobError> {
        let (verb, value) = script.trim().split_once(' ').unwrap_or((script.trim(), ""));
        let time = Duration::from_millis(value.parse().unwrap_or(0));
        let until = Instant::now() + time;
        match verb {
            "sleep" => {
                while Instant::now() < until {
                    watch.check()?;
                    sleep(Duration::from_millis(2));
                }
                Ok(())
            }
            "hang" => loop {
                watch.check()?;
                sleep(Duration::from_millis(2));
            },
            "deaf" => {
                sleep(time);
                Ok(())
            }
            "eat" => {
                let mib: usize = value.parse().unwrap_or(0);
                // Written to, so that it is there.
                let eaten = vec![1_u8; mib << 20];
                for _ in 0..1000 {
                    watch.check()?;
                    sleep(Duration::from_millis(10));
                }
                assert!(eaten.iter().step_by(4096).all(|byte| *byte == 1));
                Ok(())
            }
            "panic" => panic!("secret internals"),
            "fail" => {
                let code = ErrorCode::ALL.into_iter().find(|code| code.name() == value).expect("a code");
                Err(JobError::new(code, format!("scripted {value}")).hint("change the script"))
            }
            "ok" | "names" => Ok(()),
            other => Err(JobError::new(ErrorCode::UnreadableMesh, format!("no script {other:?}"))),
        }
    }
}

impl Rigger for Scripted {
    fn perform(&self, request: &RigRequest, watch: &Watch) -> Result<Outcome, JobError> {
        let running = self.running.fetch_add(1, Ordering::SeqCst) + 1;
        self.running_most.fetch_max(running, Ordering::SeqCst);
        self.seen.lock().expect("not poisoned").push(request.clone());
        let main = request.files.first().expect("a file");
        let script = String::from_utf8_lossy(&main.bytes).into_owned();
        watch.enter(Stage::Ingest);
        watch.enter(Stage::Joints);
        let acted = if script.starts_with("panic") {
            self.running.fetch_sub(1, Ordering::SeqCst);
            self.act(&script, watch)
        } else {
            let acted = self.act(&script, watch);
            self.running.fetch_sub(1, Ordering::SeqCst);
            acted
        };
        acted?;
        watch.enter(Stage::Export);
        let name = if script.starts_with("names") { "../rigged.glb" } else { "rigged.glb" };
        // `ok N` makes a file of its own; every other script, the same one.
        let own = script.strip_prefix("ok ").unwrap_or_default();
        let artifact = |name: &str, media_type, bytes| Artifact { name: name.to_owned(), media_type, bytes };
        Ok(Outcome {
            artifacts: vec![
                artifact(name, "model/gltf-binary", [glb(), own.as_bytes().to_vec()].concat()),
                artifact("rigged.rig.json", "application/json", b"{}".to_vec()),
            ],
            report: Map::from_iter([("skeleton".to_owned(), json!({"joints": 24}))]),
            findings: vec![scripted_finding()],
            method_used: "rignet".to_owned(),
        })
    }

    fn check(&self, request: &RigRequest, watch: &Watch) -> Result<Check, JobError> {
        self.checks.fetch_add(1, Ordering::SeqCst);
        let script = String::from_utf8_lossy(&request.files.first().expect("a file").bytes).into_owned();
        // What hangs, hangs at work; a look at the file is short.
        if !script.starts_with("hang") {
            self.act(&script, watch)?;
        }
        Ok(Check {
            riggable: Riggable::Yes,
            suggested_method: "rignet",
            format: Format::Obj,
            vertices: 8,
            faces: 12,
            primitives: 1,
            contents: Contents { meshes: 1, ..Contents::default() },
            existing_rig: None,
            orientation: Orientation { up: DVec3::Y, front: DVec3::Z, confidence: 1.0 },
            orientation_given: true,
            survey: None,
            findings: vec![scripted_finding().into()],
        })
    }

    fn engine_version(&self) -> String {
        self.engine_version.lock().expect("not poisoned").clone()
    }

    fn methods(&self) -> Vec<MethodInfo> {
        let method = |name: &str, availability, models| MethodInfo {
            name: name.to_owned(),
            title: name.to_owned(),
            description: String::new(),
            availability,
            licence: "CC-BY-4.0".to_owned(),
            models,
            skin_methods: vec![],
            limits: vec![("faces", 2_000_000)],
        };
        let model = ModelInfo { name: "skin".to_owned(), sha256: "00".repeat(32), self_test: "passed".to_owned() };
        let missing = Availability::Unavailable { reason: "no networks".to_owned() };
        vec![method("rignet", Availability::Available, vec![model]), method("volumetric_nets", missing, vec![])]
    }

    fn ready(&self) -> Readiness {
        self.readiness.lock().expect("not poisoned").clone()
    }
}

/// A service with a folder of its own.
pub struct Service {
    pub router: Router,
    pub rigger: Arc<Scripted>,
    pub state: App,
    pub folder: TempDir,
}

impl Service {
    pub fn new() -> Self {
        Self::with(|_, _| {})
    }

    pub fn with(change: impl FnOnce(&mut Settings, &mut Limits)) -> Self {
        Self::storing(1 << 30, change)
    }

    pub fn storing(bytes_max: u64, change: impl FnOnce(&mut Settings, &mut Limits)) -> Self {
        let mut settings = Settings { workers: 2, sweep_every: Duration::from_millis(10), ..Settings::default() };
        let mut limits = Limits { upload_pause_max: Duration::from_millis(200), ..Limits::default() };
        change(&mut settings, &mut limits);
        let folder = TempDir::new().expect("folder");
        let rigger = Arc::new(Scripted::default());
        let store = Store::open(folder.path(), bytes_max).expect("store");
        let jobs = Jobs::start(rigger.clone(), store, settings).expect("workers");
        let state = App::new(jobs, limits);
        Self { router: app(state.clone()), rigger, state, folder }
    }

    pub async fn send(&self, request: Request<Body>) -> Answer {
        let response = self.router.clone().oneshot(request).await.expect("infallible");
        let (parts, body) = response.into_parts();
        let bytes = body.collect().await.expect("body").to_bytes().to_vec();
        Answer { status: parts.status, headers: parts.headers, bytes }
    }

    pub async fn get(&self, path: &str) -> Answer {
        self.send(request("GET", path, &[], "")).await
    }

    /// Posts a script as the mesh, to be worked on even if an equal one was.
    pub async fn rig(&self, query: &str, headers: &[(&str, &str)], script: &str) -> Answer {
        let mut fields = vec![("content-type", "model/obj"), ("cache-control", "no-cache")];
        fields.extend(headers);
        self.send(request("POST", &format!("/v1/rigs{query}"), &fields, script)).await
    }

    /// Posts a script and waits for the end of the job.
    pub async fn finished(&self, script: &str) -> Value {
        let answer = self.rig("", &[("prefer", "wait=10")], script).await;
        assert_eq!(answer.status, 200, "{}", answer.text());
        answer.json()
    }

    pub async fn state_of(&self, path: &str) -> String {
        self.get(path).await.json()["state"].as_str().expect("a state").to_owned()
    }

    /// Waits until the job at `path` is in `state`; a few seconds at most.
    pub async fn until(&self, path: &str, state: &str) -> Value {
        for _ in 0..500 {
            let job = self.get(path).await.json();
            if job["state"] == state {
                return job;
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        panic!("{path} did not become {state}: {}", self.get(path).await.text());
    }

    /// Asserts that `count` uploads and artifacts are in the data folder, after a moment at most.
    #[track_caller]
    pub fn keeps(&self, count: usize) {
        for _ in 0..200 {
            if self.files() == count {
                return;
            }
            // Blocks this test alone: the jobs have threads of their own.
            sleep(Duration::from_millis(10));
        }
        assert_eq!(self.files(), count);
    }

    /// Uploads and artifacts in the data folder.
    pub fn files(&self) -> usize {
        let bundles = ["incoming", "blobs"].map(|name| self.folder.path().join(name));
        bundles.iter().map(|path| std::fs::read_dir(path).expect("folder").count()).sum()
    }
}

pub struct Answer {
    pub status: StatusCode,
    pub headers: HeaderMap,
    pub bytes: Vec<u8>,
}

impl Answer {
    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.bytes).unwrap_or_else(|error| panic!("{error}: {}", self.text()))
    }

    pub fn text(&self) -> String {
        format!("{} {}", self.status, String::from_utf8_lossy(&self.bytes))
    }

    pub fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().expect("ASCII"))
    }

    /// Asserts that this is a complete problem with `code`.
    #[track_caller]
    pub fn refused(&self, status: u16, code: &str) -> Value {
        assert_eq!(self.status.as_u16(), status, "{}", self.text());
        assert_eq!(self.header("content-type"), "application/problem+json");
        let problem = self.json();
        assert_eq!(problem["code"], code, "{problem:#}");
        assert_eq!(problem["status"], status);
        assert_eq!(problem["type"], format!("/v1/problems/{code}"));
        assert_eq!(problem["request_id"], self.header("x-request-id"));
        for member in ["title", "detail", "instance"] {
            assert!(problem[member].as_str().is_some_and(|text| !text.is_empty()), "{member} in {problem:#}");
        }
        problem
    }
}

pub fn request(method: &str, path: &str, headers: &[(&str, &str)], body: &str) -> Request<Body> {
    let mut request = Request::builder().method(method).uri(path);
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    request.body(Body::from(body.to_owned())).expect("a request")
}

/// One part of a form: field, file name, content.
pub type Part<'a> = (&'a str, Option<&'a str>, &'a str);

pub fn form(path: &str, headers: &[(&str, &str)], parts: &[Part]) -> Request<Body> {
    let mut body = String::new();
    for (field, file_name, content) in parts {
        let file = file_name.map(|name| format!("; filename=\"{name}\"")).unwrap_or_default();
        body += &format!("--edge\r\nContent-Disposition: form-data; name=\"{field}\"{file}\r\n\r\n{content}\r\n");
    }
    body += "--edge--\r\n";
    let mut fields = vec![("content-type", "multipart/form-data; boundary=edge")];
    fields.extend(headers);
    request("POST", path, &fields, &body)
}
