//! Digests of requests: what makes two of them the same wish, and what makes their results the same.

use super::options::RigOptions;
use super::perform::MethodInfo;
use super::store::codec;
use super::submission::Submission;
use serde_json::json;
use sha2::{Digest, Sha256};

/// Everything that a caller says of a job, beside its files.
pub fn wish(submission: &Submission) -> [u8; 32] {
    let Submission { options, priority, labels, timeout, retention, client_id, webhook, .. } = submission;
    let said = json!({
        "options": options.to_json(),
        "priority": priority.name(),
        "labels": labels,
        "timeout_ms": timeout.map(|time| time.as_millis() as u64),
        "retention_ms": retention.map(|time| time.as_millis() as u64),
        "client_id": client_id,
        "webhook": webhook.as_ref().map(codec::webhook),
    });
    Sha256::digest(said.to_string()).into()
}

/// Everything that decides a result, beside the files: options, networks, and the version of what runs between them.
pub fn recipe(options: &RigOptions, methods: &[MethodInfo], engine_version: &str) -> [u8; 32] {
    let models = methods.iter().flat_map(|method| &method.models);
    let digests: Vec<_> = models.map(|model| json!([model.name, model.sha256])).collect();
    let decides = json!({
        "options": options.to_json(),
        "models": digests,
        "engine": engine_version,
    });
    Sha256::digest(decides.to_string()).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::perform::{Availability, ModelInfo};

    #[test]
    fn whatever_changes_a_result_changes_the_recipe() {
        let methods = |sha256: &str| {
            let models = vec![ModelInfo { name: "joints".into(), sha256: sha256.into(), self_test: "passed".into() }];
            let (name, text) = ("rignet".to_owned(), String::new());
            let availability = Availability::Available;
            vec![MethodInfo {
                name,
                title: text.clone(),
                description: text.clone(),
                availability,
                licence: text,
                models,
                skin_methods: vec![],
                limits: vec![],
            }]
        };
        let (options, other) = (RigOptions::default(), RigOptions { seed: 1, ..RigOptions::default() });
        let usual = recipe(&options, &methods("00"), "1.0.0/1");
        assert_eq!(recipe(&options, &methods("00"), "1.0.0/1"), usual);
        for changed in [
            recipe(&other, &methods("00"), "1.0.0/1"),
            recipe(&options, &methods("01"), "1.0.0/1"),
            recipe(&options, &methods("00"), "1.0.1/1"),
            recipe(&options, &methods("00"), "1.0.0/2"),
        ] {
            assert_ne!(changed, usual);
        }
    }
}
