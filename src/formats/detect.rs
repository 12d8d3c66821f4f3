//! What an upload is: by its first bytes, then by its name. Names lie more often than magic numbers do.

use super::{DecodeError, Format};

/// What can be opened here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Mesh(Format),
    Zip,
}

/// How much of a text file is looked at for its first keywords.
const TEXT_HEAD_BYTES: usize = 4096;

/// First bytes of formats that are refused by name.
const FOREIGN: &[(&[u8], &str)] = &[
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"GIF8", "a GIF image"),
    (b"II*\0", "a TIFF image"),
    (b"MM\0*", "a TIFF image"),
    (b"8BPS", "a Photoshop file"),
    (b"\xabKTX", "a KTX texture"),
    (b"DDS ", "a DDS texture"),
    (b"%PDF", "a PDF document"),
    (b"PXR-USDC", "a USD file"),
    (b"#usda", "a USD file"),
    (b"Ogawa", "an Alembic file"),
    (b"\x89HDF", "an HDF5 file"),
    (b"FOR4", "a Maya binary file"),
    (b"FOR8", "a Maya binary file"),
    (b"//Maya ASCII", "a Maya ASCII file"),
    (b"DRACO", "a bare Draco file"),
    (b"3D Geometry File Format", "a Rhino file"),
    (b"HIERARCHY", "a BVH motion file"),
    (b"#VRML", "a VRML file"),
    (b"MD5Version", "an MD5 file"),
    (b"PMX ", "an MMD model"),
    (b"Pmd", "an MMD model"),
    (b"MM\0\0", "a 3DS file"),
    (b"\xd0\xcf\x11\xe0", "an OLE file (3ds Max or Office)"),
    (b"\x1f\x8b", "a gzip file"),
    (b"\x28\xb5\x2f\xfd", "a Zstandard file (Blender compresses so)"),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive"),
    (b"Rar!", "a RAR archive"),
    (b"BZh", "a bzip2 file"),
    (b"\xfd7zXZ", "an xz file"),
    (b"\x7fELF", "a program"),
    (b"MZ", "a program"),
    (b"ID3", "an audio file"),
    (b"OggS", "an Ogg file"),
    (b"RIFF", "a RIFF file (WebP, WAV or AVI)"),
];

/// Words in the head of a text file that tell what it is, first match wins.
const FOREIGN_TEXT: &[(&str, &str)] = &[
    ("<COLLADA", "a Collada file"),
    ("<X3D", "an X3D file"),
    ("<html", "a web page"),
    ("<!DOCTYPE html", "a web page"),
    ("<svg", "an SVG image"),
    ("<?xml", "an XML file"),
];

/// Tells the kind of `bytes`, or names what was seen instead.
pub fn detect(file_name: &str, bytes: &[u8]) -> Result<Kind, DecodeError> {
    if bytes.is_empty() {
        return Err(DecodeError::Empty);
    }
    if let Some(kind) = by_magic(bytes) {
        return Ok(kind);
    }
    if let Some(seen) = foreign(bytes) {
        return Err(DecodeError::UnsupportedFormat { seen });
    }
    by_text(bytes)
        .or_else(|| by_extension(file_name))
        .or_else(|| is_binary_stl_length(bytes).then_some(Kind::Mesh(Format::Stl)))
        .ok_or_else(|| DecodeError::UnsupportedFormat { seen: unknown(file_name, bytes) })
}

/// Refuses by its first bytes what is surely no mesh, so that an upload need not be received to its end. Whatever is
/// not known here passes.
pub fn refuse_foreign(head: &[u8]) -> Result<(), DecodeError> {
    let markup = || {
        let text = String::from_utf8_lossy(&head[..head.len().min(TEXT_HEAD_BYTES)]).into_owned();
        let begun = text.trim_start().starts_with('<');
        FOREIGN_TEXT.iter().find(|(word, _)| begun && text.contains(word)).map(|(_, seen)| (*seen).to_owned())
    };
    match by_magic(head).is_none().then(|| foreign(head).or_else(markup)).flatten() {
        Some(seen) => Err(DecodeError::UnsupportedFormat { seen }),
        None => Ok(()),
    }
}

/// Whether these bytes are an FBX file, binary or text.
pub fn is_fbx(bytes: &[u8]) -> bool {
    by_magic(bytes).or_else(|| by_text(bytes)) == Some(Kind::Mesh(Format::Fbx))
}

