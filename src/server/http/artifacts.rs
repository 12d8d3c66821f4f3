//! The files that a job made.

use super::App;
use super::authenticate::Identity;
use super::error::{ApiError, Code};
use super::negotiate::query;
use super::outermost::AboutJob;
use super::rigs::{find, server_timing};
use super::segments::Segments;
use super::views::{ArtifactListView, ArtifactView, hex};
use crate::jobs::{ArtifactInfo, Job, JobState};
use crate::storage::Content;
use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use utoipa::ToSchema;

const REPR_DIGEST: HeaderName = HeaderName::from_static("repr-digest");

/// Bytes of a file.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
pub struct FileBytes(pub Vec<u8>);

/// List the files of a rig.
#[utoipa::path(
    get, path = "/v1/rigs/{id}/artifacts", tag = "artifacts",
    params(("id" = String, Path, description = "Id of the rig", example = "rig_01jdf5fj63fh5ra1njpy75fmyg")),
    responses(
        (status = 200, description = "The files; an empty list while there are none", body = ArtifactListView),
    ),
    extensions(("x-curl" = json!("curl $HOST/v1/rigs/$ID/artifacts"))),
)]
pub async fn list_artifacts(
    State(app): State<App>,
    Segments(id): Segments<String>,
    identity: Identity,
    uri: Uri,
) -> Result<Json<ArtifactListView>, ApiError> {
    query(&uri, &[])?;
    let job = find(&app, &identity.caller, &id).await?;
    refuse_expired(&job)?;
    let made = job.result.iter().flat_map(|result| &result.artifacts);
    let data = made.map(|artifact| ArtifactView::new(&job, artifact)).collect();
    Ok(Json(ArtifactListView { object: "list", data }))
}

/// Download a file.
///
/// Answers `Range` (one range), `If-Range` and `If-None-Match`; `ETag` and `Repr-Digest` carry the SHA-256.
#[utoipa::path(
    get, path = "/v1/rigs/{id}/artifacts/{name}", tag = "artifacts",
    params(
        ("id" = String, Path, description = "Id of the rig", example = "rig_01jdf5fj63fh5ra1njpy75fmyg"),
        ("name" = String, Path, description = "Name of the file, as listed", example = "rigged.glb"),
        ("Range" = Option<String>, Header, description = "One range of bytes", example = "bytes=0-1023"),
        ("If-Range" = Option<String>, Header, description = "Send the range only if this is still the `ETag`"),
        ("If-None-Match" = Option<String>, Header, description = "Answer 304 if this is still the `ETag`"),
    ),
    responses(
        (status = 200, description = "The bytes", content_type = "application/octet-stream", body = FileBytes, headers(
            ("ETag" = String, description = "SHA-256 of the file, quoted"),
            ("Repr-Digest" = String, description = "SHA-256 of the file (RFC 9530)"),
            ("Content-Disposition" = String, description = "The file's name"),
            ("Accept-Ranges" = String, description = "`bytes`"),
        )),
        (status = 206, description = "The range", content_type = "application/octet-stream", body = FileBytes, headers(
            ("Content-Range" = String, description = "Which bytes these are"),
        )),
        (status = 304, description = "The caller has it"),
    ),
    extensions(("x-curl" = json!("curl -OJ $HOST/v1/rigs/$ID/artifacts/rigged.glb"))),
)]
pub async fn get_artifact(
    State(app): State<App>,
    Segments((id, name)): Segments<(String, String)>,
    identity: Identity,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    query(&uri, &[])?;
    let job = find(&app, &identity.caller, &id).await?;
    serve(&app, &job, named(&job, &name)?, &headers).await
}

/// The file of this name that a job made.
pub fn named<'job>(job: &'job Job, name: &str) -> Result<&'job ArtifactInfo, ApiError> {
    refuse_expired(job)?;
    let made = job.result.iter().flat_map(|result| &result.artifacts).find(|artifact| artifact.name == name);
    made.ok_or_else(|| {
        let error = ApiError::not_found("such file of this job");
        if job.state.is_final() { error } else { error.hint("the job is not done yet; files come with success") }
    })
}

