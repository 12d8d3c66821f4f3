//! A service as the command line sees it: requests, refusals, and the events of a job.

use super::failure::Failure;
use clap::Args;
use serde_json::Value;
use std::io::{BufRead, BufReader, Read};
use std::time::Duration;
use ureq::http::{Response, StatusCode};
use ureq::{Agent, Body, RequestBuilder};

/// Which service, and the key for it.
#[derive(Args)]
pub struct ServerArguments {
    /// Address of the service.
    #[arg(long, env = "RIGSMITH_SERVER", value_name = "URL", default_value = "http://127.0.0.1:8080")]
    server: String,
    /// Key for the service, where it asks for one.
    #[arg(long, env = "RIGSMITH_KEY", value_name = "KEY", hide_env_values = true)]
    key: Option<String>,
}

pub struct Client {
    agent: Agent,
    server: String,
    bearer: Option<String>,
}

const CONNECT_TIME_MAX: Duration = Duration::from_secs(10);
/// Events come at least every 15 s, if only as a sign of life.
const SILENCE_MAX: Duration = Duration::from_secs(45);
/// The largest answer that is read into memory.
const ANSWER_BYTES_MAX: u64 = 4 << 30;
/// How often a request is sent again to a service that says that it is busy.
const BUSY_MAX: u32 = 100;
/// How often a broken stream of events is taken up again,
const RECONNECTS_MAX: u32 = 30;
/// and how long after.
const RECONNECT_AFTER: Duration = Duration::from_secs(2);

/// One event of a job.
pub struct Event {
    pub name: String,
    pub data: Value,
}

impl Client {
    pub fn new(arguments: &ServerArguments) -> Self {
        Self::of(&arguments.server, arguments.key.as_deref())
    }

    pub fn of(server: &str, key: Option<&str>) -> Self {
        let config = Agent::config_builder()
            .http_status_as_error(false)
            .timeout_connect(Some(CONNECT_TIME_MAX))
            .timeout_per_read(Some(SILENCE_MAX))
            .user_agent(concat!("rigsmith/", env!("CARGO_PKG_VERSION")))
            .build();
        Self {
            agent: config.into(),
            server: server.trim_end_matches('/').to_owned(),
            bearer: key.map(|key| format!("Bearer {key}")),
        }
    }

    /// `request` with `fields` and the key.
    fn dressed<B>(&self, mut request: RequestBuilder<B>, fields: &[(&str, &str)]) -> RequestBuilder<B> {
        let bearer = self.bearer.as_deref().map(|bearer| ("authorization", bearer));
        for (name, value) in fields.iter().copied().chain(bearer) {
            request = request.header(name, value);
        }
        request
    }

    fn unreachable(&self, error: &ureq::Error) -> Failure {
        Failure::internal(format!("{}: {error}", self.server), "is it running? --server names another")
    }

    fn get(&self, path: &str, fields: &[(&str, &str)]) -> Result<Response<Body>, Failure> {
        let request = self.dressed(self.agent.get(format!("{}{path}", self.server)), fields);
        let response = request.call().map_err(|error| self.unreachable(&error))?;
        accepted(response)
    }

    /// Sends a form; gives the job.
    pub fn create(&self, content_type: &str, body: &[u8], idempotency_key: &str) -> Result<Value, Failure> {
        let fields = [("content-type", content_type), ("idempotency-key", idempotency_key)];
        let request = self.dressed(self.agent.post(format!("{}/v1/rigs", self.server)), &fields);
        let response = request.send(body).map_err(|error| self.unreachable(&error))?;
        json(accepted(response)?)
    }

    /// Sends a body; gives the JSON of the answer, or of the problem. Waits where the service says that it is too busy.
    pub fn post(&self, path: &str, fields: &[(&str, &str)], body: &[u8]) -> Result<Result<Value, Value>, Failure> {
        for _ in 0..BUSY_MAX {
            let request = self.dressed(self.agent.post(format!("{}{path}", self.server)), fields);
            let mut response = request.send(body).map_err(|error| self.unreachable(&error))?;
            if response.status().is_success() {
                return json(response).map(Ok);
            }
            let wait = response.headers().get("retry-after").and_then(|wait| wait.to_str().ok()?.parse().ok());
            match wait {
                Some(seconds) => std::thread::sleep(Duration::from_secs(seconds)),
                None => {
                    let problem: Value = response.body_mut().read_json().unwrap_or_default();
                    let status = response.status();
                    return if problem["code"].is_string() { Ok(Err(problem)) } else { Err(stranger(status)) };
                }
            }
        }
        Err(Failure::internal(format!("{} is too busy", self.server), "try again later"))
    }

