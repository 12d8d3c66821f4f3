//! A bucket of S3-compatible storage, which many machines share.

use super::StoreError;
use object_store::aws::{AmazonS3, AmazonS3Builder, AmazonS3ConfigKey};
use object_store::client::SpawnedReqwestConnector;
use object_store::path::Path;
use object_store::prefix::PrefixStore;
use object_store::{
    BackoffConfig, ClientOptions, Error, ObjectStore, ObjectStoreExt, PutPayload, RetryConfig, WriteMultipart,
};
use reqwest::Url;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};
use tokio_stream::StreamExt;

/// A file up to this size travels in one request; a larger one in parts of it.
const PART_BYTES: usize = 8 << 20;
/// Parts on their way at the same time.
const PARTS_MAX: usize = 4;
/// A request is tried again for this long. Then whoever waits is told, and may try again.
const RETRY_TIME: Duration = Duration::from_secs(20);
const RETRIES_MAX: usize = 20;
const PAUSE_MIN: Duration = Duration::from_millis(100);
const PAUSE_MAX: Duration = Duration::from_secs(3);
/// What is written to see whether it can be.
const MARK: &str = "mark";
/// How long a connection may take to be made, and may bring nothing.
const CONNECT_TIME: Duration = Duration::from_secs(5);
const SILENCE_MAX: Duration = Duration::from_secs(30);

/// A bucket, or what lies below a prefix in it.
#[derive(Debug)]
pub struct Bucket {
    pub objects: Arc<dyn ObjectStore>,
    /// Requests run here, whoever asks. `None` only while it is dropped.
    runtime: Option<Runtime>,
}

impl Drop for Bucket {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

impl Bucket {
    /// The bucket at `url`: `s3://BUCKET/PREFIX?endpoint=URL&region=NAME`, where all but the bucket may be left out. Keys
    /// and what else is not said come from those of the `variables` that are known (`AWS_ACCESS_KEY_ID`,
    /// `AWS_SECRET_ACCESS_KEY`, `AWS_REGION`, …). Requests name the bucket in their path.
    pub fn open(url: &str, variables: impl Iterator<Item = (String, String)>) -> Result<Self, StoreError> {
        // Fails when it was installed before, which is as good.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let wrong = |reason: &dyn std::fmt::Display| StoreError::Bucket { reason: reason.to_string() };
        let parsed = Url::parse(url).map_err(|error| wrong(&error))?;
        let bucket = parsed.host_str().filter(|_| parsed.scheme() == "s3");
        let bucket =
            bucket.ok_or_else(|| wrong(&"write s3://bucket, s3://bucket/prefix or s3://bucket?endpoint=URL"))?;
        let runtime = Builder::new_multi_thread().worker_threads(1).thread_name("storage").enable_all().build();
        let runtime = runtime.map_err(|error| wrong(&error))?;
        let known = |(name, value): (String, String)| {
            let name = Some(name).filter(|name| name.starts_with("AWS_"))?.to_ascii_lowercase();
            Some((name.parse::<AmazonS3ConfigKey>().ok()?, value))
        };
        let builder = variables
            .filter_map(known)
            .fold(AmazonS3Builder::new(), |builder, (key, value)| builder.with_config(key, value));
        let mut builder = builder
            .with_bucket_name(bucket)
            // Not every provider knows how to delete several at once.
            .with_disable_bulk_delete(true)
            .with_http_connector(SpawnedReqwestConnector::new(runtime.handle().clone()))
            .with_retry(RetryConfig {
                backoff: BackoffConfig { init_backoff: PAUSE_MIN, max_backoff: PAUSE_MAX, base: 2.0 },
                max_retries: RETRIES_MAX,
                retry_timeout: RETRY_TIME,
            });
        let mut options = ClientOptions::new()
            .with_timeout_disabled()
            .with_read_timeout(SILENCE_MAX)
            .with_connect_timeout(CONNECT_TIME);
        for (name, value) in parsed.query_pairs() {
            builder = match name.as_ref() {
                "endpoint" if !value.starts_with("http://") && !value.starts_with("https://") => {
                    return Err(wrong(&format!("the endpoint {value} is no http:// or https:// URL")));
                }
                "endpoint" => {
                    // Without TLS only where the operator writes so.
                    options = options.with_allow_http(value.starts_with("http://"));
                    builder.with_endpoint(value)
                }
                "region" => builder.with_region(value),
                other => return Err(wrong(&format!("{other} is neither endpoint nor region"))),
            };
        }
        let s3: AmazonS3 = builder.with_client_options(options).build().map_err(|error| wrong(&error))?;
        let objects = Arc::new(PrefixStore::new(s3, parsed.path()));
        Ok(Self { objects, runtime: Some(runtime) })
    }

