//! The body of a request that goes on with an upload. What arrived is written down part by part, so that little is lost with a
//! connection, or with the service; with a checksum, all of it once it is known to be right.

use super::App;
use super::error::{ApiError, Code, Limit};
use super::receive::incomplete;
use super::sink::{Deadline, Sink};
use super::tus_headers::Checksum;
use crate::jobs::{Caller, ErrorCode, NotAdded, Received, Resumable};
use crate::server::uploads;
use axum::body::Body;
use bytes::Bytes;
use http_body_util::BodyExt;

/// A part is written down when it has this many bytes.
const PART_BYTES: u64 = 8 << 20;

/// Bytes on their way to an upload.
pub struct Incoming {
    app: App,
    caller: Caller,
    upload: Resumable,
    checksum: Option<Checksum>,
    /// Bytes that came and are not written down,
    pending: u64,
    /// as complete parts,
    parts: Vec<Received>,
    /// and as one that is not.
    sink: Option<Sink>,
}

impl Incoming {
    /// Goes on where `upload` ends.
    pub fn new(app: App, caller: Caller, upload: Resumable, checksum: Option<Checksum>) -> Self {
        Self { app, caller, upload, checksum, pending: 0, parts: Vec::new(), sink: None }
    }

    /// Takes `body` to its end. What came of a body that breaks off is kept, unless a checksum is owed.
    pub async fn receive(mut self, mut body: Body) -> Result<(), ApiError> {
        let app = self.app.clone();
        let _permit = uploads::permit(&app)?;
        let deadline = Deadline::of(&app);
        loop {
            let frame = match deadline.in_time(body.frame()).await {
                Ok(None) => return self.finish().await,
                Ok(Some(Ok(frame))) => frame,
                Ok(Some(Err(_))) => return self.break_off(incomplete()).await,
                Err(late) => return self.break_off(late).await,
            };
            if let Ok(data) = frame.into_data() {
                self.take(data).await?;
            }
        }
    }

    async fn take(&mut self, data: Bytes) -> Result<(), ApiError> {
        self.pending += data.len() as u64;
        if self.upload.received + self.pending > self.upload.length {
            return Err(too_long(&self.upload, None));
        }
        if let Some(checksum) = &mut self.checksum {
            checksum.update(&data);
        }
        let name = &self.upload.file_name;
        let mut sink = match self.sink.take() {
            Some(sink) => sink,
            None => {
                let mut sink = Sink::open(&self.app)?;
                sink.begin(name).await?;
                sink
            }
        };
        sink.push(data).await?;
        if self.upload.received == 0 && self.parts.is_empty() {
            sink.refuse_foreign(name)?;
        }
        let is_full = sink.file_bytes() >= PART_BYTES;
        self.sink = Some(sink);
        if is_full {
            self.seal().await?;
            if self.checksum.is_none() {
                self.keep().await?;
            }
        }
        Ok(())
    }

    /// The part that was begun is complete.
    async fn seal(&mut self) -> Result<(), ApiError> {
        if let Some(mut sink) = self.sink.take() {
            sink.flush().await?;
            self.parts.push(sink.finish(&self.upload.file_name).await?);
        }
        Ok(())
    }

    /// Writes down what is complete.
    async fn keep(&mut self) -> Result<(), ApiError> {
        let parts = std::mem::take(&mut self.parts);
        if parts.is_empty() {
            return Ok(());
        }
        let at = self.upload.received;
        match self.app.jobs.add_to_resumable(&self.caller, &self.upload, at, parts).await? {
            Ok(()) => {
                self.upload.received += std::mem::take(&mut self.pending);
                Ok(())
            }
            Err(NotAdded::Elsewhere) => Err(elsewhere(at)),
            Err(NotAdded::Gone) => Err(expired()),
        }
    }

    async fn finish(mut self) -> Result<(), ApiError> {
        self.seal().await?;
        if let Some(checksum) = self.checksum.take() {
            checksum.verify()?;
        }
        self.keep().await
    }

    /// The sender is gone, or as good as that.
    async fn break_off(mut self, why: ApiError) -> Result<(), ApiError> {
        if self.checksum.is_none() {
            self.seal().await?;
            self.keep().await?;
        }
        Err(why.hint("ask for the offset by HEAD, and go on from there"))
    }
}

/// The upload does not end at `offset`.
pub fn elsewhere(offset: u64) -> ApiError {
    ApiError::new(Code::Conflict, format!("the upload does not end at byte {offset}"))
        .hint("ask for the offset by HEAD, and go on from there")
}

pub fn expired() -> ApiError {
    ApiError::new(Code::Expired, "the parts of this upload are no longer kept").hint("begin a new upload")
}

/// More than was announced.
pub fn too_long(upload: &Resumable, actual: Option<u64>) -> ApiError {
    let max = upload.length;
    ApiError::new(Code::Work(ErrorCode::TooLarge), format!("the upload was announced with {max} bytes; this is more"))
        .limit(Limit { name: "upload_length".to_owned(), max, actual })
        .hint("begin a new upload with the right Upload-Length")
}
