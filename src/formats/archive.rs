//! A zip of one mesh file and the files that it refers to.
//!
//! The main file is the entry with a mesh extension that comes first by format (GLB, glTF, FBX, OBJ, PLY, STL), then by
//! depth in the folder tree, then by name; other mesh files are told in a finding. Entries are unpacked only when they
//! are needed, and never to disk. The whole directory is checked first: names that leave the archive, encryption and a
//! declared ratio above the limit refuse the upload even where the entry would not be used.

use super::detect::{self, Kind};
use super::siblings::{base_name, relative_name};
use super::zip_directory::{self, Entry};
use super::{Asset, DecodeError, DecodeOptions, Finding, Format, Limits, Severity, Siblings, decode_as};
use std::cell::RefCell;

/// Below this an unpacked archive is harmless at any ratio.
const HARMLESS_BYTES: u64 = 1 << 20;

/// Which format is the main file where an archive holds several.
const PREFERENCE: [Format; 6] = [Format::Glb, Format::Gltf, Format::Fbx, Format::Obj, Format::Ply, Format::Stl];

/// Reads the mesh file in an archive.
pub(super) fn decode(bytes: &[u8], limits: &Limits, options: &DecodeOptions) -> Result<Asset, DecodeError> {
    let entries = zip_directory::read(bytes, limits)?;
    check_entries(&entries, bytes, limits)?;
    let entries: Vec<Entry> = entries.into_iter().filter(|entry| !is_clutter(&entry.name)).collect();
    let candidates = candidates(&entries);
    let Some((&main, others)) = candidates.split_first() else {
        return Err(no_mesh(&entries));
    };
    let name = main.name.as_str();
    let content = zip_directory::unpack(bytes, main, limits)?;
    let Kind::Mesh(format) = detect::detect(name, &content)? else {
        return Err(DecodeError::NestedArchive { name: name.into() });
    };
    let files = ArchiveFiles { bytes, entries: &entries, main: name, limits, failure: RefCell::new(None) };
    let asset = decode_as(format, base_name(name), &content, &files, limits, options);
    if let Some(failure) = files.failure.into_inner() {
        return Err(failure);
    }
    let mut asset = asset?;
    if !others.is_empty() {
        let others: Vec<&str> = others.iter().take(5).map(|entry| entry.name.as_str()).collect();
        asset.findings.push(Finding {
            code: "several_meshes",
            parts: Vec::new(),
            severity: Severity::Warning,
            message: format!("the archive holds several mesh files; {name} was taken, not {}", others.join(", ")),
            hint: "send the mesh files one by one".into(),
        });
    }
    Ok(asset)
}

fn check_entries(entries: &[Entry], bytes: &[u8], limits: &Limits) -> Result<(), DecodeError> {
    let mut unpacked_bytes = 0_u64;
    for entry in entries {
        if relative_name(&entry.name).is_none() || has_parent_component(&entry.name) {
            return Err(DecodeError::UnsafePath { name: entry.name.clone() });
        }
        if entry.is_encrypted {
            return Err(DecodeError::EncryptedArchive { name: entry.name.clone() });
        }
        unpacked_bytes = unpacked_bytes.saturating_add(entry.unpacked_bytes);
    }
    let allowed = limits.unzip_ratio_max.saturating_mul(bytes.len() as u64).max(HARMLESS_BYTES);
    if unpacked_bytes > allowed {
        return Err(DecodeError::ZipBomb { limit: limits.unzip_ratio_max });
    }
    Ok(())
}

/// `a/../b` stays inside, but no honest program writes it.
fn has_parent_component(name: &str) -> bool {
    name.split(['/', '\\']).any(|component| component == "..")
}

/// What operating systems add to archives on their own.
fn is_clutter(name: &str) -> bool {
    name.starts_with("__MACOSX/") || base_name(name).starts_with("._") || base_name(name) == ".DS_Store"
}

/// The entries with a mesh extension, the main file first.
fn candidates(entries: &[Entry]) -> Vec<&Entry> {
    let rank = |entry: &Entry| match detect::by_extension(&entry.name) {
        Some(Kind::Mesh(format)) => PREFERENCE.iter().position(|preferred| *preferred == format),
        _ => None,
    };
    let mut found: Vec<_> = entries.iter().filter_map(|entry| Some((rank(entry)?, entry))).collect();
    found.sort_by_key(|(rank, entry)| (*rank, entry.name.matches(['/', '\\']).count(), entry.name.clone()));
    found.into_iter().map(|(_, entry)| entry).collect()
}

fn no_mesh(entries: &[Entry]) -> DecodeError {
    let has = |suffix: &str| entries.iter().find(|entry| entry.name.to_ascii_lowercase().ends_with(suffix));
    if let Some(nested) = [".zip", ".7z", ".rar", ".tar", ".gz"].into_iter().find_map(has) {
        return DecodeError::NestedArchive { name: nested.name.clone() };
    }
    let seen = if has("3d/3dmodel.model").is_some() {
        "a 3MF package".into()
    } else if [".usdc", ".usda", ".usd"].into_iter().any(|suffix| has(suffix).is_some()) {
        "a USDZ package".into()
    } else if has("[content_types].xml").is_some() {
        "an Office document".into()
    } else if entries.is_empty() {
        "an empty zip archive".into()
    } else {
        let names: Vec<&str> = entries.iter().take(5).map(|entry| entry.name.as_str()).collect();
        format!("a zip archive of {} file(s) ({})", entries.len(), names.join(", "))
    };
    DecodeError::UnsupportedFormat { seen }
}

/// The other entries of an archive, by name relative to the main file's folder, or else by a name that only one entry
/// has. Case does not matter where the exact name is not there: files often come from systems that ignore it.
struct ArchiveFiles<'a> {
    bytes: &'a [u8],
    entries: &'a [Entry],
    main: &'a str,
    limits: &'a Limits,
    /// Why an entry that is there could not be unpacked; refuses the upload.
    failure: RefCell<Option<DecodeError>>,
}

impl ArchiveFiles<'_> {
    fn find(&self, name: &str) -> Option<&Entry> {
        let name = relative_name(name)?;
        let folder = self.main.rsplit_once(['/', '\\']).map_or("", |(folder, _)| folder);
        let beside = relative_name(&format!("./{folder}/{name}"))?;
        let is_at = |entry: &&Entry| relative_name(&entry.name).as_deref() == Some(beside.as_str());
        let is_about_at =
            |entry: &&Entry| relative_name(&entry.name).is_some_and(|name| name.eq_ignore_ascii_case(&beside));
        let only = |is_it: &dyn Fn(&&Entry) -> bool| {
            let mut found = self.entries.iter().filter(is_it);
            found.next().filter(|_| found.next().is_none())
        };
        let has_bare_name = |entry: &&Entry| base_name(&entry.name).eq_ignore_ascii_case(&name);
        self.entries.iter().find(is_at).or_else(|| only(&is_about_at)).or_else(|| only(&has_bare_name))
    }
}

impl Siblings for ArchiveFiles<'_> {
    fn read(&self, name: &str) -> Option<Vec<u8>> {
        match zip_directory::unpack(self.bytes, self.find(name)?, self.limits) {
            Ok(content) => Some(content),
            Err(failure) => {
                self.failure.borrow_mut().get_or_insert(failure);
                None
            }
        }
    }
}
