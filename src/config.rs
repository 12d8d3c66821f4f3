//! The configuration of `rigsmith serve`: every setting is a flag, an environment variable, a key of the TOML file, and
//! has a default. The nearest wins, in that order.
//!
//! The file is flat and uses the names of the flags with `_` for `-`:
//!
//! ```toml
//! listen = "0.0.0.0:8080"
//! keys = "/etc/rigsmith/keys.toml"
//! workers = 2
//! upload_mib = 200
//! ```
//!
//! Its values become the defaults of the command line ([`layer`]), so that one parser checks them all.

mod effective;
mod file;
mod node;

pub use effective::{Origin, Setting, effective, to_toml, unknown_variables};
pub use file::{ConfigError, ConfigFile, nearest};
pub use node::{NodeConfig, WorkerConfig};

use clap::builder::BoolishValueParser;
use std::net::SocketAddr;
use std::path::PathBuf;

/// Where the networks are and how many threads they get.
#[derive(Clone, Debug, clap::Args)]
pub struct EngineConfig {
    /// Folder with manifest.json and the networks
    #[arg(long, global = true, value_name = "DIR", env = crate::nets::locate::MODELS_VARIABLE)]
    pub models: Option<PathBuf>,

    /// ONNX Runtime's shared library
    #[arg(long, global = true, value_name = "FILE", env = crate::nets::locate::RUNTIME_VARIABLE)]
    pub onnxruntime: Option<PathBuf>,

    /// Threads of one job; by default the cores divided by the workers
    #[arg(long, global = true, value_name = "N", env = "RIGSMITH_THREADS", value_parser = clap::value_parser!(u16).range(1..=512))]
    pub threads: Option<u16>,
}

/// Run the HTTP service.
#[derive(Clone, Debug, clap::Args)]
pub struct ServeConfig {
    /// Read settings from this TOML file; flags and environment variables go before it
    #[arg(long, env = "RIGSMITH_CONFIG", value_name = "FILE")]
    pub config: Option<PathBuf>,

    /// Address to listen on
    #[arg(long, env = "RIGSMITH_LISTEN", value_name = "ADDR", default_value = "127.0.0.1:8080")]
    pub listen: SocketAddr,

    /// File with the callers' keys, made by `rigsmith keys new`; callers must then send one
    #[arg(long, env = "RIGSMITH_KEYS", value_name = "FILE")]
    pub keys: Option<PathBuf>,

    /// Listen on an address that others can reach although no key is asked for
    #[arg(long, env = "RIGSMITH_ALLOW_ANONYMOUS", value_name = "BOOL", default_value = "false", num_args = 0..=1,
        default_missing_value = "true", action = clap::ArgAction::Set, value_parser = BoolishValueParser::new())]
    pub allow_anonymous: bool,

    /// Requests per minute of one key, unless its line in the keys file says otherwise
    #[arg(long, env = "RIGSMITH_KEY_REQUESTS_PER_MINUTE", value_name = "N", default_value_t = 600, value_parser = clap::value_parser!(u32).range(1..))]
    pub key_requests_per_minute: u32,

    /// Unfinished jobs of one key, unless its line in the keys file says otherwise
    #[arg(long, env = "RIGSMITH_KEY_JOBS", value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..))]
    pub key_jobs: u32,

    /// MiB of uploads per hour of one key, unless its line in the keys file says otherwise
    #[arg(long, env = "RIGSMITH_KEY_UPLOAD_MIB_PER_HOUR", value_name = "MIB", default_value_t = 10_240, value_parser = clap::value_parser!(u64).range(1..))]
    pub key_upload_mib_per_hour: u64,

    /// Make requests to addresses that callers name, to fetch meshes (asset.url) and to send webhooks: https, on the public
    /// internet alone
    #[arg(long, env = "RIGSMITH_OUTGOING", value_name = "BOOL", default_value = "false", num_args = 0..=1,
        default_missing_value = "true", action = clap::ArgAction::Set, value_parser = BoolishValueParser::new())]
    pub outgoing: bool,

    /// Hosts, separated by commas, that may be asked wherever they are, over http too
    #[arg(long, env = "RIGSMITH_OUTGOING_HOSTS", value_name = "HOSTS")]
    pub outgoing_hosts: Option<String>,

    /// Jobs that may wait; one more is refused with 429
    #[arg(long, env = "RIGSMITH_QUEUE", value_name = "N", default_value_t = 100, value_parser = at_least_one)]
    pub queue: usize,

    /// Uploads received at the same time; one more is refused with 429
    #[arg(long, env = "RIGSMITH_UPLOADS", value_name = "N", default_value_t = 32, value_parser = at_least_one)]
    pub uploads: usize,

    /// Uploads in parts of one caller that are not complete; one more is refused with 429
    #[arg(long, env = "RIGSMITH_OPEN_UPLOADS", value_name = "N", default_value_t = 16, value_parser = at_least_one)]
    pub open_uploads: usize,

    /// Largest upload in MiB, all its files together
    #[arg(long, env = "RIGSMITH_UPLOAD_MIB", value_name = "MIB", default_value_t = 100)]
    pub upload_mib: u64,

    /// Longest pause in seconds while an upload arrives
    #[arg(long, env = "RIGSMITH_UPLOAD_PAUSE_SECONDS", value_name = "SECONDS", default_value_t = 30)]
    pub upload_pause_seconds: u64,

    /// Longest time in seconds that one upload may take
    #[arg(long, env = "RIGSMITH_UPLOAD_SECONDS", value_name = "SECONDS", default_value_t = 900)]
    pub upload_seconds: u64,

    /// Connections open at the same time; more wait to be taken
    #[arg(long, env = "RIGSMITH_CONNECTIONS", value_name = "N", default_value_t = 1024, value_parser = at_least_one)]
    pub connections: usize,

    /// Longest time in seconds for the header of a request, and for a connection without a request
    #[arg(long, env = "RIGSMITH_HEADER_SECONDS", value_name = "SECONDS", default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..))]
    pub header_seconds: u64,

    /// Largest header of a request in KiB; a larger one is answered with 431
    #[arg(long, env = "RIGSMITH_HEADER_KIB", value_name = "KIB", default_value_t = 64, value_parser = clap::value_parser!(u32).range(8..=1024))]
    pub header_kib: u32,

    /// Longest time in seconds that a caller may take no byte of an answer
    #[arg(long, env = "RIGSMITH_DOWNLOAD_PAUSE_SECONDS", value_name = "SECONDS", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..))]
    pub download_pause_seconds: u64,

    #[command(flatten)]
    pub node: NodeConfig,
}

