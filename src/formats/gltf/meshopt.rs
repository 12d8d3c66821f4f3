//! Buffer views compressed with `EXT_meshopt_compression` or `KHR_meshopt_compression` become plain ones.
//!
//! The output is uncompressed, so both extensions leave the document's lists. The compressed bytes are returned as free.

use super::buffers::{append_view, items_mut_if_any};
use super::json::{items, malformed, number, remove, text};
use crate::formats::{DecodeError, Limits};
use serde_json::Value;
use std::ops::Range;

pub(super) const EXTENSIONS: &[&str] = &["EXT_meshopt_compression", "KHR_meshopt_compression"];

/// Largest vertex that the codec knows.
const STRIDE_MAX: u64 = 256;

pub(super) fn is_fallback(buffer: &Value) -> bool {
    let is_marked = |extension: &&str| buffer["extensions"][*extension]["fallback"] == Value::Bool(true);
    EXTENSIONS.iter().any(is_marked)
}

/// Decompresses every compressed view; returns the ranges of the buffer that nothing needs any more.
pub(super) fn decompress(
    json: &mut Value,
    binary: &mut Vec<u8>,
    limits: &Limits,
) -> Result<Vec<Range<usize>>, DecodeError> {
    let mut freed = Vec::new();
    for view in 0..items(json, "bufferViews").len() {
        let extensions = &json["bufferViews"][view]["extensions"];
        let Some(extension) = EXTENSIONS.iter().find(|name| extensions.get(**name).is_some()) else { continue };
        let compressed = &extensions[*extension];
        let range = super::accessors::view_range(compressed, view, binary.len())?;
        let plain = decode(compressed, &binary[range.clone()], binary.len() as u64, view, limits)?;
        freed.push(range);
        // The new view takes over the place of the old one in the list.
        let appended = append_view(json, binary, &plain);
        let views = json["bufferViews"].as_array_mut().expect("a list of views");
        let location = views.remove(appended);
        let target = &mut views[view];
        for key in ["buffer", "byteOffset", "byteLength"] {
            target[key] = location[key].clone();
        }
        remove(&mut target["extensions"], extension);
        if target["extensions"].as_object().is_some_and(|all| all.is_empty()) {
            remove(target, "extensions");
        }
    }
    for buffer in items_mut_if_any(json, "buffers") {
        remove(buffer, "extensions");
    }
    Ok(freed)
}

fn decode(json: &Value, bytes: &[u8], held: u64, view: usize, limits: &Limits) -> Result<Vec<u8>, DecodeError> {
    let place = format!("buffer view {view}, meshopt data");
    let required = |key: &str| number(json, key, &place)?.ok_or_else(|| malformed(&place, format!("no {key}")));
    let (count, stride) = (required("count")?, required("byteStride")?);
    if stride == 0 || stride > STRIDE_MAX {
        return Err(malformed(place, format!("a stride of {stride}")));
    }
    let total = count.saturating_mul(stride).saturating_add(held);
    // Unpacked data may take four times what a plain upload may: compression is what makes large meshes small.
    let limit = limits.bytes_max.saturating_mul(4);
    if total > limit {
        return Err(DecodeError::TooLarge { what: "the unpacked meshopt data".into(), found: total, limit });
    }
    let (count, stride) = (count as usize, stride as usize);
    let failed = |_| malformed(&place, "the compressed bytes are damaged");
    let mut plain = match (text(json, "mode"), stride) {
        ("ATTRIBUTES", stride) if stride % 4 == 0 => decode_vertices(bytes, count, stride).ok_or(()).map_err(failed)?,
        ("TRIANGLES", 2 | 4) if count % 3 != 0 => return Err(malformed(place, "triangles of two corners")),
        ("TRIANGLES", 2) => le_u16(&meshopt::decode_index_buffer(bytes, count).map_err(|_| ()).map_err(failed)?),
        ("TRIANGLES", 4) => le_u32(&meshopt::decode_index_buffer(bytes, count).map_err(|_| ()).map_err(failed)?),
        ("INDICES", 2) => le_u16(&meshopt::decode_index_sequence(bytes, count).map_err(|_| ()).map_err(failed)?),
        ("INDICES", 4) => le_u32(&meshopt::decode_index_sequence(bytes, count).map_err(|_| ()).map_err(failed)?),
        (mode, stride) => return Err(malformed(place, format!("mode {mode:?} with a stride of {stride}"))),
    };
    filter(text(json, "filter"), stride, &mut plain).ok_or_else(|| malformed(place, "its filter does not fit"))?;
    Ok(plain)
}

