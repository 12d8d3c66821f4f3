//! Which things of a document refer to which by index; counting, and removing what our edits left without a user.
//!
//! What nothing used in the upload stays: it is the sender's. Indices may only be counted anew when every extension in
//! use is known to hold none that this module does not visit ([`is_fully_understood`]).

use super::buffers::{ALIGNMENT, items_mut_if_any, set_buffer_length};
use super::json::{index, items};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    Accessor,
    BufferView,
    Node,
}

impl Kind {
    fn list(self) -> &'static str {
        match self {
            Self::Accessor => "accessors",
            Self::BufferView => "bufferViews",
            Self::Node => "nodes",
        }
    }
}

/// Extensions, by the start of their names, that refer to nothing but textures, or are handled here.
const UNDERSTOOD: &[&str] = &[
    "KHR_materials_",
    "VRMC_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "EXT_materials_",
    "MSFT_texture_",
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "EXT_meshopt_compression",
    "EXT_mesh_gpu_instancing",
    "KHR_draco_mesh_compression",
    "KHR_node_visibility",
    "KHR_xmp",
    "FB_ngon_encoding",
];

pub(super) fn is_fully_understood(json: &Value) -> bool {
    let is_known = |name: &str| UNDERSTOOD.iter().any(|start| name.starts_with(start));
    items(json, "extensionsUsed").iter().filter_map(Value::as_str).all(is_known)
}

/// Calls `visit` for every reference of one kind.
pub(super) fn visit(json: &mut Value, kind: Kind, visit: &mut dyn FnMut(&mut Value)) {
    match kind {
        Kind::Accessor => visit_accessors(json, visit),
        Kind::BufferView => visit_views(json, visit),
        Kind::Node => visit_nodes(json, visit),
    }
}

fn visit_accessors(json: &mut Value, visit: &mut dyn FnMut(&mut Value)) {
    for mesh in items_mut_if_any(json, "meshes") {
        for primitive in items_mut_if_any(mesh, "primitives") {
            members(primitive.get_mut("attributes"), visit);
            member(primitive, "indices", visit);
            items_mut_if_any(primitive, "targets").iter_mut().for_each(|target| members(Some(target), visit));
        }
    }
    for skin in items_mut_if_any(json, "skins") {
        member(skin, "inverseBindMatrices", visit);
    }
    for animation in items_mut_if_any(json, "animations") {
        for sampler in items_mut_if_any(animation, "samplers") {
            member(sampler, "input", visit);
            member(sampler, "output", visit);
        }
    }
    for node in items_mut_if_any(json, "nodes") {
        let instancing = node.get_mut("extensions").and_then(|all| all.get_mut("EXT_mesh_gpu_instancing"));
        members(instancing.and_then(|instancing| instancing.get_mut("attributes")), visit);
    }
}

fn visit_views(json: &mut Value, visit: &mut dyn FnMut(&mut Value)) {
    for accessor in items_mut_if_any(json, "accessors") {
        member(accessor, "bufferView", visit);
        if let Some(sparse) = accessor.get_mut("sparse") {
            for part in ["indices", "values"] {
                if let Some(part) = sparse.get_mut(part) {
                    member(part, "bufferView", visit);
                }
            }
        }
    }
    for image in items_mut_if_any(json, "images") {
        member(image, "bufferView", visit);
    }
}

fn visit_nodes(json: &mut Value, visit: &mut dyn FnMut(&mut Value)) {
    for scene in items_mut_if_any(json, "scenes") {
        items_mut_if_any(scene, "nodes").iter_mut().for_each(&mut *visit);
    }
    for node in items_mut_if_any(json, "nodes") {
        items_mut_if_any(node, "children").iter_mut().for_each(&mut *visit);
    }
    for skin in items_mut_if_any(json, "skins") {
        member(skin, "skeleton", visit);
        items_mut_if_any(skin, "joints").iter_mut().for_each(&mut *visit);
    }
    for animation in items_mut_if_any(json, "animations") {
        for channel in items_mut_if_any(animation, "channels") {
            if let Some(target) = channel.get_mut("target") {
                member(target, "node", visit);
            }
        }
    }
}

fn member(object: &mut Value, key: &str, visit: &mut dyn FnMut(&mut Value)) {
    if let Some(value) = object.get_mut(key) {
        visit(value);
    }
}

fn members(object: Option<&mut Value>, visit: &mut dyn FnMut(&mut Value)) {
    if let Some(object) = object.and_then(Value::as_object_mut) {
        object.values_mut().for_each(visit);
    }
}

/// How often each thing of a kind is referred to.
pub(super) fn counts(json: &mut Value, kind: Kind) -> BTreeMap<usize, usize> {
    let mut counts = BTreeMap::new();
    visit(json, kind, &mut |reference| {
        if let Some(index) = index(reference) {
            *counts.entry(index).or_insert(0) += 1;
        }
    });
    counts
}

/// Removes elements of a list and counts the references to the others anew.
pub(super) fn remove_all(json: &mut Value, kind: Kind, removed: &BTreeSet<usize>) {
    if removed.is_empty() {
        return;
    }
    let mut below = 0;
    let renumbered: Vec<usize> = (0..items(json, kind.list()).len())
        .map(|index| {
            below += usize::from(removed.contains(&index));
            index.saturating_sub(below)
        })
        .collect();
    visit(json, kind, &mut |reference| {
        if let Some(new) = index(reference).and_then(|old| renumbered.get(old)) {
            *reference = json!(new);
        }
    });
    let mut position = 0..;
    if let Some(list) = json.get_mut(kind.list()).and_then(Value::as_array_mut) {
        list.retain(|_| position.next().is_none_or(|index| !removed.contains(&index)));
    }
}