fn refuse_expired(job: &Job) -> Result<(), ApiError> {
    if job.state == JobState::Expired {
        return Err(expired().hint("rig the mesh again"));
    }
    Ok(())
}

/// The bytes of `artifact`, or the part of them that `headers` ask for.
pub async fn serve(app: &App, job: &Job, artifact: &ArtifactInfo, headers: &HeaderMap) -> Result<Response, ApiError> {
    let mut response = serve_file(app, artifact, headers, expired).await?;
    if let Some(timing) = server_timing(job) {
        response.headers_mut().insert(super::rigs::SERVER_TIMING, timing);
    }
    response.extensions_mut().insert(AboutJob(job.id));
    Ok(response)
}

/// The files of a job went.
pub fn expired() -> ApiError {
    ApiError::new(Code::Expired, "the files of this job are no longer kept")
}

/// No byte of the file lies where the caller asks.
pub fn outside(artifact: &ArtifactInfo) -> ApiError {
    ApiError::new(Code::RangeNotSatisfiable, format!("the file has {} bytes", artifact.bytes))
}

/// The bytes of a stored file, or the part of them that `headers` ask for.
pub async fn serve_file(
    app: &App,
    artifact: &ArtifactInfo,
    headers: &HeaderMap,
    expired: impl Fn() -> ApiError + Copy,
) -> Result<Response, ApiError> {
    let etag = format!("\"{}\"", hex(&artifact.sha256));
    let part = match part(headers, &etag, artifact.bytes) {
        Ok(part) => part,
        Err(NotSatisfiable) => {
            return Err(outside(artifact).header(header::CONTENT_RANGE, &format!("bytes */{}", artifact.bytes)));
        }
    };
    let mut response = if part == Part::Nothing {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        let content = app.jobs.open(&artifact.sha256).await?.ok_or_else(expired)?;
        bytes_response(&content, &part, artifact).await?.ok_or_else(expired)?
    };
    let digest = format!("sha-256=:{}:", BASE64_STANDARD.encode(artifact.sha256));
    let disposition = format!("attachment; filename=\"{}\"", artifact.name);
    let fields = [
        (header::ETAG, etag),
        (header::ACCEPT_RANGES, "bytes".to_owned()),
        (header::CACHE_CONTROL, "private, no-cache".to_owned()),
        (REPR_DIGEST, digest),
        (header::CONTENT_DISPOSITION, disposition),
    ];
    for (name, value) in fields {
        response.headers_mut().insert(name, HeaderValue::from_str(&value).map_err(|error| ApiError::internal(&error))?);
    }
    Ok(response)
}

/// `None`: the file went just now.
async fn bytes_response(content: &Content, part: &Part, artifact: &ArtifactInfo) -> Result<Option<Response>, ApiError> {
    let (status, first, bytes) = match *part {
        Part::Range { first, last } => (StatusCode::PARTIAL_CONTENT, first, last - first + 1),
        Part::Whole | Part::Nothing => (StatusCode::OK, 0, artifact.bytes),
    };
    let stream = match content.stream(first, bytes).await {
        Err(error) if error.is_missing() => return Ok(None),
        stream => stream.map_err(|error| ApiError::internal(&error))?,
    };
    let body = Body::from_stream(stream);
    let mut response = (status, [(header::CONTENT_TYPE, artifact.media_type.clone())], body).into_response();
    response.headers_mut().insert(header::CONTENT_LENGTH, bytes.into());
    if let Part::Range { first, last } = part
        && let Ok(range) = HeaderValue::from_str(&format!("bytes {first}-{last}/{}", artifact.bytes))
    {
        response.headers_mut().insert(header::CONTENT_RANGE, range);
    }
    Ok(Some(response))
}

/// What is sent of a file.
#[derive(Debug, PartialEq, Eq)]
enum Part {
    /// The caller has it.
    Nothing,
    Whole,
    /// First and last byte.
    Range {
        first: u64,
        last: u64,
    },
}

