//! The directory of a zip file and the content of single entries [PKWARE APPNOTE 6.3].
//!
//! A reader of our own because an upload is hostile: nothing is allocated for a declared count or size, the end record
//! is looked for once, and every entry is unpacked no further than it declares. Read: stored and deflated entries,
//! ZIP64 sizes. Refused by name: encryption, other compression methods, several disks, ZIP64 directories (more than
//! 65,535 entries or 4 GiB, beyond any limit here).

use super::{DecodeError, Limits, Place};
use std::io::Read;

const FORMAT: &str = "zip";

const END_RECORD: &[u8] = b"PK\x05\x06";
const END_RECORD_BYTES: usize = 22;
const COMMENT_BYTES_MAX: usize = 65_535;
const CENTRAL_HEADER: &[u8] = b"PK\x01\x02";
const CENTRAL_HEADER_BYTES: usize = 46;
const LOCAL_HEADER: &[u8] = b"PK\x03\x04";
const LOCAL_HEADER_BYTES: usize = 30;
const IS_ENCRYPTED: u16 = 1;
const STORED: u16 = 0;
const DEFLATED: u16 = 8;
/// "See the ZIP64 field" in a 32-bit size.
const IN_ZIP64: u64 = 0xffff_ffff;

/// One file of an archive, as its directory declares it.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    pub(super) name: String,
    pub(super) is_encrypted: bool,
    pub(super) unpacked_bytes: u64,
    packed_bytes: u64,
    method: u16,
    crc: u32,
    local_header: u64,
}

/// Little-endian fields of a record that may end early.
struct Record<'a>(&'a [u8]);

impl Record<'_> {
    fn u16(&self, at: usize) -> Option<u16> {
        self.0.get(at..at + 2)?.try_into().ok().map(u16::from_le_bytes)
    }

    fn u32(&self, at: usize) -> Option<u32> {
        self.0.get(at..at + 4)?.try_into().ok().map(u32::from_le_bytes)
    }

    fn u64(&self, at: usize) -> Option<u64> {
        self.0.get(at..at + 8)?.try_into().ok().map(u64::from_le_bytes)
    }
}

fn malformed(at: usize, problem: &str) -> DecodeError {
    DecodeError::Malformed { format: FORMAT, place: Place::Byte(at as u64), problem: problem.into() }
}

/// The entries that are files, in directory order.
pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<Vec<Entry>, DecodeError> {
    let end = find_end_record(bytes).ok_or_else(|| DecodeError::Truncated {
        format: FORMAT,
        what: "the directory at the end of the archive".into(),
        needed: END_RECORD_BYTES as u64,
        available: 0,
    })?;
    let record = Record(&bytes[end..]);
    let cut = || malformed(end, "the end record is cut off");
    let (disk, count) = (record.u16(4).ok_or_else(cut)?, record.u16(10).ok_or_else(cut)?);
    let start = record.u32(16).ok_or_else(cut)?;
    let unsupported = |feature: &str| DecodeError::UnsupportedFeature { format: FORMAT, feature: feature.into() };
    if count == u16::MAX || u64::from(start) == IN_ZIP64 {
        return Err(unsupported("a ZIP64 directory"));
    }
    if disk != 0 {
        return Err(unsupported("an archive of several volumes"));
    }
    let (found, limit) = (u64::from(count), limits.archive_entries_max as u64);
    if found > limit {
        return Err(DecodeError::TooMany { what: "archive entries", found, limit });
    }
    let mut entries = Vec::new();
    let mut at = start as usize;
    for _ in 0..count {
        let (entry, next) = read_central_header(bytes, at)?;
        at = next;
        if !entry.name.ends_with('/') {
            entries.push(entry);
        }
    }
    Ok(entries)
}

/// The last end record whose comment reaches exactly to the end of the file.
fn find_end_record(bytes: &[u8]) -> Option<usize> {
    let last = bytes.len().checked_sub(END_RECORD_BYTES)?;
    let first = last.saturating_sub(COMMENT_BYTES_MAX);
    (first..=last).rev().find(|&at| {
        bytes[at..].starts_with(END_RECORD) && Record(&bytes[at..]).u16(20) == u16::try_from(last - at).ok()
    })
}

