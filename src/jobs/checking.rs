//! A look at a mesh, answered without a job: for a request that is still to come, or for an asset.

use super::asset::Asset;
use super::check::Check;
use super::job::FileInfo;
use super::memory;
use super::options::RigOptions;
use super::perform::{NamedFile, RigRequest, Watch};
use super::queue::Jobs;
use super::submission::{Caller, Missing, Refusal, Source};
use super::upload::{Received, identity};
use super::worker;
use crate::cancellation::Cancellation;
use crate::storage::{NewBlob, StoreError};
use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::OwnedSemaphorePermit;

/// Assets whose check is remembered; each takes a few hundred bytes.
const REMEMBERED_MAX: usize = 1_000;

impl Jobs {
    /// What would be rigged, now and without a job. Refused rather than queued when as many are looked at as there are
    /// workers.
    pub async fn check(&self, caller: &Caller, source: Source, options: RigOptions) -> Result<Check, Refusal> {
        self.ready()?;
        self.method_exists(&options)?;
        let Ok(permit) = self.core().checks.clone().try_acquire_owned() else {
            let waiting = self.counts().await?.queued;
            return Err(Refusal::QueueFull { waiting, retry_after: Duration::from_secs(1) });
        };
        let files = match source {
            Source::Upload(received) => {
                self.fits(&received.files())?;
                Files::Received(received)
            }
            Source::Asset(id) => {
                let asset = self.asset(caller, id).await?.ok_or(Refusal::NotFound(Missing::Asset))?;
                self.fits(&asset.files)?;
                Files::Loaded(self.load_files(&asset.files, Missing::Asset).await?)
            }
            Source::Job(id) => {
                let job = self.get(caller, id).await?.ok_or(Refusal::NotFound(Missing::Job))?;
                self.fits(&job.request.files)?;
                Files::Loaded(self.load_files(&job.request.files, Missing::Job).await?)
            }
        };
        self.look(permit, files, options).await.map(|(check, _)| check)
    }

    /// What an asset holds, by a check with the options that a request has when it names none. It is a matter of the files
    /// alone, so it is not written down but found again after a restart.
    pub async fn check_asset(&self, asset: &Asset) -> Result<Arc<Check>, Refusal> {
        let key = key(&asset.files);
        if let Some(known) = self.core().looks.get(&key) {
            return Ok(known);
        }
        self.fits(&asset.files)?;
        let permit = self.turn_to_look().await?;
        let files = Files::Loaded(self.load_files(&asset.files, Missing::Asset).await?);
        let (check, _) = self.look(permit, files, RigOptions::default()).await?;
        Ok(self.core().looks.keep(key, check))
    }

    async fn turn_to_look(&self) -> Result<OwnedSemaphorePermit, Refusal> {
        self.core().checks.clone().acquire_owned().await.map_err(|_| Refusal::Draining)
    }

    fn fits(&self, files: &[FileInfo]) -> Result<(), Refusal> {
        let (needed, max) = (memory::expected_bytes(files), self.settings().memory_max());
        if needed > max { Err(Refusal::Check(memory::too_much(needed, max))) } else { Ok(()) }
    }

    /// Gives the files back, with what was seen.
    async fn look(
        &self,
        permit: OwnedSemaphorePermit,
        files: Files,
        options: RigOptions,
    ) -> Result<(Check, Files), Refusal> {
        let (core, span) = (self.core().clone(), tracing::Span::current());
        let work = move || {
            let (_permit, _entered) = (permit, span.enter());
            let request = RigRequest { files: files.read().map_err(Refusal::Store)?, options, skeleton: None };
            let looked = || core.rigger.check(&request, &Watch::new(Cancellation::default(), |_| {}));
            worker::guarded(looked).map(|check| (check, files)).map_err(Refusal::Check)
        };
        tokio::task::spawn_blocking(work).await.unwrap_or(Err(Refusal::Draining))
    }
}

/// The files of a check.
enum Files {
    /// An upload that belongs to nobody yet.
    Received(Received),
    Loaded(Vec<NamedFile>),
}

impl Files {
    /// Blocks.
    fn read(&self) -> Result<Vec<NamedFile>, StoreError> {
        match self {
            Self::Loaded(files) => Ok(files.clone()),
            Self::Received(received) => {
                let read = |blob: &NewBlob| {
                    Ok(NamedFile { name: blob.name.clone(), bytes: received.bundle.read(blob)?.into() })
                };
                received.blobs().iter().map(read).collect()
            }
        }
    }
}

fn key(files: &[FileInfo]) -> [u8; 32] {
    identity(files.iter().map(|file| (file.name.as_str(), &file.sha256)))
}

/// Checks of assets by their files; the oldest goes when there are too many.
#[derive(Default)]
pub struct Looks(Mutex<Remembered>);

#[derive(Default)]
struct Remembered {
    checks: HashMap<[u8; 32], Arc<Check>>,
    order: VecDeque<[u8; 32]>,
}

impl Looks {
    fn get(&self, key: &[u8; 32]) -> Option<Arc<Check>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).checks.get(key).cloned()
    }

    fn keep(&self, key: [u8; 32], check: Check) -> Arc<Check> {
        let check = Arc::new(check);
        let mut remembered = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if remembered.checks.insert(key, check.clone()).is_none() {
            remembered.order.push_back(key);
        }
        if remembered.order.len() > REMEMBERED_MAX
            && let Some(oldest) = remembered.order.pop_front()
        {
            remembered.checks.remove(&oldest);
        }
        check
    }
}
