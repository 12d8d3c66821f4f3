//! Who may call: bearer keys. The keys file holds their digests only, so that whoever reads it cannot call.
//!
//! ```toml
//! [[key]]
//! caller = "studio"                  # jobs belong to the caller: several keys may stand for one, so that keys can change
//! id = "key_5d41402a"
//! sha256 = "9f86d081884c7d65…"
//! created_at = "2026-11-24T15:20:07Z"
//! requests_per_minute = 1200         # optional, as are
//! jobs = 16
//! upload_mib_per_hour = 51200
//! ```

use super::http::timestamp::rfc3339;
use base64::Engine;
use base64::prelude::BASE64_URL_SAFE_NO_PAD;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::SystemTime;
use subtle::ConstantTimeEq;

const SECRET_PREFIX: &str = "rsk_";
const SECRET_BYTES: usize = 32;
const CALLER_CHARACTERS_MAX: usize = 64;
const MIB: u64 = 1 << 20;

/// What one key may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quota {
    pub requests_per_minute: u32,
    /// Unfinished jobs of the caller.
    pub jobs: u32,
    pub upload_bytes_per_hour: u64,
}

/// What the line of a key says of its quota; the rest is as for every key.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OwnQuota {
    pub requests_per_minute: Option<u32>,
    pub jobs: Option<u32>,
    pub upload_mib_per_hour: Option<u64>,
}

impl OwnQuota {
    fn over(self, quota: Quota) -> Quota {
        let bytes = self.upload_mib_per_hour.map(|mib| mib.saturating_mul(MIB));
        Quota {
            requests_per_minute: self.requests_per_minute.unwrap_or(quota.requests_per_minute).max(1),
            jobs: self.jobs.unwrap_or(quota.jobs),
            upload_bytes_per_hour: bytes.unwrap_or(quota.upload_bytes_per_hour).max(1),
        }
    }
}

/// A key that may call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Key {
    pub id: String,
    pub caller: String,
    pub quota: Quota,
    sha256: [u8; 32],
}

/// One entry of the file.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    pub caller: String,
    pub id: String,
    pub sha256: String,
    pub created_at: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub requests_per_minute: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jobs: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub upload_mib_per_hour: Option<u64>,
}

impl Entry {
    pub fn quota(&self) -> OwnQuota {
        let Self { requests_per_minute, jobs, upload_mib_per_hour, .. } = *self;
        OwnQuota { requests_per_minute, jobs, upload_mib_per_hour }
    }
}

#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entries {
    #[serde(default)]
    key: Vec<Entry>,
}

/// Why the keys cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum KeysError {
    #[error("the keys file {}: {source}", .path.display())]
    Io { path: PathBuf, source: io::Error },
    #[error("the keys file {} cannot be read: {reason}", .path.display())]
    Syntax { path: PathBuf, reason: String },
    #[error("no random bytes: {0}")]
    Random(String),
    #[error("a caller's name has 1 to {CALLER_CHARACTERS_MAX} letters, digits, `.`, `-` or `_`; {0:?} is none")]
    Caller(String),
}

/// The keys in force. Clones share them.
#[derive(Clone, Debug)]
pub struct Keys(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    path: PathBuf,
    quota: Quota,
    loaded: RwLock<Loaded>,
}

#[derive(Debug)]
struct Loaded {
    keys: Vec<Arc<Key>>,
    modified: Option<SystemTime>,
}

impl Keys {
    /// Reads the keys file. `quota` is that of keys which name none.
    pub fn open(path: &Path, quota: Quota) -> Result<Self, KeysError> {
        let loaded = RwLock::new(load(path, quota)?);
        Ok(Self(Arc::new(Shared { path: path.to_owned(), quota, loaded })))
    }

    /// The key that `secret` is. Looks at every key and compares in constant time, so that the time taken tells nothing.
    pub fn find(&self, secret: &str) -> Option<Arc<Key>> {
        let digest: [u8; 32] = Sha256::digest(secret).into();
        let loaded = self.0.loaded.read().unwrap_or_else(PoisonError::into_inner);
        let same = |key: &&Arc<Key>| bool::from(key.sha256.ct_eq(&digest));
        loaded.keys.iter().fold(None, |found, key| if same(&key) { Some(key.clone()) } else { found })
    }

