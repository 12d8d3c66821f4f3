//! From start to stop.

use super::keys::{Keys, KeysError, Quota};
use super::{App, ConnectionLimits, Limits, app, batches, connections, metrics};
use crate::config::ServeConfig;
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
    let store = Store::open(&config.data, config.keep_mib.saturating_mul(MIB))?;
    let settings = Settings {
        workers: workers(config.workers),
        memory_bytes_max: config.memory_mib.map(|mib| mib.saturating_mul(MIB)),
        queue_max: config.queue,
        job_time_max: Duration::from_secs(config.job_seconds),
        keep_time: Duration::from_secs(config.keep_hours.saturating_mul(3600)),
        ..Settings::default()
    };
    let jobs = Jobs::start(rigger, store, settings)?;
    let mut app = App::new(jobs.clone(), limits(config));
    if let Some(keys) = keys {
        app = app.with_keys(keys);
    }
    if config.outgoing {
        app = app.with_outgoing(Outgoing::new(Arc::new(SystemNames), &trusted(config))?);
    }
    let background = background(config, &app).await?;
    listening(listener.local_addr()?);
    let ended = run(listener, stop_signal(), app).await;
    background.iter().for_each(JoinHandle::abort);
    jobs.close().await;
    Ok(ended?)
}

/// The hosts that outgoing requests may go to wherever they are.
fn trusted(config: &ServeConfig) -> Vec<String> {
    let hosts = config.outgoing_hosts.iter().flat_map(|hosts| hosts.split(','));
    hosts.map(str::trim).filter(|host| !host.is_empty()).map(str::to_owned).collect()
}

/// The workers that the cores allow.
fn workers(asked: usize) -> usize {
    let workers = cores::share(cores::available(), asked, None).workers;
    if workers < asked {
        tracing::warn!(asked, workers, "fewer workers than asked for: there are no more cores");
    }
    workers
}

/// Reads the keys, or makes sure that none are needed.
fn keys(config: &ServeConfig) -> Result<Option<Keys>, ServeError> {
    let quota = Quota { requests_per_minute: config.key_requests_per_minute, jobs: config.key_jobs };
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
        upload_pause_max: Duration::from_secs(config.upload_pause_seconds),
        upload_time_max: Duration::from_secs(config.upload_seconds),
        grace: Duration::from_secs(config.grace_seconds),
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

/// What runs beside the service: metrics, and a look at the keys file now and then.
async fn background(config: &ServeConfig, app: &App) -> Result<Vec<JoinHandle<()>>, ServeError> {
    let mut tasks = Vec::new();
    if let Some(address) = config.metrics_listen {
        let router = metrics::routes(app.clone(), telemetry::metrics::install());
        let listener = bind(address).await?;
        let limits = ConnectionLimits { connections_max: 16, ..ConnectionLimits::default() };
        tracing::info!(%address, "metrics are at http://{address}/metrics");
        tasks.push(tokio::spawn(connections::serve(listener, router, limits, std::future::pending(), LAST_WAIT)));
    }
    if let Some(keys) = app.keys.clone() {
        tasks.push(tokio::spawn(async move {
            loop {
                tokio::time::sleep(KEYS_REFRESH).await;
                keys.refresh();
            }
        }));
    }
    Ok(tasks)
}

/// Serves on `listener` until `shutdown` resolves, then stops in order: no new jobs and not ready, while callers can
/// still look; running jobs finish within the grace, or are asked to stop; then connections close.
pub async fn run(listener: TcpListener, shutdown: impl Future<Output = ()>, state: App) -> io::Result<()> {
    let (jobs, limits, closing) = (state.jobs.clone(), state.limits, state.closing.clone());
    let (close, closed) = oneshot::channel::<()>();
    let closed = async {
        // An error says that `close` is dropped, which means the same.
        let _ = closed.await;
    };
    let feeding = tokio::spawn(batches::feed(state.clone()));
    let server = tokio::spawn(connections::serve(listener, app(state), limits.connection, closed, LAST_WAIT));
    shutdown.await;
    drain(&jobs, limits.grace).await;
    closing.send_replace(true);
    drop(close);
    feeding.await.map_err(io::Error::other)?;
    server.await.map_err(io::Error::other)
}

async fn drain(jobs: &Jobs, grace: Duration) {
    tracing::info!(grace_s = grace.as_secs(), "stopping: no new jobs, running ones may finish");
    jobs.drain();
    if jobs.running() == 0 {
        return;
    }
    if timeout(grace, jobs.idle()).await.is_err() {
        tracing::warn!("the grace is over: running jobs are asked to stop");
        jobs.stop_running();
        if timeout(LAST_WAIT, jobs.idle()).await.is_err() {
            tracing::error!("running jobs did not stop; their work is lost");
        }
    }
    tokio::time::sleep(LINGER).await;
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
