//! The walls of the house: who may import whom, and who may name what.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Who may import whom. A new arrow is a decision: argue it in ARCHITECTURE.md, then add it here.
const MAY_IMPORT: &[(&str, &[&str])] = &[
    ("cancellation", &[]),
    ("mesh", &["cancellation"]),
    ("geometry", &["cancellation", "mesh"]),
    ("rig", &["cancellation", "mesh", "geometry"]),
    ("nets", &["cancellation", "mesh", "geometry", "rig"]),
    ("pipelines", &["cancellation", "mesh", "geometry", "nets", "rig"]),
    ("formats", &["mesh", "rig"]),
    ("outgoing", &[]),
    ("storage", &[]),
    ("jobs", &["cancellation", "formats", "pipelines", "rig", "storage"]),
    ("server", &["cancellation", "formats", "jobs", "outgoing", "pipelines", "storage"]),
];

/// Words of the outside world that the corridor must not use: it does no I/O.
const OUTSIDE: &[&str] = &["std::fs", "std::net", "std::env", "std::process", "tokio::", "std::time::SystemTime"];

fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).expect("source folder") {
        let path = entry.expect("entry").path();
        if path.is_dir() {
            found.extend(sources(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
    found.sort();
    found
}

fn src() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// The room a source file belongs to: the first path component below `src`, without `.rs`.
fn room(path: &Path) -> String {
    let inside = path.strip_prefix(src()).expect("below src");
    let first = inside.components().next().expect("a component").as_os_str().to_string_lossy();
    first.trim_end_matches(".rs").to_owned()
}

/// Code lines only: comments may name anything.
fn code(path: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(path).expect("source reads");
    text.lines().map(|line| line.split("//").next().unwrap_or_default().to_owned()).collect()
}

fn imported(line: &str) -> impl Iterator<Item = String> + '_ {
    line.match_indices("crate::").map(|(at, word)| {
        line[at + word.len()..].chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>()
    })
}

#[test]
fn modules_import_only_what_the_table_allows() {
    let mut wrong = BTreeSet::new();
    for path in sources(&src()) {
        let room = room(&path);
        let Some((_, allowed)) = MAY_IMPORT.iter().find(|(name, _)| *name == room) else {
            assert!(
                ["lib", "main", "cli", "config", "telemetry"].contains(&room.as_str()),
                "{room} has no row in MAY_IMPORT"
            );
            continue;
        };
        for line in code(&path) {
            for target in imported(&line) {
                let known = MAY_IMPORT.iter().any(|(name, _)| *name == target);
                if known && target != room && !allowed.contains(&target.as_str()) {
                    wrong.insert(format!("{room} imports {target} ({})", path.display()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn only_nets_names_the_network_runtime() {
    for path in sources(&src()).iter().filter(|path| room(path) != "nets") {
        for line in code(path) {
            // `report::` ends like it, but is another word.
            let named = line.match_indices("ort::").any(|(at, _)| !line[..at].ends_with(char::is_alphanumeric));
            assert!(!named, "{}: {line}", path.display());
        }
    }
}

#[test]
fn the_corridor_does_no_io() {
    for path in sources(&src()) {
        if !["mesh", "geometry", "rig", "formats", "pipelines"].contains(&room(&path).as_str()) {
            continue;
        }
        for line in code(&path) {
            for word in OUTSIDE {
                assert!(!line.contains(word), "{} does I/O: {line}", path.display());
            }
        }
    }
}
