//! Typed reading of accessors: every component type, stride and sparse form, checked before memory is spent.
//! glTF 2.0 specification, sections 3.6.2 (accessors), 3.11 (normalized integers), 5.1 (accessor properties).

use super::container::truncated;
use super::json::{items, malformed, member_reference, number, reference, text};
use crate::formats::{DecodeError, Limits};
use serde_json::Value;
use std::ops::Range;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn of(code: u64) -> Option<Self> {
        Some(match code {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return None,
        })
    }

    pub(super) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// `bytes` holds exactly one component.
    fn float(self, bytes: &[u8], normalized: bool) -> f32 {
        let scaled = |value: f32, largest: f32| if normalized { (value / largest).max(-1.0) } else { value };
        match *bytes {
            [byte] if self == Self::I8 => scaled(f32::from(byte as i8), 127.0),
            [byte] => scaled(f32::from(byte), 255.0),
            [low, high] if self == Self::I16 => scaled(f32::from(i16::from_le_bytes([low, high])), 32767.0),
            [low, high] => scaled(f32::from(u16::from_le_bytes([low, high])), 65535.0),
            [a, b, c, d] if self == Self::F32 => f32::from_le_bytes([a, b, c, d]),
            [a, b, c, d] => scaled(u32::from_le_bytes([a, b, c, d]) as f32, u32::MAX as f32),
            _ => 0.0,
        }
    }

    fn whole(bytes: &[u8]) -> u32 {
        bytes.iter().rev().fold(0, |sum, &byte| (sum << 8) | u32::from(byte))
    }
}

/// Where an accessor's elements lie in the document's one buffer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    pub(super) start: usize,
    pub(super) stride: usize,
    pub(super) element_bytes: usize,
    pub(super) count: usize,
}

impl Layout {
    pub(super) fn element(&self, index: usize) -> Range<usize> {
        let start = self.start + index * self.stride;
        start..start + self.element_bytes
    }

    pub(super) fn range(&self) -> Range<usize> {
        self.start..self.start + self.count.saturating_sub(1) * self.stride + self.element_bytes
    }
}

/// Replaced elements of a sparse accessor.
#[derive(Debug)]
struct Sparse {
    indices: Layout,
    values: Layout,
}

/// One accessor, its ranges checked against its buffer view.
#[derive(Debug)]
pub(super) struct Accessor {
    pub(super) component: Component,
    /// Components per element: 3 for VEC3.
    pub(super) width: usize,
    pub(super) count: usize,
    pub(super) normalized: bool,
    /// `None`: zeros.
    pub(super) layout: Option<Layout>,
    sparse: Option<Sparse>,
    place: String,
}

/// Reads accessors of a document whose buffers are merged into one.
#[derive(Clone, Copy)]
pub(super) struct Reader<'a> {
    pub(super) json: &'a Value,
    pub(super) binary: &'a [u8],
    pub(super) limits: &'a Limits,
}

