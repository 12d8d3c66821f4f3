//! `rigsmith skin`: weights for a skeleton that the caller has.

use super::EngineOptions;
use super::failure::Failure;
use super::rig::{AnySkeletonArguments, ResultArguments, make};
use clap::Args;
use rigsmith::jobs::read_skeleton;
use std::path::PathBuf;

/// Weigh a mesh over a skeleton of your own.
///
/// The skeleton stays as it is: names, order, parents and positions. It is read from a .glb that
/// holds one, or from a rig.json (`rigsmith.rig/1`), where only `format` and `joints` are needed: `{"format": "rigsmith.rig/1", "joints": [{"name": "hips", "parent": null,
/// "position": [0, 1, 0]}, ...]}`, parents by index and before their children, positions in the mesh's own coordinates.
#[derive(Args)]
pub struct SkinArguments {
    /// The mesh: .glb, .gltf, .obj, .ply, .stl, .fbx, or a .zip of one with its textures.
    input: PathBuf,
    /// The skeleton: .rig.json or .glb.
    #[arg(long, value_name = "FILE")]
    skeleton: PathBuf,
    #[command(flatten)]
    options: AnySkeletonArguments,
    #[command(flatten)]
    results: ResultArguments,
}

pub fn run(arguments: &SkinArguments, engine: &EngineOptions) -> Result<(), Failure> {
    let mut options = arguments.options.read(&arguments.results.kinds()?)?;
    let path = &arguments.skeleton;
    let bytes = std::fs::read(path).map_err(|error| Failure::unreadable(path, &error))?;
    options.skeleton = Some(read_skeleton(&bytes).map_err(|error| Failure::job(path, &error))?);
    make(&arguments.input, &options, &arguments.results, engine)
}
