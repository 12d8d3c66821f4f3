//! What is asked and what is said, in the words of neither door.

use crate::http::scripted::Service;
use serde_json::{Value, json};

/// A mesh within a request.
#[derive(Clone, Debug)]
pub enum Mesh {
    Inline(&'static str, Vec<u8>),
    Asset(String),
    Url(String),
}

#[derive(Clone, Debug)]
pub struct Create {
    pub mesh: Mesh,
    /// As JSON members.
    pub options: Value,
    pub key: Option<String>,
    pub client_id: Option<String>,
    pub no_cache: bool,
}

/// A script as the mesh.
pub fn script(script: &str) -> Mesh {
    Mesh::Inline("model/obj", script.as_bytes().to_vec())
}

pub fn create(text: &str, options: Value) -> Create {
    Create { mesh: script(text), options, key: None, client_id: None, no_cache: false }
}

#[derive(Clone, Debug)]
pub enum Ask {
    /// A job, looked at when it is over.
    Create(Create),
    Check(Create),
    Get(String),
    /// State, label, page size, page token.
    List(&'static str, &'static str, i32, &'static str),
    Cancel(String),
    Delete(String),
    Reskin(String, &'static str, Value),
    /// Defaults, and the name, asset and options of each item; answered by what became of them.
    Batch(Value, Vec<(&'static str, String, Value)>, Option<String>),
    /// Name and content of each file.
    Upload(Vec<(&'static str, &'static str)>, Option<String>),
    Download(String, &'static str, u64),
}

/// An answer that can be compared.
#[derive(Clone, Debug, PartialEq)]
pub enum Said {
    Fine(Value),
    Refused { code: String, hint: String, retryable: bool, retry: bool, fields: Vec<(String, String)>, limit: Value },
}

impl Said {
    /// The code of a refusal, else empty.
    pub fn code(&self) -> &str {
        match self {
            Self::Fine(_) => "",
            Self::Refused { code, .. } => code,
        }
    }
}

/// A door of one service.
pub struct Door<'service> {
    pub service: &'service Service,
    pub key: Option<String>,
    pub over: Over,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Over {
    Rest,
    Grpc,
}

impl Door<'_> {
    pub async fn ask(&self, ask: Ask) -> Said {
        match self.over {
            Over::Rest => self.ask_rest(ask).await,
            Over::Grpc => self.ask_grpc(ask).await,
        }
    }
}

/// What of a rig both doors must tell alike: all but ids and times.
pub fn comparable(rig: &Value) -> Value {
    let member = |name: &str| rig[name].clone();
    let mut error = member("error");
    if let Some(members) = error.as_object_mut() {
        members.retain(|name, value| {
            !value.is_null() && ["code", "stage", "message", "hint", "retryable"].contains(&name.as_str())
        });
    }
    let mut result = member("result");
    for artifact in result["artifacts"].as_array_mut().into_iter().flatten() {
        artifact.as_object_mut().expect("an artifact").remove("url");
    }
    json!({
        "state": rig["state"],
        "stage": rig["stage"],
        "progress": rig["progress"],
        "attempt": rig["attempt"],
        "cancel_requested": rig["cancel_requested"],
        "queue_position": rig["queue_position"],
        "request": rig["request"],
        "client_id": rig["client_id"],
        "files": rig["files"],
        "method_used": rig["method_used"],
        "provenance": rig["provenance"],
        "warnings": rig["warnings"],
        "stages": rig["timings_ms"].as_object().map(|timings| timings.keys().cloned().collect::<std::collections::BTreeSet<_>>()),
        "has_asset": !rig["asset"].is_null(),
        "started": !rig["started_at"].is_null(),
        "finished": !rig["finished_at"].is_null(),
        "expires": !rig["expires_at"].is_null(),
        "result": result,
        "error": error,
    })
}
