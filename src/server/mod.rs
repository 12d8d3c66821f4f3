//! The doors of the service, REST and gRPC on one port: extract, call [`crate::jobs`], answer.

mod batch_orders;
pub mod batches;
mod connections;
mod exchanges;
pub mod grpc;
pub mod http;
pub mod keys;
mod metrics;
mod orders;
mod quota;
mod run;
mod tickets;
mod uploads;
mod webhooks;

pub use connections::ConnectionLimits;
pub use run::{ServeError, run, serve, stop_signal, work};

use self::keys::{Keys, KeysError};
use self::quota::Buckets;
use self::tickets::Tickets;
use crate::jobs::Jobs;
use crate::outgoing::Outgoing;
use axum::Router;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Notify, Semaphore, watch};

/// What handlers need. Clones share it.
#[derive(Clone)]
pub struct App {
    pub jobs: Jobs,
    pub limits: Limits,
    uploads: Arc<Semaphore>,
    /// `None`: everybody may ask.
    guard: Option<Guard>,
    /// The way out, to fetch meshes and to send webhooks; `None`: neither is done.
    outgoing: Option<Outgoing>,
    /// A batch was handed in.
    batch_came: Arc<Notify>,
    /// `true` once the service stops: streams without an end end then.
    closing: Arc<watch::Sender<bool>>,
}

/// What tells callers apart, and how much each may ask for.
#[derive(Clone)]
struct Guard {
    keys: Keys,
    buckets: Arc<Buckets>,
    tickets: Arc<Tickets>,
}

/// Limits of the door.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// All files of one upload together.
    pub upload_bytes_max: u64,
    /// Uploads received at the same time.
    pub uploads_max: usize,
    /// Uploads in parts of one caller that are not complete.
    pub open_uploads_max: usize,
    /// Longest pause while an upload arrives.
    pub upload_pause_max: Duration,
    /// Longest time that one upload may take, however steadily it trickles.
    pub upload_time_max: Duration,
    /// Time that running jobs get when the service is asked to stop.
    pub grace: Duration,
    pub connection: ConnectionLimits,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            upload_bytes_max: 100 * 1024 * 1024,
            uploads_max: 32,
            open_uploads_max: 16,
            upload_pause_max: Duration::from_secs(30),
            upload_time_max: Duration::from_secs(900),
            grace: Duration::from_secs(30),
            connection: ConnectionLimits::default(),
        }
    }
}

impl App {
    pub fn new(jobs: Jobs, limits: Limits) -> Self {
        let uploads = Arc::new(Semaphore::new(limits.uploads_max));
        Self { jobs, limits, uploads, guard: None, outgoing: None, batch_came: Arc::default(), closing: Arc::default() }
    }

    /// Meshes are fetched from where callers say, and webhooks sent there.
    pub fn with_outgoing(mut self, outgoing: Outgoing) -> Self {
        self.outgoing = Some(outgoing);
        self
    }

    /// Only callers who send one of `keys` may ask.
    pub fn with_keys(mut self, keys: Keys) -> Result<Self, KeysError> {
        let tickets = Tickets::new().map_err(|error| KeysError::Random(error.to_string()))?;
        self.guard = Some(Guard { keys, buckets: Arc::default(), tickets: Arc::new(tickets) });
        Ok(self)
    }
}

/// The service as a router; tests call it without a port.
pub fn app(app: App) -> Router {
    http::routes(app)
}
