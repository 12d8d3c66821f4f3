//! The GLB container: a header, a JSON chunk, a binary chunk, and chunks of other kinds that are passed on unread.

use super::FORMAT;
use crate::formats::{DecodeError, Place};

const MAGIC: u32 = u32::from_le_bytes(*b"glTF");
const JSON_CHUNK: u32 = u32::from_le_bytes(*b"JSON");
const BINARY_CHUNK: u32 = u32::from_le_bytes(*b"BIN\0");
const HEADER_BYTES: usize = 12;
const CHUNK_HEADER_BYTES: usize = 8;

/// A file taken apart, nothing parsed yet.
#[derive(Debug, Default)]
pub(super) struct Container<'a> {
    pub(super) json: &'a [u8],
    pub(super) binary: Option<&'a [u8]>,
    /// Kind and content of further chunks.
    pub(super) other_chunks: Vec<(u32, &'a [u8])>,
}

pub(super) fn is_glb(bytes: &[u8]) -> bool {
    bytes.starts_with(b"glTF")
}

/// Takes a GLB file apart; anything else is the JSON itself.
pub(super) fn split(bytes: &[u8]) -> Result<Container<'_>, DecodeError> {
    if !is_glb(bytes) {
        return Ok(Container { json: bytes, ..Container::default() });
    }
    let length = check_header(bytes)?;
    let mut container = Container::default();
    let mut at = HEADER_BYTES;
    // Each turn moves on by a chunk header at least.
    while length.saturating_sub(at) >= CHUNK_HEADER_BYTES {
        let (size, kind) = (word(bytes, at)?, word(bytes, at + 4)?);
        let start = at + CHUNK_HEADER_BYTES;
        let available = length - start;
        if size as usize > available {
            let what = if kind == JSON_CHUNK { "the JSON chunk" } else { "the BIN chunk" };
            return Err(truncated(what, u64::from(size), available as u64));
        }
        let content = &bytes[start..start + size as usize];
        match (at == HEADER_BYTES, kind) {
            (true, JSON_CHUNK) => container.json = content,
            (true, _) => return Err(malformed(at, "the first chunk is not JSON")),
            (false, BINARY_CHUNK) if container.binary.is_none() => container.binary = Some(content),
            (false, JSON_CHUNK | BINARY_CHUNK) => return Err(malformed(at, "a second chunk of the same kind")),
            (false, _) if size > 0 => container.other_chunks.push((kind, content)),
            (false, _) => {}
        }
        at = start + size as usize;
    }
    if at == HEADER_BYTES {
        return Err(truncated("the JSON chunk", CHUNK_HEADER_BYTES as u64, (length - at) as u64));
    }
    Ok(container)
}

/// The declared length, checked.
fn check_header(bytes: &[u8]) -> Result<usize, DecodeError> {
    if bytes.len() < HEADER_BYTES {
        return Err(truncated("the GLB header", HEADER_BYTES as u64, bytes.len() as u64));
    }
    match word(bytes, 4)? {
        2 => {}
        version => {
            let feature = format!("version {version} of GLB");
            return Err(DecodeError::UnsupportedFeature { format: FORMAT, feature });
        }
    }
    let length = word(bytes, 8)? as usize;
    if length < HEADER_BYTES {
        return Err(malformed(8, "the declared length is shorter than the header"));
    }
    if length > bytes.len() {
        return Err(truncated("the file", length as u64, bytes.len() as u64));
    }
    Ok(length)
}

/// Little-endian word at `at`.
fn word(bytes: &[u8], at: usize) -> Result<u32, DecodeError> {
    let four = bytes.get(at..at + 4).and_then(|four| <[u8; 4]>::try_from(four).ok());
    four.map(u32::from_le_bytes).ok_or_else(|| truncated("the GLB header", at as u64 + 4, bytes.len() as u64))
}

fn malformed(at: usize, problem: &str) -> DecodeError {
    DecodeError::Malformed { format: FORMAT, place: Place::Byte(at as u64), problem: problem.into() }
}

pub(super) fn truncated(what: &str, needed: u64, available: u64) -> DecodeError {
    DecodeError::Truncated { format: FORMAT, what: what.into(), needed, available }
}

/// Puts a GLB file together. `None` when it is larger than the container can say.
pub(super) fn join(json: &[u8], binary: &[u8], other_chunks: &[(u32, Vec<u8>)]) -> Option<Vec<u8>> {
    let mut file = Vec::with_capacity(json.len() + binary.len() + 64);
    file.extend_from_slice(&MAGIC.to_le_bytes());
    file.extend_from_slice(&2_u32.to_le_bytes());
    file.extend_from_slice(&0_u32.to_le_bytes());
    let mut chunk = |kind: u32, content: &[u8], padding: u8| {
        let size = content.len().next_multiple_of(4);
        file.extend_from_slice(&u32::try_from(size).ok()?.to_le_bytes());
        file.extend_from_slice(&kind.to_le_bytes());
        file.extend_from_slice(content);
        file.resize(file.len() + size - content.len(), padding);
        Some(())
    };
    chunk(JSON_CHUNK, json, b' ')?;
    chunk(BINARY_CHUNK, binary, 0)?;
    for (kind, content) in other_chunks {
        chunk(*kind, content, 0)?;
    }
    let length = u32::try_from(file.len()).ok()?;
    file[8..12].copy_from_slice(&length.to_le_bytes());
    Some(file)
}
