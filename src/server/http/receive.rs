//! Uploads: a raw body or a form becomes stored files and options. Whatever goes wrong on the way, nothing stays.

use super::App;
use super::error::{ApiError, Code};
use super::media::{self, Body};
use super::negotiate::query_pairs;
use crate::formats::refuse_foreign;
use crate::jobs::{ErrorCode, OptionsReader, Received, Refusal, RigOptions, Upload};
use axum::extract::multipart::{Field, MultipartError};
use axum::extract::{FromRequest, Multipart, Request};
use axum::http::{HeaderMap, StatusCode, header};
use bytes::Bytes;
use http_body_util::BodyExt;
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::time::Instant;

/// Bytes collected before they are written, so that a byte-wise upload does not become a byte-wise disk.
const WRITE_BYTES: usize = 1 << 20;
/// Enough of a file to tell what it is.
const HEAD_BYTES: usize = 4096;
/// Files and fields of one form.
const PARTS_MAX: usize = 512;
/// A text field, or the JSON part `options`.
const TEXT_BYTES_MAX: usize = 64 * 1024;
/// Refusing early helps the sender; an upload that is refused after it began is read no further.
const BUSY_RETRY: Duration = Duration::from_secs(2);

/// A mesh to rig and how, as a request brought it.
pub struct Order {
    pub received: Received,
    pub options: RigOptions,
}

/// Receives the upload of a create or check request. Refuses what it can before the body is read.
pub async fn order(app: &App, request: Request) -> Result<Order, ApiError> {
    let (mut options, file_name) = query_options(&request)?;
    let body = media::body(request.headers(), file_name)?;
    declared_length(request.headers(), app.limits.upload_bytes_max)?;
    // A form may still bring options; those of the query must be right by themselves.
    let early = options.clone().finish().map_err(ApiError::fields)?;
    app.jobs.admit(&early).await?;
    let Ok(_permit) = app.uploads.try_acquire() else {
        let refusal = Refusal::QueueFull { waiting: app.limits.uploads_max, retry_after: BUSY_RETRY };
        return Err(refusal.into());
    };
    let mut sink = Sink::open(app)?;
    let main = match body {
        Body::Mesh { name } => raw(&mut sink, request, &name).await.map(|()| name)?,
        Body::Form => form(&mut sink, request, &mut options).await?,
    };
    let options = options.finish().map_err(ApiError::fields)?;
    let received = sink.finish(&main).await?;
    Ok(Order { received, options })
}

/// Options of the query, and the name that it gives to a raw body.
fn query_options(request: &Request) -> Result<(OptionsReader, Option<String>), ApiError> {
    let mut options = OptionsReader::default();
    let mut file_name = None;
    for (name, value) in query_pairs(request.uri())? {
        if name == "file_name" {
            file_name = Some(media::relative_name(&value).map_err(|detail| ApiError::field("file_name", detail))?);
        } else {
            options.text(&name, &value);
        }
    }
    Ok((options, file_name))
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
    while let Some(frame) = sink.in_time(body.frame()).await? {
        let frame = frame.map_err(|_| incomplete())?;
        if let Ok(data) = frame.into_data() {
            sink.push(data).await?;
            sink.refuse_foreign(name)?;
        }
    }
    sink.flush().await?;
    if sink.file_bytes == 0 {
        return Err(empty(name));
    }
    Ok(())
}

/// Reads a form; gives the name of the main file.
async fn form(sink: &mut Sink, request: Request, options: &mut OptionsReader) -> Result<String, ApiError> {
    let mut form = Multipart::from_request(request, &())
        .await
        .map_err(|rejection| ApiError::new(Code::InvalidMultipart, rejection.body_text()))?;
    let mut files = Files::default();
    for _ in 0..PARTS_MAX {
        let Some(mut field) = sink.in_time(form.next_field()).await?.map_err(|error| broken(sink, &error))? else {
            let main = files.main()?;
            sink.refuse_foreign(&main)?;
            return Ok(main);
        };
        let name = field.name().unwrap_or_default().to_owned();
        match field.file_name().map(str::to_owned) {
            Some(_) if name == "options" => json_options(&text(sink, &mut field).await?, options)?,
            Some(file_name) => {
                let file_name = files.add(&name, &file_name)?;
                sink.begin(&file_name).await?;
                while let Some(chunk) = sink.in_time(field.chunk()).await?.map_err(|error| broken(sink, &error))? {
                    sink.push(chunk).await?;
                }
                sink.flush().await?;
                if sink.file_bytes == 0 && media::is_mesh_name(&file_name) {
                    return Err(empty(&file_name));
                }
            }
            None if name == "options" => json_options(&text(sink, &mut field).await?, options)?,
            None => options.text(&name, &text(sink, &mut field).await?),
        }
    }
    Err(ApiError::new(Code::InvalidMultipart, format!("the form has more than {PARTS_MAX} parts"))
        .hint("send the files in one zip archive"))
}

