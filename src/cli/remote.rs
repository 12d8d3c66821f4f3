//! `rigsmith submit`, `watch` and `get`: rigs made by a service.

use super::client::{Client, Event, ServerArguments};
use super::failure::Failure;
use super::files::{Form, write_whole};
use super::rig::{OptionArguments, output_kind};
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use rigsmith::jobs::Output;
use serde_json::Value;
use std::path::{Path, PathBuf};

#[derive(Args)]
pub struct SubmitArguments {
    /// The mesh.
    input: PathBuf,
    /// A file that the mesh refers to: buffers, materials, textures. Repeat for more.
    #[arg(long = "with", value_name = "FILE")]
    others: Vec<PathBuf>,
    /// Wait for the end and write what was made, by extension as for `rig`. Repeat for more.
    #[arg(short, long = "output", value_name = "OUT")]
    outputs: Vec<PathBuf>,
    #[command(flatten)]
    options: OptionArguments,
    #[command(flatten)]
    server: ServerArguments,
}

#[derive(Args)]
pub struct WatchArguments {
    /// Id of the rig.
    id: String,
    #[command(flatten)]
    server: ServerArguments,
}

#[derive(Args)]
pub struct GetArguments {
    /// Id of the rig.
    id: String,
    /// Write what was made, by extension as for `rig`; without it, the job is printed as JSON. Repeat for more.
    #[arg(short, long = "output", value_name = "OUT")]
    outputs: Vec<PathBuf>,
    #[command(flatten)]
    server: ServerArguments,
}

/// Sends a mesh; with outputs, waits and writes them. The id goes to standard output.
pub fn submit(arguments: &SubmitArguments) -> Result<(), Failure> {
    let kinds = kinds(&arguments.outputs)?;
    let options = arguments.options.read(&kinds)?.to_json();
    let (content_type, body) = form(&options, &arguments.input, &arguments.others)?;
    let client = Client::new(&arguments.server);
    // New for each run: sending the same file twice on purpose makes two jobs.
    let key = uuid::Uuid::now_v7().to_string();
    let job = client.create(&content_type, &body, &key)?;
    let id = job["id"].as_str().unwrap_or_default();
    say!("{id}");
    if arguments.outputs.is_empty() {
        return Ok(());
    }
    follow(&client, id)?;
    write(&client, id, &arguments.outputs, &kinds)
}

/// Shows progress until the job is over.
pub fn watch(arguments: &WatchArguments) -> Result<(), Failure> {
    follow(&Client::new(&arguments.server), &arguments.id)
}

/// Prints a job, or writes what it made.
pub fn get(arguments: &GetArguments) -> Result<(), Failure> {
    let kinds = kinds(&arguments.outputs)?;
    let client = Client::new(&arguments.server);
    if !arguments.outputs.is_empty() {
        return write(&client, &arguments.id, &arguments.outputs, &kinds);
    }
    let job = client.job(&arguments.id)?;
    let text = serde_json::to_string_pretty(&job).map_err(|error| Failure::internal(error.to_string(), ""))?;
    say!("{text}");
    Ok(())
}

/// A mesh, what belongs to it, and the options: media type and body.
fn form(options: &Value, input: &Path, others: &[PathBuf]) -> Result<(String, Vec<u8>), Failure> {
    let mut form = Form::new();
    form.text("options", &options.to_string());
    for (field, path) in std::iter::once(("file", input)).chain(others.iter().map(|path| ("with", path.as_path()))) {
        let bytes = std::fs::read(path).map_err(|error| Failure::unreadable(path, &error))?;
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        form.file(field, &name, &bytes);
    }
    Ok(form.finish())
}

fn kinds(outputs: &[PathBuf]) -> Result<Vec<Output>, Failure> {
    outputs.iter().map(|path| output_kind(path)).collect()
}

fn follow(client: &Client, id: &str) -> Result<(), Failure> {
    let bar = ProgressBar::new(100);
    // The template is ours and right; a bar without it is a bar all the same.
    if let Ok(style) = ProgressStyle::with_template("{bar:32} {pos:>3} %  {msg}  {elapsed}") {
        bar.set_style(style);
    }
    let mut end = None;
    client.follow(id, |event: &Event| {
        let text = |name: &str| event.data.get(name).and_then(Value::as_str);
        if let Some(progress) = event.data.get("progress").and_then(Value::as_u64) {
            bar.set_position(progress);
        }
        if let Some(now) = text("stage").or(text("state")).filter(|_| event.name != "warning") {
            bar.set_message(now.to_owned());
        }
        if event.name == "warning" {
            bar.suspend(|| eprintln!("note: {}", text("message").unwrap_or_default()));
        }
        if event.name == "done" {
            end = Some(event.data.clone());
        }
    })?;
    let ended = end.map_or_else(|| client.job(id), Ok)?;
    match ended["state"].as_str() {
        Some("succeeded") => {
            bar.finish_with_message("succeeded");
            Ok(())
        }
        state => {
            bar.abandon_with_message(state.unwrap_or_default().to_owned());
            Err(ended_without(id, &ended))
        }
    }
}

/// Why a job has nothing to give.
fn ended_without(id: &str, job: &Value) -> Failure {
    let state = job["state"].as_str().unwrap_or("lost");
    let text = |name: &str| job["error"][name].as_str().unwrap_or_default();
    match text("code") {
        "" if state == "canceled" => Failure::coded("canceled", &format!("{id} was canceled"), ""),
        "" => Failure::internal(format!("{id} is {state}"), "rigsmith watch waits for its end"),
        code => Failure::coded(code, &format!("{id}: {}", text("message")), text("hint")),
    }
}

fn write(client: &Client, id: &str, outputs: &[PathBuf], kinds: &[Output]) -> Result<(), Failure> {
    let job = client.job(id)?;
    if job["state"] != "succeeded" {
        return Err(ended_without(id, &job));
    }
    let made = job["result"]["artifacts"].as_array().cloned().unwrap_or_default();
    for (path, kind) in outputs.iter().zip(kinds) {
        let artifact = made.iter().find(|artifact| artifact["name"] == kind.file_name());
        let url = artifact.and_then(|artifact| artifact["url"].as_str()).ok_or_else(|| {
            let names: Vec<&str> = made.iter().filter_map(|artifact| artifact["name"].as_str()).collect();
            Failure::arguments(format!("{id} has no {}; it has {}", kind.name(), names.join(", ")))
        })?;
        write_whole(path, &client.bytes(url)?)?;
    }
    Ok(())
}
