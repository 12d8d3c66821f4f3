//! Uploads from disk: the file that was named, and the files beside it that it asks for.

use super::failure::Failure;
use rigsmith::formats::Siblings;
use std::path::{Component, Path, PathBuf};

/// A file to work on, read into memory.
pub struct InputFile {
    pub name: String,
    pub bytes: Vec<u8>,
    pub siblings: Folder,
}

impl InputFile {
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let bytes = std::fs::read(path).map_err(|error| Failure::unreadable(path, &error))?;
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        Ok(Self { name, bytes, siblings: Folder(path.parent().unwrap_or(Path::new("")).to_path_buf()) })
    }
}

/// The folder that a file stands in. Names that leave it are not read.
pub struct Folder(PathBuf);

impl Siblings for Folder {
    fn read(&self, name: &str) -> Option<Vec<u8>> {
        let inside = Path::new(name).components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
        if inside { std::fs::read(self.0.join(name)).ok() } else { None }
    }
}

/// Writes a result whole or not at all: under another name first, then renamed.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(format!(".{}.partial", std::process::id()));
    let partial = PathBuf::from(partial);
    let written = std::fs::write(&partial, bytes).and_then(|()| std::fs::rename(&partial, path));
    written.map_err(|error| {
        let _ = std::fs::remove_file(&partial); // nothing more can be done if this fails too
        Failure::unwritable(path, &error)
    })
}
