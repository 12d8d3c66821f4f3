//! Digests of requests: what makes two of them the same wish, and what makes their results the same.

use super::options::RigOptions;
use super::perform::MethodInfo;
use super::submission::Submission;
use serde_json::json;
use sha2::{Digest, Sha256};

/// Everything that a caller says of a job, beside its files.
pub fn wish(submission: &Submission) -> [u8; 32] {
    let Submission { options, priority, labels, timeout, retention, client_id, .. } = submission;
    let said = json!({
        "options": options.to_json(),
        "priority": priority.name(),
        "labels": labels,
        "timeout_ms": timeout.map(|time| time.as_millis() as u64),
        "retention_ms": retention.map(|time| time.as_millis() as u64),
        "client_id": client_id,
    });
    Sha256::digest(said.to_string()).into()
}

/// Everything that decides a result, beside the files: options, networks, and the version of the program.
pub fn recipe(options: &RigOptions, methods: &[MethodInfo]) -> [u8; 32] {
    let models = methods.iter().flat_map(|method| &method.models);
    let digests: Vec<_> = models.map(|model| json!([model.name, model.sha256])).collect();
    let decides = json!({
        "options": options.to_json(),
        "models": digests,
        "version": env!("CARGO_PKG_VERSION"),
    });
    Sha256::digest(decides.to_string()).into()
}