async fn text(sink: &mut Sink, field: &mut Field<'_>) -> Result<String, ApiError> {
    let name = field.name().unwrap_or_default().to_owned();
    let mut bytes = Vec::new();
    while let Some(chunk) = sink.in_time(field.chunk()).await?.map_err(|error| broken(sink, &error))? {
        bytes.extend_from_slice(&chunk);
        if bytes.len() > TEXT_BYTES_MAX {
            return Err(ApiError::field(&name, format!("is longer than {TEXT_BYTES_MAX} bytes"))
                .hint("send a file with a file name, as curl does with -F file=@hero.obj"));
        }
    }
    String::from_utf8(bytes).map_err(|_| ApiError::field(&name, "is not UTF-8 text"))
}

fn json_options(text: &str, options: &mut OptionsReader) -> Result<(), ApiError> {
    let members: serde_json::Map<String, serde_json::Value> = serde_json::from_str(text).map_err(|error| {
        ApiError::new(Code::InvalidJson, format!("the part options is not a JSON object: {error}"))
            .hint("send options={\"detail\": 0.7}, for example")
    })?;
    for (name, value) in &members {
        options.json(name, value);
    }
    Ok(())
}

/// The files of a form, and which of them is to be rigged.
#[derive(Default)]
struct Files {
    names: BTreeSet<String>,
    /// Sent as the field `file`.
    named: Vec<String>,
    /// Have the extension of a mesh format.
    meshes: Vec<String>,
}

impl Files {
    fn add(&mut self, field: &str, file_name: &str) -> Result<String, ApiError> {
        let name = media::relative_name(file_name).map_err(|detail| ApiError::field(field, detail))?;
        if !self.names.insert(name.clone()) {
            return Err(ApiError::field(field, format!("a second file is named {name:?}")));
        }
        if field == "file" {
            self.named.push(name.clone());
        }
        if media::is_mesh_name(&name) {
            self.meshes.push(name.clone());
        }
        Ok(name)
    }

    /// The file sent as `file`, when there is one such; else the only one with the extension of a mesh format. A
    /// caller who sends all files as `file` means the mesh among them.
    fn main(self) -> Result<String, ApiError> {
        let Self { names, named, meshes } = self;
        if let ([only], _) | (_, [only]) = (&named[..], &meshes[..]) {
            return Ok(only.clone());
        }
        let mut names = names.into_iter();
        match (names.next(), names.next()) {
            (None, _) => Err(ApiError::field("file", "the form has no file")
                .hint("send the mesh as a file, as curl does with -F file=@hero.obj")),
            (Some(only), None) => Ok(only),
            _ if meshes.is_empty() => {
                Err(ApiError::field("file", "none of the files has the extension of a mesh format")
                    .hint("send the mesh in the field file, and the others in fields of another name"))
            }
            _ => Err(ApiError::field("file", format!("which of {} is to be rigged is not clear", meshes.join(", ")))
                .hint("send that one in the field file, and the others in fields of another name")),
        }
    }
}

/// Where received bytes go. Writes happen on threads that may block.
struct Sink {
    /// `None` while a write is under way, and for good when it failed.
    upload: Option<Upload>,
    pending: Vec<Bytes>,
    pending_bytes: usize,
    bytes: u64,
    bytes_max: u64,
    /// Bytes of the file begun last.
    file_bytes: u64,
    /// The first bytes of each file, the newest last.
    heads: Vec<(String, Vec<u8>)>,
    pause_max: Duration,
    /// When even a steady upload has taken too long.
    deadline: Instant,
}

