//! Uploads: a raw body or a form becomes stored files and options. Whatever goes wrong on the way, nothing stays.

use super::App;
use super::error::{ApiError, Code};
use super::fetch;
use super::media::{self, Body};
use super::negotiate::{query, query_pairs};
use super::sink::{Deadline, Sink};
use super::wishes::{Wishes, WishesReader};
use crate::jobs::{Received, Source};
use crate::server::orders;
use crate::server::uploads::{self, Files, asset_id, empty};
use axum::extract::multipart::{Field, MultipartError};
use axum::extract::{FromRequest, Multipart, Request};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use http_body_util::BodyExt;
use serde_json::{Map, Value};

/// Files and fields of one form.
const PARTS_MAX: usize = 512;
/// A text field, or the JSON part `options`.
const TEXT_BYTES_MAX: usize = 64 * 1024;
/// A `rig.json` with its weights.
const SKELETON_BYTES_MAX: usize = JSON_BYTES_MAX as usize;
/// JSON with a mesh within: base64 makes four bytes of three.
const JSON_BYTES_MAX: u64 = 6 << 20;

/// What a create or check request brought.
pub struct Order {
    pub source: Source,
    pub wishes: Wishes,
}

/// Receives the upload of a create or check request, or the name of an asset in its place. Refuses what it can before
/// the body is read; a full queue only when the request cannot be a repetition.
pub async fn order(app: &App, request: Request, may_be_known: bool) -> Result<Order, ApiError> {
    let (mut wishes, file_name) = query_wishes(&request)?;
    let body = media::body(request.headers(), file_name, true)?;
    let bytes_max = if body == Body::Json { JSON_BYTES_MAX } else { app.limits.upload_bytes_max };
    declared_length(request.headers(), bytes_max)?;
    // The body may still bring wishes; those of the query must be right by themselves.
    let early = wishes.clone().finish(app.jobs.settings())?;
    orders::admit(app, &early.options, may_be_known).await?;
    let source = match body {
        Body::Json => json_order(app, request, &mut wishes).await?,
        body => Source::Upload(files(app, request, body, Some(&mut wishes)).await?),
    };
    Ok(Order { source, wishes: wishes.finish(app.jobs.settings())? })
}

/// Receives the files of an asset.
pub async fn asset(app: &App, request: Request) -> Result<Received, ApiError> {
    let mut file_name = None;
    for (name, value) in query(request.uri(), &["file_name"])? {
        file_name = Some(media::relative_name(&value).map_err(|detail| ApiError::field(&name, detail))?);
    }
    let body = media::body(request.headers(), file_name, false)?;
    declared_length(request.headers(), app.limits.upload_bytes_max)?;
    files(app, request, body, None).await
}

/// Receives files; a form without `wishes` may hold nothing else.
async fn files(
    app: &App,
    request: Request,
    body: Body,
    wishes: Option<&mut WishesReader>,
) -> Result<Received, ApiError> {
    let _permit = uploads::permit(app)?;
    let mut sink = Sink::open(app)?;
    let main = match body {
        Body::Mesh { name } => raw(&mut sink, request, &name).await.map(|()| name)?,
        Body::Form | Body::Json => form(&mut sink, request, wishes).await?,
    };
    sink.finish(&main).await
}

/// Wishes of the query, and the name that it gives to a raw body.
fn query_wishes(request: &Request) -> Result<(WishesReader, Option<String>), ApiError> {
    let mut wishes = WishesReader::default();
    let mut file_name = None;
    for (name, value) in query_pairs(request.uri())? {
        if name == "file_name" {
            file_name = Some(media::relative_name(&value).map_err(|detail| ApiError::field("file_name", detail))?);
        } else {
            wishes.text(&name, &value);
        }
    }
    Ok((wishes, file_name))
}

