//! `rigsmith check`: what would be rigged, what was noticed, and an estimate; no networks are run.

use super::failure::Failure;
use super::files::InputFile;
use super::rig::OptionArguments;
use clap::Args;
use rigsmith::jobs::{Watch, check_file};
use rigsmith::server::http::check_views::CheckView;
use serde_json::Value;
use std::path::PathBuf;

#[derive(Args)]
pub struct CheckArguments {
    /// The mesh to look at.
    input: PathBuf,
    /// Print JSON instead of lines.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    options: OptionArguments,
}

pub fn run(arguments: &CheckArguments) -> Result<(), Failure> {
    let options = arguments.options.read(&[])?;
    let file = InputFile::read(&arguments.input)?;
    let check = check_file(&file.name, &file.bytes, &file.siblings, &options, &Watch::unattended())
        .map_err(|error| Failure::job(&arguments.input, &error))?;
    let check =
        serde_json::to_value(CheckView::from(&check)).map_err(|error| Failure::internal(error.to_string(), ""))?;
    if arguments.json {
        let text = serde_json::to_string_pretty(&check).map_err(|error| Failure::internal(error.to_string(), ""))?;
        say!("{text}");
    } else {
        print_lines("", &check);
    }
    Ok(())
}

/// One line per value, named by its path: `mesh.vertices: 1024`.
fn print_lines(path: &str, value: &Value) {
    match value {
        Value::Object(fields) => {
            for (name, value) in fields {
                let path = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
                print_lines(&path, value);
            }
        }
        Value::Array(items) if items.iter().any(Value::is_object) => {
            for (index, item) in items.iter().enumerate() {
                print_lines(&format!("{path}[{index}]"), item);
            }
        }
        Value::String(text) => say!("{path}: {text}"),
        Value::Array(items) if items.is_empty() => {}
        other => say!("{path}: {other}"),
    }
}
