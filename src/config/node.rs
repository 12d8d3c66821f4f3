//! What every process of a service is told, whether it has a door or only works.

use crate::telemetry::LogFormat;
use std::net::SocketAddr;
use std::path::PathBuf;

/// Settings of one process.
#[derive(Clone, Debug, clap::Args)]
pub struct NodeConfig {
    /// PostgreSQL database that several processes share, as in postgres://user:password@host/name; by default jobs are
    /// in a file of the data folder
    #[arg(long, env = "RIGSMITH_DATABASE", value_name = "URL", hide_env_values = true)]
    pub database: Option<String>,

    /// Bucket for uploads and results, as in s3://bucket/prefix?endpoint=https://host; keys come from AWS_ACCESS_KEY_ID and
    /// AWS_SECRET_ACCESS_KEY; by default they are in the data folder
    #[arg(long, env = "RIGSMITH_STORAGE", value_name = "URL")]
    pub storage: Option<String>,

    /// Folder for uploads and results while they are needed; made when missing
    #[arg(long, env = "RIGSMITH_DATA", value_name = "DIR", default_value = "data")]
    pub data: PathBuf,

    /// Jobs that run at the same time; no more than there are cores. 0 with a shared database: others do the work
    #[arg(long, env = "RIGSMITH_WORKERS", value_name = "N", default_value_t = 1)]
    pub workers: usize,

    /// Most MiB of memory that all running jobs together may take; by default 2048 for each worker, and no more than three
    /// quarters of what there is
    #[arg(long, env = "RIGSMITH_MEMORY_MIB", value_name = "MIB", value_parser = clap::value_parser!(u64).range(256..))]
    pub memory_mib: Option<u64>,

    /// Longest run of one job in seconds
    #[arg(long, env = "RIGSMITH_JOB_SECONDS", value_name = "SECONDS", default_value_t = 300)]
    pub job_seconds: u64,

    /// Hours that results are kept after a job has finished
    #[arg(long, env = "RIGSMITH_KEEP_HOURS", value_name = "HOURS", default_value_t = 24)]
    pub keep_hours: u64,

    /// Most MiB of uploads and results kept on this machine; the oldest results go first
    #[arg(long, env = "RIGSMITH_KEEP_MIB", value_name = "MIB", default_value_t = 10_240)]
    pub keep_mib: u64,

    /// Seconds that running jobs get to finish when the service is asked to stop
    #[arg(long, env = "RIGSMITH_GRACE_SECONDS", value_name = "SECONDS", default_value_t = 30)]
    pub grace_seconds: u64,

    /// Address of Prometheus metrics, at /metrics; none unless given, since they tell what runs here
    #[arg(long, env = "RIGSMITH_METRICS_LISTEN", value_name = "ADDR")]
    pub metrics_listen: Option<SocketAddr>,

    /// Send OpenTelemetry traces to this collector (OTLP over HTTP), as in http://127.0.0.1:4318; nothing is sent unless given
    #[arg(long, env = "RIGSMITH_OTLP_ENDPOINT", value_name = "URL")]
    pub otlp_endpoint: Option<String>,

    /// Headers for the collector, as in `authorization=Bearer abc,x-team=rigs`
    #[arg(long, env = "RIGSMITH_OTLP_HEADERS", value_name = "NAME=VALUE,…", hide_env_values = true)]
    pub otlp_headers: Option<String>,

    /// How log lines look
    #[arg(long, env = "RIGSMITH_LOG_FORMAT", value_enum, default_value_t)]
    pub log_format: LogFormat,

    /// What is logged, as in `info` or `rigsmith=debug,warn`
    #[arg(long, env = "RIGSMITH_LOG", value_name = "FILTER", default_value = "info,ort=warn")]
    pub log: String,
}

/// Work on the jobs of a shared database.
#[derive(Clone, Debug, clap::Args)]
pub struct WorkerConfig {
    /// Read settings from this TOML file; flags and environment variables go before it
    #[arg(long, env = "RIGSMITH_CONFIG", value_name = "FILE")]
    pub config: Option<PathBuf>,

    #[command(flatten)]
    pub node: NodeConfig,
}