/// The mesh that a JSON body names or holds; its other members are wishes.
async fn json_order(app: &App, request: Request, wishes: &mut WishesReader) -> Result<Source, ApiError> {
    let mut members = json_body(app, request).await?;
    let asset = members.shift_remove("asset");
    members.iter().for_each(|(name, value)| wishes.json(name, value));
    // What is wrong with the other members is told first: it needs no look into the store.
    wishes.clone().finish(app.jobs.settings())?;
    match asset {
        Some(Value::String(id)) => asset_id(&id).map(Source::Asset),
        Some(Value::Object(given)) if given.contains_key("url") => {
            fetch::Wanted::of_json(&given)?.fetch(app).await.map(Source::Upload)
        }
        Some(Value::Object(given)) => inline_mesh(app, &given).await.map(Source::Upload),
        Some(other) => Err(ApiError::field("asset", format!("{other} is neither an id nor an object"))),
        None => Err(ApiError::field("asset", "is missing")
            .hint("POST the mesh to /v1/assets and name its id, or send the mesh itself as the body")),
    }
}

/// A JSON object as the body.
pub async fn json_body(app: &App, request: Request) -> Result<Map<String, Value>, ApiError> {
    let bytes = body_bytes(app, request, JSON_BYTES_MAX).await?;
    serde_json::from_slice(&bytes).map_err(|error| {
        ApiError::new(Code::InvalidJson, format!("the body is not a JSON object: {error}"))
            .hint("send {\"asset\": \"ast_…\"}, for example")
    })
}

/// A body that is read into memory.
pub async fn body_bytes(app: &App, request: Request, bytes_max: u64) -> Result<Vec<u8>, ApiError> {
    declared_length(request.headers(), bytes_max)?;
    let deadline = Deadline::of(app);
    let mut body = request.into_body();
    let mut bytes = Vec::new();
    while let Some(frame) = deadline.in_time(body.frame()).await? {
        if let Ok(data) = frame.map_err(|_| incomplete())?.into_data() {
            bytes.extend_from_slice(&data);
        }
        if bytes.len() as u64 > bytes_max {
            return Err(ApiError::too_large(bytes_max, None));
        }
    }
    Ok(bytes)
}

/// A small mesh within the JSON.
async fn inline_mesh(app: &App, given: &Map<String, Value>) -> Result<Received, ApiError> {
    let inner = given.get("inline").filter(|_| given.len() == 1).and_then(Value::as_object);
    let inner = inner.ok_or_else(|| {
        ApiError::unknown_field("asset", "asset.inline with media_type and base64, or asset.url with sha256")
    })?;
    if let Some(name) = inner.keys().find(|name| !["media_type", "base64"].contains(&name.as_str())) {
        return Err(ApiError::unknown_field(&format!("asset.inline.{name}"), "media_type, base64"));
    }
    let text = |name: &str| {
        let value = inner.get(name).and_then(Value::as_str);
        value.ok_or_else(|| ApiError::field(&format!("asset.inline.{name}"), "is missing or not a text"))
    };
    let name = media::name_for(text("media_type")?)?;
    let bytes = BASE64_STANDARD
        .decode(text("base64")?)
        .map_err(|error| ApiError::field("asset.inline.base64", format!("is not base64: {error}")))?;
    uploads::inline(app, &name, bytes.into()).await
}

fn declared_length(headers: &HeaderMap, max: u64) -> Result<(), ApiError> {
    let declared = headers.get(header::CONTENT_LENGTH).and_then(|length| length.to_str().ok()?.parse().ok());
    match declared {
        Some(length) if length > max => Err(ApiError::too_large(max, Some(length))),
        _ => Ok(()),
    }
}

async fn raw(sink: &mut Sink, request: Request, name: &str) -> Result<(), ApiError> {
    sink.begin(name).await?;
    let mut body = request.into_body();
    while let Some(frame) = sink.deadline.in_time(body.frame()).await? {
        let frame = frame.map_err(|_| incomplete())?;
        if let Ok(data) = frame.into_data() {
            sink.push(data).await?;
            sink.refuse_foreign(name)?;
        }
    }
    sink.flush().await?;
    if sink.file_bytes() == 0 {
        return Err(empty(name));
    }
    Ok(())
}

