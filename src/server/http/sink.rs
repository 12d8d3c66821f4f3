//! Where received bytes go, and how long they may take. Writes happen on threads that may block.

use super::App;
use super::error::{ApiError, Code};
use crate::formats::refuse_foreign;
use crate::jobs::{ErrorCode, Received, Upload};
use crate::telemetry::metrics as names;
use bytes::Bytes;
use std::time::Duration;
use tokio::time::Instant;

/// Bytes collected before they are written, so that a byte-wise upload does not become a byte-wise disk.
const WRITE_BYTES: usize = 1 << 20;
/// Enough of a file to tell what it is.
const HEAD_BYTES: usize = 4096;

/// An upload being written. Dropped before it is finished, it leaves nothing.
pub struct Sink {
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
    pub deadline: Deadline,
}

/// How long an upload may pause, and how long it may take.
pub struct Deadline {
    pause_max: Duration,
    /// When even a steady upload has taken too long.
    end: Instant,
}

impl Deadline {
    pub fn of(app: &App) -> Self {
        Self { pause_max: app.limits.upload_pause_max, end: Instant::now() + app.limits.upload_time_max }
    }

    /// What `next` gives, unless the sender pauses for too long.
    pub async fn in_time<T>(&self, next: impl Future<Output = T>) -> Result<T, ApiError> {
        let until = self.next();
        tokio::time::timeout_at(until, next).await.map_err(|_| self.passed(until))
    }

    /// Until when the next bytes must be here, if they are waited for from now on.
    pub fn next(&self) -> Instant {
        self.end.min(Instant::now() + self.pause_max)
    }

    /// The refusal of a sender who sent nothing until `until`, which [`Deadline::next`] gave.
    pub fn passed(&self, until: Instant) -> ApiError {
        let detail = if until == self.end {
            "the upload took too long".to_owned()
        } else {
            format!("no byte arrived for {} s", self.pause_max.as_secs_f64())
        };
        ApiError::new(Code::UploadTimeout, detail).hint("send it again over a steadier connection")
    }
}

impl Sink {
    pub fn open(app: &App) -> Result<Self, ApiError> {
        Ok(Self {
            upload: Some(app.jobs.upload().map_err(|error| ApiError::store(&error))?),
            pending: Vec::new(),
            pending_bytes: 0,
            bytes: 0,
            bytes_max: app.limits.upload_bytes_max,
            file_bytes: 0,
            heads: Vec::new(),
            deadline: Deadline::of(app),
        })
    }

    pub fn bytes_max(&self) -> u64 {
        self.bytes_max
    }

    /// Bytes of the file begun last.
    pub fn file_bytes(&self) -> u64 {
        self.file_bytes
    }

    pub async fn begin(&mut self, name: &str) -> Result<(), ApiError> {
        self.file_bytes = 0;
        self.heads.push((name.to_owned(), Vec::new()));
        let name = name.to_owned();
        self.write(move |upload| upload.begin(&name)).await
    }

    pub async fn push(&mut self, data: Bytes) -> Result<(), ApiError> {
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
    pub fn refuse_foreign(&self, name: &str) -> Result<(), ApiError> {
        let head = self.heads.iter().find(|(known, _)| known == name).map_or(&[][..], |(_, head)| head);
        refuse_foreign(head).map_err(|error| {
            let code = Code::Work(ErrorCode::UnsupportedMediaType);
            ApiError::new(code, format!("{name}: {error}")).hint(error.hint())
        })
    }

    pub async fn flush(&mut self) -> Result<(), ApiError> {
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

    pub async fn finish(mut self, main: &str) -> Result<Received, ApiError> {
        let Some(upload) = self.upload.take() else {
            return Err(ApiError::internal(&"an upload was finished twice"));
        };
        metrics::counter!(names::UPLOAD_BYTES).increment(self.bytes);
        let main = main.to_owned();
        let finished = tokio::task::spawn_blocking(move || upload.finish(&main)).await;
        finished.map_err(|error| ApiError::internal(&error))?.map_err(|error| ApiError::store(&error))
    }
}
