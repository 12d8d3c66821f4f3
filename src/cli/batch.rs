//! `rigsmith batch`: every mesh of a folder, here or by a service. What an earlier run made of the same files is kept.

use super::EngineOptions;
use super::batch_remote::{self, Remote};
use super::batch_report::{Entry, Made, Report, Why, digest};
use super::failure::Failure;
use super::files::{InputFile, ReadSiblings, place, write_whole};
use super::rig::OptionArguments;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use rigsmith::jobs::{Engine, FieldError, OptionsReader, Output, RigOptions, Rigger, Watch};
use rigsmith::server::http::media::is_mesh_name;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

#[derive(Args)]
pub struct BatchArguments {
    /// The folder of meshes. Files beside them that are no meshes (materials, textures, buffers) belong to those that name them.
    folder: PathBuf,
    /// The folder for what is made, and for the report of what became of each mesh (rigsmith-batch.json).
    #[arg(short, long = "output", value_name = "DIR")]
    output: PathBuf,
    /// What to make of each mesh: glb, gltf, rig_json, rignet_txt, preview_png. Separated by commas.
    #[arg(long, value_name = "KINDS", default_value = "glb")]
    make: String,
    #[command(flatten)]
    options: OptionArguments,
    /// Address of a service that does the work; without it, the work is done here.
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    /// Key for the service, where it asks for one.
    #[arg(long, env = "RIGSMITH_KEY", value_name = "KEY", hide_env_values = true)]
    key: Option<String>,
}

const REPORT: &str = "rigsmith-batch.json";

/// A mesh of the folder, and the name that what is made of it begins with.
pub struct Input {
    pub path: PathBuf,
    pub name: String,
    stem: String,
}

/// A run over one folder.
pub struct Run {
    outputs: Vec<Output>,
    folder: PathBuf,
    report: Report,
    bar: ProgressBar,
}

pub fn run(arguments: &BatchArguments, engine: &EngineOptions) -> Result<(), Failure> {
    let outputs = outputs(&arguments.make)?;
    let options = arguments.options.read(&outputs)?;
    let inputs = inputs(&arguments.folder)?;
    std::fs::create_dir_all(&arguments.output).map_err(|error| Failure::unwritable(&arguments.output, &error))?;
    if place(&arguments.output)? == place(&arguments.folder)? {
        let message = format!("{} holds the meshes: rigs would take their places", arguments.output.display());
        return Err(Failure::arguments(message).hint("name another folder with -o"));
    }
    let worker = match &arguments.server {
        Some(server) => Worker::Remote(Remote::new(server, arguments.key.as_deref())),
        None => Worker::Local(Box::new(Engine::open(&engine.load_options(1))?)),
    };
    let made_by =
        json!({"options": options.to_json(), "version": env!("CARGO_PKG_VERSION"), "models": worker.models()?});
    let report = Report::open(&arguments.output.join(REPORT), made_by)?;
    let bar = ProgressBar::new(inputs.len() as u64);
    // The template is ours and right; a bar without it is a bar all the same.
    if let Ok(style) = ProgressStyle::with_template("{bar:32} {pos}/{len}  {msg}  {elapsed}, {eta} left") {
        bar.set_style(style);
    }
    let mut run = Run { outputs, folder: arguments.output.clone(), report, bar };
    let (done, left): (Vec<Input>, Vec<Input>) = inputs.into_iter().partition(|input| run.is_done(input));
    run.bar.inc(done.len() as u64);
    run.report.keep_only(done.iter().chain(&left).map(|input| input.name.as_str()));
    match worker {
        Worker::Local(engine) => run.locally(&engine, &options, &left)?,
        Worker::Remote(remote) => batch_remote::work(&remote, &mut run, &options, &left)?,
    }
    run.bar.finish_and_clear();
    run.report.save()?;
    say!("{}", run.report.table());
    if !done.is_empty() {
        say!("{} of them were done before", done.len());
    }
    match run.report.failed() {
        0 => Ok(()),
        failed => Err(Failure::refused(
            format!("{failed} of {} meshes have no rig", done.len() + left.len()),
            format!("{} says why for each", arguments.output.join(REPORT).display()),
        )),
    }
}

/// Who does the work.
enum Worker {
    Local(Box<Engine>),
    Remote(Remote),
}

impl Worker {
    /// The networks that decide the result.
    fn models(&self) -> Result<Value, Failure> {
        match self {
            Self::Local(engine) => {
                let methods = engine.methods();
                let models = methods.iter().flat_map(|method| &method.models);
                Ok(models.map(|model| json!([model.name, model.sha256])).collect())
            }
            Self::Remote(remote) => remote.models(),
        }
    }
}

