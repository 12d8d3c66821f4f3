//! Uploads from disk: the file that was named, and the files beside it that it asks for.

use super::batch_report::digest;
use super::failure::Failure;
use rigsmith::formats::Siblings;
use std::cell::RefCell;
use std::collections::BTreeMap;
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

/// The files of a folder that were asked for, remembered.
pub struct ReadSiblings<'folder> {
    folder: &'folder Folder,
    asked: RefCell<BTreeMap<String, Option<Vec<u8>>>>,
}

impl<'folder> ReadSiblings<'folder> {
    pub fn new(folder: &'folder Folder) -> Self {
        Self { folder, asked: RefCell::default() }
    }

    /// Digests of what was there; `None` for what was not.
    pub fn digests(&self) -> BTreeMap<String, Option<String>> {
        let asked = self.asked.borrow();
        asked.iter().map(|(name, bytes)| (name.clone(), bytes.as_deref().map(digest))).collect()
    }

    /// What was there.
    pub fn found(&self) -> Vec<(String, Vec<u8>)> {
        let asked = self.asked.borrow();
        asked.iter().filter_map(|(name, bytes)| Some((name.clone(), bytes.clone()?))).collect()
    }
}

impl Siblings for ReadSiblings<'_> {
    fn read(&self, name: &str) -> Option<Vec<u8>> {
        let read = self.folder.read(name);
        self.asked.borrow_mut().insert(name.to_owned(), read.clone());
        read
    }
}

/// Files and texts as `multipart/form-data`.
pub struct Form {
    boundary: String,
    body: Vec<u8>,
}

impl Form {
    pub fn new() -> Self {
        Self { boundary: format!("rigsmith-{}", uuid::Uuid::now_v7().simple()), body: Vec::new() }
    }

    pub fn text(&mut self, field: &str, text: &str) {
        self.part(field, "", text.as_bytes());
    }

    pub fn file(&mut self, field: &str, name: &str, bytes: &[u8]) {
        self.part(field, &format!("; filename=\"{}\"", name.replace(['"', '\r', '\n'], "_")), bytes);
    }

    fn part(&mut self, field: &str, file: &str, bytes: &[u8]) {
        let boundary = &self.boundary;
        let head = format!("--{boundary}\r\nContent-Disposition: form-data; name=\"{field}\"{file}\r\n\r\n");
        self.body.extend_from_slice(head.as_bytes());
        self.body.extend_from_slice(bytes);
        self.body.extend_from_slice(b"\r\n");
    }

    /// Media type and body.
    pub fn finish(mut self) -> (String, Vec<u8>) {
        self.body.extend_from_slice(format!("--{}--\r\n", self.boundary).as_bytes());
        (format!("multipart/form-data; boundary={}", self.boundary), self.body)
    }
}

/// Where a file is, or will be: two names of one place are the same. Its folder must be there.
pub fn place(path: &Path) -> Result<PathBuf, Failure> {
    if let Ok(there) = std::fs::canonicalize(path) {
        return Ok(there);
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let folder = std::fs::canonicalize(folder).map_err(|error| Failure::unwritable(path, &error))?;
    Ok(folder.join(path.file_name().unwrap_or_default()))
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