/// The entry whose central header is at `at`, and where the next header begins.
fn read_central_header(bytes: &[u8], at: usize) -> Result<(Entry, usize), DecodeError> {
    let cut = || malformed(at, "the directory is cut off");
    let header = bytes.get(at..).ok_or_else(cut)?;
    if !header.starts_with(CENTRAL_HEADER) {
        return Err(malformed(at, "the directory is damaged"));
    }
    let record = Record(header);
    let length = |at: usize| record.u16(at).map(usize::from).ok_or_else(cut);
    let (name_bytes, extra_bytes, comment_bytes) = (length(28)?, length(30)?, length(32)?);
    let name_end = CENTRAL_HEADER_BYTES + name_bytes;
    let name = header.get(CENTRAL_HEADER_BYTES..name_end).ok_or_else(cut)?;
    let extra = header.get(name_end..name_end + extra_bytes).ok_or_else(cut)?;
    let wide = |at: usize| record.u32(at).map(u64::from).ok_or_else(cut);
    let mut sizes = [wide(24)?, wide(20)?, wide(42)?];
    fill_from_zip64(extra, &mut sizes);
    let [unpacked_bytes, packed_bytes, local_header] = sizes;
    let entry = Entry {
        name: String::from_utf8_lossy(name).into_owned(),
        is_encrypted: record.u16(8).ok_or_else(cut)? & IS_ENCRYPTED != 0,
        unpacked_bytes,
        packed_bytes,
        method: record.u16(10).ok_or_else(cut)?,
        crc: record.u32(16).ok_or_else(cut)?,
        local_header,
    };
    Ok((entry, at + name_end + extra_bytes + comment_bytes))
}

/// The ZIP64 extra field holds, in this order, only those of the values that do not fit in 32 bits.
fn fill_from_zip64(extra: &[u8], sizes: &mut [u64; 3]) {
    let mut rest = extra;
    while let (Some(id), Some(length)) = (Record(rest).u16(0), Record(rest).u16(2)) {
        let end = (4 + usize::from(length)).min(rest.len());
        if id == 1 {
            let field = Record(&rest[4..end]);
            let too_wide = sizes.iter_mut().filter(|size| **size == IN_ZIP64);
            for (index, size) in too_wide.enumerate() {
                *size = field.u64(8 * index).unwrap_or(*size);
            }
        }
        rest = &rest[end..];
    }
}

/// The content of one entry. An entry that unpacks to more than it declares is refused as a bomb.
pub(super) fn unpack(bytes: &[u8], entry: &Entry, limits: &Limits) -> Result<Vec<u8>, DecodeError> {
    if entry.is_encrypted {
        return Err(DecodeError::EncryptedArchive { name: entry.name.clone() });
    }
    let (found, limit) = (entry.unpacked_bytes, limits.bytes_max);
    if found > limit {
        return Err(DecodeError::TooLarge { what: format!("the archive entry {:?}", entry.name), found, limit });
    }
    let packed = packed_content(bytes, entry)?;
    let bomb = || DecodeError::ZipBomb { limit: limits.unzip_ratio_max };
    let damaged = || malformed(entry.local_header as usize, &format!("the entry {:?} is damaged", entry.name));
    let content = match entry.method {
        STORED => packed.to_vec(),
        DEFLATED => {
            let mut content = Vec::new();
            let mut reader = flate2::read::DeflateDecoder::new(packed).take(entry.unpacked_bytes + 1);
            reader.read_to_end(&mut content).map_err(|_| damaged())?;
            content
        }
        method => {
            let feature = format!("the compression method {method}");
            return Err(DecodeError::UnsupportedFeature { format: FORMAT, feature });
        }
    };
    if content.len() as u64 > entry.unpacked_bytes {
        return Err(bomb());
    }
    let mut crc = flate2::Crc::new();
    crc.update(&content);
    if content.len() as u64 != entry.unpacked_bytes || crc.sum() != entry.crc {
        return Err(damaged());
    }
    Ok(content)
}

fn packed_content<'a>(bytes: &'a [u8], entry: &Entry) -> Result<&'a [u8], DecodeError> {
    let at = usize::try_from(entry.local_header).unwrap_or(usize::MAX);
    let truncated = || DecodeError::Truncated {
        format: FORMAT,
        what: format!("the entry {:?}", entry.name),
        needed: entry.packed_bytes,
        available: (bytes.len() as u64).saturating_sub(entry.local_header),
    };
    let header = bytes.get(at..).ok_or_else(truncated)?;
    if !header.starts_with(LOCAL_HEADER) {
        return Err(malformed(at, &format!("the entry {:?} is not where the directory says", entry.name)));
    }
    let record = Record(header);
    let length = |at: usize| record.u16(at).map(usize::from).ok_or_else(truncated);
    let start = LOCAL_HEADER_BYTES + length(26)? + length(28)?;
    let packed_bytes = usize::try_from(entry.packed_bytes).map_err(|_| truncated())?;
    let end = start.checked_add(packed_bytes).ok_or_else(truncated)?;
    header.get(start..end).ok_or_else(truncated)
}