fn outputs(names: &str) -> Result<Vec<Output>, Failure> {
    let mut reader = OptionsReader::default();
    reader.text("outputs", names);
    let refused = |errors: Vec<FieldError>| errors.iter().map(|error| error.detail.clone()).collect::<Vec<_>>();
    let options = reader.finish();
    options
        .map(|options| options.outputs)
        .map_err(|errors| Failure::arguments(format!("--make: {}", refused(errors).join("; "))))
}

/// The ending of a file of this kind.
fn ending(output: Output) -> &'static str {
    match output {
        Output::Glb => "glb",
        Output::Gltf => "gltf",
        Output::RigJson => "rig.json",
        Output::RignetTxt => "txt",
        Output::PreviewPng => "png",
    }
}

/// The meshes of a folder, by name. Two that differ in their extension alone keep it in the names of what is made.
fn inputs(folder: &Path) -> Result<Vec<Input>, Failure> {
    let unreadable = |error: std::io::Error| Failure::unreadable(folder, &error);
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        if is_mesh_name(&name) && path.is_file() {
            paths.push((name, path));
        }
    }
    paths.sort();
    if paths.is_empty() {
        return Err(Failure::arguments(format!("{} has no file with the extension of a mesh", folder.display())));
    }
    let stem = |name: &str| name.rsplit_once('.').map_or(name, |(stem, _)| stem).to_owned();
    let mut stems: BTreeMap<String, usize> = BTreeMap::new();
    for (name, _) in &paths {
        *stems.entry(stem(name)).or_default() += 1;
    }
    let input = |(name, path): (String, PathBuf)| {
        let short = stem(&name);
        let stem = if stems.get(&short) == Some(&1) { short } else { name.clone() };
        Input { path, name, stem }
    };
    Ok(paths.into_iter().map(input).collect())
}

impl Run {
    fn output_name(&self, input: &Input, output: Output) -> String {
        format!("{}.{}", input.stem, ending(output))
    }

    /// Whether an earlier run has made everything of the same bytes, in the same way, and it is still there.
    fn is_done(&self, input: &Input) -> bool {
        let Some(Entry { sha256, with, made: Ok(made), .. }) = self.report.entry(&input.name) else { return false };
        let same = |path: &Path, sha256: &str| std::fs::read(path).is_ok_and(|bytes| digest(&bytes) == *sha256);
        let beside = input.path.parent().unwrap_or(Path::new(""));
        let kept = |output: &Output| {
            let name = self.output_name(input, *output);
            made.files.get(&name).is_some_and(|sha256| same(&self.folder.join(name), sha256))
        };
        same(&input.path, sha256)
            && with.iter().all(|(name, known)| match known {
                Some(sha256) => same(&beside.join(name), sha256),
                None => !beside.join(name).exists(),
            })
            && self.outputs.iter().all(kept)
    }

    fn locally(&mut self, engine: &Engine, options: &RigOptions, inputs: &[Input]) -> Result<(), Failure> {
        for input in inputs {
            self.bar.set_message(input.name.clone());
            let file = InputFile::read(&input.path)?;
            let siblings = ReadSiblings::new(&file.siblings);
            let began = Instant::now();
            let watch = Watch::unattended();
            let outcome = engine.rig_file(&file.name, &file.bytes, &siblings, options, &watch);
            let rigged = outcome.map_err(|error| Why::from(&error)).map(|outcome| Rigged {
                joints: outcome.joint_count(),
                files: outcome.artifacts.into_iter().map(|artifact| (artifact.name, artifact.bytes)).collect(),
            });
            let entry = Entry::of(&file.bytes, siblings.digests(), began.elapsed());
            self.note(input, entry, rigged)?;
        }
        Ok(())
    }

    pub fn say(&self, message: impl Into<String>) {
        self.bar.set_message(message.into());
    }

    /// Writes what was made of a mesh, and what became of it.
    pub fn note(&mut self, input: &Input, mut entry: Entry, rigged: Result<Rigged, Why>) -> Result<(), Failure> {
        entry.made = match rigged {
            Err(why) => Err(why),
            Ok(rigged) => {
                let mut made = Made { joints: rigged.joints, files: BTreeMap::new() };
                for output in &self.outputs {
                    let bytes = rigged.files.get(output.file_name()).ok_or_else(|| {
                        Failure::internal(format!("no {} was made", output.name()), "report this as a bug")
                    })?;
                    let name = self.output_name(input, *output);
                    write_whole(&self.folder.join(&name), bytes)?;
                    made.files.insert(name, digest(bytes));
                }
                Ok(made)
            }
        };
        self.report.set(&input.name, entry);
        self.report.save()?;
        self.bar.inc(1);
        Ok(())
    }

    /// The artifacts to fetch of each rig.
    pub fn outputs(&self) -> &[Output] {
        &self.outputs
    }
}

/// What was made of one mesh: files by the names of artifacts.
pub struct Rigged {
    pub joints: u64,
    pub files: BTreeMap<String, Vec<u8>>,
}
