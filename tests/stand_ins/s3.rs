//! A stand-in for S3-compatible storage: objects in memory, addressed by path (`/BUCKET/KEY`), with ranges, lists and
//! uploads in parts. It looks for a SigV4 header with the right key id, and does not check the signature. It can be told
//! to answer with 500 or to cut connections:
//!
//! | request | |
//! |---|---|
//! | `PUT /-/faults?errors=0.2&cuts=0.1` | shares of the requests from now on |
//! | `GET /-/counts` | requests by method, bytes in and out, and objects, as JSON |

use axum::body::Body;
use axum::extract::Query;
use axum::http::header::{AUTHORIZATION, CONTENT_LENGTH, CONTENT_RANGE, ETAG, LAST_MODIFIED, RANGE};
use axum::http::{HeaderMap, Method, Request, Response, StatusCode, Uri};
use bytes::Bytes;
use http_body_util::BodyExt;
use hyper::body::Incoming;
use hyper::service::service_fn;
use hyper_util::rt::{TokioExecutor, TokioIo};
use hyper_util::server::conn::auto;
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, HashMap};
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::net::TcpListener;

/// The key id that is let in; any secret goes with it.
pub const KEY_ID: &str = "stand-in";
/// Objects in one page of a list.
const PAGE: usize = 100;
/// Everything was written then; nobody asks when.
const WHEN: &str = "Tue, 24 Nov 2026 18:30:00 GMT";
const WHEN_LISTED: &str = "2026-11-24T18:30:00.000Z";

#[derive(Default)]
struct Kept {
    objects: BTreeMap<String, Bytes>,
    uploads: HashMap<String, BTreeMap<u32, Bytes>>,
    /// Shares of the requests.
    errors: f64,
    cuts: f64,
    /// Requests that may fail, so far: decides which do.
    requests: u64,
    counts: BTreeMap<String, u64>,
}

#[derive(Clone, Default)]
struct StandIn(Arc<Mutex<Kept>>);

/// What becomes of a request.
#[derive(Clone, Copy, PartialEq)]
enum Fate {
    Answered,
    Error,
    /// The connection is cut before anything is done,
    CutBefore,
    /// or after.
    CutAfter,
}

/// Answers whoever connects, for ever.
pub async fn serve(listener: TcpListener) -> io::Result<()> {
    let state = StandIn::default();
    loop {
        let (stream, _) = listener.accept().await?;
        let state = state.clone();
        tokio::spawn(async move {
            let service = service_fn(move |request: Request<Incoming>| {
                let state = state.clone();
                async move { state.handle(request).await.ok_or(io::Error::from(io::ErrorKind::ConnectionReset)) }
            });
            // Ends with an error where a connection is cut.
            let _ = auto::Builder::new(TokioExecutor::new()).serve_connection(TokioIo::new(stream), service).await;
        });
    }
}

/// Half of an answer: the server drops the connection where the body fails.
fn half(answer: Response<Body>, content: &Bytes) -> Response<Body> {
    let chunks = [Ok(content.slice(..content.len() / 2)), Err(io::Error::from(io::ErrorKind::ConnectionReset))];
    answer.map(|_| Body::from_stream(tokio_stream::iter(chunks)))
}

fn answer(status: StatusCode, headers: &[(&str, &str)], body: impl Into<Body>) -> Response<Body> {
    let mut response = Response::builder().status(status).header(LAST_MODIFIED, WHEN);
    for (name, value) in headers {
        response = response.header(*name, *value);
    }
    response.body(body.into()).expect("an answer")
}

fn error(status: StatusCode, code: &str) -> Response<Body> {
    answer(status, &[], format!("<Error><Code>{code}</Code><Message>{code}</Message></Error>"))
}

fn etag(content: &[u8]) -> String {
    let digest: String = Sha256::digest(content).iter().take(16).map(|byte| format!("{byte:02x}")).collect();
    format!("\"{digest}\"")
}

/// First and last byte of `bytes=FIRST-LAST`.
fn range(headers: &HeaderMap, length: usize) -> Option<(usize, usize)> {
    let (first, last) = headers.get(RANGE)?.to_str().ok()?.strip_prefix("bytes=")?.split_once('-')?;
    let first: usize = first.parse().ok()?;
    let last: usize = last.parse().unwrap_or(usize::MAX);
    Some((first, last.min(length.checked_sub(1)?)))
}

