//! From start to stop.

use super::keys::{Keys, KeysError, Quota};
use super::{App, ConnectionLimits, Limits, app, batches, connections, metrics, webhooks};
use crate::config::{NodeConfig, ServeConfig, WorkerConfig};
use crate::jobs::{Jobs, Rigger, Settings, StartError, cores};
use crate::outgoing::{Outgoing, OutgoingError, SystemNames};
use crate::storage::{Store, StoreError};
use crate::telemetry;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio::time::timeout;

const MIB: u64 = 1024 * 1024;
/// After the last job, so that callers who look every second see how it ended.
const LINGER: Duration = Duration::from_secs(2);
/// For work that was asked to stop, and for connections to close.
const LAST_WAIT: Duration = Duration::from_secs(5);
/// How often the keys file is looked at.
const KEYS_REFRESH: Duration = Duration::from_secs(2);

#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    #[error("the service cannot listen on {address}: {source}")]
    Listen { address: SocketAddr, source: io::Error },
    #[error("{address} can be reached by others, and no key is asked for")]
    Unprotected { address: SocketAddr },
    #[error("the keys file {path} holds no key, so nobody could ask")]
    NoKeys { path: String },
    #[error("jobs that processes share need both --database and --storage")]
    HalfShared,
    #[error("--workers 0 without --database: nobody would do the work")]
    NoWorkers,
    #[error("a worker needs the --database and the --storage of the service that it works for")]
    NoService,
    #[error(transparent)]
    Keys(#[from] KeysError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Start(#[from] StartError),
    #[error("requests to other places cannot be made: {0}")]
    Outgoing(#[from] OutgoingError),
    #[error("the service ended: {0}")]
    Io(#[from] io::Error),
}

impl ServeError {
    /// Whether it is a matter of settings rather than of the moment.
    pub fn is_setting(&self) -> bool {
        matches!(
            self,
            Self::Unprotected { .. }
                | Self::NoKeys { .. }
                | Self::Keys(_)
                | Self::HalfShared
                | Self::NoWorkers
                | Self::NoService
                | Self::Store(StoreError::Bucket { .. })
        )
    }

    /// What the operator can do.
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Listen { .. } => "name another address by --listen",
            Self::Unprotected { .. } => {
                "make a key with rigsmith keys new and name the file by --keys, or say --allow-anonymous when something \
                 in front of the service asks who calls"
            }
            Self::NoKeys { .. } => "make a key with rigsmith keys new",
            Self::Keys(_) => "rigsmith keys new makes the file; rigsmith keys list reads it",
            Self::HalfShared | Self::NoService => {
                "as in --database postgres://user:password@host/name --storage s3://bucket?endpoint=https://host"
            }
            Self::NoWorkers => "leave --workers out, or name the database that workers share",
            Self::Store(StoreError::Bucket { .. }) => {
                "as in s3://bucket/prefix?endpoint=https://host; keys come from AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
            }
            Self::Start(StartError::SharedDatabase(_)) => "is it running, and does --database name it?",
            Self::Store(_) | Self::Start(_) => "name another folder by --data",
            Self::Outgoing(_) => "leave --outgoing out",
            Self::Io(_) => "",
        }
    }
}

/// Serves as `config` says, until the process is asked to stop. `listening` is told the address once it is open.
pub async fn serve(
    config: &ServeConfig,
    rigger: Arc<dyn Rigger>,
    listening: impl FnOnce(SocketAddr),
) -> Result<(), ServeError> {
    let keys = keys(config)?;
    let listener = bind(config.listen).await?;
    let jobs = jobs(&config.node, rigger, config.queue)?;
    let mut app = App::new(jobs.clone(), limits(config));
    if let Some(keys) = keys {
        app = app.with_keys(keys)?;
    }
    if config.outgoing {
        app = app.with_outgoing(Outgoing::new(Arc::new(SystemNames), &trusted(config))?);
    }
    let mut background: Vec<JoinHandle<()>> = Vec::new();
    background.extend(metrics(&config.node, &jobs).await?);
    background.extend(app.guard.as_ref().map(|guard| refreshed(guard.keys.clone())));
    listening(listener.local_addr()?);
    let ended = run(listener, stop_signal(), app).await;
    background.iter().for_each(JoinHandle::abort);
    jobs.close().await;
    Ok(ended?)
}