/// No byte of the file lies in the range.
#[derive(Debug, PartialEq, Eq)]
struct NotSatisfiable;

/// Conditional and range requests (RFC 9110, sections 13 and 14). Ranges that cannot be read, and lists of ranges, are
/// answered with the whole file, as the standard allows.
fn part(headers: &HeaderMap, etag: &str, bytes: u64) -> Result<Part, NotSatisfiable> {
    let value = |name: HeaderName| headers.get(name).and_then(|value| value.to_str().ok());
    if let Some(known) = value(header::IF_NONE_MATCH)
        && known.split(',').map(str::trim).any(|tag| tag == "*" || tag.trim_start_matches("W/") == etag)
    {
        return Ok(Part::Nothing);
    }
    if value(header::IF_RANGE).is_some_and(|known| known.trim() != etag) {
        return Ok(Part::Whole);
    }
    let range = value(header::RANGE).and_then(|range| range.trim().strip_prefix("bytes="));
    let Some((first, last)) = range.and_then(|range| range.split_once('-')) else { return Ok(Part::Whole) };
    let number = |text: &str| text.trim().parse::<u64>().ok();
    let (first, last) = match (first.trim(), last.trim()) {
        ("", last) => match number(last) {
            Some(count) => (bytes.saturating_sub(count), if count == 0 { None } else { bytes.checked_sub(1) }),
            None => return Ok(Part::Whole),
        },
        (first, "") => match number(first) {
            Some(first) => (first, bytes.checked_sub(1)),
            None => return Ok(Part::Whole),
        },
        (first, last) => match (number(first), number(last)) {
            (Some(first), Some(last)) if first <= last => (first, bytes.checked_sub(1).map(|end| last.min(end))),
            _ => return Ok(Part::Whole),
        },
    };
    match last {
        Some(last) if first <= last => Ok(Part::Range { first, last }),
        _ => Err(NotSatisfiable),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(fields: &[(HeaderName, &'static str)], bytes: u64) -> Result<Part, NotSatisfiable> {
        let headers = fields.iter().map(|(name, value)| (name.clone(), HeaderValue::from_static(value))).collect();
        part(&headers, "\"abc\"", bytes)
    }

    #[test]
    fn ranges_are_read_as_the_standard_says() {
        for (range, bytes, expected) in [
            ("bytes=0-9", 100, Ok(Part::Range { first: 0, last: 9 })),
            ("bytes=90-", 100, Ok(Part::Range { first: 90, last: 99 })),
            ("bytes=-5", 100, Ok(Part::Range { first: 95, last: 99 })),
            ("bytes=-500", 100, Ok(Part::Range { first: 0, last: 99 })),
            ("bytes=50-500", 100, Ok(Part::Range { first: 50, last: 99 })),
            ("bytes=100-", 100, Err(NotSatisfiable)),
            ("bytes=-0", 100, Err(NotSatisfiable)),
            ("bytes=0-", 0, Err(NotSatisfiable)),
            ("bytes=9-5", 100, Ok(Part::Whole)),
            ("bytes=0-1,3-4", 100, Ok(Part::Whole)),
            ("bytes=a-b", 100, Ok(Part::Whole)),
            ("lines=0-1", 100, Ok(Part::Whole)),
        ] {
            assert_eq!(asked(&[(header::RANGE, range)], bytes), expected, "{range}");
        }
    }

    #[test]
    fn conditions_decide_before_ranges() {
        let range = (header::RANGE, "bytes=0-9");
        assert_eq!(asked(&[(header::IF_NONE_MATCH, "\"x\", W/\"abc\""), range.clone()], 100), Ok(Part::Nothing));
        assert_eq!(asked(&[(header::IF_RANGE, "\"old\""), range.clone()], 100), Ok(Part::Whole));
        assert_eq!(asked(&[(header::IF_RANGE, "\"abc\""), range], 100), Ok(Part::Range { first: 0, last: 9 }));
    }
}
