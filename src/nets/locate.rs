//! Where ONNX Runtime and the models are looked for, first to last: what the caller names, the environment, beside
//! the program (an installed copy), the repository that the program was built in or is started from.

use std::env;
use std::path::{Path, PathBuf};

/// Names the ONNX Runtime library file.
pub const RUNTIME_VARIABLE: &str = "ORT_DYLIB_PATH";
/// Names the folder that holds `manifest.json`.
pub const MODELS_VARIABLE: &str = "RIGSMITH_MODELS";

/// Library files to try, in order. A named file is the only one tried: a wrong name must not be papered over.
pub fn runtime_candidates(named: Option<&Path>) -> Vec<PathBuf> {
    let library = format!("{}onnxruntime{}", env::consts::DLL_PREFIX, env::consts::DLL_SUFFIX);
    candidates(named, RUNTIME_VARIABLE, &|folder| {
        vec![
            folder.join(&library),
            folder.join("lib").join(&library),
            folder.join("../lib/rigsmith").join(&library),
            folder.join("third_party/onnxruntime").join(&library),
        ]
    })
}

/// Model folders to try, in order; likewise.
pub fn models_candidates(named: Option<&Path>) -> Vec<PathBuf> {
    candidates(named, MODELS_VARIABLE, &|folder| {
        vec![folder.join("models"), folder.join("../share/rigsmith/models"), folder.join("models/artifacts")]
    })
}

fn candidates(named: Option<&Path>, variable: &str, places: &dyn Fn(&Path) -> Vec<PathBuf>) -> Vec<PathBuf> {
    if let Some(path) = named {
        return vec![path.to_path_buf()];
    }
    if let Some(path) = env::var_os(variable).filter(|value| !value.is_empty()) {
        return vec![PathBuf::from(path)];
    }
    folders().iter().flat_map(|folder| places(folder)).collect()
}

/// The program's folder, then its ancestors up to the repository (`target/release` is two below), then here.
fn folders() -> Vec<PathBuf> {
    let program = env::current_exe().ok().and_then(|path| path.canonicalize().ok());
    let mut folders: Vec<PathBuf> =
        program.iter().flat_map(|path| path.ancestors().skip(1).take(4)).map(Path::to_path_buf).collect();
    folders.extend(env::current_dir());
    folders
}