    /// Writes and removes a mark. Refuses a bucket that is not there or not ours; one that does not answer may come back.
    pub fn try_out(&self) -> Result<(), StoreError> {
        let (objects, mark) = (self.objects.clone(), Path::from(MARK));
        let tried = self.finish(async move {
            objects.put(&mark, PutPayload::new()).await?;
            objects.delete(&mark).await
        });
        match tried? {
            Ok(()) => Ok(()),
            Err(error @ (Error::NotFound { .. } | Error::PermissionDenied { .. } | Error::Unauthenticated { .. })) => {
                Err(StoreError::Bucket { reason: error.to_string() })
            }
            Err(error) => {
                tracing::warn!(%error, "the bucket does not answer now");
                Ok(())
            }
        }
    }

    /// Copies a file of `local` into the bucket. Blocks.
    pub fn upload(&self, local: Arc<dyn ObjectStore>, from: String, to: &str) -> Result<(), StoreError> {
        let (objects, location) = (self.objects.clone(), Path::from(to));
        let uploaded = self.finish(async move { upload(&*objects, &*local, &Path::from(from), &location).await })?;
        uploaded.map_err(|source| StoreError::Upload { location: to.to_owned(), source })
    }

    /// Removes a blob that nobody names, some time.
    pub fn forget(&self, location: &str) {
        let (objects, location) = (self.objects.clone(), Path::from(location));
        if let Some(runtime) = &self.runtime {
            runtime.spawn(async move {
                if let Err(error) = objects.delete(&location).await {
                    tracing::warn!(%error, "a blob that nobody names stays until the next sweep");
                }
            });
        }
    }

    /// Runs `future` to its end. Blocks.
    fn finish<T: Send + 'static>(&self, future: impl Future<Output = T> + Send + 'static) -> Result<T, StoreError> {
        let (sender, receiver) = std::sync::mpsc::sync_channel(1);
        if let Some(runtime) = &self.runtime {
            runtime.spawn(async move {
                // Nobody waits any more: nobody minds.
                let _ = sender.send(future.await);
            });
        }
        receiver.recv().map_err(|_| StoreError::Interrupted)
    }
}

async fn upload(to: &dyn ObjectStore, from: &dyn ObjectStore, path: &Path, location: &Path) -> Result<(), Error> {
    let got = from.get(path).await?;
    let bytes = got.meta.size;
    if bytes <= PART_BYTES as u64 {
        let content = PutPayload::from(got.bytes().await?);
        return to.put(location, content).await.map(|_| ());
    }
    let mut content = got.into_stream();
    let mut parts = WriteMultipart::new_with_chunk_size(to.put_multipart(location).await?, PART_BYTES);
    while let Some(chunk) = content.next().await {
        let ready = match chunk {
            Ok(chunk) => parts.wait_for_capacity(PARTS_MAX).await.map(|()| chunk),
            Err(error) => Err(error),
        };
        match ready {
            Ok(chunk) => parts.put(chunk),
            Err(error) => {
                // What cannot be taken back now goes by the bucket's rule for unfinished uploads.
                let _ = parts.abort().await;
                return Err(error);
            }
        }
    }
    match parts.finish().await {
        Ok(_) => Ok(()),
        // The last request may have been heard and its answer lost; repeated, it finds nothing to complete.
        Err(error) => match to.head(location).await {
            Ok(there) if there.size == bytes => Ok(()),
            _ => Err(error),
        },
    }
}
