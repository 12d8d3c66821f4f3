//! A message as it is sent: its body, and the headers that prove whose it is ([Standard Webhooks 1.0]).
//!
//! [Standard Webhooks 1.0]: https://github.com/standard-webhooks/standard-webhooks/blob/main/spec/standard-webhooks.md

use crate::jobs::MessageId;
use crate::jobs::webhooks::{Message, Secret, Subject};
use crate::server::http::batch_views::BatchView;
use crate::server::http::timestamp::rfc3339;
use crate::server::http::views::JobView;
use crate::server::http::webhook_views::{MessageView, TestView};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use hmac::{Hmac, Mac};
use reqwest::header::{CONTENT_TYPE, HeaderMap, HeaderName, HeaderValue};
use serde_json::{Map, Value};
use sha2::Sha256;
use std::time::{SystemTime, UNIX_EPOCH};

const WEBHOOK_ID: HeaderName = HeaderName::from_static("webhook-id");
const WEBHOOK_TIMESTAMP: HeaderName = HeaderName::from_static("webhook-timestamp");
const WEBHOOK_SIGNATURE: HeaderName = HeaderName::from_static("webhook-signature");

/// Receivers may rely on this.
pub const DATA_BYTES_MAX: usize = 20_000;
/// What is left out of `data` that is larger, in this order. It is all to be had at `links.self`.
const LEFT_OUT_FIRST: [&str; 6] = ["warnings", "files", "result", "request", "provenance", "error"];

/// The body of a message: the same for the same message, whenever it is sent.
pub fn body(message: &Message) -> String {
    let data = match &message.subject {
        Subject::Rig(job) => serde_json::to_value(JobView::from(&**job)),
        Subject::Batch(batch) => serde_json::to_value(BatchView::from(&**batch)),
        Subject::Endpoint(id) => serde_json::to_value(TestView::new(*id)),
    };
    let Value::Object(mut data) = data.unwrap_or_default() else { return String::new() };
    let left_out = fit(&mut data);
    let view = MessageView {
        r#type: message.kind.name(),
        timestamp: rfc3339(message.at),
        sequence: message.sequence(),
        data,
        left_out,
    };
    serde_json::to_string(&view).unwrap_or_default()
}

/// Leaves out of `data` what makes it too large, and says what that is.
fn fit(data: &mut Map<String, Value>) -> Vec<&'static str> {
    let mut left_out = Vec::new();
    for name in LEFT_OUT_FIRST {
        // Written out to be measured; most are far below.
        if serde_json::to_string(data).is_ok_and(|text| text.len() <= DATA_BYTES_MAX) {
            break;
        }
        if data.shift_remove(name).is_some() {
            left_out.push(name);
        }
    }
    left_out
}

/// The headers of a message that is sent at `now`, signed with each of `secrets`.
pub fn headers(id: MessageId, now: SystemTime, body: &[u8], secrets: &[Secret]) -> HeaderMap {
    let id = id.to_string();
    let timestamp = now.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs().to_string();
    let signatures: Vec<String> = secrets.iter().map(|secret| signature(secret, &id, &timestamp, body)).collect();
    let mut headers = HeaderMap::from_iter([(CONTENT_TYPE, HeaderValue::from_static("application/json"))]);
    for (name, value) in [(WEBHOOK_ID, id), (WEBHOOK_TIMESTAMP, timestamp), (WEBHOOK_SIGNATURE, signatures.join(" "))] {
        // All of them are ASCII.
        if let Ok(value) = HeaderValue::from_str(&value) {
            headers.insert(name, value);
        }
    }
    headers
}

/// `v1,` and the HMAC-SHA256 of `id.timestamp.body` in base64.
fn signature(secret: &Secret, id: &str, timestamp: &str, body: &[u8]) -> String {
    // The other constructor refuses keys of a wrong length; this one takes the block that HMAC pads keys to.
    let mut block = [0; 64];
    block[..32].copy_from_slice(&secret.to_bytes());
    let mac = <Hmac<Sha256> as hmac::digest::KeyInit>::new(&block.into());
    let parts: [&[u8]; 5] = [id.as_bytes(), b".", timestamp.as_bytes(), b".", body];
    let mac = parts.into_iter().fold(mac, |mut mac, part| {
        mac.update(part);
        mac
    });
    format!("v1,{}", BASE64_STANDARD.encode(mac.finalize().into_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::time::Duration;

    /// Computed with Python's `hmac`, which the library of Standard Webhooks uses.
    #[test]
    fn signatures_are_those_of_the_standard() {
        let secret = Secret::from_bytes(*b"0123456789abcdef0123456789abcdef");
        let signed = signature(&secret, "evt_1", "1700000000", b"{\"type\":\"rig.succeeded\"}");
        assert_eq!(signed, "v1,gkRr++a9/pr0bL78ky26U8dCN6lfJEsu32Ms/u9MWjI=");
    }

    #[test]
    fn every_secret_signs() {
        let secrets = [Secret::from_bytes([1; 32]), Secret::from_bytes([2; 32])];
        let now = UNIX_EPOCH + Duration::from_millis(1_700_000_000_999);
        let id = MessageId::new();
        let headers = headers(id, now, b"{}", &secrets);
        let text = |name: &HeaderName| headers[name].to_str().expect("ASCII").to_owned();
        assert_eq!((text(&WEBHOOK_ID), text(&WEBHOOK_TIMESTAMP)), (id.to_string(), "1700000000".to_owned()));
        let both: Vec<String> =
            secrets.iter().map(|secret| signature(secret, &id.to_string(), "1700000000", b"{}")).collect();
        assert_eq!(text(&WEBHOOK_SIGNATURE), both.join(" "));
        assert_ne!(both[0], both[1]);
    }

    #[test]
    fn what_is_too_large_is_left_out_by_name_and_no_more_than_needed() {
        let long = "x".repeat(DATA_BYTES_MAX);
        let data = |value: Value| value.as_object().expect("an object").clone();
        let mut small = data(json!({"id": "rig_1", "warnings": [], "result": {}}));
        assert!(fit(&mut small).is_empty() && small.len() == 3);
        let mut large = data(json!({"id": "rig_1", "warnings": [], "files": [long], "result": {}}));
        assert_eq!(fit(&mut large), ["warnings", "files"]);
        assert_eq!(Value::from(large), json!({"id": "rig_1", "result": {}}));
        let mut huge = data(json!({"id": "rig_1", "files": [long], "result": {"a": long}, "error": {"message": long}}));
        assert_eq!(fit(&mut huge), ["files", "result", "error"]);
        assert_eq!(Value::from(huge), json!({"id": "rig_1"}));
    }
}
