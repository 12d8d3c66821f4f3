//! What would be rigged, answered at once and without a job.

use super::options::RigOptions;
use super::perform::{NamedFile, RigRequest, Watch};
use super::queue::Jobs;
use super::submission::{Caller, Missing, Refusal, Source};
use super::upload::Received;
use super::worker;
use crate::cancellation::Cancellation;
use crate::storage::{NewBlob, StoreError};
use std::time::Duration;

impl Jobs {
    /// What would be rigged, now and without a job.
    pub async fn check(
        &self,
        caller: &Caller,
        source: Source,
        options: RigOptions,
    ) -> Result<serde_json::Map<String, serde_json::Value>, Refusal> {
        self.ready()?;
        self.method_exists(&options)?;
        let core = self.core().clone();
        let Ok(permit) = core.checks.clone().try_acquire_owned() else {
            let waiting = self.counts().await?.queued;
            return Err(Refusal::QueueFull { waiting, retry_after: Duration::from_secs(1) });
        };
        let loaded = match source {
            Source::Upload(received) => Files::Received(received),
            Source::Asset(id) => Files::Loaded(self.load_asset(caller, id).await?),
            Source::Job(id) => {
                let job = self.get(caller, id).await?.ok_or(Refusal::NotFound(Missing::Job))?;
                Files::Loaded(self.load_files(&job.request.files, Missing::Job).await?)
            }
        };
        let span = tracing::Span::current();
        let work = move || {
            let (_permit, _entered) = (permit, span.enter());
            let files = match loaded {
                Files::Received(received) => read(&received).map_err(Refusal::Store)?,
                Files::Loaded(files) => files,
            };
            let request = RigRequest { files, options, skeleton: None };
            worker::guarded(|| core.rigger.check(&request, &Watch::new(Cancellation::default(), |_| {})))
                .map_err(Refusal::Check)
        };
        match tokio::task::spawn_blocking(work).await {
            Ok(checked) => checked,
            Err(_) => Err(Refusal::Draining),
        }
    }
}

/// The files of a check.
enum Files {
    Received(Received),
    Loaded(Vec<NamedFile>),
}

/// Reads an upload that belongs to nobody yet. Blocks.
fn read(received: &Received) -> Result<Vec<NamedFile>, StoreError> {
    let blobs = received.blobs();
    let read = |blob: &NewBlob| Ok(NamedFile { name: blob.name.clone(), bytes: received.bundle.read(blob)?.into() });
    blobs.iter().map(read).collect()
}