fn by_magic(bytes: &[u8]) -> Option<Kind> {
    let ply_line_end = |byte: Option<&u8>| matches!(byte, Some(b'\n' | b'\r' | b' '));
    if bytes.starts_with(b"glTF") {
        Some(Kind::Mesh(Format::Glb))
    } else if bytes.starts_with(b"Kaydara FBX Binary") {
        Some(Kind::Mesh(Format::Fbx))
    } else if bytes.starts_with(b"ply") && ply_line_end(bytes.get(3)) {
        Some(Kind::Mesh(Format::Ply))
    } else if bytes.starts_with(b"PK\x03\x04") || bytes.starts_with(b"PK\x05\x06") {
        Some(Kind::Zip)
    } else {
        None
    }
}

/// A known format that is not read here, with its article.
fn foreign(bytes: &[u8]) -> Option<String> {
    if bytes.starts_with(b"BLENDER") {
        return Some(blender(bytes));
    }
    if bytes.get(4..8) == Some(b"ftyp") {
        return Some("an MP4 or HEIF file".into());
    }
    FOREIGN.iter().find(|(magic, _)| bytes.starts_with(magic)).map(|(_, seen)| (*seen).to_owned())
}

/// "a Blender 4.2 file". The header ends with `v` or `V` and the version as `402` (to 4.x) or `0500` (from 5.0).
fn blender(bytes: &[u8]) -> String {
    let header = &bytes[..bytes.len().min(17)];
    let digits = header.iter().skip_while(|byte| !matches!(byte, b'v' | b'V')).skip(1);
    let version = digits
        .take_while(|byte| byte.is_ascii_digit())
        .take(4)
        .fold(0, |sum, digit| sum * 10 + u32::from(digit - b'0'));
    if version == 0 { "a Blender file".into() } else { format!("a Blender {}.{} file", version / 100, version % 100) }
}

/// Text formats by their first keywords. `solid` alone does not make an STL: binary ones may begin so too.
fn by_text(bytes: &[u8]) -> Option<Kind> {
    let head = &bytes[..bytes.len().min(TEXT_HEAD_BYTES)];
    let text = String::from_utf8_lossy(head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head));
    let start = text.trim_start();
    if start.starts_with('{') {
        Some(Kind::Mesh(Format::Gltf))
    } else if start.starts_with("; FBX") || text.contains("FBXHeaderExtension") {
        Some(Kind::Mesh(Format::Fbx))
    } else if is_binary_stl_length(bytes) || (is_solid(start) && text.contains("facet")) {
        Some(Kind::Mesh(Format::Stl))
    } else if text.lines().any(|line| is_obj_line(line.trim_start())) && !text.contains('\0') {
        Some(Kind::Mesh(Format::Obj))
    } else {
        None
    }
}

fn is_solid(text: &str) -> bool {
    text.get(..5).is_some_and(|word| word.eq_ignore_ascii_case("solid"))
}

/// A vertex line, `v` and at least three numbers: the one statement that no OBJ is without.
fn is_obj_line(line: &str) -> bool {
    let mut words = line.split_ascii_whitespace();
    words.next() == Some("v") && words.by_ref().take(3).filter(|word| word.parse::<f64>().is_ok()).count() == 3
}

/// A binary STL says its length exactly: 80 bytes of header, the count, 50 bytes per facet.
fn is_binary_stl_length(bytes: &[u8]) -> bool {
    let Some(count) = bytes.get(80..84).and_then(|word| <[u8; 4]>::try_from(word).ok()) else {
        return false;
    };
    bytes.len() as u64 == 84 + 50 * u64::from(u32::from_le_bytes(count))
}

/// The format that a file name's extension promises.
pub fn by_extension(file_name: &str) -> Option<Kind> {
    Some(match extension(file_name).as_str() {
        "glb" | "vrm" => Kind::Mesh(Format::Glb),
        "gltf" => Kind::Mesh(Format::Gltf),
        "obj" => Kind::Mesh(Format::Obj),
        "ply" => Kind::Mesh(Format::Ply),
        "stl" => Kind::Mesh(Format::Stl),
        "fbx" => Kind::Mesh(Format::Fbx),
        "zip" => Kind::Zip,
        _ => return None,
    })
}

/// Lower case, without the dot; empty when there is none.
fn extension(file_name: &str) -> String {
    let base = file_name.rsplit(['/', '\\']).next().unwrap_or_default();
    base.rsplit_once('.').map(|(_, extension)| extension.to_ascii_lowercase()).unwrap_or_default()
}

fn unknown(file_name: &str, bytes: &[u8]) -> String {
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(TEXT_HEAD_BYTES)]).into_owned();
    if let Some((_, seen)) = FOREIGN_TEXT.iter().find(|(word, _)| head.contains(word)) {
        return (*seen).to_owned();
    }
    let kind = if std::str::from_utf8(&bytes[..bytes.len().min(256)]).is_ok() { "text" } else { "binary" };
    match extension(file_name) {
        extension if extension.is_empty() => format!("an unknown {kind} file"),
        extension => format!("a {kind} file named .{extension}"),
    }
}
