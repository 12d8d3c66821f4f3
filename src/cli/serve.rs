//! `rigsmith serve`, `rigsmith worker` and `rigsmith health`.

use super::EngineOptions;
use super::failure::Failure;
use clap::Args;
use rigsmith::config::{NodeConfig, ServeConfig, WorkerConfig};
use rigsmith::jobs::Engine;
use rigsmith::server::ServeError;
use rigsmith::telemetry::TelemetryError;
use rigsmith::telemetry::traces::Collector;
use rigsmith::{server, telemetry};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

#[derive(Args)]
pub struct ServeArguments {
    #[command(flatten)]
    config: ServeConfig,
}

#[derive(Args)]
pub struct WorkerArguments {
    #[command(flatten)]
    config: WorkerConfig,
}

#[derive(Args)]
pub struct HealthArguments {
    /// Address of the service.
    #[arg(long, env = "RIGSMITH_LISTEN", value_name = "ADDR", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// The configuration file of the service, for its address.
    #[arg(long, env = "RIGSMITH_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
}

pub fn run(arguments: ServeArguments, engine: &EngineOptions) -> Result<(), Failure> {
    let config = arguments.config;
    let listening = |address: SocketAddr| {
        println!("rigsmith listens on http://{address} (API description: http://{address}/docs)");
    };
    start(&config.node, engine, async |engine| server::serve(&config, engine, listening).await)
}

/// Works on the jobs of other processes.
pub fn work(arguments: WorkerArguments, engine: &EngineOptions) -> Result<(), Failure> {
    let config = arguments.config;
    start(&config.node, engine, async |engine| server::work(&config, engine, || println!("rigsmith works")).await)
}

/// Telemetry, networks and a runtime for one process of a service.
fn start(
    node: &NodeConfig,
    engine: &EngineOptions,
    serve: impl AsyncFnOnce(Arc<Engine>) -> Result<(), ServeError>,
) -> Result<(), Failure> {
    let arguments_wrong = |error: TelemetryError| Failure::arguments(error.to_string());
    let headers = node.otlp_headers.as_deref();
    let collector = node.otlp_endpoint.as_deref().map(|endpoint| Collector::new(endpoint, headers)).transpose();
    let collector = collector.map_err(arguments_wrong)?;
    let _telemetry = telemetry::init(node.log_format, &node.log, collector.as_ref()).map_err(arguments_wrong)?;
    super::config::warn_of_unknown_variables();
    if node.metrics_listen.is_some() {
        telemetry::metrics::install();
    }
    // A service without its networks would only ever refuse: better to stop here, where the operator sees it.
    let began = Instant::now();
    let engine = Engine::open(&engine.load_options(node.workers))?;
    metrics::gauge!(telemetry::metrics::MODEL_LOAD_SECONDS).set(began.elapsed().as_secs_f64());
    let runtime = tokio::runtime::Runtime::new().map_err(|error| Failure::internal(error.to_string(), ""))?;
    runtime.block_on(serve(Arc::new(engine))).map_err(|error| {
        if error.is_setting() {
            Failure::arguments(error.to_string()).hint(error.hint())
        } else {
            Failure::internal(error.to_string(), error.hint())
        }
    })
}

/// How long a health check waits for its answer.
const PATIENCE: Duration = Duration::from_secs(4);

/// Succeeds when the service at the address answers that it is ready.
pub fn health(arguments: &HealthArguments) -> Result<(), Failure> {
    let mut address = arguments.listen;
    if address.ip().is_unspecified() {
        address.set_ip(std::net::Ipv4Addr::LOCALHOST.into());
    }
    let answer = ask(address).map_err(|error| Failure::internal(format!("{address}: {error}"), "is it running?"))?;
    if answer.starts_with("HTTP/1.1 200") {
        Ok(())
    } else {
        let line = answer.lines().next().unwrap_or("no answer").to_owned();
        Err(Failure::internal(format!("{address} is not ready: {line}"), ""))
    }
}

fn ask(address: SocketAddr) -> std::io::Result<String> {
    let mut stream = TcpStream::connect_timeout(&address, PATIENCE)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    write!(stream, "GET /readyz HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n")?;
    let mut answer = String::new();
    stream.take(64 * 1024).read_to_string(&mut answer)?;
    Ok(answer)
}
