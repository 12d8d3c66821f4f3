//! `manifest.json` of the models folder: what stands there, its digests, interfaces, known answers and licences.

use super::error::NetError;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// File name in the models folder.
pub const FILE_NAME: &str = "manifest.json";

/// The parts of the manifest that the program reads; the training records are for people.
#[derive(Clone, Debug, Deserialize)]
pub struct Manifest {
    /// Layout version of the manifest itself.
    pub format: u64,
    pub networks: BTreeMap<String, NetworkEntry>,
    pub licence: Licence,
}

/// One network.
#[derive(Clone, Debug, Deserialize)]
pub struct NetworkEntry {
    /// Relative to the manifest.
    pub file: PathBuf,
    /// Of the file, lower-case hexadecimal.
    pub sha256: String,
    pub inputs: Vec<TensorEntry>,
    pub outputs: Vec<TensorEntry>,
    pub self_test: SelfTestEntry,
}

/// An input or output.
#[derive(Clone, Debug, Deserialize)]
pub struct TensorEntry {
    pub name: String,
}

/// Expected outputs for the inputs of [`super::self_test`].
#[derive(Clone, Debug, Deserialize)]
pub struct SelfTestEntry {
    /// The first values in C order.
    pub first: Vec<f64>,
    pub mean: f64,
    pub std: f64,
    pub tolerance: f64,
}

/// Under what terms the weights may be used.
#[derive(Clone, Debug, Deserialize)]
pub struct Licence {
    /// SPDX expression.
    pub weights: String,
    /// Names that must be given with them.
    pub attributions: Vec<String>,
}

const FORMAT: u64 = 1;

impl Manifest {
    /// Reads the manifest of the first folder that has one. Second: that folder.
    pub fn find(folders: &[PathBuf]) -> Result<(Self, PathBuf), NetError> {
        let folder = folders
            .iter()
            .find(|folder| folder.join(FILE_NAME).is_file())
            .ok_or_else(|| NetError::ModelsNotFound { looked: folders.to_vec() })?;
        Ok((Self::read(&folder.join(FILE_NAME))?, folder.clone()))
    }

    fn read(path: &Path) -> Result<Self, NetError> {
        let broken = |cause: String| NetError::Manifest { path: path.to_path_buf(), cause };
        let text = std::fs::read(path)
            .map_err(|error| NetError::Unreadable { path: path.to_path_buf(), cause: error.to_string() })?;
        let manifest: Self = serde_json::from_slice(&text).map_err(|error| broken(error.to_string()))?;
        if manifest.format != FORMAT {
            return Err(broken(format!("its format is {}, this version reads {FORMAT}", manifest.format)));
        }
        Ok(manifest)
    }
}
