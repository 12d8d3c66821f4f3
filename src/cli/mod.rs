//! The command line: parse, read files, call the library, write files, say what happened.

mod failure;
mod features;
mod files;

use clap::{Parser, Subcommand};
use failure::Failure;
use std::process::ExitCode;

/// Rigs characters: a mesh in, the same file with a skeleton and skin weights out.
///
/// Exit status: 0 done; 2 bad arguments; 3 the file is refused; 4 it cannot be rigged; 5 internal.
#[derive(Parser)]
#[command(name = "rigsmith", version, about, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Compute the arrays that the networks are trained on, by the code that the service runs.
    Features(features::FeaturesArguments),
}

/// Runs the program; the exit status says who must act.
pub fn run() -> ExitCode {
    let cli = Cli::parse();
    let done = match cli.command {
        Command::Features(arguments) => features::run(&arguments),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}