/// Reads a form; gives the name of the main file.
async fn form(sink: &mut Sink, request: Request, mut wishes: Option<&mut WishesReader>) -> Result<String, ApiError> {
    let mut form = Multipart::from_request(request, &())
        .await
        .map_err(|rejection| ApiError::new(Code::InvalidMultipart, rejection.body_text()))?;
    let mut files = Files::default();
    for _ in 0..PARTS_MAX {
        let Some(mut field) = sink.deadline.in_time(form.next_field()).await?.map_err(|error| broken(sink, &error))?
        else {
            let main = files.main()?;
            sink.refuse_foreign(&main)?;
            return Ok(main);
        };
        let name = field.name().unwrap_or_default().to_owned();
        // A wish is one also where its value was a file of the sender's: `-F skeleton=@edited.rig.json`.
        let is_wish = wishes.is_some() && (name == "options" || WishesReader::reads(&name));
        match field.file_name().map(str::to_owned) {
            Some(file_name) if !is_wish => {
                let file_name = files.add(&name, &file_name)?;
                sink.begin(&file_name).await?;
                while let Some(chunk) =
                    sink.deadline.in_time(field.chunk()).await?.map_err(|error| broken(sink, &error))?
                {
                    sink.push(chunk).await?;
                }
                sink.flush().await?;
                if sink.file_bytes() == 0 && media::is_mesh_name(&file_name) {
                    return Err(empty(&file_name));
                }
            }
            None if says_file_name(&field) => {
                return Err(ApiError::new(
                    Code::InvalidMultipart,
                    format!("the file name of the part {name:?} is not UTF-8"),
                )
                .hint("name the file in UTF-8, or in plain letters"));
            }
            _ if name == "options" => json_options(&text(sink, &mut field).await?, wishes.as_deref_mut())?,
            _ => match wishes.as_deref_mut() {
                Some(wishes) => wishes.text(&name, &text(sink, &mut field).await?),
                None => return Err(ApiError::unknown_field(&name, "files alone, each with a file name")),
            },
        }
    }
    Err(ApiError::new(Code::InvalidMultipart, format!("the form has more than {PARTS_MAX} parts"))
        .hint("send the files in one zip archive"))
}

/// Whether the part has a file name, be it one that cannot be read.
fn says_file_name(field: &Field<'_>) -> bool {
    let said = field.headers().get(header::CONTENT_DISPOSITION).map(HeaderValue::as_bytes).unwrap_or_default();
    said.windows(FILE_NAME.len()).any(|bytes| bytes.eq_ignore_ascii_case(FILE_NAME))
}

const FILE_NAME: &[u8] = b"filename=";

async fn text(sink: &mut Sink, field: &mut Field<'_>) -> Result<String, ApiError> {
    let name = field.name().unwrap_or_default().to_owned();
    let bytes_max = if name == "skeleton" { SKELETON_BYTES_MAX } else { TEXT_BYTES_MAX };
    let mut bytes = Vec::new();
    while let Some(chunk) = sink.deadline.in_time(field.chunk()).await?.map_err(|error| broken(sink, &error))? {
        bytes.extend_from_slice(&chunk);
        if bytes.len() > bytes_max {
            let refusal = ApiError::field(&name, format!("is longer than {bytes_max} bytes"));
            return Err(match WishesReader::reads(&name) || name == "options" {
                true => refusal.hint("no value of this field is so long"),
                false => refusal.hint("send a file with a file name, as curl does with -F file=@hero.obj"),
            });
        }
    }
    String::from_utf8(bytes).map_err(|_| ApiError::field(&name, "is not UTF-8 text"))
}

fn json_options(text: &str, wishes: Option<&mut WishesReader>) -> Result<(), ApiError> {
    let Some(wishes) = wishes else {
        return Err(ApiError::unknown_field("options", "files alone, each with a file name"));
    };
    let members: serde_json::Map<String, serde_json::Value> = serde_json::from_str(text).map_err(|error| {
        ApiError::new(Code::InvalidJson, format!("the part options is not a JSON object: {error}"))
            .hint("send options={\"detail\": 0.7}, for example")
    })?;
    for (name, value) in &members {
        wishes.json(name, value);
    }
    Ok(())
}

pub fn incomplete() -> ApiError {
    ApiError::new(Code::UploadIncomplete, "the connection closed before the body was complete")
}

fn broken(sink: &Sink, error: &MultipartError) -> ApiError {
    if error.status() == StatusCode::PAYLOAD_TOO_LARGE {
        return ApiError::too_large(sink.bytes_max(), None);
    }
    ApiError::new(Code::InvalidMultipart, format!("the form cannot be read: {}", error.body_text()))
}