impl StandIn {
    fn lock(&self) -> MutexGuard<'_, Kept> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// `None`: the connection is cut.
    async fn handle(&self, request: Request<Incoming>) -> Option<Response<Body>> {
        let (parts, body) = request.into_parts();
        let query: HashMap<String, String> =
            Query::try_from_uri(&parts.uri).map(|Query(pairs)| pairs).unwrap_or_default();
        match parts.uri.path() {
            "/-/faults" => return Some(self.set_faults(&query)),
            "/-/counts" => return Some(self.counts()),
            _ => {}
        }
        let signed = parts.headers.get(AUTHORIZATION).and_then(|value| value.to_str().ok());
        if !signed.is_some_and(|value| value.starts_with(&format!("AWS4-HMAC-SHA256 Credential={KEY_ID}/"))) {
            return Some(error(StatusCode::FORBIDDEN, "InvalidAccessKeyId"));
        }
        let fate = self.fate();
        if fate == Fate::CutBefore {
            return None;
        }
        let body = body.collect().await.ok()?.to_bytes();
        if fate == Fate::Error {
            return Some(error(StatusCode::INTERNAL_SERVER_ERROR, "InternalError"));
        }
        let answer = self.answer(&parts.method, &parts.uri, &query, &parts.headers, body);
        if fate == Fate::Answered {
            return Some(answer);
        }
        let (head, body) = answer.into_parts();
        let content = body.collect().await.ok()?.to_bytes();
        (!content.is_empty()).then(|| half(Response::from_parts(head, Body::empty()), &content))
    }

    fn set_faults(&self, shares: &HashMap<String, String>) -> Response<Body> {
        let share = |name: &str| shares.get(name).and_then(|share| share.parse().ok()).unwrap_or(0.0);
        let mut kept = self.lock();
        (kept.errors, kept.cuts) = (share("errors"), share("cuts"));
        answer(StatusCode::OK, &[], Body::empty())
    }

    fn counts(&self) -> Response<Body> {
        let kept = self.lock();
        let mut counts = kept.counts.clone();
        counts.insert("objects".to_owned(), kept.objects.len() as u64);
        counts.insert("unfinished uploads".to_owned(), kept.uploads.len() as u64);
        answer(StatusCode::OK, &[], serde_json::json!(counts).to_string())
    }

    /// The same for every run that sends the same number of requests.
    fn fate(&self) -> Fate {
        let mut kept = self.lock();
        kept.requests += 1;
        let digest = Sha256::digest(kept.requests.to_be_bytes());
        let share = f64::from(u32::from_be_bytes([digest[0], digest[1], digest[2], digest[3]])) / f64::from(u32::MAX);
        if share < kept.errors {
            Fate::Error
        } else if share < kept.errors + kept.cuts {
            if digest[4] % 2 == 0 { Fate::CutBefore } else { Fate::CutAfter }
        } else {
            Fate::Answered
        }
    }