    /// The key with this id, while it is in force.
    pub fn by_id(&self, id: &str) -> Option<Arc<Key>> {
        let loaded = self.0.loaded.read().unwrap_or_else(PoisonError::into_inner);
        loaded.keys.iter().find(|key| key.id == id).cloned()
    }

    pub fn is_empty(&self) -> bool {
        self.0.loaded.read().unwrap_or_else(PoisonError::into_inner).keys.is_empty()
    }

    /// Reads the file again if it has changed. A file that cannot be read leaves the keys as they are.
    pub fn refresh(&self) {
        let Shared { path, quota, loaded } = &*self.0;
        let known = loaded.read().unwrap_or_else(PoisonError::into_inner).modified;
        let now = fs::metadata(path).and_then(|facts| facts.modified()).ok();
        if now == known {
            return;
        }
        match load(path, *quota) {
            Ok(read) => {
                tracing::info!(keys = read.keys.len(), "the keys were read again");
                *loaded.write().unwrap_or_else(PoisonError::into_inner) = read;
            }
            Err(error) => {
                tracing::error!(%error, "the keys stay as they were");
                // Said once for each change of the file.
                loaded.write().unwrap_or_else(PoisonError::into_inner).modified = now;
            }
        }
    }
}

fn load(path: &Path, quota: Quota) -> Result<Loaded, KeysError> {
    let modified = fs::metadata(path).and_then(|facts| facts.modified()).ok();
    let keys = entries(path)?.into_iter().map(|entry| {
        let sha256 = digest(&entry.sha256).ok_or_else(|| KeysError::Syntax {
            path: path.to_owned(),
            reason: format!("the sha256 of {} is not 64 hexadecimal digits", entry.id),
        })?;
        check_caller(&entry.caller)?;
        let quota = entry.quota().over(quota);
        Ok(Arc::new(Key { id: entry.id, caller: entry.caller, quota, sha256 }))
    });
    Ok(Loaded { keys: keys.collect::<Result<_, KeysError>>()?, modified })
}

/// The entries of the keys file.
pub fn entries(path: &Path) -> Result<Vec<Entry>, KeysError> {
    let text = fs::read_to_string(path).map_err(|source| KeysError::Io { path: path.to_owned(), source })?;
    let read: Entries = toml::from_str(&text).map_err(|error| KeysError::Syntax {
        path: path.to_owned(),
        reason: error.to_string().trim_end().replace('\n', " "),
    })?;
    Ok(read.key)
}

/// Makes a key and adds its digest to the file, which is made when it is missing. The secret is told here and never
/// again.
pub fn add(path: &Path, caller: &str, quota: OwnQuota) -> Result<String, KeysError> {
    check_caller(caller)?;
    let mut listed = match entries(path) {
        Err(KeysError::Io { source, .. }) if source.kind() == io::ErrorKind::NotFound => Vec::new(),
        other => other?,
    };
    let mut random = [0; SECRET_BYTES];
    getrandom::fill(&mut random).map_err(|error| KeysError::Random(error.to_string()))?;
    let secret = format!("{SECRET_PREFIX}{}", BASE64_URL_SAFE_NO_PAD.encode(random));
    let sha256: String = Sha256::digest(&secret).iter().map(|byte| format!("{byte:02x}")).collect();
    listed.push(Entry {
        caller: caller.to_owned(),
        id: format!("key_{}", &sha256[..12]),
        sha256,
        created_at: Some(rfc3339(SystemTime::now())),
        requests_per_minute: quota.requests_per_minute,
        jobs: quota.jobs,
        upload_mib_per_hour: quota.upload_mib_per_hour,
    });
    write(path, listed)?;
    Ok(secret)
}

/// Removes the key with `id`; whether there was one.
pub fn remove(path: &Path, id: &str) -> Result<bool, KeysError> {
    let mut listed = entries(path)?;
    let before = listed.len();
    listed.retain(|entry| entry.id != id);
    let found = listed.len() < before;
    if found {
        write(path, listed)?;
    }
    Ok(found)
}

