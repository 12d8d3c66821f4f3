//! `rigsmith rig`: a file in, files out.

use super::EngineOptions;
use super::failure::Failure;
use super::files::{InputFile, place, write_whole};
use clap::Args;
use rigsmith::jobs::{Engine, OptionsReader, Outcome, Output, RigOptions, Watch};
use std::path::{Path, PathBuf};

#[derive(Args)]
pub struct RigArguments {
    /// The mesh: .glb, .gltf, .obj, .ply, .stl, .fbx, or a .zip of one with its textures.
    input: PathBuf,
    #[command(flatten)]
    options: OptionArguments,
    #[command(flatten)]
    results: ResultArguments,
}

/// Where results go.
#[derive(Args)]
pub struct ResultArguments {
    /// What to make, by extension: .glb, .gltf, .rig.json, .txt (RigNet text) or .png (preview). Repeat for more.
    #[arg(short, long = "output", value_name = "OUT", required = true)]
    outputs: Vec<PathBuf>,
    /// Write the report of the work as JSON.
    #[arg(long, value_name = "FILE.json")]
    report: Option<PathBuf>,
}

/// The options of a rig, named as in the HTTP API.
#[derive(Args)]
pub struct OptionArguments {
    /// The method to rig by; see `rigsmith methods`.
    #[arg(long, value_name = "NAME")]
    method: Option<String>,
    /// How many joints: 0 (few) to 1 (many).
    #[arg(long, value_name = "0..1", conflicts_with = "bandwidth")]
    detail: Option<String>,
    /// RigNet's mean-shift bandwidth instead of --detail; larger means fewer joints.
    #[arg(long, value_name = "H")]
    bandwidth: Option<String>,
    /// Fingers: auto gives hands that show three or more the joints of these and folds two stray ends into the wrist; on takes
    /// more for a hand and keeps all; off none.
    #[arg(long, value_name = "auto|on|off")]
    fingers: Option<String>,
    #[command(flatten)]
    any_skeleton: AnySkeletonArguments,
}

/// The options that a skeleton of one's own leaves open.
#[derive(Args)]
pub struct AnySkeletonArguments {
    /// Make left and right alike: auto, on or off.
    #[arg(long, value_name = "auto|on|off")]
    symmetry: Option<String>,
    /// What weighs the vertices: auto, rignet, heter_skin_net, geodesic_voxel or geodesic_heat.
    #[arg(long, value_name = "NAME")]
    skin_method: Option<String>,
    /// A character made of boxes: auto puts joints where its boxes touch and moves each box as a whole (unless
    /// --skin-method is given); off rigs it like any other.
    #[arg(long, value_name = "auto|off")]
    boxes: Option<String>,
    /// What may weigh them where that cannot run here, in this order, separated by commas.
    #[arg(long, value_name = "NAMES")]
    skin_fallback: Option<String>,
    /// Most joints that may move one vertex, 1 to 8.
    #[arg(long, value_name = "N")]
    max_influences: Option<String>,
    /// How far weights run into each other along the surface, never across a gap: 0 (not at all) to 1.
    #[arg(long, value_name = "0..1")]
    smooth: Option<String>,
    /// Drop weights below this share of a vertex's, 0 to 0.5; 0.001 unless given.
    #[arg(long, value_name = "SHARE")]
    prune: Option<String>,
    /// Make the weights of left and right alike, where mesh and joints are: auto, on or off.
    #[arg(long, value_name = "auto|on|off")]
    mirror_weights: Option<String>,
    /// Fixes what the mesh does not decide.
    #[arg(long, value_name = "N")]
    seed: Option<String>,
    /// The axis that points up, where the file does not say: x, -x, y, -y, z or -z.
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    up: Option<String>,
    /// The axis that the character faces.
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    front: Option<String>,
    /// What to do with a file that is rigged already: reject, replace, or reskin, which keeps its skeleton and makes new weights.
    #[arg(long, value_name = "reject|replace|reskin")]
    existing_rig: Option<String>,
    /// Joints of a skeleton that is there which must not move vertices: names or patterns ('IK_*'), separated by commas.
    #[arg(long, alias = "no-deform", value_name = "NAMES")]
    non_deforming: Option<String>,
    /// Joints of a skeleton that is there which keep the weights that they had, named alike; the others share what is left.
    #[arg(long, alias = "lock", value_name = "NAMES")]
    locked_joints: Option<String>,
}

impl OptionArguments {
    /// The options, checked by the reader that the HTTP door uses too.
    pub fn read(&self, outputs: &[Output]) -> Result<RigOptions, Failure> {
        let mut given = self.any_skeleton.given();
        given.extend([("method", &self.method), ("detail", &self.detail), ("bandwidth", &self.bandwidth)]);
        given.push(("fingers", &self.fingers));
        read_options(&given, outputs)
    }
}

impl AnySkeletonArguments {
    pub fn read(&self, outputs: &[Output]) -> Result<RigOptions, Failure> {
        read_options(&self.given(), outputs)
    }

    pub fn names_existing_rig(&self) -> bool {
        self.existing_rig.is_some()
    }

