//! The command line: parse, read files, call the library, write files, say what happened.

/// `println!` for results, which ends quietly when nobody reads on, as behind `| head`.
macro_rules! say {
    ($($text:tt)*) => { $crate::cli::said(format_args!($($text)*)) };
}

mod batch;
mod batch_remote;
mod batch_report;
mod check;
mod client;
mod config;
mod failure;
mod features;
mod files;
mod keys;
mod methods;
mod openapi;
mod remote;
mod rig;
mod serve;
mod skin;

use clap::{Args, CommandFactory, Parser, Subcommand};
use rigsmith::config::EngineConfig;
use rigsmith::jobs::cores;
use rigsmith::pipelines::LoadOptions;
use std::io::Write;
use std::process::ExitCode;

/// What the shell gives for a program that a closed pipe has ended.
const PIPE_CLOSED: i32 = 128 + 13;

fn said(text: std::fmt::Arguments) {
    if writeln!(std::io::stdout().lock(), "{text}").is_err() {
        std::process::exit(PIPE_CLOSED);
    }
}

/// Rigs characters: a mesh in, the same file with a skeleton and skin weights out.
///
/// Exit status: 0 done; 2 bad arguments; 3 the file is refused; 4 it cannot be rigged; 5 internal.
#[derive(Parser)]
#[command(name = "rigsmith", version, about, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    engine: EngineOptions,
}

#[derive(Subcommand)]
enum Command {
    /// Rig a mesh file.
    Rig(rig::RigArguments),
    Skin(skin::SkinArguments),
    /// Rig every mesh of a folder, here or by a service; a run that was cut off goes on where it was.
    Batch(batch::BatchArguments),
    /// Say what would be rigged, without doing it.
    Check(check::CheckArguments),
    /// List the methods that run here, their models, licences and self-tests.
    Methods,
    /// Print the OpenAPI document of the service.
    Openapi,
    /// Start the HTTP service.
    Serve(serve::ServeArguments),
    /// Work on the jobs that other processes of the service take in.
    Worker(serve::WorkerArguments),
    /// Send a mesh to a service; with -o, wait for its rig.
    Submit(remote::SubmitArguments),
    /// Show the progress of a rig that a service makes, until it is over.
    Watch(remote::WatchArguments),
    /// Print a rig of a service, or fetch what it made.
    Get(remote::GetArguments),
    /// Print the settings that `serve` would use, each with where it comes from, as a configuration file.
    Config(config::ConfigArguments),
    /// Make, list and remove the keys that callers of a service show.
    #[command(subcommand)]
    Keys(keys::KeysCommand),
    /// Ask a running service whether it is ready; for container health checks.
    Health(serve::HealthArguments),
    /// Compute the arrays that the networks are trained on, by the code that the service runs.
    Features(features::FeaturesArguments),
}

/// Variables of the environment that are no settings of the service.
const OTHER_VARIABLES: [&str; 2] = ["RIGSMITH_SERVER", "RIGSMITH_KEY"];

/// Where the networks are and how many threads they get.
#[derive(Args)]
struct EngineOptions {
    #[command(flatten)]
    config: EngineConfig,
}

impl EngineOptions {
    /// Workers × threads stay within the cores.
    fn load_options(&self, workers: usize) -> LoadOptions {
        let asked = self.config.threads.map(usize::from);
        let threads = cores::share(cores::available(), workers, asked).threads;
        // Fails only when the pool stands already, which a second engine of one process shares.
        let _ = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
        LoadOptions { onnxruntime: self.config.onnxruntime.clone(), models: self.config.models.clone(), threads }
    }
}

/// Runs the program; the exit status says who must act.
pub fn run() -> ExitCode {
    match run_command() {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

fn run_command() -> Result<(), failure::Failure> {
    let layered = config::parse(Cli::command())?;
    let cli: Cli = config::read(&layered.matches)?;
    match cli.command {
        Command::Rig(arguments) => rig::run(&arguments, &cli.engine),
        Command::Skin(arguments) => skin::run(&arguments, &cli.engine),
        Command::Batch(arguments) => batch::run(&arguments, &cli.engine),
        Command::Check(arguments) => check::run(&arguments),
        Command::Methods => methods::run(&cli.engine),
        Command::Openapi => openapi::run(),
        Command::Serve(arguments) => serve::run(arguments, &cli.engine),
        Command::Worker(arguments) => serve::work(arguments, &cli.engine),
        Command::Submit(arguments) => remote::submit(&arguments),
        Command::Watch(arguments) => remote::watch(&arguments),
        Command::Get(arguments) => remote::get(&arguments),
        Command::Config(_) => config::run(&layered),
        Command::Keys(command) => keys::run(&command),
        Command::Health(arguments) => serve::health(&arguments),
        Command::Features(arguments) => features::run(&arguments),
    }
}
