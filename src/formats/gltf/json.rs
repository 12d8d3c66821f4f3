//! Checked reading of a glTF document's JSON.
//!
//! The document stays a [`Value`] with its order kept, because the output is this document plus a skin: names, extras
//! and unknown extensions must come back as they were sent. The `gltf` crate's typed tree would drop what it does not
//! know, and its reader indexes without checks.

use super::FORMAT;
use crate::formats::{DecodeError, Limits, Place};
use serde_json::Value;

/// Values in one document. Each costs about a hundred bytes once parsed, so this bounds the memory of a hostile file;
/// the largest honest documents hold a tenth of it.
const VALUES_MAX: usize = 2_000_000;

/// The lists of objects at the top of a document.
pub(super) const LISTS: &[&str] = &[
    "accessors",
    "animations",
    "bufferViews",
    "buffers",
    "cameras",
    "images",
    "materials",
    "meshes",
    "nodes",
    "samplers",
    "scenes",
    "skins",
    "textures",
];

pub(super) fn malformed(place: impl Into<String>, problem: impl Into<String>) -> DecodeError {
    DecodeError::Malformed { format: FORMAT, place: Place::Element(place.into()), problem: problem.into() }
}

/// Parses a document and checks the kinds of its top-level members, so that later code may rely on them.
pub(super) fn parse(text: &[u8], limits: &Limits) -> Result<Value, DecodeError> {
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
    let end =
        text.iter().rposition(|byte| !matches!(byte, 0 | b' ' | b'\n' | b'\r' | b'\t')).map_or(0, |last| last + 1);
    let text = &text[..end];
    check_size(text, limits)?;
    let json: Value = serde_json::from_slice(text).map_err(|error| DecodeError::Malformed {
        format: FORMAT,
        place: Place::Element(format!("JSON line {}, column {}", error.line(), error.column())),
        problem: match error.classify() {
            serde_json::error::Category::Eof => "the text ends too early".into(),
            _ => error.to_string(),
        },
    })?;
    check_shape(&json)?;
    Ok(json)
}

/// Refuses text that is nested too deep or holds too many values, before anything is built from it.
fn check_size(text: &[u8], limits: &Limits) -> Result<(), DecodeError> {
    let (mut depth, mut values) = (0_usize, 0_usize);
    let (mut in_string, mut escaped) = (false, false);
    for &byte in text {
        if in_string {
            match byte {
                _ if escaped => escaped = false,
                b'\\' => escaped = true,
                b'"' => in_string = false,
                _ => {}
            }
            continue;
        }
        match byte {
            b'"' => in_string = true,
            b'{' | b'[' => {
                depth += 1;
                values += 1;
                if depth > limits.depth_max {
                    let limit = limits.depth_max as u64;
                    return Err(DecodeError::TooDeep { format: FORMAT, what: "JSON", limit });
                }
            }
            b'}' | b']' => depth = depth.saturating_sub(1),
            b',' => values += 1,
            _ => {}
        }
    }
    if values > VALUES_MAX {
        return Err(DecodeError::TooMany { what: "JSON values", found: values as u64, limit: VALUES_MAX as u64 });
    }
    Ok(())
}

fn check_shape(json: &Value) -> Result<(), DecodeError> {
    if !json.is_object() {
        return Err(malformed("JSON", "the document is not an object"));
    }
    for key in LISTS {
        match json.get(*key) {
            None => {}
            Some(Value::Array(list)) if list.iter().all(Value::is_object) => {}
            Some(_) => return Err(malformed(*key, "not a list of objects")),
        }
    }
    for key in ["extensionsUsed", "extensionsRequired"] {
        match json.get(key) {
            None => {}
            Some(Value::Array(list)) if list.iter().all(Value::is_string) => {}
            Some(_) => return Err(malformed(key, "not a list of names")),
        }
    }
    Ok(())
}

/// The list `key` of an object; empty when absent.
pub(super) fn items<'a>(object: &'a Value, key: &str) -> &'a [Value] {
    object.get(key).and_then(Value::as_array).map_or(&[], Vec::as_slice)
}

/// The list `key` of an object, made when absent.
pub(super) fn items_mut<'a>(object: &'a mut Value, key: &str) -> &'a mut Vec<Value> {
    if !object.is_object() {
        *object = Value::Object(serde_json::Map::new());
    }
    let entry = &mut object[key];
    if !entry.is_array() {
        *entry = Value::Array(Vec::new());
    }
    entry.as_array_mut().expect("made an array above")
}

/// Appends to the list `key` of an object and returns the new element's index.
pub(super) fn push(object: &mut Value, key: &str, value: Value) -> usize {
    let list = items_mut(object, key);
    list.push(value);
    list.len() - 1
}

/// Removes a member of an object, keeping the order of the others.
pub(super) fn remove(object: &mut Value, key: &str) -> Option<Value> {
    object.as_object_mut()?.shift_remove(key)
}

/// A whole number at or above zero; some exporters write `3.0`.
pub(super) fn whole(value: &Value) -> Option<u64> {
    value.as_u64().or_else(|| {
        let number = value.as_f64()?;
        (number >= 0.0 && number.fract() == 0.0 && number < 9e15).then_some(number as u64)
    })
}

/// An index without a check of its range.
pub(super) fn index(value: &Value) -> Option<usize> {
    whole(value).and_then(|number| usize::try_from(number).ok())
}

/// Member `key` as a whole number.
pub(super) fn number(object: &Value, key: &str, place: &str) -> Result<Option<u64>, DecodeError> {
    match object.get(key) {
        None => Ok(None),
        Some(value) => match whole(value) {
            Some(number) => Ok(Some(number)),
            None => Err(malformed(place, format!("{key} is not a whole number"))),
        },
    }
}

/// A reference: `value` as an index below the length of `count` things called `what`.
pub(super) fn reference(value: &Value, what: &'static str, count: usize, place: &str) -> Result<usize, DecodeError> {
    match index(value) {
        Some(index) if index < count => Ok(index),
        Some(index) => Err(out_of_range(place, what, index as i64, count)),
        None => match value.as_i64() {
            Some(negative) => Err(out_of_range(place, what, negative, count)),
            None => Err(malformed(place, format!("the reference to a {what} is not a whole number"))),
        },
    }
}

pub(super) fn out_of_range(place: &str, what: &'static str, index: i64, count: usize) -> DecodeError {
    DecodeError::IndexOutOfRange { format: FORMAT, place: Place::Element(place.into()), what, index, count }
}

/// Member `key` as a reference into a list of `count` things.
pub(super) fn member_reference(
    object: &Value,
    key: &str,
    what: &'static str,
    count: usize,
    place: &str,
) -> Result<Option<usize>, DecodeError> {
    object.get(key).map(|value| reference(value, what, count, place)).transpose()
}

/// Member `key` as N finite numbers.
pub(super) fn numbers<const N: usize>(object: &Value, key: &str, place: &str) -> Result<Option<[f64; N]>, DecodeError> {
    let Some(value) = object.get(key) else { return Ok(None) };
    let list: Option<Vec<f64>> = value.as_array().and_then(|list| list.iter().map(Value::as_f64).collect());
    match list.and_then(|list| <[f64; N]>::try_from(list).ok()) {
        Some(numbers) => Ok(Some(numbers)),
        None => Err(malformed(place, format!("{key} is not a list of {N} numbers"))),
    }
}

pub(super) fn text<'a>(object: &'a Value, key: &str) -> &'a str {
    object.get(key).and_then(Value::as_str).unwrap_or_default()
}
