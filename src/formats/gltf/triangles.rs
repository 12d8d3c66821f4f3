//! Triangles of a primitive: lists, strips and fans, with indices or without. glTF 2.0 specification, section 3.7.2.1.

use super::accessors::Component;
use super::bake::{Edit, mode};
use super::buffers::append_view;
use super::json::{index, items, malformed, member_reference, push};
use crate::formats::DecodeError;
use serde_json::{Value, json};

const LIST: u64 = 4;
const STRIP: u64 = 5;
const FAN: u64 = 6;

pub(super) fn has_triangles(mode: u64) -> bool {
    matches!(mode, LIST | STRIP | FAN)
}

/// How many triangles `corners` corners make.
pub(super) fn count(mode: u64, corners: usize) -> usize {
    match mode {
        LIST => corners / 3,
        STRIP | FAN => corners.saturating_sub(2),
        _ => 0,
    }
}

/// Triangles `[F, 3]` of one primitive, counter-clockwise. Strips hide stitches of no area; those are left out.
pub(super) fn of(corners: &[u32], mode: u64) -> Vec<[u32; 3]> {
    let is_stitch = |triangle: &[u32; 3]| {
        let [a, b, c] = *triangle;
        a == b || b == c || c == a
    };
    match mode {
        LIST => corners.as_chunks::<3>().0.to_vec(),
        STRIP => {
            let windows = corners.windows(3).enumerate();
            let turned =
                windows.map(|(number, v)| if number % 2 == 0 { [v[0], v[1], v[2]] } else { [v[0], v[2], v[1]] });
            turned.filter(|triangle| !is_stitch(triangle)).collect()
        }
        FAN => {
            let Some((&first, rest)) = corners.split_first() else { return Vec::new() };
            let around = rest.windows(2).map(|pair| [pair[0], pair[1], first]);
            around.filter(|triangle| !is_stitch(triangle)).collect()
        }
        _ => Vec::new(),
    }
}

/// The corners of a primitive, checked against its `vertices`.
pub(super) fn corners(edit: &Edit, primitive: &Value, vertices: usize, place: &str) -> Result<Vec<u32>, DecodeError> {
    let accessors = items(edit.json, "accessors").len();
    let Some(indices) = member_reference(primitive, "indices", "accessor", accessors, place)? else {
        return Ok((0..vertices as u32).collect());
    };
    let reader = edit.reader();
    let accessor = reader.accessor(indices)?;
    if accessor.width != 1 {
        return Err(malformed(place, "its indices are not scalars"));
    }
    let corners = reader.wholes(&accessor)?;
    match corners.iter().find(|&&corner| corner as usize >= vertices) {
        Some(&corner) => Err(super::json::out_of_range(place, "vertex", i64::from(corner), vertices)),
        None => Ok(corners),
    }
}

/// Turns every triangle of a primitive over: a mirroring transform turned it inside out.
pub(super) fn flip(edit: &mut Edit, mesh: usize, primitive: usize) -> Result<(), DecodeError> {
    let place = format!("mesh {mesh}, primitive {primitive}");
    let json = &edit.json["meshes"][mesh]["primitives"][primitive];
    let mode = mode(json, &place)?;
    if !has_triangles(mode) {
        return Ok(());
    }
    let position = json["attributes"].get("POSITION").and_then(index);
    let vertices = match position {
        Some(position) => edit.reader().accessor(position)?.count,
        None => return Ok(()),
    };
    let corners = corners(edit, json, vertices, &place)?;
    let given = json.get("indices").and_then(index);
    let flipped: Vec<u32> = of(&corners, mode).into_iter().flat_map(|[a, b, c]| [a, c, b]).collect();
    if let Some(given) = given.filter(|_| mode == LIST) {
        let accessor = edit.reader().accessor(given)?;
        if flipped.len() == accessor.count && edit.layouts.may_overwrite(given, &accessor, 1) {
            let layout = accessor.layout.as_ref().expect("an accessor that may be overwritten has bytes");
            for (element, corner) in flipped.iter().enumerate() {
                let bytes = &corner.to_le_bytes()[..layout.element_bytes];
                edit.binary[layout.element(element)].copy_from_slice(bytes);
            }
            return Ok(());
        }
    }
    let new = append_indices(edit, &flipped, vertices)?;
    if let Some(given) = given {
        edit.layouts.move_users(given, new, 1);
    }
    let json = &mut edit.json["meshes"][mesh]["primitives"][primitive];
    json["indices"] = json!(new);
    if mode != LIST {
        json["mode"] = json!(LIST);
    }
    Ok(())
}

fn append_indices(edit: &mut Edit, indices: &[u32], vertices: usize) -> Result<usize, DecodeError> {
    // The largest value of a type is kept for restarts.
    let component = if vertices < usize::from(u16::MAX) { Component::U16 } else { Component::U32 };
    let bytes: Vec<u8> =
        indices.iter().flat_map(|index| index.to_le_bytes().into_iter().take(component.bytes())).collect();
    edit.check_growth(bytes.len())?;
    let view = append_view(edit.json, edit.binary, &bytes);
    edit.json["bufferViews"][view]["target"] = json!(34963);
    let code = if component == Component::U16 { 5123 } else { 5125 };
    let accessor = json!({ "bufferView": view, "componentType": code, "count": indices.len(), "type": "SCALAR" });
    Ok(push(edit.json, "accessors", accessor))
}