/// Settings that are shown masked.
const SECRETS: &[&str] = &["otlp_headers"];

/// Settings whose value is a URL; a password in it is shown masked.
const URLS: &[&str] = &["database", "storage", "otlp_endpoint"];

fn at_least_one(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(0) => Err("must be at least 1".to_owned()),
        Ok(count) => Ok(count),
        Err(error) => Err(format!("{error}")),
    }
}

/// `command` with the values of `file` as its defaults.
pub fn layer(mut command: clap::Command, file: &ConfigFile) -> clap::Command {
    for (name, value) in &file.values {
        if command.get_arguments().any(|argument| argument.get_id() == name.as_str()) {
            command = command.mut_arg(name, |argument| argument.default_value(value.clone()));
        }
    }
    command
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{Args, FromArgMatches};

    fn command() -> clap::Command {
        ServeConfig::augment_args(clap::Command::new("serve"))
    }

    #[test]
    fn every_setting_is_a_flag_a_variable_and_has_a_default_or_is_off() {
        command().debug_assert();
        for setting in command().get_arguments() {
            let name = setting.get_id().as_str();
            let variable = format!("RIGSMITH_{}", name.to_uppercase());
            assert_eq!(setting.get_env().and_then(|env| env.to_str()), Some(variable.as_str()));
            assert_eq!(setting.get_long(), Some(name.replace('_', "-").as_str()));
            let off = [
                "config",
                "keys",
                "memory_mib",
                "metrics_listen",
                "otlp_endpoint",
                "outgoing_hosts",
                "otlp_headers",
                "database",
                "storage",
            ];
            assert_eq!(off.contains(&name), setting.get_default_values().is_empty(), "{name}");
        }
    }

    #[test]
    fn a_flag_goes_before_the_file_and_the_file_before_the_default() {
        let file = ConfigFile::parse(
            "t.toml".as_ref(),
            "workers = 3\nqueue = 7\nallow_anonymous = true\n",
            &["workers", "queue", "allow_anonymous"],
        );
        let file = file.expect("reads");
        let matches = layer(command(), &file).get_matches_from(["serve", "--queue", "9"]);
        let config = ServeConfig::from_arg_matches(&matches).expect("valid");
        assert_eq!((config.node.workers, config.queue, config.uploads, config.allow_anonymous), (3, 9, 32, true));
        let settings = effective(&command(), &matches, &file);
        let origin =
            |name: &str| settings.iter().find(|setting| setting.name == name).map(|setting| setting.origin.clone());
        assert_eq!(origin("queue"), Some(Origin::Flag));
        assert_eq!(origin("workers"), Some(Origin::File("t.toml".into())));
        assert_eq!(origin("uploads"), Some(Origin::Default));
        assert_eq!(origin("keys"), Some(Origin::Unset));
    }

    #[test]
    fn what_is_printed_is_a_file_that_says_the_same_and_hides_secrets() {
        let names: Vec<String> = command().get_arguments().map(|argument| argument.get_id().to_string()).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let arguments = [
            "serve",
            "--otlp-headers",
            "authorization=Bearer s3cret",
            "--log",
            "rigsmith=\"x\"",
            "--workers",
            "2",
            "--database",
            "postgres://rigs:s3cret@db/rigs?password=s3cret&sslmode=prefer",
        ];
        let empty = ConfigFile::default();
        let matches = command().get_matches_from(arguments);
        let text = to_toml(&effective(&command(), &matches, &empty));
        assert!(!text.contains("s3cret"), "{text}");
        assert!(text.contains("postgres://rigs:***@db/rigs?password=***&sslmode=prefer"), "{text}");
        let read = ConfigFile::parse("again.toml".as_ref(), &text, &names).expect("reads");
        assert_eq!(read.values.get("workers").map(String::as_str), Some("2"));
        assert_eq!(read.values.get("log").map(String::as_str), Some("rigsmith=\"x\""));
    }
}
