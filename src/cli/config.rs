//! `rigsmith config`, and how `serve` comes to its settings.

use super::failure::Failure;
use clap::{ArgMatches, Args, Command, FromArgMatches};
use rigsmith::config::{self, ConfigFile, EngineConfig, ServeConfig};
use std::path::PathBuf;

#[derive(Args)]
pub struct ConfigArguments {
    #[command(flatten)]
    pub config: ServeConfig,
}

/// The commands whose settings a file may give.
const LAYERED: [&str; 4] = ["serve", "worker", "config", "health"];

/// A command line read twice: once for the name of the file, once with its values as defaults.
pub struct Layered {
    pub matches: ArgMatches,
    pub file: ConfigFile,
}

/// Parses the arguments of the program with flag > environment > file > default. clap ends the program where it refuses.
pub fn parse(command: Command) -> Result<Layered, Failure> {
    let matches = command.clone().get_matches();
    let path = matches.subcommand().filter(|(name, _)| LAYERED.contains(name));
    let path = path.and_then(|(_, matches)| matches.get_one::<PathBuf>("config").cloned());
    let Some(path) = path else { return Ok(Layered { matches, file: ConfigFile::default() }) };
    let known = names();
    let known: Vec<&str> = known.iter().map(String::as_str).filter(|name| *name != "config").collect();
    let file = ConfigFile::read(&path, &known).map_err(|error| Failure::arguments(error.to_string()))?;
    let mut layered = config::layer(command, &file);
    for name in LAYERED {
        layered = layered.mut_subcommand(name, |command| config::layer(command, &file));
    }
    match layered.try_get_matches() {
        Ok(matches) => Ok(Layered { matches, file }),
        // Without the file the line was right, so the value is the file's.
        Err(error) => {
            let message = error.to_string();
            let message = message.trim_start_matches("error: ").lines().next().unwrap_or_default().to_owned();
            Err(Failure::arguments(format!("{}: {message}", path.display())))
        }
    }
}

/// The settings and nothing else, for their names and variables.
fn settings() -> Command {
    EngineConfig::augment_args(ServeConfig::augment_args(Command::new("serve")))
}

fn names() -> Vec<String> {
    settings().get_arguments().map(|argument| argument.get_id().to_string()).collect()
}

/// Prints what is in force.
pub fn run(layered: &Layered) -> Result<(), Failure> {
    let Some((_, matches)) = layered.matches.subcommand() else {
        return Err(Failure::internal("no command", ""));
    };
    say!("{}", config::to_toml(&config::effective(&settings(), matches, &layered.file)).trim_end());
    warn_of_unknown_variables();
    Ok(())
}

/// Says on stderr which variables look like settings and are none. Not refused: container platforms add variables of
/// their own, named after the service.
pub fn warn_of_unknown_variables() {
    let mut known: Vec<String> =
        settings().get_arguments().filter_map(|setting| setting.get_env()?.to_str().map(str::to_owned)).collect();
    known.extend(super::OTHER_VARIABLES.iter().map(|name| (*name).to_owned()));
    let known: Vec<&str> = known.iter().map(String::as_str).collect();
    let names = std::env::vars_os().filter_map(|(name, _)| name.into_string().ok());
    for (name, near) in config::unknown_variables(names, &known) {
        let near = near.map(|near| format!("; did you mean {near}?")).unwrap_or_default();
        eprintln!("warning: the variable {name} is no setting{near}");
    }
}

/// The value of a flattened group of arguments.
pub fn read<T: FromArgMatches>(matches: &ArgMatches) -> Result<T, Failure> {
    T::from_arg_matches(matches).map_err(|error| Failure::arguments(error.to_string()))
}
