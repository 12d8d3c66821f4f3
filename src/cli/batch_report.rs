//! What became of each mesh of a batch: kept as JSON beside what was made, so that a later run goes on from there.

use super::failure::Failure;
use super::files::write_whole;
use rigsmith::jobs::JobError;
use serde_json::{Map, Value, json};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Duration;

const FORMAT: &str = "rigsmith.batch/1";

pub struct Report {
    path: PathBuf,
    /// Options, networks and version: everything beside the files that decides a result.
    made_by: Value,
    entries: BTreeMap<String, Entry>,
}

/// What became of one mesh.
#[derive(Clone)]
pub struct Entry {
    pub sha256: String,
    /// Files beside it that were asked for; `None`: it was not there.
    pub with: BTreeMap<String, Option<String>>,
    pub seconds: f64,
    pub made: Result<Made, Why>,
}

#[derive(Clone, Default)]
pub struct Made {
    pub joints: u64,
    /// Digests by name.
    pub files: BTreeMap<String, String>,
}

/// Why there is no rig.
#[derive(Clone)]
pub struct Why {
    pub code: String,
    pub message: String,
    pub hint: String,
}

pub fn digest(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

impl From<&JobError> for Why {
    fn from(error: &JobError) -> Self {
        Self { code: error.code.name().to_owned(), message: error.message.clone(), hint: error.hint.clone() }
    }
}

impl Entry {
    /// Of a mesh with these bytes, of which nothing was made yet.
    pub fn of(bytes: &[u8], with: BTreeMap<String, Option<String>>, time: Duration) -> Self {
        let seconds = (time.as_secs_f64() * 1000.0).round() / 1000.0;
        Self { sha256: digest(bytes), with, seconds, made: Ok(Made::default()) }
    }
}

impl Report {
    /// The report at `path`; entries that were made in another way are forgotten.
    pub fn open(path: &Path, made_by: Value) -> Result<Self, Failure> {
        let mut report = Self { path: path.to_owned(), made_by, entries: BTreeMap::new() };
        let text = match std::fs::read(path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(report),
            read => read.map_err(|error| Failure::unreadable(path, &error))?,
        };
        let known: Value = serde_json::from_slice(&text).map_err(|error| {
            Failure::arguments(format!("{}: {error}", path.display())).hint("remove it, or name another folder with -o")
        })?;
        if known["format"] != FORMAT {
            let message = format!("{} is no report of rigsmith batch", path.display());
            return Err(Failure::arguments(message).hint("name another folder with -o"));
        }
        if known["made_by"] == report.made_by {
            let files = known["files"].as_object().into_iter().flatten();
            report.entries = files.filter_map(|(name, value)| Some((name.clone(), read(value)?))).collect();
        }
        Ok(report)
    }

    pub fn entry(&self, name: &str) -> Option<&Entry> {
        self.entries.get(name)
    }

    pub fn set(&mut self, name: &str, entry: Entry) {
        self.entries.insert(name.to_owned(), entry);
    }

    /// Forgets meshes that are not there any more.
    pub fn keep_only<'name>(&mut self, names: impl Iterator<Item = &'name str>) {
        let names: BTreeSet<&str> = names.collect();
        self.entries.retain(|name, _| names.contains(name.as_str()));
    }

    pub fn failed(&self) -> usize {
        self.entries.values().filter(|entry| entry.made.is_err()).count()
    }

    pub fn save(&self) -> Result<(), Failure> {
        let files: Map<String, Value> =
            self.entries.iter().map(|(name, entry)| (name.clone(), written(entry))).collect();
        let counts = json!({"succeeded": self.entries.len() - self.failed(), "failed": self.failed()});
        let report = json!({"format": FORMAT, "counts": counts, "made_by": self.made_by, "files": files});
        let text = serde_json::to_vec_pretty(&report).map_err(|error| Failure::internal(error.to_string(), ""))?;
        write_whole(&self.path, &text)
    }

    /// A line for each mesh, and one for all.
    pub fn table(&self) -> String {
        let width = self.entries.keys().map(|name| name.chars().count()).max().unwrap_or(0).max("mesh".len());
        let mut text = format!("{:width$}  {:>6}  {:>8}  result\n", "mesh", "joints", "seconds");
        for (name, entry) in &self.entries {
            let (joints, result) = match &entry.made {
                Ok(made) => (made.joints.to_string(), "succeeded".to_owned()),
                Err(why) => (String::new(), format!("{}: {}", why.code, why.message)),
            };
            text += &format!("{name:width$}  {joints:>6}  {:>8.2}  {result}\n", entry.seconds);
        }
        let failed = self.failed();
        text + &format!("{} rigs, {failed} meshes without one", self.entries.len() - failed)
    }
}

fn written(entry: &Entry) -> Value {
    let mut value = json!({"sha256": entry.sha256, "with": entry.with, "seconds": entry.seconds});
    match &entry.made {
        Ok(made) => {
            value["state"] = "succeeded".into();
            value["joints"] = made.joints.into();
            value["made"] = json!(made.files);
        }
        Err(why) => {
            value["state"] = "failed".into();
            value["error"] = json!({"code": why.code, "message": why.message, "hint": why.hint});
        }
    }
    value
}

/// `None`: this is no entry of ours, and its mesh is done again.
fn read(value: &Value) -> Option<Entry> {
    let text = |value: &Value| value.as_str().map(str::to_owned);
    let with = value["with"].as_object()?.iter().map(|(name, digest)| (name.clone(), text(digest)));
    let made = if value["state"] == "succeeded" {
        let files = value["made"].as_object()?.iter();
        let files = files.map(|(name, digest)| Some((name.clone(), text(digest)?))).collect::<Option<_>>()?;
        Ok(Made { joints: value["joints"].as_u64()?, files })
    } else {
        let error = &value["error"];
        Err(Why { code: text(&error["code"])?, message: text(&error["message"])?, hint: text(&error["hint"])? })
    };
    Some(Entry { sha256: text(&value["sha256"])?, with: with.collect(), seconds: value["seconds"].as_f64()?, made })
}