/// What the upload used, to be compared with what is used after our edits.
#[derive(Debug)]
pub(super) struct UsedBefore {
    accessors: BTreeSet<usize>,
    views: BTreeSet<usize>,
    accessor_count: usize,
    view_count: usize,
}

impl UsedBefore {
    pub(super) fn new(json: &mut Value) -> Self {
        Self {
            accessors: counts(json, Kind::Accessor).into_keys().collect(),
            views: counts(json, Kind::BufferView).into_keys().collect(),
            accessor_count: items(json, "accessors").len(),
            view_count: items(json, "bufferViews").len(),
        }
    }

    /// Removes accessors and views that lost their last user, and the bytes that no view shows any more.
    pub(super) fn remove_orphans(&self, json: &mut Value, binary: &mut Vec<u8>, mut freed: Vec<Range<usize>>) {
        if is_fully_understood(json) {
            let orphans = orphans(json, Kind::Accessor, &self.accessors, self.accessor_count);
            remove_all(json, Kind::Accessor, &orphans);
            let orphans = orphans_of_views(json, self);
            let views = items(json, "bufferViews");
            freed.extend(
                orphans
                    .iter()
                    .filter_map(|&view| super::accessors::view_range(views.get(view)?, view, binary.len()).ok()),
            );
            remove_all(json, Kind::BufferView, &orphans);
        }
        compact(json, binary, freed);
    }
}

/// Things that were used, or are new, and have no user now.
fn orphans(json: &mut Value, kind: Kind, used_before: &BTreeSet<usize>, count_before: usize) -> BTreeSet<usize> {
    let now = counts(json, kind);
    let count = items(json, kind.list()).len();
    (0..count)
        .filter(|index| !now.contains_key(index) && (used_before.contains(index) || *index >= count_before))
        .collect()
}

fn orphans_of_views(json: &mut Value, before: &UsedBefore) -> BTreeSet<usize> {
    orphans(json, Kind::BufferView, &before.views, before.view_count)
}

/// Cuts `freed` ranges out of the buffer where no view needs them, in steps of the alignment.
fn compact(json: &mut Value, binary: &mut Vec<u8>, freed: Vec<Range<usize>>) {
    let views = items(json, "bufferViews").iter().enumerate();
    let live: Result<Vec<Range<usize>>, _> =
        views.map(|(number, view)| super::accessors::view_range(view, number, binary.len())).collect();
    let Ok(live) = live else { return };
    // What fills a freed range up to the alignment goes with it.
    let padded = |range: Range<usize>| range.start..range.end.next_multiple_of(ALIGNMENT).min(binary.len());
    let cuts = without(merged(freed.into_iter().map(padded).collect()), &merged(live));
    if cuts.is_empty() {
        return;
    }
    let mut kept = Vec::with_capacity(binary.len());
    let mut from = 0;
    // Ends of cuts, with what is cut away up to there.
    let mut removed_at = Vec::with_capacity(cuts.len());
    let mut removed = 0;
    for cut in &cuts {
        kept.extend_from_slice(&binary[from..cut.start]);
        from = cut.end;
        removed += cut.len();
        removed_at.push((cut.end, removed));
    }
    kept.extend_from_slice(&binary[from..]);
    for view in items_mut_if_any(json, "bufferViews") {
        let offset = view.get("byteOffset").and_then(index).unwrap_or(0);
        let cuts_before = removed_at.partition_point(|(end, _)| *end <= offset);
        if cuts_before > 0 {
            view["byteOffset"] = json!(offset - removed_at[cuts_before - 1].1);
        }
    }
    *binary = kept;
    set_buffer_length(json, binary.len());
}

/// Sorted, apart from each other, none empty.
fn merged(mut ranges: Vec<Range<usize>>) -> Vec<Range<usize>> {
    ranges.retain(|range| !range.is_empty());
    ranges.sort_by_key(|range| (range.start, range.end));
    let mut merged: Vec<Range<usize>> = Vec::with_capacity(ranges.len());
    for range in ranges {
        match merged.last_mut() {
            Some(last) if range.start <= last.end => last.end = last.end.max(range.end),
            _ => merged.push(range),
        }
    }
    merged
}

/// `ranges` without `kept`, both merged; shrunk to the alignment.
fn without(ranges: Vec<Range<usize>>, kept: &[Range<usize>]) -> Vec<Range<usize>> {
    let mut rest = Vec::with_capacity(ranges.len());
    for range in ranges {
        let mut from = range.start;
        let first = kept.partition_point(|kept| kept.end <= range.start);
        for kept in kept[first..].iter().take_while(|kept| kept.start < range.end) {
            rest.push(from..kept.start.max(from));
            from = kept.end;
        }
        rest.push(from..range.end.max(from));
    }
    let aligned = |range: Range<usize>| range.start.next_multiple_of(ALIGNMENT)..range.end / ALIGNMENT * ALIGNMENT;
    rest.into_iter().map(aligned).filter(|range| !range.is_empty()).collect()
}
