//! What the caller says about the answer: query parameters, `Prefer` and `Accept`.

use super::error::ApiError;
use super::error::Code;
use axum::extract::Query;
use axum::http::{HeaderMap, HeaderName, Uri, header};
use std::time::Duration;

/// Longest time that a request may wait for its job.
pub const WAIT_MAX: Duration = Duration::from_secs(60);
pub const PREFER: HeaderName = HeaderName::from_static("prefer");
pub const PREFERENCE_APPLIED: HeaderName = HeaderName::from_static("preference-applied");

/// Form of the answer to a create request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// The job.
    Json,
    /// The rigged file itself.
    Glb,
}

/// Query parameters in order, decoded. `known` are the only names allowed.
pub fn query(uri: &Uri, known: &[&str]) -> Result<Vec<(String, String)>, ApiError> {
    let pairs = query_pairs(uri)?;
    match pairs.iter().find(|(name, _)| !known.contains(&name.as_str())) {
        Some((name, _)) if known.is_empty() => Err(ApiError::unknown_field(name, "none here")),
        Some((name, _)) => Err(ApiError::unknown_field(name, &known.join(", "))),
        None => Ok(pairs),
    }
}

pub fn query_pairs(uri: &Uri) -> Result<Vec<(String, String)>, ApiError> {
    let Query(pairs) = Query::<Vec<(String, String)>>::try_from_uri(uri)
        .map_err(|rejection| ApiError::new(Code::InvalidParameter, format!("the query cannot be read: {rejection}")))?;
    Ok(pairs)
}

/// `Prefer: wait=N` in seconds, cut to [`WAIT_MAX`]. Preferences that are not known are passed over (RFC 7240).
pub fn wait(headers: &HeaderMap) -> Result<Option<Duration>, ApiError> {
    let preferences = headers.get_all(PREFER).iter().filter_map(|value| value.to_str().ok());
    for preference in preferences.flat_map(|value| value.split([',', ';'])) {
        let (name, value) = preference.split_once('=').unwrap_or((preference, ""));
        if name.trim().eq_ignore_ascii_case("wait") {
            let seconds: u64 = value.trim().trim_matches('"').parse().map_err(|_| {
                ApiError::field(
                    "Prefer",
                    format!("{:?} is not wait and whole seconds, as in wait=30", preference.trim()),
                )
            })?;
            return Ok(Some(Duration::from_secs(seconds).min(WAIT_MAX)));
        }
    }
    Ok(None)
}

/// The form that `Accept` asks for; JSON when it leaves the choice.
pub fn answer(headers: &HeaderMap) -> Result<Answer, ApiError> {
    let mut ranges = Vec::new();
    for value in headers.get_all(header::ACCEPT) {
        let value = value.to_str().unwrap_or_default();
        for range in value.split(',').map(str::trim).filter(|range| !range.is_empty()) {
            let (name, parameters) = range.split_once(';').unwrap_or((range, ""));
            ranges.push((name.trim().to_ascii_lowercase(), quality(parameters)));
        }
    }
    if ranges.is_empty() {
        return Ok(Answer::Json);
    }
    let best = |names: &[&str]| {
        let fitting = ranges.iter().filter(|(name, _)| names.contains(&name.as_str()));
        fitting.map(|(_, quality)| *quality).fold(0.0, f64::max)
    };
    let json = best(&["application/json", "application/*", "*/*"]);
    let glb = best(&["model/gltf-binary", "model/*"]);
    match (json, glb) {
        (json, glb)
            if glb > json
                || (glb > 0.0 && glb >= json && !ranges.iter().any(|(name, _)| name == "application/json")) =>
        {
            Ok(Answer::Glb)
        }
        (json, _) if json > 0.0 => Ok(Answer::Json),
        _ => Err(ApiError::new(Code::NotAcceptable, "the answer is application/json or model/gltf-binary")
            .hint("send one of them in Accept, or */*")),
    }
}

/// The one value of a field that is text; refused when it is sent twice or is no text.
pub fn text_header<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Result<Option<&'a str>, ApiError> {
    let mut values = headers.get_all(name).iter();
    let Some(value) = values.next() else { return Ok(None) };
    if values.next().is_some() {
        return Err(ApiError::field(name.as_str(), "is sent twice; send it once"));
    }
    value.to_str().map(Some).map_err(|_| ApiError::field(name.as_str(), "is not ASCII text"))
}

/// Whether the caller wants the work done even if an equal result is there.
pub fn no_cache(headers: &HeaderMap) -> bool {
    let directives = headers.get_all(header::CACHE_CONTROL).iter().filter_map(|value| value.to_str().ok());
    directives.flat_map(|value| value.split(',')).any(|directive| directive.trim().eq_ignore_ascii_case("no-cache"))
}

/// The `q` of a media range, 1 when it has none.
fn quality(parameters: &str) -> f64 {
    let q = parameters.split(';').filter_map(|parameter| parameter.trim().strip_prefix("q=")).next();
    q.map_or(1.0, |q| q.trim().parse().unwrap_or(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    fn headers(name: HeaderName, value: &'static str) -> HeaderMap {
        HeaderMap::from_iter([(name, HeaderValue::from_static(value))])
    }

    #[test]
    fn prefer_wait_is_found_among_others_and_cut() {
        for (value, seconds) in [
            ("wait=10", Some(10)),
            ("respond-async, Wait = 7", Some(7)),
            ("wait=600", Some(60)),
            ("return=minimal", None),
        ] {
            assert_eq!(wait(&headers(PREFER, value)).expect("readable"), seconds.map(Duration::from_secs), "{value}");
        }
        for value in ["wait", "wait=soon", "wait=-1"] {
            assert!(wait(&headers(PREFER, value)).is_err(), "{value}");
        }
    }

    #[test]
    fn accept_decides_the_form_of_the_answer() {
        for (value, expected) in [
            ("*/*", Some(Answer::Json)),
            ("application/json", Some(Answer::Json)),
            ("text/html,application/xhtml+xml,*/*;q=0.8", Some(Answer::Json)),
            ("model/gltf-binary", Some(Answer::Glb)),
            ("model/gltf-binary, */*", Some(Answer::Glb)),
            ("model/gltf-binary;q=0.5, application/json", Some(Answer::Json)),
            ("image/png", None),
            ("application/json;q=0", None),
        ] {
            assert_eq!(answer(&headers(header::ACCEPT, value)).ok(), expected, "{value}");
        }
        assert_eq!(answer(&HeaderMap::new()).ok(), Some(Answer::Json));
    }
}
