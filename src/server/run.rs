//! From start to stop.

use super::{App, Limits, app};
use crate::config::ServeConfig;
use crate::jobs::{Jobs, Rigger, Settings, StartError};
use crate::storage::{Store, StoreError};
use std::future::IntoFuture;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::time::timeout;

const MIB: u64 = 1024 * 1024;
/// After the last job, so that callers who look every second see how it ended.
const LINGER: Duration = Duration::from_secs(2);
/// For work that was asked to stop, and for connections to close.
const LAST_WAIT: Duration = Duration::from_secs(5);

#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    #[error("the service cannot listen on {address}: {source}")]
    Listen { address: SocketAddr, source: io::Error },
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Start(#[from] StartError),
    #[error("the service ended: {0}")]
    Io(#[from] io::Error),
}

/// Serves as `config` says, until the process is asked to stop. `listening` is told the address once it is open.
pub async fn serve(
    config: &ServeConfig,
    rigger: Arc<dyn Rigger>,
    listening: impl FnOnce(SocketAddr),
) -> Result<(), ServeError> {
    let listen = |source| ServeError::Listen { address: config.listen, source };
    let listener = TcpListener::bind(config.listen).await.map_err(listen)?;
    let store = Store::open(&config.data, config.keep_mib.saturating_mul(MIB))?;
    let settings = Settings {
        workers: config.workers,
        queue_max: config.queue,
        job_time_max: Duration::from_secs(config.job_seconds),
        keep_time: Duration::from_secs(config.keep_hours.saturating_mul(3600)),
        ..Settings::default()
    };
    let limits = Limits {
        upload_bytes_max: config.upload_mib.saturating_mul(MIB),
        uploads_max: config.uploads,
        upload_pause_max: Duration::from_secs(config.upload_pause_seconds),
        upload_time_max: Duration::from_secs(config.upload_seconds),
        grace: Duration::from_secs(config.grace_seconds),
    };
    let jobs = Jobs::start(rigger, store, settings)?;
    listening(listener.local_addr()?);
    let ended = run(listener, stop_signal(), App::new(jobs.clone(), limits)).await;
    jobs.close().await;
    Ok(ended?)
}

/// Serves on `listener` until `shutdown` resolves, then stops in order: no new jobs and not ready, while callers can
/// still look; running jobs finish within the grace, or are asked to stop; then connections close.
pub async fn run(listener: TcpListener, shutdown: impl Future<Output = ()>, state: App) -> io::Result<()> {
    let (jobs, grace) = (state.jobs.clone(), state.limits.grace);
    let (close, closed) = oneshot::channel::<()>();
    let server = axum::serve(listener, app(state)).with_graceful_shutdown(async {
        // An error says that `close` is dropped, which means the same.
        let _ = closed.await;
    });
    let mut server = tokio::spawn(server.into_future());
    tokio::select! {
        ended = &mut server => return ended.unwrap_or_else(|error| Err(io::Error::other(error))),
        () = shutdown => {}
    }
    drain(&jobs, grace).await;
    drop(close);
    match timeout(LAST_WAIT, &mut server).await {
        Ok(ended) => ended.unwrap_or_else(|error| Err(io::Error::other(error))),
        Err(_) => {
            tracing::warn!("some connections were still open at the end");
            server.abort();
            Ok(())
        }
    }
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