impl Reader<'_> {
    pub(super) fn accessor(&self, index: usize) -> Result<Accessor, DecodeError> {
        let place = format!("accessor {index}");
        let list = items(self.json, "accessors");
        let Some(json) = list.get(index) else {
            return Err(super::json::out_of_range(&place, "accessor", index as i64, list.len()));
        };
        let component = component(json, &place)?;
        let width = match text(json, "type") {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" | "MAT2" => 4,
            "MAT3" => 9,
            "MAT4" => 16,
            other => return Err(malformed(place, format!("unknown type {other:?}"))),
        };
        let declared = number(json, "count", &place)?.ok_or_else(|| malformed(&place, "no count"))?;
        let count = usize::try_from(declared).map_err(|_| malformed(&place, "the count is too large"))?;
        let offset = number(json, "byteOffset", &place)?.unwrap_or(0);
        let layout = self.layout(json, offset, component.bytes() * width, count, &place)?;
        let count_max = self.limits.vertices_max.max(self.limits.faces_max.saturating_mul(3));
        if layout.is_none() && count > count_max {
            // Nothing but the count says how large this is.
            return Err(DecodeError::TooManyVertices { found: declared, limit: self.limits.vertices_max as u64 });
        }
        let sparse =
            json.get("sparse").map(|sparse| self.sparse(sparse, component, width, count, &place)).transpose()?;
        let normalized = json.get("normalized").and_then(Value::as_bool).unwrap_or(false);
        Ok(Accessor { component, width, count, normalized, layout, sparse, place })
    }

    /// The elements that `holder.bufferView` holds; `None` without a buffer view.
    fn layout(
        &self,
        holder: &Value,
        offset: u64,
        element_bytes: usize,
        count: usize,
        place: &str,
    ) -> Result<Option<Layout>, DecodeError> {
        let views = items(self.json, "bufferViews");
        let Some(view) = member_reference(holder, "bufferView", "buffer view", views.len(), place)? else {
            return Ok(None);
        };
        let range = view_range(&views[view], view, self.binary.len())?;
        let stride = match number(&views[view], "byteStride", &format!("buffer view {view}"))? {
            None | Some(0) => element_bytes as u64,
            Some(stride) if stride < element_bytes as u64 => {
                return Err(malformed(place, format!("its stride of {stride} is below its size of {element_bytes}")));
            }
            Some(stride) => stride,
        };
        let needed = (count as u64)
            .checked_sub(1)
            .map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(element_bytes as u64))
            .and_then(|bytes| bytes.checked_add(offset));
        match needed {
            Some(needed) if needed <= range.len() as u64 => {
                Ok(Some(Layout { start: range.start + offset as usize, stride: stride as usize, element_bytes, count }))
            }
            needed => Err(truncated(place, needed.unwrap_or(u64::MAX), range.len() as u64)),
        }
    }

    fn sparse(
        &self,
        json: &Value,
        component: Component,
        width: usize,
        count: usize,
        place: &str,
    ) -> Result<Sparse, DecodeError> {
        let replaced = number(json, "count", place)?.ok_or_else(|| malformed(place, "sparse without a count"))?;
        if replaced > count as u64 {
            return Err(malformed(place, format!("{replaced} sparse elements of {count}")));
        }
        let part = |key: &str, bytes: Option<usize>| {
            let part = json.get(key).ok_or_else(|| malformed(place, format!("sparse without {key}")))?;
            let bytes = match bytes {
                Some(bytes) => bytes,
                None => self::component(part, place)?.bytes(),
            };
            let offset = number(part, "byteOffset", place)?.unwrap_or(0);
            self.layout(part, offset, bytes, replaced as usize, place)?
                .ok_or_else(|| malformed(place, format!("sparse {key} without a buffer view")))
        };
        Ok(Sparse { indices: part("indices", None)?, values: part("values", Some(component.bytes() * width))? })
    }

    /// All components in order `[count × width]`; normalized integers as the numbers they stand for.
    pub(super) fn floats(&self, accessor: &Accessor) -> Result<Vec<f32>, DecodeError> {
        let size = accessor.component.bytes();
        let convert = |bytes: &[u8]| accessor.component.float(bytes, accessor.normalized);
        self.components(accessor, size, 0.0, convert)
    }

    /// All components of an unsigned integer accessor in order.
    pub(super) fn wholes(&self, accessor: &Accessor) -> Result<Vec<u32>, DecodeError> {
        if !matches!(accessor.component, Component::U8 | Component::U16 | Component::U32) {
            return Err(malformed(&accessor.place, "its components are not unsigned integers"));
        }
        self.components(accessor, accessor.component.bytes(), 0, Component::whole)
    }

    fn components<T: Copy>(
        &self,
        accessor: &Accessor,
        size: usize,
        zero: T,
        convert: impl Fn(&[u8]) -> T,
    ) -> Result<Vec<T>, DecodeError> {
        let width = accessor.width;
        let mut values = Vec::with_capacity(accessor.count * width);
        match &accessor.layout {
            None => values.resize(accessor.count * width, zero),
            Some(layout) => {
                for element in 0..accessor.count {
                    values.extend(self.binary[layout.element(element)].chunks_exact(size).map(&convert));
                }
            }
        }
        if let Some(Sparse { indices, values: replacements }) = &accessor.sparse {
            for replaced in 0..indices.count {
                let element = Component::whole(&self.binary[indices.element(replaced)]) as usize;
                let Some(row) = values.get_mut(element * width..(element + 1) * width) else {
                    let place = format!("{}, sparse indices", accessor.place);
                    return Err(super::json::out_of_range(&place, "element", element as i64, accessor.count));
                };
                let bytes = &self.binary[replacements.element(replaced)];
                row.iter_mut().zip(bytes.chunks_exact(size)).for_each(|(value, bytes)| *value = convert(bytes));
            }
        }
        Ok(values)
    }

    /// A float accessor of `N`-component elements.
    pub(super) fn vectors<const N: usize>(&self, index: usize) -> Result<Vec<[f32; N]>, DecodeError> {
        let accessor = self.accessor(index)?;
        if accessor.width != N {
            return Err(malformed(format!("accessor {index}"), format!("its elements do not have {N} components")));
        }
        let floats = self.floats(&accessor)?;
        Ok(floats.as_chunks::<N>().0.to_vec())
    }
}

impl Accessor {
    pub(super) fn is_sparse(&self) -> bool {
        self.sparse.is_some()
    }
}

fn component(json: &Value, place: &str) -> Result<Component, DecodeError> {
    let code = number(json, "componentType", place)?.ok_or_else(|| malformed(place, "no componentType"))?;
    Component::of(code).ok_or_else(|| malformed(place, format!("unknown componentType {code}")))
}

/// The bytes of a buffer view in the document's one buffer.
pub(super) fn view_range(view: &Value, index: usize, available: usize) -> Result<Range<usize>, DecodeError> {
    let place = format!("buffer view {index}");
    let buffer = view.get("buffer").ok_or_else(|| malformed(&place, "no buffer"))?;
    reference(buffer, "buffer", 1, &place)?;
    let start = number(view, "byteOffset", &place)?.unwrap_or(0);
    let length = number(view, "byteLength", &place)?.ok_or_else(|| malformed(&place, "no byteLength"))?;
    match start.checked_add(length) {
        Some(end) if end <= available as u64 => Ok(start as usize..end as usize),
        end => Err(truncated(&place, end.unwrap_or(u64::MAX), available as u64)),
    }
}
