//! The command line: parse, read files, call the library, write files, say what happened.

mod check;
mod failure;
mod features;
mod files;
mod methods;
mod rig;
mod serve;
mod skin;

use clap::{Args, Parser, Subcommand};
use rigsmith::pipelines::LoadOptions;
use std::path::PathBuf;
use std::process::ExitCode;

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
    /// Say what would be rigged, without doing it.
    Check(check::CheckArguments),
    /// List the methods that run here, their models, licences and self-tests.
    Methods,
    /// Start the HTTP service.
    Serve(serve::ServeArguments),
    /// Ask a running service whether it is ready; for container health checks.
    Health(serve::HealthArguments),
    /// Compute the arrays that the networks are trained on, by the code that the service runs.
    Features(features::FeaturesArguments),
}

/// Where the networks are and how many threads they get.
#[derive(Args)]
struct EngineOptions {
    /// Folder with manifest.json and the networks.
    #[arg(long, global = true, value_name = "DIR", env = rigsmith::nets::locate::MODELS_VARIABLE)]
    models: Option<PathBuf>,
    /// ONNX Runtime's shared library.
    #[arg(long, global = true, value_name = "FILE", env = rigsmith::nets::locate::RUNTIME_VARIABLE)]
    onnxruntime: Option<PathBuf>,
    /// Threads of one job; by default the cores divided by the workers.
    #[arg(long, global = true, value_name = "N", env = "RIGSMITH_THREADS", value_parser = clap::value_parser!(u16).range(1..=512))]
    threads: Option<u16>,
}

impl EngineOptions {
    /// Workers × threads stay within the cores, unless the caller says otherwise.
    fn load_options(&self, workers: usize) -> LoadOptions {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let threads = self.threads.map_or((cores / workers.max(1)).max(1), usize::from);
        // Fails only when the pool stands already, which a second engine of one process shares.
        let _ = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
        LoadOptions { onnxruntime: self.onnxruntime.clone(), models: self.models.clone(), threads }
    }
}

/// Runs the program; the exit status says who must act.
pub fn run() -> ExitCode {
    let cli = Cli::parse();
    let done = match cli.command {
        Command::Rig(arguments) => rig::run(&arguments, &cli.engine),
        Command::Skin(arguments) => skin::run(&arguments, &cli.engine),
        Command::Check(arguments) => check::run(&arguments),
        Command::Methods => methods::run(&cli.engine),
        Command::Serve(arguments) => serve::run(arguments, &cli.engine),
        Command::Health(arguments) => serve::health(&arguments),
        Command::Features(arguments) => features::run(&arguments),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}
