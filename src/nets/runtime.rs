//! ONNX Runtime, loaded once per process with one thread pool for all sessions.

use super::error::NetError;
use ort::environment::{Environment, GlobalThreadPoolOptions};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// The loaded library. Clones share it; it lives as long as the process.
#[derive(Clone)]
pub struct Runtime {
    pub(super) environment: Environment,
}

/// ONNX Runtime allows one environment per process.
static LOADED: Mutex<Option<Runtime>> = Mutex::new(None);

impl Runtime {
    /// Loads the first of `candidates` that exists, with a pool of `threads` threads that do not spin while idle.
    ///
    /// Once loaded, later calls return the same runtime, whatever they ask for.
    pub fn load(candidates: &[PathBuf], threads: usize) -> Result<Self, NetError> {
        let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(runtime) = loaded.as_ref() {
            return Ok(runtime.clone());
        }
        let path = candidates
            .iter()
            .find(|path| path.is_file())
            .ok_or_else(|| NetError::RuntimeNotFound { looked: candidates.to_vec() })?;
        let runtime = Self { environment: environment(path, threads)? };
        *loaded = Some(runtime.clone());
        Ok(runtime)
    }
}

fn environment(path: &Path, threads: usize) -> Result<Environment, NetError> {
    let broken = |cause: String| NetError::RuntimeBroken { path: path.to_path_buf(), cause };
    // The library must be named before any other call: the first call of any kind loads it.
    let builder = ort::init_from(path).map_err(|error| broken(error.to_string()))?;
    GlobalThreadPoolOptions::default()
        .with_intra_threads(threads)
        .and_then(|pool| pool.with_inter_threads(1))
        .and_then(|pool| pool.with_spin_control(false))
        .and_then(|pool| builder.with_name("rigsmith").with_telemetry(false).with_global_thread_pool(pool).build())
        .map_err(|error| broken(error.to_string()))
}