    fn given(&self) -> Vec<(&'static str, &Option<String>)> {
        vec![
            ("symmetry", &self.symmetry),
            ("skin_method", &self.skin_method),
            ("boxes", &self.boxes),
            ("skin_fallback", &self.skin_fallback),
            ("max_influences", &self.max_influences),
            ("smooth", &self.smooth),
            ("prune", &self.prune),
            ("mirror_weights", &self.mirror_weights),
            ("seed", &self.seed),
            ("up", &self.up),
            ("front", &self.front),
            ("existing_rig", &self.existing_rig),
            ("non_deforming", &self.non_deforming),
            ("locked_joints", &self.locked_joints),
        ]
    }
}

fn read_options(given: &[(&str, &Option<String>)], outputs: &[Output]) -> Result<RigOptions, Failure> {
    let mut reader = OptionsReader::default();
    for (field, value) in given {
        if let Some(value) = value {
            reader.text(field, value);
        }
    }
    if !outputs.is_empty() {
        let names: Vec<&str> = outputs.iter().map(|output| output.name()).collect();
        reader.text("outputs", &names.join(","));
    }
    reader.finish().map_err(|errors| {
        let lines: Vec<String> =
            errors.iter().map(|error| format!("--{}: {}", error.field.replace('_', "-"), error.detail)).collect();
        Failure::arguments(lines.join("; "))
    })
}

pub fn run(arguments: &RigArguments, engine: &EngineOptions) -> Result<(), Failure> {
    let options = arguments.options.read(&arguments.results.kinds()?)?;
    make(&arguments.input, &options, &arguments.results, engine)
}

/// Rigs the file at `input` and writes what was asked for.
pub fn make(
    input: &Path,
    options: &RigOptions,
    results: &ResultArguments,
    engine: &EngineOptions,
) -> Result<(), Failure> {
    results.spares(Some(input))?;
    let file = InputFile::read(input)?;
    let engine = Engine::open(&engine.load_options(1))?;
    let watch = Watch::unattended();
    let outcome = engine
        .rig_file(&file.name, &file.bytes, &file.siblings, options, &watch)
        .map_err(|error| Failure::job(input, &error))?;
    results.write(&outcome, &watch)?;
    summarise(&results.outputs, &outcome, &watch);
    Ok(())
}

impl ResultArguments {
    /// What to make, in the order of the files.
    pub fn kinds(&self) -> Result<Vec<Output>, Failure> {
        self.outputs.iter().map(|path| output_kind(path)).collect()
    }

    /// Whether every result has a place of its own, which is there and is not `sent`: what was sent is never written over.
    pub fn spares(&self, sent: Option<&Path>) -> Result<(), Failure> {
        let mut taken = Vec::new();
        for path in self.outputs.iter().chain(&self.report) {
            let place = place(path)?;
            if sent.is_some_and(|sent| std::fs::canonicalize(sent).is_ok_and(|sent| sent == place)) {
                let message = format!("{} is what was sent, and would be lost", path.display());
                return Err(Failure::arguments(message).hint("name another file for the result"));
            }
            if taken.contains(&place) {
                let message = format!("{} is named for two results", path.display());
                return Err(Failure::arguments(message).hint("give each a name of its own"));
            }
            taken.push(place);
        }
        Ok(())
    }

    fn write(&self, outcome: &Outcome, watch: &Watch) -> Result<(), Failure> {
        for (path, kind) in self.outputs.iter().zip(self.kinds()?) {
            let artifact = outcome
                .artifact(kind)
                .ok_or_else(|| Failure::internal(format!("no {} was made", kind.name()), "report this as a bug"))?;
            write_whole(path, &artifact.bytes)?;
        }
        if let Some(path) = &self.report {
            let report = serde_json::to_vec_pretty(&outcome.timed_report(watch))
                .map_err(|error| Failure::internal(error.to_string(), ""))?;
            write_whole(path, &report)?;
        }
        Ok(())
    }
}

/// Which output a file name asks for.
pub fn output_kind(path: &Path) -> Result<Output, Failure> {
    let name = path.file_name().map(|name| name.to_string_lossy().to_lowercase()).unwrap_or_default();
    let kinds = [
        (".rig.json", Output::RigJson),
        (".glb", Output::Glb),
        (".gltf", Output::Gltf),
        (".txt", Output::RignetTxt),
        (".png", Output::PreviewPng),
    ];
    kinds.into_iter().find(|(ending, _)| name.ends_with(ending)).map(|(_, kind)| kind).ok_or_else(|| {
        Failure::arguments(format!("-o {}: the name must end in .glb, .gltf, .rig.json, .txt or .png", path.display()))
    })
}

fn summarise(outputs: &[PathBuf], outcome: &Outcome, watch: &Watch) {
    let seconds: f64 = watch.timings().iter().map(|timing| timing.duration.as_secs_f64()).sum();
    let names: Vec<String> = outputs.iter().map(|path| path.display().to_string()).collect();
    eprintln!("{} joints by {} in {seconds:.1} s: {}", outcome.joint_count(), outcome.method_used, names.join(", "));
    if let Some(reason) = outcome.skin_reason() {
        eprintln!("skin: {reason}");
    }
    for finding in &outcome.findings {
        let hint = if finding.hint.is_empty() { String::new() } else { format!(" ({})", finding.hint) };
        eprintln!("note: {}{hint}", finding.message);
    }
}
