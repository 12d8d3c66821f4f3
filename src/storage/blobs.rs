//! Complete files, by their location.

use super::{BLOBS, Store, StoreError};
use bytes::Bytes;
use object_store::path::Path;
use object_store::{GetOptions, GetRange, ObjectStoreExt};
use std::collections::BTreeSet;
use std::io;
use std::pin::Pin;
use std::time::{Duration, SystemTime};
use tokio_stream::{Stream, StreamExt};

/// Bytes of a blob as they are read.
pub type ContentStream = Pin<Box<dyn Stream<Item = io::Result<Bytes>> + Send>>;

/// A blob that can be read, while it is kept.
#[derive(Clone, Debug)]
pub struct Content {
    store: Store,
    location: String,
    bytes: u64,
}

impl Content {
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    pub async fn read(&self) -> Result<Bytes, StoreError> {
        let got = self.store.objects().get(&Path::from(self.location.as_str())).await;
        let got = got.map_err(|source| self.failed(source))?;
        got.bytes().await.map_err(|source| self.failed(source))
    }

    /// `bytes` bytes from `offset`. Once this has answered, the bytes come whatever happens to the blob.
    pub async fn stream(&self, offset: u64, bytes: u64) -> Result<ContentStream, StoreError> {
        if bytes == 0 {
            return Ok(Box::pin(tokio_stream::empty()));
        }
        let range = GetRange::Bounded(offset..offset.saturating_add(bytes));
        let options = GetOptions { range: Some(range), ..GetOptions::default() };
        let got = self.store.objects().get_opts(&Path::from(self.location.as_str()), options).await;
        let got = got.map_err(|source| self.failed(source))?;
        Ok(Box::pin(got.into_stream().map(|chunk| chunk.map_err(io::Error::other))))
    }

    fn failed(&self, source: object_store::Error) -> StoreError {
        StoreError::Blob { location: self.location.clone(), source }
    }
}

impl Store {
    /// The blob at `location`, of `bytes` bytes, as the database knows it.
    pub fn content(&self, location: &str, bytes: u64) -> Content {
        Content { store: self.clone(), location: location.to_owned(), bytes }
    }

    /// Removes a blob that the database does not name any more. Removing it twice is removing it once.
    pub async fn remove(&self, location: &str, bytes: u64) -> Result<(), StoreError> {
        match self.objects().delete(&Path::from(location)).await {
            Ok(()) if self.is_shared() => {}
            Ok(()) => self.give_back(bytes),
            Err(object_store::Error::NotFound { .. }) => {}
            Err(source) => return Err(StoreError::Blob { location: location.to_owned(), source }),
        }
        Ok(())
    }

    /// Removes every blob that is older than `age` and not among the `named` ones: what a crash left between writing a
    /// blob and naming it. `age` is longer than that takes, or nothing is being received. Gives their number.
    pub async fn sweep(&self, named: &BTreeSet<String>, age: Duration) -> Result<usize, StoreError> {
        let before = SystemTime::now().checked_sub(age).unwrap_or(SystemTime::UNIX_EPOCH);
        let failed = |source| StoreError::Blob { location: BLOBS.to_owned(), source };
        let mut listed = self.objects().list(Some(&Path::from(BLOBS)));
        let mut orphans = Vec::new();
        while let Some(found) = listed.next().await {
            let found = found.map_err(failed)?;
            if !named.contains(found.location.as_ref()) && SystemTime::from(found.last_modified) <= before {
                orphans.push((found.location.to_string(), found.size));
            }
        }
        for (location, bytes) in &orphans {
            self.remove(location, *bytes).await?;
        }
        Ok(orphans.len())
    }
}
