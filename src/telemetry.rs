//! What the program says while it runs: one line per event on stderr, for people or for machines; metrics for those who
//! ask ([`metrics`]); traces only where an operator names a collector ([`traces`]). Nothing is sent anywhere else.

pub mod metrics;
pub mod traces;

use clap::ValueEnum;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer};

/// How log lines look.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    #[default]
    Text,
    /// One JSON object per line.
    Json,
}

/// Sends what is left when dropped.
#[must_use = "traces end when this is dropped"]
pub struct Telemetry(Option<traces::Provider>);

impl Drop for Telemetry {
    fn drop(&mut self) {
        if let Some(provider) = &self.0 {
            traces::finish(provider);
        }
    }
}

/// Installs the log for the whole process, and traces when there is a collector; a second call changes nothing.
/// `filter` is in the syntax of `tracing_subscriber::EnvFilter`, for example `info` or `rigsmith=debug,warn`.
pub fn init(
    format: LogFormat,
    filter: &str,
    collector: Option<&traces::Collector>,
) -> Result<Telemetry, TelemetryError> {
    let invalid = |error: tracing_subscriber::filter::ParseError| TelemetryError::Filter {
        filter: filter.to_owned(),
        reason: error.to_string(),
    };
    let wanted = EnvFilter::builder().parse(filter).map_err(invalid)?;
    let lines = tracing_subscriber::fmt::layer().with_writer(std::io::stderr);
    let lines = match format {
        LogFormat::Text => lines.with_target(false).boxed(),
        LogFormat::Json => lines.json().flatten_event(true).with_current_span(false).boxed(),
    };
    let provider = collector.map(traces::provider).transpose()?;
    let spans = provider.as_ref().map(traces::layer);
    // The only error is that a log is installed already.
    let _ = tracing_subscriber::registry().with(spans).with(lines.with_filter(wanted)).try_init();
    Ok(Telemetry(provider))
}

#[derive(Debug, thiserror::Error)]
pub enum TelemetryError {
    #[error("the log filter {filter:?} cannot be read: {reason}")]
    Filter { filter: String, reason: String },
    #[error("traces cannot be sent to {endpoint}: {reason}")]
    Collector { endpoint: String, reason: String },
    #[error("otlp_headers: {0:?} is not NAME=VALUE")]
    Header(String),
}
