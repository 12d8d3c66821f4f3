//! The configuration of `rigsmith serve`: every setting as a flag, as an environment variable, and with its default.

use crate::telemetry::LogFormat;
use std::net::SocketAddr;
use std::path::PathBuf;

/// Run the HTTP service.
#[derive(Clone, Debug, clap::Args)]
pub struct ServeConfig {
    /// Address to listen on
    #[arg(long, env = "RIGSMITH_LISTEN", value_name = "ADDR", default_value = "127.0.0.1:8080")]
    pub listen: SocketAddr,

    /// Folder for uploads and results while they are needed; made when missing
    #[arg(long, env = "RIGSMITH_DATA", value_name = "DIR", default_value = "data")]
    pub data: PathBuf,

    /// Jobs that run at the same time
    #[arg(long, env = "RIGSMITH_WORKERS", value_name = "N", default_value_t = 1, value_parser = at_least_one)]
    pub workers: usize,

    /// Jobs that may wait; one more is refused with 429
    #[arg(long, env = "RIGSMITH_QUEUE", value_name = "N", default_value_t = 100, value_parser = at_least_one)]
    pub queue: usize,

    /// Uploads received at the same time; one more is refused with 429
    #[arg(long, env = "RIGSMITH_UPLOADS", value_name = "N", default_value_t = 32, value_parser = at_least_one)]
    pub uploads: usize,

    /// Largest upload in MiB, all its files together
    #[arg(long, env = "RIGSMITH_UPLOAD_MIB", value_name = "MIB", default_value_t = 100)]
    pub upload_mib: u64,

    /// Longest pause in seconds while an upload arrives
    #[arg(long, env = "RIGSMITH_UPLOAD_PAUSE_SECONDS", value_name = "SECONDS", default_value_t = 30)]
    pub upload_pause_seconds: u64,

    /// Longest time in seconds that one upload may take
    #[arg(long, env = "RIGSMITH_UPLOAD_SECONDS", value_name = "SECONDS", default_value_t = 900)]
    pub upload_seconds: u64,

    /// Longest run of one job in seconds
    #[arg(long, env = "RIGSMITH_JOB_SECONDS", value_name = "SECONDS", default_value_t = 300)]
    pub job_seconds: u64,

    /// Hours that results are kept after a job has finished
    #[arg(long, env = "RIGSMITH_KEEP_HOURS", value_name = "HOURS", default_value_t = 24)]
    pub keep_hours: u64,

    /// Most MiB of uploads and results kept; the oldest results go first
    #[arg(long, env = "RIGSMITH_KEEP_MIB", value_name = "MIB", default_value_t = 10_240)]
    pub keep_mib: u64,

    /// Seconds that running jobs get to finish when the service is asked to stop
    #[arg(long, env = "RIGSMITH_GRACE_SECONDS", value_name = "SECONDS", default_value_t = 30)]
    pub grace_seconds: u64,

    /// How log lines look
    #[arg(long, env = "RIGSMITH_LOG_FORMAT", value_enum, default_value_t)]
    pub log_format: LogFormat,

    /// What is logged, as in `info` or `rigsmith=debug,warn`
    #[arg(long, env = "RIGSMITH_LOG", value_name = "FILTER", default_value = "info,ort=warn")]
    pub log: String,
}

fn at_least_one(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(0) => Err("must be at least 1".to_owned()),
        Ok(count) => Ok(count),
        Err(error) => Err(format!("{error}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Args;

    #[test]
    fn every_setting_is_a_flag_a_variable_and_has_a_default() {
        let command = ServeConfig::augment_args(clap::Command::new("serve"));
        command.clone().debug_assert();
        for setting in command.get_arguments() {
            let name = setting.get_id().as_str();
            let variable = format!("RIGSMITH_{}", name.to_uppercase());
            assert_eq!(setting.get_env().and_then(|env| env.to_str()), Some(variable.as_str()));
            assert!(setting.get_long().is_some() && !setting.get_default_values().is_empty(), "{name}");
        }
    }
}
