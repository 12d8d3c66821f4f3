//! `rigsmith skin`: weights for a skeleton that is there.

use super::EngineOptions;
use super::failure::Failure;
use super::rig::{AnySkeletonArguments, ResultArguments, make};
use clap::Args;
use rigsmith::jobs::{ExistingRigPolicy, read_skeleton};
use std::path::PathBuf;

/// Weigh a mesh over a skeleton of your own.
///
/// The skeleton stays as it is. Without --skeleton it is that of the mesh's own file (GLB, glTF or FBX): its names, order, orientations and
/// further nodes come back in the output. With --skeleton it is read from a .glb or .fbx that holds one, or from a rig.json
/// (`rigsmith.rig/1`), where only `format` and `joints` are needed: `{"format": "rigsmith.rig/1", "joints": [{"name": "hips", "parent": null,
/// "position": [0, 1, 0]}, ...]}`, parents by index and before their children, positions in the mesh's own coordinates.
#[derive(Args)]
pub struct SkinArguments {
    /// The mesh: .glb, .gltf, .obj, .ply, .stl, .fbx, or a .zip of one with its textures.
    input: PathBuf,
    /// The skeleton, unless it is in the file itself: .rig.json, .glb or .fbx.
    #[arg(long, value_name = "FILE")]
    skeleton: Option<PathBuf>,
    #[command(flatten)]
    options: AnySkeletonArguments,
    #[command(flatten)]
    results: ResultArguments,
}

pub fn run(arguments: &SkinArguments, engine: &EngineOptions) -> Result<(), Failure> {
    let mut options = arguments.options.read(&arguments.results.kinds()?)?;
    arguments.results.spares(arguments.skeleton.as_deref())?;
    match &arguments.skeleton {
        Some(_) if options.existing_rig == ExistingRigPolicy::Reskin => {
            let says = "--existing-rig reskin keeps the skeleton of the file, and --skeleton names another";
            return Err(Failure::arguments(format!("{says}: leave out one of them, or say --existing-rig replace")));
        }
        None if arguments.options.names_existing_rig() && options.existing_rig != ExistingRigPolicy::Reskin => {
            let says = "without --skeleton, the skeleton of the file is what the mesh is weighed over";
            return Err(Failure::arguments(format!("{says}: leave out --existing-rig, or name a skeleton")));
        }
        Some(path) => {
            let bytes = std::fs::read(path).map_err(|error| Failure::unreadable(path, &error))?;
            let read = read_skeleton(&bytes, !options.locked_joints.is_empty());
            options.skeleton = Some(read.map_err(|error| Failure::job(path, &error))?);
        }
        None => options.existing_rig = ExistingRigPolicy::Reskin,
    }
    make(&arguments.input, &options, &arguments.results, engine)
}
