//! `rigsmith keys`: the keys that callers of a service show.

use super::failure::Failure;
use clap::{Args, Subcommand};
use rigsmith::server::keys::{self, KeysError, OwnQuota};
use std::path::PathBuf;

#[derive(Subcommand)]
pub enum KeysCommand {
    /// Make a key and print it, once: the file keeps its digest only. A running service takes it up within seconds.
    New(NewArguments),
    /// List the keys, without their secrets, which nobody has but their callers.
    List(FileArgument),
    /// Remove a key. A running service forgets it within seconds.
    Remove(RemoveArguments),
}

#[derive(Args)]
pub struct FileArgument {
    /// The keys file; `serve --keys` names it to the service.
    #[arg(long, env = "RIGSMITH_KEYS", value_name = "FILE", default_value = "keys.toml")]
    keys: PathBuf,
}

#[derive(Args)]
pub struct NewArguments {
    /// Whose key it is. Jobs belong to the caller: several keys of one caller see the same jobs.
    caller: String,
    /// Requests per minute, if not what the service gives every key.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    requests_per_minute: Option<u32>,
    /// Unfinished jobs, if not what the service gives every key.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    jobs: Option<u32>,
    /// MiB of uploads per hour, if not what the service gives every key.
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u64).range(1..))]
    upload_mib_per_hour: Option<u64>,
    #[command(flatten)]
    file: FileArgument,
}

#[derive(Args)]
pub struct RemoveArguments {
    /// As `keys list` shows it.
    id: String,
    #[command(flatten)]
    file: FileArgument,
}

pub fn run(command: &KeysCommand) -> Result<(), Failure> {
    let failed = |error: KeysError| Failure::arguments(error.to_string()).hint("");
    match command {
        KeysCommand::New(new) => {
            let NewArguments { requests_per_minute, jobs, upload_mib_per_hour, .. } = *new;
            let quota = OwnQuota { requests_per_minute, jobs, upload_mib_per_hour };
            let secret = keys::add(&new.file.keys, &new.caller, quota).map_err(failed)?;
            say!("{secret}");
            eprintln!("{} has a new key; this is the only time it is shown", new.caller);
        }
        KeysCommand::List(file) => {
            for entry in keys::entries(&file.keys).map_err(failed)? {
                let number = |number: Option<u64>| number.map_or("default".to_owned(), |number| number.to_string());
                let OwnQuota { requests_per_minute, jobs, upload_mib_per_hour } = entry.quota();
                say!(
                    "{}  {:<16}  {}  requests/minute {}  jobs {}  upload MiB/hour {}",
                    entry.id,
                    entry.caller,
                    entry.created_at.as_deref().unwrap_or("-"),
                    number(requests_per_minute.map(u64::from)),
                    number(jobs.map(u64::from)),
                    number(upload_mib_per_hour),
                );
            }
        }
        KeysCommand::Remove(remove) => {
            if !keys::remove(&remove.file.keys, &remove.id).map_err(failed)? {
                let path = remove.file.keys.display();
                return Err(
                    Failure::arguments(format!("{path} has no key {:?}", remove.id)).hint("see rigsmith keys list")
                );
            }
            eprintln!("{} is removed", remove.id);
        }
    }
    Ok(())
}