impl Sink {
    fn open(app: &App) -> Result<Self, ApiError> {
        Ok(Self {
            upload: Some(app.jobs.upload().map_err(|error| ApiError::store(&error))?),
            pending: Vec::new(),
            pending_bytes: 0,
            bytes: 0,
            bytes_max: app.limits.upload_bytes_max,
            file_bytes: 0,
            heads: Vec::new(),
            pause_max: app.limits.upload_pause_max,
            deadline: Instant::now() + app.limits.upload_time_max,
        })
    }

    /// What `next` gives, unless the sender pauses for too long.
    async fn in_time<T>(&self, next: impl Future<Output = T>) -> Result<T, ApiError> {
        let until = self.deadline.min(Instant::now() + self.pause_max);
        tokio::time::timeout_at(until, next).await.map_err(|_| {
            let detail = if until == self.deadline {
                "the upload took too long".to_owned()
            } else {
                format!("no byte arrived for {} s", self.pause_max.as_secs_f64())
            };
            ApiError::new(Code::UploadTimeout, detail).hint("send it again over a steadier connection")
        })
    }

    async fn begin(&mut self, name: &str) -> Result<(), ApiError> {
        self.file_bytes = 0;
        self.heads.push((name.to_owned(), Vec::new()));
        let name = name.to_owned();
        self.write(move |upload| upload.begin(&name)).await
    }

    async fn push(&mut self, data: Bytes) -> Result<(), ApiError> {
        self.bytes += data.len() as u64;
        self.file_bytes += data.len() as u64;
        if self.bytes > self.bytes_max {
            return Err(ApiError::too_large(self.bytes_max, None));
        }
        if let Some((_, head)) = self.heads.last_mut() {
            let missing = HEAD_BYTES.saturating_sub(head.len()).min(data.len());
            head.extend(data.iter().take(missing));
        }
        self.pending_bytes += data.len();
        self.pending.push(data);
        if self.pending_bytes >= WRITE_BYTES { self.flush().await } else { Ok(()) }
    }

    /// Refuses what is surely no mesh, by name.
    fn refuse_foreign(&self, name: &str) -> Result<(), ApiError> {
        let head = self.heads.iter().find(|(known, _)| known == name).map_or(&[][..], |(_, head)| head);
        refuse_foreign(head).map_err(|error| {
            let code = Code::Work(ErrorCode::UnsupportedMediaType);
            ApiError::new(code, format!("{name}: {error}")).hint(error.hint())
        })
    }

    async fn flush(&mut self) -> Result<(), ApiError> {
        let pending = std::mem::take(&mut self.pending);
        self.pending_bytes = 0;
        if pending.is_empty() {
            return Ok(());
        }
        self.write(move |upload| pending.iter().try_for_each(|data| upload.append(data))).await
    }

    async fn write(
        &mut self,
        write: impl FnOnce(&mut Upload) -> Result<(), crate::storage::StoreError> + Send + 'static,
    ) -> Result<(), ApiError> {
        let Some(mut upload) = self.upload.take() else {
            return Err(ApiError::internal(&"an upload was written to after its end"));
        };
        let written = tokio::task::spawn_blocking(move || write(&mut upload).map(|()| upload)).await;
        let upload = written.map_err(|error| ApiError::internal(&error))?;
        self.upload = Some(upload.map_err(|error| ApiError::store(&error))?);
        Ok(())
    }

    async fn finish(mut self, main: &str) -> Result<Received, ApiError> {
        let Some(upload) = self.upload.take() else {
            return Err(ApiError::internal(&"an upload was finished twice"));
        };
        let main = main.to_owned();
        let finished = tokio::task::spawn_blocking(move || upload.finish(&main)).await;
        finished.map_err(|error| ApiError::internal(&error))?.map_err(|error| ApiError::store(&error))
    }
}

fn incomplete() -> ApiError {
    ApiError::new(Code::UploadIncomplete, "the connection closed before the body was complete")
}

fn broken(sink: &Sink, error: &MultipartError) -> ApiError {
    if error.status() == StatusCode::PAYLOAD_TOO_LARGE {
        return ApiError::too_large(sink.bytes_max, None);
    }
    ApiError::new(Code::InvalidMultipart, format!("the form cannot be read: {}", error.body_text()))
}

fn empty(name: &str) -> ApiError {
    ApiError::new(Code::Work(ErrorCode::UnreadableMesh), format!("the file {name} has no bytes"))
        .hint("with curl, send a file by --data-binary @hero.glb or -F file=@hero.glb")
}
