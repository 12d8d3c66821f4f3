//! Which accessors may be overwritten where they lie: those whose bytes nothing else reads.

use super::accessors::{Accessor, Layout, Reader, view_range};
use super::json::{index, items};
use super::references::{self, Kind};
use crate::formats::Limits;
use serde_json::Value;
use std::collections::BTreeMap;
use std::ops::Range;

/// Above this many accessors nothing is overwritten: looking for overlaps would take too long.
const ACCESSORS_MAX: usize = 10_000;

/// Users and places of every accessor of a document that is being changed.
pub(super) struct Layouts {
    users: BTreeMap<usize, usize>,
    /// Of the accessors that came with the document; new ones have bytes of their own. `None`: overwrite nothing.
    layouts: Option<Vec<Option<Layout>>>,
    images: Vec<Range<usize>>,
}

impl Layouts {
    pub(super) fn new(json: &mut Value, binary: &[u8], limits: &Limits) -> Self {
        let users = references::counts(json, Kind::Accessor);
        let reader = Reader { json, binary, limits };
        let count = items(json, "accessors").len();
        // A sparse accessor keeps more bytes than its layout tells.
        let layout = |number: usize| {
            let accessor = reader.accessor(number).ok()?;
            (!accessor.is_sparse()).then_some(accessor.layout)
        };
        let layouts = (count <= ACCESSORS_MAX).then(|| (0..count).map(layout).collect()).flatten();
        let view_of = |image: &Value| {
            let view = image.get("bufferView").and_then(index)?;
            view_range(items(json, "bufferViews").get(view)?, view, binary.len()).ok()
        };
        let images = items(json, "images").iter().filter_map(view_of).collect();
        Self { users, layouts, images }
    }

    /// True when `users` references are all there are, and no other accessor or image lies on the same bytes.
    pub(super) fn may_overwrite(&self, number: usize, accessor: &Accessor, users: usize) -> bool {
        let (Some(layout), Some(layouts)) = (&accessor.layout, &self.layouts) else { return false };
        let range = layout.range();
        !accessor.is_sparse()
            && self.users.get(&number) == Some(&users)
            && !self.images.iter().any(|image| image.start < range.end && range.start < image.end)
            && layouts
                .iter()
                .enumerate()
                .filter(|(other, _)| *other != number)
                .all(|(_, other)| other.as_ref().is_none_or(|other| !overlap(layout, other)))
    }

    pub(super) fn move_users(&mut self, from: usize, to: usize, users: usize) {
        if let Some(count) = self.users.get_mut(&from) {
            *count = count.saturating_sub(users);
        }
        self.users.insert(to, users);
    }
}

/// Whether two accessors share a byte. Interleaved ones share a range, but not a byte.
fn overlap(a: &Layout, b: &Layout) -> bool {
    let (first, second) = (a.range(), b.range());
    if first.start >= second.end || second.start >= first.end {
        return false;
    }
    if a.stride != b.stride || a.stride == 0 {
        return true;
    }
    let shift = (b.start + a.stride - a.start % a.stride) % a.stride;
    !(shift >= a.element_bytes && shift + b.element_bytes <= a.stride)
}
