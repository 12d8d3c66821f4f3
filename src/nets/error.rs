//! What can go wrong with networks. All of it is the operator's to fix, except cancellation.

use crate::cancellation::Cancelled;
use std::path::PathBuf;

/// Why a network could not be loaded, checked or run.
#[derive(Debug, thiserror::Error)]
pub enum NetError {
    #[error("ONNX Runtime was not found (looked at {})", list(.looked))]
    RuntimeNotFound { looked: Vec<PathBuf> },
    #[error("ONNX Runtime at {} does not load: {cause}", .path.display())]
    RuntimeBroken { path: PathBuf, cause: String },
    #[error("the models were not found (looked at {})", list(.looked))]
    ModelsNotFound { looked: Vec<PathBuf> },
    #[error("{} cannot be read: {cause}", .path.display())]
    Unreadable { path: PathBuf, cause: String },
    #[error("{} is not a model manifest: {cause}", .path.display())]
    Manifest { path: PathBuf, cause: String },
    #[error("network {network}: the manifest does not list it")]
    NotListed { network: &'static str },
    #[error("network {network}: the file's digest is {actual}, the manifest says {expected}")]
    Digest { network: String, expected: String, actual: String },
    #[error("network {network}: {what} differs from what this version expects: got {got}, expected {expected}")]
    Interface { network: String, what: &'static str, got: String, expected: String },
    #[error("network {network} failed its self-test: {what}")]
    SelfTest { network: String, what: String },
    #[error("network {network} gave numbers that are not finite")]
    NotFinite { network: String },
    #[error("network {network}: {cause}")]
    Run { network: String, cause: String },
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl NetError {
    /// The next step for whoever runs the program; empty where there is none.
    pub fn hint(&self) -> &'static str {
        match self {
            Self::RuntimeNotFound { .. } => {
                "run `make ort` in the repository, or name the library by --onnxruntime or ORT_DYLIB_PATH"
            }
            Self::RuntimeBroken { .. } => {
                "run `make ort` again: it fetches the version that this program was built for"
            }
            Self::ModelsNotFound { .. } => "name the folder with manifest.json by --models or RIGSMITH_MODELS",
            Self::Unreadable { .. } | Self::Manifest { .. } | Self::NotListed { .. } | Self::Digest { .. } => {
                "restore the models folder from the release that this program came with"
            }
            Self::Interface { .. } => "use the models folder and the program of one release",
            Self::SelfTest { .. } => "check that ONNX Runtime is the pinned version (`make ort`)",
            Self::NotFinite { .. } | Self::Run { .. } | Self::Cancelled(_) => "",
        }
    }
}

fn list(paths: &[PathBuf]) -> String {
    paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
}