/// Whole or not at all, readable by its owner alone.
fn write(path: &Path, listed: Vec<Entry>) -> Result<(), KeysError> {
    let io_error = |source| KeysError::Io { path: path.to_owned(), source };
    let text = toml::to_string(&Entries { key: listed })
        .map_err(|error| KeysError::Syntax { path: path.to_owned(), reason: error.to_string() })?;
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    let mut options = fs::OpenOptions::new();
    options.write(true).create(true).truncate(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut file = options.open(&partial).map_err(io_error)?;
    let head = "# Keys of the callers of this service. Only digests are kept; `rigsmith keys new` adds one.\n\n";
    file.write_all(head.as_bytes()).and_then(|()| file.write_all(text.as_bytes())).map_err(io_error)?;
    file.sync_all().map_err(io_error)?;
    fs::rename(&partial, path).map_err(io_error)
}

fn check_caller(name: &str) -> Result<(), KeysError> {
    let fit = |letter: char| letter.is_ascii_alphanumeric() || ['.', '-', '_'].contains(&letter);
    if (1..=CALLER_CHARACTERS_MAX).contains(&name.len()) && name.chars().all(fit) {
        return Ok(());
    }
    Err(KeysError::Caller(name.chars().take(CALLER_CHARACTERS_MAX).collect()))
}

fn digest(hex: &str) -> Option<[u8; 32]> {
    let mut bytes = [0; 32];
    if hex.len() != 64 || !hex.is_ascii() {
        return None;
    }
    for (index, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from_str_radix(hex.get(2 * index..2 * index + 2)?, 16).ok()?;
    }
    Some(bytes)
}

#[cfg(test)]
pub fn test_key(id: &str, quota: Quota) -> Key {
    Key { id: id.to_owned(), caller: "test".to_owned(), quota, sha256: [0; 32] }
}

#[cfg(test)]
mod tests {
    use super::*;

    const QUOTA: Quota = Quota { requests_per_minute: 600, jobs: 4, upload_bytes_per_hour: 1 << 30 };

    #[test]
    fn a_key_is_known_by_its_secret_and_the_file_holds_only_its_digest() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("keys.toml");
        let secret = add(&path, "studio", OwnQuota { jobs: Some(9), ..OwnQuota::default() }).expect("made");
        let other =
            add(&path, "farm", OwnQuota { requests_per_minute: Some(10), upload_mib_per_hour: Some(3), jobs: None })
                .expect("made");
        let text = fs::read_to_string(&path).expect("reads");
        assert!(!text.contains(&secret) && !text.contains(&secret[4..]), "{text}");
        let keys = Keys::open(&path, QUOTA).expect("opens");
        let key = keys.find(&secret).expect("known");
        assert_eq!((key.caller.as_str(), key.quota), ("studio", Quota { jobs: 9, ..QUOTA }));
        assert_eq!(
            keys.find(&other).map(|key| key.quota),
            Some(Quota { requests_per_minute: 10, jobs: 4, upload_bytes_per_hour: 3 * MIB })
        );
        assert_eq!(keys.find(&secret[..secret.len() - 1]), None);
        assert_eq!(keys.find(""), None);
    }

    #[test]
    fn a_removed_key_is_forgotten_when_the_file_is_read_again_and_a_broken_file_changes_nothing() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("keys.toml");
        let secret = add(&path, "studio", OwnQuota::default()).expect("made");
        let keys = Keys::open(&path, QUOTA).expect("opens");
        let touch = |seconds| {
            let file = fs::File::options().write(true).open(&path).expect("opens");
            file.set_modified(SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(seconds)).expect("touched");
        };
        fs::write(&path, "[[key").expect("writes");
        touch(1);
        keys.refresh();
        assert!(keys.find(&secret).is_some());
        fs::write(&path, "").expect("writes");
        touch(2);
        keys.refresh();
        assert!(keys.find(&secret).is_none() && keys.is_empty());
    }

    #[test]
    fn callers_have_plain_names() {
        let folder = tempfile::tempdir().expect("folder");
        for name in ["", "two words", "a/b", &"x".repeat(65)] {
            assert!(add(&folder.path().join("keys.toml"), name, OwnQuota::default()).is_err(), "{name:?}");
        }
    }
}
