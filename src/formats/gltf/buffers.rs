//! A document's buffers and image files, wherever they are: in the BIN chunk, in data URIs, in files sent along.
//!
//! Afterwards the document has one buffer. Views keep their order and content; only their offsets are counted anew.

use super::container::truncated;
use super::json::{index, items, items_mut, malformed, number, push, remove, text};
use crate::formats::{DecodeError, DecodeOptions, Finding, ImageType, Limits, Severity, Siblings};
use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use serde_json::{Value, json};
use std::cell::Cell;

/// Exporters disagree about padding; both ways mean the same bytes.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// One white pixel, for an image that was not sent.
const WHITE_PIXEL_PNG: &[u8] = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x01\0\0\0\x01\x08\0\0\0\0:~\x9bU\
    \0\0\0\nIDATx\xdac\xf8\x0f\0\x01\x01\x01\0\x1c\xb0\x8c\x99\0\0\0\0IEND\xaeB`\x82";

/// Alignment of everything in the merged buffer; the largest component has four bytes.
pub(super) const ALIGNMENT: usize = 4;

/// What this upload's buffers are made from.
pub(super) struct Sources<'a> {
    pub(super) is_glb: bool,
    pub(super) chunk: Option<&'a [u8]>,
    pub(super) siblings: &'a dyn Siblings,
    /// Folder of the main file inside the upload, with a trailing slash, or empty.
    pub(super) folder: &'a str,
    pub(super) limits: &'a Limits,
    /// Bytes used up so far, the main file included.
    pub(super) used: Cell<u64>,
}

impl Sources<'_> {
    /// The bytes behind a URI; `None` when the upload has no such file.
    fn read(&self, uri: &str, place: &str) -> Result<Option<Vec<u8>>, DecodeError> {
        if let Some(data) = uri.strip_prefix("data:") {
            return decode_data_uri(data).map(Some).ok_or_else(|| malformed(place, "its data URI is not base64"));
        }
        if uri.contains("://") {
            return Ok(None);
        }
        let name = percent_decoded(uri);
        let beside = format!("{}{name}", self.folder);
        let bytes = self.siblings.read(&beside).or_else(|| self.siblings.read(&name));
        if let Some(bytes) = &bytes {
            self.used.set(self.used.get().saturating_add(bytes.len() as u64));
            if self.used.get() > self.limits.bytes_max {
                let what = "the file together with those it refers to".into();
                return Err(DecodeError::TooLarge { what, found: self.used.get(), limit: self.limits.bytes_max });
            }
        }
        Ok(bytes)
    }
}

/// The part of a data URI after `data:`. Text without `;base64` is percent-encoded.
fn decode_data_uri(data: &str) -> Option<Vec<u8>> {
    let (head, content) = data.split_once(',')?;
    if head.ends_with(";base64") { BASE64.decode(content).ok() } else { Some(percent_bytes(content)) }
}

fn percent_decoded(uri: &str) -> String {
    String::from_utf8_lossy(&percent_bytes(uri)).into_owned()
}

fn percent_bytes(uri: &str) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let [first, tail @ ..] = rest {
        let hex = tail.get(..2).and_then(|two| std::str::from_utf8(two).ok());
        match hex.and_then(|two| u8::from_str_radix(two, 16).ok()) {
            Some(byte) if *first == b'%' => {
                bytes.push(byte);
                rest = &tail[2..];
            }
            _ => {
                bytes.push(*first);
                rest = tail;
            }
        }
    }
    bytes
}

/// Loads every buffer and joins them. A fallback buffer of meshopt compression stays empty: nobody reads it.
pub(super) fn load(json: &mut Value, sources: &Sources) -> Result<Vec<u8>, DecodeError> {
    let mut binary = Vec::new();
    let mut starts = Vec::new();
    for (number_of, buffer) in items(json, "buffers").iter().enumerate() {
        let place = format!("buffer {number_of}");
        binary.resize(binary.len().next_multiple_of(ALIGNMENT), 0);
        starts.push((binary.len(), number(buffer, "byteLength", &place)?.unwrap_or(0)));
        if super::meshopt::is_fallback(buffer) {
            continue;
        }
        append(buffer, number_of, &place, sources, &mut binary)?;
    }
    rebase_views(json, &starts)?;
    let mut merged = match items_mut(json, "buffers").first_mut() {
        Some(first) => first.take(),
        None => json!({}),
    };
    remove(&mut merged, "uri");
    remove(&mut merged, "extensions");
    merged["byteLength"] = json!(binary.len());
    if !starts.is_empty() {
        json["buffers"] = json!([merged]);
    }
    Ok(binary)
}

/// Appends one buffer's declared bytes.
fn append(
    buffer: &Value,
    number_of: usize,
    place: &str,
    sources: &Sources,
    binary: &mut Vec<u8>,
) -> Result<(), DecodeError> {
    let declared = number(buffer, "byteLength", place)?.ok_or_else(|| malformed(place, "no byteLength"))?;
    if declared > sources.limits.bytes_max {
        return Err(DecodeError::TooLarge { what: place.into(), found: declared, limit: sources.limits.bytes_max });
    }
    let take = |bytes: &[u8], binary: &mut Vec<u8>| match bytes.get(..declared as usize) {
        Some(bytes) => {
            binary.extend_from_slice(bytes);
            Ok(())
        }
        None => Err(truncated(place, declared, bytes.len() as u64)),
    };
    match (buffer.get("uri").and_then(Value::as_str), sources.chunk) {
        (Some(uri), _) => match sources.read(uri, place)? {
            Some(bytes) => take(&bytes, binary),
            None => Err(DecodeError::MissingResource { name: shown(uri) }),
        },
        (None, Some(chunk)) if number_of == 0 => take(chunk, binary),
        (None, _) => Err(malformed(place, "neither a uri nor a BIN chunk holds its bytes")),
    }
}

/// Counts view offsets from the start of the merged buffer.
fn rebase_views(json: &mut Value, starts: &[(usize, u64)]) -> Result<(), DecodeError> {
    for (view_index, view) in items_mut_if_any(json, "bufferViews").iter_mut().enumerate() {
        let place = format!("buffer view {view_index}");
        rebase(view, starts, &place)?;
        for extension in super::meshopt::EXTENSIONS {
            if let Some(compressed) = view.get_mut("extensions").and_then(|all| all.get_mut(*extension)) {
                rebase(compressed, starts, &place)?;
            }
        }
    }
    Ok(())
}

fn rebase(view: &mut Value, starts: &[(usize, u64)], place: &str) -> Result<(), DecodeError> {
    let reference = view.get("buffer").ok_or_else(|| malformed(place, "no buffer"))?;
    let buffer = super::json::reference(reference, "buffer", starts.len(), place)?;
    let offset = number(view, "byteOffset", place)?.unwrap_or(0);
    let length = number(view, "byteLength", place)?.ok_or_else(|| malformed(place, "no byteLength"))?;
    let (start, available) = starts[buffer];
    match offset.checked_add(length) {
        Some(end) if end <= available => {}
        end => return Err(truncated(place, end.unwrap_or(u64::MAX), available)),
    }
    if buffer > 0 {
        view["buffer"] = json!(0);
    }
    if start > 0 {
        view["byteOffset"] = json!(offset + start as u64);
    }
    Ok(())
}

/// Like [`items_mut`], but an absent list stays absent.
pub(super) fn items_mut_if_any<'a>(object: &'a mut Value, key: &str) -> &'a mut [Value] {
    object.get_mut(key).and_then(Value::as_array_mut).map_or(&mut [], Vec::as_mut_slice)
}

/// Brings image files into the buffer, so that the output needs no other file.
pub(super) fn embed_images(
    json: &mut Value,
    binary: &mut Vec<u8>,
    sources: &Sources,
    options: &DecodeOptions,
) -> Result<Vec<Finding>, DecodeError> {
    let mut missing = Vec::new();
    for number_of in 0..items(json, "images").len() {
        let image = &json["images"][number_of];
        let uri = text(image, "uri").to_owned();
        // In a GLB they are as the sender wants them; coming from JSON, a data URI would be a fault in the GLB.
        if uri.is_empty() || (uri.starts_with("data:") && sources.is_glb) {
            continue;
        }
        let bytes = match sources.read(&uri, &format!("image {number_of}"))? {
            Some(bytes) => bytes,
            None if options.allow_missing_textures => {
                missing.push(number_of);
                WHITE_PIXEL_PNG.to_vec()
            }
            None => return Err(DecodeError::MissingResource { name: shown(&uri) }),
        };
        let media_type = media_type(&bytes, text(image, "mimeType"), &uri);
        let view = append_view(json, binary, &bytes);
        let image = &mut json["images"][number_of];
        remove(image, "uri");
        if text(image, "name").is_empty() && !uri.starts_with("data:") {
            let base = percent_decoded(&uri);
            let base = base.rsplit(['/', '\\']).next().unwrap_or_default();
            image["name"] = json!(base.rsplit_once('.').map_or(base, |(stem, _)| stem));
        }
        image["bufferView"] = json!(view);
        image["mimeType"] = json!(media_type);
    }
    Ok(forget_images(json, &missing))
}

/// Takes textures of missing images out of the materials.
fn forget_images(json: &mut Value, missing: &[usize]) -> Vec<Finding> {
    if missing.is_empty() {
        return Vec::new();
    }
    let names: Vec<String> = missing.iter().map(|&image| text(&json["images"][image], "name").to_owned()).collect();
    let is_missing =
        |texture: &Value| texture.get("source").and_then(index).is_some_and(|source| missing.contains(&source));
    let textures: Vec<usize> = items(json, "textures")
        .iter()
        .enumerate()
        .filter_map(|(number_of, texture)| is_missing(texture).then_some(number_of))
        .collect();
    for material in items_mut_if_any(json, "materials") {
        forget_textures(material, &textures);
    }
    vec![Finding {
        code: "missing_texture",
        parts: Vec::new(),
        severity: Severity::Warning,
        message: format!("{} texture(s) were not sent and are left out: {}", names.len(), names.join(", ")),
        hint: "send the textures along, or everything in one zip".into(),
    }]
}

/// Removes members that name one of `textures`, at any depth; JSON depth is limited.
fn forget_textures(value: &mut Value, textures: &[usize]) {
    let Some(object) = value.as_object_mut() else { return };
    object.retain(|key, member| {
        let named = member.get("index").and_then(index);
        !(key.ends_with("Texture") && named.is_some_and(|texture| textures.contains(&texture)))
    });
    object.values_mut().for_each(|member| forget_textures(member, textures));
}

/// By the first bytes, then by what the file says, then by its extension.
fn media_type(bytes: &[u8], declared: &str, uri: &str) -> String {
    let seen = match bytes {
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => Some("image/webp"),
        [0xab, b'K', b'T', b'X', ..] => Some("image/ktx2"),
        [b'D', b'D', b'S', b' ', ..] => Some("image/vnd-ms.dds"),
        [_, _, _, _, b'f', b't', b'y', b'p', ..] => Some("image/avif"),
        _ => ImageType::of(bytes).map(ImageType::media_type),
    };
    let by_name = if uri.to_ascii_lowercase().ends_with(".png") { "image/png" } else { "image/jpeg" };
    seen.unwrap_or(if declared.is_empty() { by_name } else { declared }).to_owned()
}

/// Appends bytes to the buffer as a view of their own.
pub(super) fn append_view(json: &mut Value, binary: &mut Vec<u8>, bytes: &[u8]) -> usize {
    binary.resize(binary.len().next_multiple_of(ALIGNMENT), 0);
    let view = json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": bytes.len() });
    binary.extend_from_slice(bytes);
    set_buffer_length(json, binary.len());
    push(json, "bufferViews", view)
}

pub(super) fn set_buffer_length(json: &mut Value, length: usize) {
    let buffers = items_mut(json, "buffers");
    match buffers.first_mut() {
        Some(buffer) => buffer["byteLength"] = json!(length),
        None => buffers.push(json!({ "byteLength": length })),
    }
}

/// A URI for people: data is not shown.
fn shown(uri: &str) -> String {
    percent_decoded(uri).chars().take(200).collect()
}
