//! The TOML file: flat keys, each the name of a setting. Anything else is refused, with the nearest name.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What a configuration file says.
#[derive(Clone, Debug, Default)]
pub struct ConfigFile {
    /// Empty: there is no file.
    pub path: PathBuf,
    /// By the name of the setting; as the command line would have it.
    pub values: BTreeMap<String, String>,
}

/// Why the configuration cannot be used. The operator must act.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    #[error("{}: {source}", .path.display())]
    Io { path: PathBuf, source: std::io::Error },
    #[error("{} is not TOML: {reason}", .path.display())]
    Syntax { path: PathBuf, reason: String },
    #[error("{}: there is no setting {key:?}{}", .path.display(), .nearest.as_ref().map(|name| format!("; did you mean {name:?}?")).unwrap_or_default())]
    UnknownKey { path: PathBuf, key: String, nearest: Option<String> },
    #[error("{}: {key} is {kind}, which no setting is; write a string, a whole number, true or false", .path.display())]
    Kind { path: PathBuf, key: String, kind: &'static str },
}

impl ConfigFile {
    /// Reads `path`. `known` are the names that it may use.
    pub fn read(path: &Path, known: &[&str]) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path).map_err(|source| ConfigError::Io { path: path.to_owned(), source })?;
        Self::parse(path, &text, known)
    }

    pub fn parse(path: &Path, text: &str, known: &[&str]) -> Result<Self, ConfigError> {
        let table: toml::Table = text.parse().map_err(|error: toml::de::Error| ConfigError::Syntax {
            path: path.to_owned(),
            reason: error.to_string().trim_end().replace('\n', " "),
        })?;
        let mut values = BTreeMap::new();
        for (key, value) in table {
            if !known.contains(&key.as_str()) {
                let nearest = nearest(&key, known).map(str::to_owned);
                return Err(ConfigError::UnknownKey { path: path.to_owned(), key, nearest });
            }
            let text = match value {
                toml::Value::String(text) => text,
                toml::Value::Integer(number) => number.to_string(),
                toml::Value::Boolean(truth) => truth.to_string(),
                other => {
                    return Err(ConfigError::Kind { path: path.to_owned(), key, kind: other.type_str() });
                }
            };
            values.insert(key, text);
        }
        Ok(Self { path: path.to_owned(), values })
    }
}

/// The name among `known` that differs from `name` in fewest letters, if it is near enough to have been meant.
pub fn nearest<'a>(name: &str, known: &[&'a str]) -> Option<&'a str> {
    let reach = (name.chars().count() / 3).max(1);
    let near = known.iter().map(|candidate| (edits(name, candidate), *candidate));
    near.filter(|(edits, _)| *edits <= reach).min().map(|(_, candidate)| candidate)
}

/// Letters to insert, delete or replace to make `from` into `to` [Levenshtein 1966], row by row.
fn edits(from: &str, to: &str) -> usize {
    let to: Vec<char> = to.chars().collect();
    let mut row: Vec<usize> = (0..=to.len()).collect();
    for (done, letter) in from.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = done + 1;
        for (index, other) in to.iter().enumerate() {
            let replaced = diagonal + usize::from(letter != *other);
            diagonal = row[index + 1];
            row[index + 1] = replaced.min(diagonal + 1).min(row[index] + 1);
        }
    }
    row[to.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: &[&str] = &["workers", "upload_mib", "listen"];

    fn refused(text: &str) -> String {
        ConfigFile::parse(Path::new("r.toml"), text, KNOWN).expect_err("refused").to_string()
    }

    #[test]
    fn unknown_keys_are_refused_with_the_nearest_name() {
        assert_eq!(refused("worker = 2"), "r.toml: there is no setting \"worker\"; did you mean \"workers\"?");
        assert_eq!(refused("upload_mb = 2"), "r.toml: there is no setting \"upload_mb\"; did you mean \"upload_mib\"?");
        assert_eq!(refused("colour = 2"), "r.toml: there is no setting \"colour\"");
        assert!(refused("workers = [1]").contains("workers is array"));
        assert!(refused("workers = ").contains("is not TOML"));
    }

    #[test]
    fn edits_count_letters() {
        for (from, to, count) in [("", "abc", 3), ("abc", "abc", 0), ("kitten", "sitting", 3), ("flaw", "lawn", 2)] {
            assert_eq!(edits(from, to), count, "{from} {to}");
        }
    }
}
