//! `Idempotency-Key`: the same request sent twice has one effect. Jobs keep their key with them
//! ([`crate::jobs::Submission`]); other answers are remembered here, for 24 hours.

use super::App;
use super::error::{ApiError, Code};
use super::negotiate::text_header;
use crate::jobs::{Caller, Refusal, Remembered};
use axum::http::{HeaderMap, HeaderName, HeaderValue};
use axum::response::Response;
use sha2::{Digest, Sha256};

pub const IDEMPOTENCY_KEY: HeaderName = HeaderName::from_static("idempotency-key");
const IDEMPOTENCY_REPLAYED: HeaderName = HeaderName::from_static("idempotency-replayed");
const KEY_BYTES_MAX: usize = 255;

/// The key of a request, when it has one.
pub fn key(headers: &HeaderMap) -> Result<Option<String>, ApiError> {
    let Some(key) = text_header(headers, &IDEMPOTENCY_KEY)? else { return Ok(None) };
    // The draft writes it as a quoted string; most callers send it bare.
    checked("Idempotency-Key", key.trim().trim_matches('"')).map(Some)
}

/// A key that is fit to be remembered.
pub fn checked(field: &str, key: &str) -> Result<String, ApiError> {
    if key.is_empty() || key.len() > KEY_BYTES_MAX || !key.bytes().all(|byte| (b' '..=b'~').contains(&byte)) {
        return Err(ApiError::field(field, format!("must have 1 to {KEY_BYTES_MAX} printable characters")));
    }
    Ok(key.to_owned())
}

/// Marks an answer as that of an earlier request.
pub fn note_replay(response: &mut Response) {
    response.headers_mut().insert(IDEMPOTENCY_REPLAYED, HeaderValue::from_static("true"));
}

/// What an earlier request with the key made, unless it is gone since: then the request makes it anew.
pub fn still_there<T>(found: Result<T, ApiError>) -> Result<Option<T>, ApiError> {
    match found {
        Ok(found) => Ok(Some(found)),
        Err(error) if error.code == Code::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// What became of a key.
pub enum Turn {
    /// Do it, then tell [`App::jobs`] to remember.
    First,
    /// The answer given before.
    Again(Vec<u8>),
}

/// Whether the request was answered before. `said` is everything that makes it this request.
pub async fn turn(app: &App, caller: &Caller, key: &str, said: &[&[u8]]) -> Result<Turn, ApiError> {
    let mut digest = Sha256::new();
    for part in said {
        digest.update((part.len() as u64).to_le_bytes());
        digest.update(part);
    }
    match app.jobs.recall(caller, key, &digest.finalize().into()).await? {
        Remembered::Fresh => Ok(Turn::First),
        Remembered::Answer(answer) => Ok(Turn::Again(answer)),
        Remembered::InProgress => Err(Refusal::IdempotencyInProgress.into()),
        Remembered::Mismatch => Err(Refusal::IdempotencyMismatch.into()),
    }
}
