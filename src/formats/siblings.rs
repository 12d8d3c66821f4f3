//! The other files of an upload: how their names are read, and how much they may weigh together.

use super::{DecodeError, Limits};
use std::cell::Cell;
use std::collections::BTreeMap;

/// The other files of an upload, by the relative name that the main file uses.
pub trait Siblings {
    /// The bytes of `name`, or `None` when the upload has no such file. Implementations refuse names that leave
    /// the upload (absolute, `..`): [`relative_name`] does.
    fn read(&self, name: &str) -> Option<Vec<u8>>;
}

/// An upload of one file.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoSiblings;

impl Siblings for NoSiblings {
    fn read(&self, _name: &str) -> Option<Vec<u8>> {
        None
    }
}

/// Files in memory, by relative name.
impl Siblings for BTreeMap<String, Vec<u8>> {
    fn read(&self, name: &str) -> Option<Vec<u8>> {
        self.get(&relative_name(name)?).cloned()
    }
}

/// `name` with forward slashes and without `.` components; `None` if it is absolute, climbs out with `..` or is empty.
pub fn relative_name(name: &str) -> Option<String> {
    let name = name.replace('\\', "/");
    let has_drive = name.as_bytes().get(1) == Some(&b':');
    if name.starts_with('/') || has_drive || name.contains('\0') {
        return None;
    }
    let mut kept: Vec<&str> = Vec::new();
    for component in name.split('/') {
        match component {
            "" | "." => {}
            ".." => {
                kept.pop()?;
            }
            component => kept.push(component),
        }
    }
    (!kept.is_empty()).then(|| kept.join("/"))
}

/// The last component of a path of any system.
pub(super) fn base_name(path: &str) -> &str {
    path.rsplit(['/', '\\']).next().unwrap_or(path)
}

/// Finds a file that another file refers to: beside the referring file, else by its bare name, since material files
/// and FBX often carry paths of the machine they were made on.
pub(super) fn find(siblings: &dyn Siblings, referrer_folder: &str, name: &str) -> Option<Vec<u8>> {
    let beside = relative_name(&format!("{referrer_folder}/{name}").trim_start_matches('/').replace('\\', "/"));
    let mut candidates: Vec<String> = beside.filter(|_| relative_name(name).is_some()).into_iter().collect();
    for other in [relative_name(name), relative_name(base_name(name))].into_iter().flatten() {
        if !candidates.contains(&other) {
            candidates.push(other);
        }
    }
    candidates.iter().find_map(|candidate| siblings.read(candidate))
}

/// Siblings that stop answering once they have given out more than the upload may weigh.
pub(super) struct BoundedSiblings<'a> {
    siblings: &'a dyn Siblings,
    given: Cell<u64>,
    limit: u64,
}

impl<'a> BoundedSiblings<'a> {
    /// `main_bytes` is what the main file has used up already.
    pub(super) fn new(siblings: &'a dyn Siblings, main_bytes: u64, limits: &Limits) -> Self {
        Self { siblings, given: Cell::new(main_bytes), limit: limits.bytes_max }
    }

    /// Refuses the upload if a sibling was held back.
    pub(super) fn check(&self) -> Result<(), DecodeError> {
        let found = self.given.get();
        if found > self.limit {
            let what = "the file together with those it refers to".into();
            return Err(DecodeError::TooLarge { what, found, limit: self.limit });
        }
        Ok(())
    }
}

impl Siblings for BoundedSiblings<'_> {
    fn read(&self, name: &str) -> Option<Vec<u8>> {
        if self.given.get() > self.limit {
            return None;
        }
        let bytes = self.siblings.read(name)?;
        self.given.set(self.given.get().saturating_add(bytes.len() as u64));
        (self.given.get() <= self.limit).then_some(bytes)
    }
}