    fn answer(
        &self,
        method: &Method,
        uri: &Uri,
        query: &HashMap<String, String>,
        headers: &HeaderMap,
        body: Bytes,
    ) -> Response<Body> {
        let mut kept = self.lock();
        let path = uri.path().trim_start_matches('/').to_owned();
        let given = |name: &str| query.get(name).cloned();
        *kept.counts.entry(method.to_string()).or_default() += 1;
        *kept.counts.entry("bytes in".to_owned()).or_default() += body.len() as u64;
        match (method.as_str(), given("uploadId"), given("list-type")) {
            ("GET", None, Some(_)) => kept.list(&path, query),
            ("GET" | "HEAD", None, None) => kept.get(&path, headers),
            ("POST", None, None) if query.contains_key("uploads") => {
                let id = format!("upload-{}", kept.requests);
                kept.uploads.insert(id.clone(), BTreeMap::new());
                let result = "InitiateMultipartUploadResult";
                answer(StatusCode::OK, &[], format!("<{result}><UploadId>{id}</UploadId></{result}>"))
            }
            ("PUT", Some(id), None) => {
                let number = given("partNumber").and_then(|number| number.parse().ok()).unwrap_or(0);
                let tag = etag(&body);
                match kept.uploads.get_mut(&id) {
                    Some(parts) => {
                        parts.insert(number, body);
                        answer(StatusCode::OK, &[(ETAG.as_str(), &tag)], Body::empty())
                    }
                    None => error(StatusCode::NOT_FOUND, "NoSuchUpload"),
                }
            }
            ("POST", Some(id), None) => match kept.uploads.remove(&id) {
                Some(parts) => {
                    let content: Bytes = parts.into_values().flatten().collect();
                    let tag = etag(&content);
                    kept.objects.insert(path, content);
                    let result = "CompleteMultipartUploadResult";
                    answer(StatusCode::OK, &[], format!("<{result}><ETag>{tag}</ETag></{result}>"))
                }
                None => error(StatusCode::NOT_FOUND, "NoSuchUpload"),
            },
            ("PUT", None, None) => {
                let tag = etag(&body);
                kept.objects.insert(path, body);
                answer(StatusCode::OK, &[(ETAG.as_str(), &tag)], Body::empty())
            }
            ("DELETE", id, None) => {
                match id {
                    Some(id) => kept.uploads.remove(&id).map(|_| ()),
                    None => kept.objects.remove(&path).map(|_| ()),
                };
                answer(StatusCode::NO_CONTENT, &[], Body::empty())
            }
            _ => error(StatusCode::NOT_IMPLEMENTED, "NotImplemented"),
        }
    }
}

impl Kept {
    fn get(&mut self, path: &str, headers: &HeaderMap) -> Response<Body> {
        let Some(content) = self.objects.get(path).cloned() else { return error(StatusCode::NOT_FOUND, "NoSuchKey") };
        let tag = etag(&content);
        let (status, content, place) = match range(headers, content.len()) {
            Some((first, last)) if first <= last => {
                let place = format!("bytes {first}-{last}/{}", content.len());
                (StatusCode::PARTIAL_CONTENT, content.slice(first..=last), Some(place))
            }
            Some(_) => return error(StatusCode::RANGE_NOT_SATISFIABLE, "InvalidRange"),
            None => (StatusCode::OK, content, None),
        };
        *self.counts.entry("bytes out".to_owned()).or_default() += content.len() as u64;
        let length = content.len().to_string();
        let mut fields = vec![(ETAG.as_str(), tag.as_str()), (CONTENT_LENGTH.as_str(), length.as_str())];
        fields.extend(place.as_deref().map(|place| (CONTENT_RANGE.as_str(), place)));
        answer(status, &fields, content)
    }

    fn list(&self, bucket: &str, query: &HashMap<String, String>) -> Response<Body> {
        let bucket = bucket.trim_end_matches('/');
        let prefix = format!("{bucket}/{}", query.get("prefix").map_or("", String::as_str));
        let after = query.get("continuation-token").map(|key| format!("{bucket}/{key}"));
        let mut found = self
            .objects
            .iter()
            .filter(|(path, _)| path.starts_with(&prefix) && after.as_ref().is_none_or(|after| *path > after))
            .map(|(path, content)| (path[bucket.len() + 1..].to_owned(), content));
        let page: Vec<_> = found.by_ref().take(PAGE).collect();
        let more = found.next().is_some();
        let contents: String = page
            .iter()
            .map(|(key, content)| {
                let (size, tag) = (content.len(), etag(content));
                format!(
                    "<Contents><Key>{key}</Key><LastModified>{WHEN_LISTED}</LastModified><Size>{size}</Size>\
                     <ETag>{tag}</ETag></Contents>"
                )
            })
            .collect();
        let next = page.last().filter(|_| more).map(|(key, _)| key.clone());
        let next = next.map(|key| format!("<NextContinuationToken>{key}</NextContinuationToken>")).unwrap_or_default();
        let result = "ListBucketResult";
        answer(StatusCode::OK, &[], format!("<{result}><IsTruncated>{more}</IsTruncated>{contents}{next}</{result}>"))
    }
}