/// Works on the jobs of a shared database, until the process is asked to stop. `working` is told when it begins.
pub async fn work(config: &WorkerConfig, rigger: Arc<dyn Rigger>, working: impl FnOnce()) -> Result<(), ServeError> {
    let node = &config.node;
    if node.database.is_none() || node.storage.is_none() {
        return Err(ServeError::NoService);
    }
    let node = &NodeConfig { workers: node.workers.max(1), ..node.clone() };
    // It takes nothing in, so it has no queue of its own.
    let jobs = jobs(node, rigger, 0)?;
    let metrics = metrics(node, &jobs).await?;
    working();
    stop_signal().await;
    drain(&jobs, Duration::from_secs(node.grace_seconds)).await;
    metrics.iter().for_each(JoinHandle::abort);
    jobs.close().await;
    Ok(())
}

/// The jobs that `node` names, with its workers.
fn jobs(node: &NodeConfig, rigger: Arc<dyn Rigger>, queue_max: usize) -> Result<Jobs, ServeError> {
    let settings = Settings {
        workers: workers(node.workers),
        memory_bytes_max: node.memory_mib.map(|mib| mib.saturating_mul(MIB)),
        queue_max,
        job_time_max: Duration::from_secs(node.job_seconds),
        keep_time: Duration::from_secs(node.keep_hours.saturating_mul(3600)),
        ..Settings::default()
    };
    let bytes_max = node.keep_mib.saturating_mul(MIB);
    match (&node.database, &node.storage) {
        (None, None) if node.workers == 0 => Err(ServeError::NoWorkers),
        (None, None) => Ok(Jobs::start(rigger, Store::open(&node.data, bytes_max)?, settings)?),
        (Some(database), Some(storage)) => {
            // A variable that is no text is none of those that are looked for.
            let variables = std::env::vars_os()
                .filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)));
            let store = Store::open_bucket(&node.data, storage, variables, bytes_max)?;
            Ok(Jobs::start_shared(rigger, store, database, settings.shared())?)
        }
        _ => Err(ServeError::HalfShared),
    }
}

/// The hosts that outgoing requests may go to wherever they are.
fn trusted(config: &ServeConfig) -> Vec<String> {
    let hosts = config.outgoing_hosts.iter().flat_map(|hosts| hosts.split(','));
    hosts.map(str::trim).filter(|host| !host.is_empty()).map(str::to_owned).collect()
}

/// The workers that the cores allow.
fn workers(asked: usize) -> usize {
    if asked == 0 {
        return 0;
    }
    let workers = cores::share(cores::available(), asked, None).workers;
    if workers < asked {
        tracing::warn!(asked, workers, "fewer workers than asked for: there are no more cores");
    }
    workers
}

/// Reads the keys, or makes sure that none are needed.
fn keys(config: &ServeConfig) -> Result<Option<Keys>, ServeError> {
    let quota = Quota {
        requests_per_minute: config.key_requests_per_minute,
        jobs: config.key_jobs,
        upload_bytes_per_hour: config.key_upload_mib_per_hour.saturating_mul(MIB),
    };
    match &config.keys {
        Some(path) => {
            let keys = Keys::open(path, quota)?;
            if keys.is_empty() {
                return Err(ServeError::NoKeys { path: path.display().to_string() });
            }
            Ok(Some(keys))
        }
        None if config.listen.ip().is_loopback() || config.allow_anonymous => Ok(None),
        None => Err(ServeError::Unprotected { address: config.listen }),
    }
}

