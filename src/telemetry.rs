//! What the program says while it runs: one line per event on stderr, for people or for machines.

use clap::ValueEnum;
use tracing_subscriber::EnvFilter;

/// How log lines look.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    #[default]
    Text,
    /// One JSON object per line.
    Json,
}

/// Installs the log for the whole process; a second call changes nothing. `filter` is in the syntax of
/// `tracing_subscriber::EnvFilter`, for example `info` or `rigsmith=debug,warn`.
pub fn init(format: LogFormat, filter: &str) -> Result<(), InvalidFilter> {
    let invalid = |error: tracing_subscriber::filter::ParseError| InvalidFilter {
        filter: filter.to_owned(),
        reason: error.to_string(),
    };
    let filter = EnvFilter::builder().parse(filter).map_err(invalid)?;
    let lines = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    // The only error is that a log is installed already.
    let _ = match format {
        LogFormat::Text => lines.with_target(false).try_init(),
        LogFormat::Json => lines.json().flatten_event(true).with_current_span(false).try_init(),
    };
    Ok(())
}

#[derive(Debug, thiserror::Error)]
#[error("the log filter {filter:?} cannot be read: {reason}")]
pub struct InvalidFilter {
    filter: String,
    reason: String,
}