/// The codec's binding wants the vertex as a type; strides are multiples of four up to 256.
fn decode_vertices(bytes: &[u8], count: usize, stride: usize) -> Option<Vec<u8>> {
    macro_rules! by_words {
        ($($words:literal),*) => {
            match stride / 4 {
                $($words => {
                    let rows = meshopt::decode_vertex_buffer::<Words<$words>>(bytes, count).ok()?;
                    Some(rows.iter().flat_map(|row| row.0.iter().flat_map(|word| word.to_ne_bytes())).collect())
                })*
                _ => None,
            }
        };
    }
    by_words!(
        1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30,
        31, 32, 33, 34, 35, 36, 37, 38, 39, 40, 41, 42, 43, 44, 45, 46, 47, 48, 49, 50, 51, 52, 53, 54, 55, 56, 57, 58,
        59, 60, 61, 62, 63, 64
    )
}

/// A vertex of N words; the codec writes its bytes in memory order.
#[derive(Clone, Copy)]
#[repr(transparent)]
struct Words<const N: usize>([u32; N]);

impl<const N: usize> Default for Words<N> {
    fn default() -> Self {
        Self([0; N])
    }
}

fn le_u16(values: &[u16]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn le_u32(values: &[u32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// Undoes the filter that made the data compress better. `None` when it does not fit the stride.
fn filter(name: &str, stride: usize, bytes: &mut [u8]) -> Option<()> {
    match (name, stride) {
        ("" | "NONE", _) => {}
        ("OCTAHEDRAL", 4) => {
            let mut rows: Vec<[i8; 4]> = bytes.as_chunks::<4>().0.iter().map(|row| row.map(|b| b as i8)).collect();
            meshopt::decode_filter_oct(&mut rows);
            write_back(bytes, rows.iter().flatten().map(|value| value.to_le_bytes()));
        }
        ("OCTAHEDRAL", 8) => {
            let mut rows = rows_of_i16(bytes);
            meshopt::decode_filter_oct(&mut rows);
            write_back(bytes, rows.iter().flatten().map(|value| value.to_le_bytes()));
        }
        ("QUATERNION", 8) => {
            let mut rows = rows_of_i16(bytes);
            meshopt::decode_filter_quat(&mut rows);
            write_back(bytes, rows.iter().flatten().map(|value| value.to_le_bytes()));
        }
        ("EXPONENTIAL", stride) if stride % 4 == 0 => {
            let mut rows: Vec<[u32; 1]> =
                bytes.as_chunks::<4>().0.iter().map(|row| [u32::from_le_bytes(*row)]).collect();
            meshopt::decode_filter_exp(&mut rows);
            write_back(bytes, rows.iter().flatten().map(|value| value.to_le_bytes()));
        }
        ("COLOR", 4) => {
            let mut rows: Vec<[u8; 4]> = bytes.as_chunks::<4>().0.to_vec();
            meshopt::decode_filter_color(&mut rows);
            write_back(bytes, rows.iter().flatten().map(|value| value.to_le_bytes()));
        }
        ("COLOR", 8) => {
            let mut rows: Vec<[u16; 4]> = rows_of_i16(bytes).iter().map(|row| row.map(|value| value as u16)).collect();
            meshopt::decode_filter_color(&mut rows);
            write_back(bytes, rows.iter().flatten().map(|value| value.to_le_bytes()));
        }
        _ => return None,
    }
    Some(())
}

fn rows_of_i16(bytes: &[u8]) -> Vec<[i16; 4]> {
    let words = bytes.as_chunks::<8>().0.iter();
    words.map(|row| [0, 1, 2, 3].map(|i| i16::from_le_bytes([row[2 * i], row[2 * i + 1]]))).collect()
}

fn write_back<const N: usize>(bytes: &mut [u8], values: impl Iterator<Item = [u8; N]>) {
    for (target, value) in bytes.as_chunks_mut::<N>().0.iter_mut().zip(values) {
        *target = value;
    }
}