fn limits(config: &ServeConfig) -> Limits {
    Limits {
        upload_bytes_max: config.upload_mib.saturating_mul(MIB),
        uploads_max: config.uploads,
        open_uploads_max: config.open_uploads,
        upload_pause_max: Duration::from_secs(config.upload_pause_seconds),
        upload_time_max: Duration::from_secs(config.upload_seconds),
        grace: Duration::from_secs(config.node.grace_seconds),
        connection: ConnectionLimits {
            connections_max: config.connections,
            header_time_max: Duration::from_secs(config.header_seconds),
            header_bytes_max: config.header_kib as usize * 1024,
            write_pause_max: Duration::from_secs(config.download_pause_seconds),
            ..ConnectionLimits::default()
        },
    }
}

async fn bind(address: SocketAddr) -> Result<TcpListener, ServeError> {
    TcpListener::bind(address).await.map_err(|source| ServeError::Listen { address, source })
}

/// Serves metrics and probes for the operator, where they are asked for.
async fn metrics(node: &NodeConfig, jobs: &Jobs) -> Result<Option<JoinHandle<()>>, ServeError> {
    let Some(address) = node.metrics_listen else { return Ok(None) };
    let router = metrics::routes(jobs.clone(), telemetry::metrics::install());
    let listener = bind(address).await?;
    let limits = ConnectionLimits { connections_max: 16, ..ConnectionLimits::default() };
    tracing::info!(%address, "metrics are at http://{address}/metrics");
    Ok(Some(tokio::spawn(connections::serve(listener, router, limits, std::future::pending(), LAST_WAIT))))
}

/// Looks at the keys file now and then.
fn refreshed(keys: Keys) -> JoinHandle<()> {
    tokio::spawn(async move {
        loop {
            tokio::time::sleep(KEYS_REFRESH).await;
            keys.refresh();
        }
    })
}

/// Serves on `listener` until `shutdown` resolves, then stops in order: no new jobs and not ready, while callers can
/// still look; running jobs finish within the grace, or are asked to stop; then what is still to be told is, and connections close.
pub async fn run(listener: TcpListener, shutdown: impl Future<Output = ()>, state: App) -> io::Result<()> {
    let (jobs, limits, closing) = (state.jobs.clone(), state.limits, state.closing.clone());
    let (close, closed) = oneshot::channel::<()>();
    let closed = async {
        // An error says that `close` is dropped, which means the same.
        let _ = closed.await;
    };
    let feeding = tokio::spawn(batches::feed(state.clone()));
    let sending = state.outgoing.clone().map(|outgoing| tokio::spawn(webhooks::send(state.clone(), outgoing)));
    let server = tokio::spawn(connections::serve(listener, app(state), limits.connection, closed, LAST_WAIT));
    shutdown.await;
    if drain(&jobs, limits.grace).await {
        tokio::time::sleep(LINGER).await;
    }
    closing.send_replace(true);
    drop(close);
    feeding.await.map_err(io::Error::other)?;
    if let Some(sending) = sending {
        sending.await.map_err(io::Error::other)?;
    }
    server.await.map_err(io::Error::other)
}

/// Lets running jobs finish within `grace`. Whether there were any.
async fn drain(jobs: &Jobs, grace: Duration) -> bool {
    tracing::info!(grace_s = grace.as_secs(), "stopping: no new jobs, running ones may finish");
    jobs.drain();
    if jobs.running() == 0 {
        return false;
    }
    if timeout(grace, jobs.idle()).await.is_err() {
        tracing::warn!("the grace is over: running jobs are asked to stop");
        jobs.stop_running();
        if timeout(LAST_WAIT, jobs.idle()).await.is_err() {
            tracing::error!("running jobs did not stop; their work is lost");
        }
    }
    true
}

/// Resolves when the process is asked to stop, by SIGTERM or from the terminal.
pub async fn stop_signal() {
    let interrupt = async {
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    };
    #[cfg(unix)]
    let terminate = async {
        match tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate()) {
            Ok(mut signal) => {
                signal.recv().await;
            }
            Err(_) => std::future::pending().await,
        }
    };
    #[cfg(not(unix))]
    let terminate = std::future::pending::<()>();
    tokio::select! {
        () = interrupt => {}
        () = terminate => {}
    }
}