    /// The JSON at a path.
    pub fn json(&self, path: &str) -> Result<Value, Failure> {
        json(self.get(path, &[])?)
    }

    pub fn job(&self, id: &str) -> Result<Value, Failure> {
        json(self.get(&format!("/v1/rigs/{}", segment(id)?), &[])?)
    }

    /// The bytes at a path that the service named.
    pub fn bytes(&self, path: &str) -> Result<Vec<u8>, Failure> {
        let mut response = self.get(path, &[])?;
        let reading = response.body_mut().with_config().limit(ANSWER_BYTES_MAX).read_to_vec();
        reading.map_err(|error| self.unreachable(&error))
    }

    /// Follows a job to its end; `seen` is told each event. Breaks of the connection are bridged.
    pub fn follow(&self, id: &str, mut seen: impl FnMut(&Event)) -> Result<(), Failure> {
        let path = format!("/v1/rigs/{}/events", segment(id)?);
        let mut last = None;
        for _ in 0..RECONNECTS_MAX {
            let resume: Vec<(&str, &str)> = last.iter().map(|id: &String| ("last-event-id", id.as_str())).collect();
            let response = self.get(&path, &resume)?;
            if response.status() == StatusCode::NO_CONTENT {
                return Ok(());
            }
            if read_events(response.into_body().into_reader(), &mut last, &mut seen) {
                return Ok(());
            }
            std::thread::sleep(RECONNECT_AFTER);
        }
        Err(Failure::internal(format!("{}: the events of {id} broke off again and again", self.server), "try again"))
    }
}

/// Reads events until the stream ends; whether the job's last one was among them.
fn read_events(stream: impl Read, last: &mut Option<String>, seen: &mut impl FnMut(&Event)) -> bool {
    let (mut id, mut name, mut data) = (None, String::new(), String::new());
    for line in BufReader::new(stream).lines() {
        let Ok(line) = line else { return false };
        match line.split_once(": ") {
            Some(("id", value)) => id = Some(value.to_owned()),
            Some(("event", value)) => value.clone_into(&mut name),
            Some(("data", value)) => value.clone_into(&mut data),
            _ if line.is_empty() && !data.is_empty() => {
                let event = Event { name: std::mem::take(&mut name), data: data.parse().unwrap_or_default() };
                data.clear();
                *last = id.take().or(last.take());
                seen(&event);
                if event.name == "done" {
                    return true;
                }
            }
            _ => {}
        }
    }
    false
}

/// An id that is one segment of a path.
fn segment(id: &str) -> Result<&str, Failure> {
    let fit = |letter: char| letter.is_ascii_alphanumeric() || ['.', '-', '_'].contains(&letter);
    if !id.is_empty() && id.chars().all(fit) {
        return Ok(id);
    }
    Err(Failure::arguments(format!("{id:?} is no id of a rig")))
}

fn json(mut response: Response<Body>) -> Result<Value, Failure> {
    let read = response.body_mut().read_json();
    read.map_err(|error| Failure::internal(format!("the answer is no JSON: {error}"), "is this a rigsmith service?"))
}

/// The response, or the problem that it tells of.
fn accepted(mut response: Response<Body>) -> Result<Response<Body>, Failure> {
    if response.status().is_success() {
        return Ok(response);
    }
    let status = response.status();
    let problem: Value = response.body_mut().read_json().unwrap_or_default();
    Err(if problem["code"].is_string() { Failure::problem(&problem) } else { stranger(status) })
}

fn stranger(status: StatusCode) -> Failure {
    Failure::internal(format!("the service answered {status}"), "is this a rigsmith service?")
}
