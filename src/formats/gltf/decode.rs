//! From bytes to an [`Asset`] whose document only lacks its skin.
//!
//! Reading ends with a document that is ready to be skinned: meshes in world space at the scene's root, no old rig, plain
//! geometry, one buffer. The mesh that is rigged is read from that document, so it is exactly the mesh that is returned.

use super::bake::{Edit, Frame, dequantise, mode, named};
use super::buffers::{Sources, embed_images, load};
use super::existing_rig::{self, OldJoints};
use super::json::{items, malformed, member_reference, parse};
use super::kept_skin::{self, KeptSkin};
use super::node_graph::{NodeGraph, check_count};
use super::references::{Kind, UsedBefore, remove_all};
use super::{Document, SkinnedPrimitive, animations, container, document, flatten, meshopt, triangles};
use crate::formats::soundness::check_counts;
use crate::formats::{
    Asset, Axes, Axis, Contents, DecodeError, DecodeOptions, EXISTING_RIG_REPLACED, ExistingRig, ExistingRigPolicy,
    Finding, Format, Limits, OldRig, Part, Severity, Siblings, Source,
};
use crate::mesh::Mesh;
use glam::{DMat4, DVec3};
use serde_json::Value;
use std::cell::Cell;
use std::collections::BTreeSet;

/// Reads a `.gltf` or `.glb` file.
pub fn decode(
    file_name: &str,
    bytes: &[u8],
    siblings: &dyn Siblings,
    limits: &Limits,
    options: &DecodeOptions,
) -> Result<Asset, DecodeError> {
    let container = container::split(bytes)?;
    let mut json = parse(container.json, limits)?;
    document::check(&json)?;
    check_list_lengths(&json, limits)?;
    let folder = file_name.rfind('/').map_or("", |slash| &file_name[..=slash]);
    let used = Cell::new(bytes.len() as u64);
    let sources = Sources { is_glb: container::is_glb(bytes), chunk: container.binary, siblings, folder, limits, used };
    let mut binary = load(&mut json, &sources)?;
    let mut findings = embed_images(&mut json, &mut binary, &sources, options)?;
    document::drop_draco(&mut json)?;
    let freed = meshopt::decompress(&mut json, &mut binary, limits)?;
    let used_before = UsedBefore::new(&mut json);
    let other_chunks = container.other_chunks.iter().map(|(kind, content)| (*kind, content.to_vec())).collect();

    let mut prepared = prepare(&mut json, &mut binary, limits, options)?;
    findings.append(&mut prepared.findings);
    compression_leaves(&mut json, &mut findings);
    used_before.remove_orphans(&mut json, &mut binary, freed);

    let format = if container::is_glb(bytes) { Format::Glb } else { Format::Gltf };
    let (mesh, parts, skinned) = read_mesh(&mut json, &mut binary, limits, &prepared.placed)?;
    let document = Document { json, binary, other_chunks, skinned, kept: prepared.kept, scenes: prepared.scenes };
    let axes = Some(Axes { up: Axis::PosY, front: Axis::PosZ });
    let source = Source::Gltf(Box::new(document));
    let Prepared { contents, existing_rig, old_rig, .. } = prepared;
    Ok(Asset { format, mesh, parts, axes, contents, existing_rig, old_rig, findings, source })
}

fn check_list_lengths(json: &Value, limits: &Limits) -> Result<(), DecodeError> {
    for what in ["materials", "textures", "images"] {
        check_count(what, items(json, what).len(), limits.materials_max)?;
    }
    Ok(())
}

/// A mesh on the node that will carry the skin.
struct Placed {
    node: usize,
    mesh: usize,
    /// In the uploaded document.
    source_mesh: usize,
}

struct Prepared {
    placed: Vec<Placed>,
    scenes: Vec<usize>,
    contents: Contents,
    existing_rig: Option<ExistingRig>,
    old_rig: Option<OldRig>,
    kept: Option<KeptSkin>,
    findings: Vec<Finding>,
}

/// Makes the document ready for a skin.
fn prepare(
    json: &mut Value,
    binary: &mut Vec<u8>,
    limits: &Limits,
    options: &DecodeOptions,
) -> Result<Prepared, DecodeError> {
    let graph = NodeGraph::new(json, limits)?;
    let old_joints = existing_rig::find(json)?;
    let existing_rig = old_joints.as_ref().map(|rig| ExistingRig { skins: rig.skins.len(), joints: rig.joints.len() });
    if let (Some(ExistingRig { skins, joints }), ExistingRigPolicy::Reject) = (existing_rig, options.existing_rig) {
        return Err(DecodeError::AlreadyRigged { skins, joints });
    }
    let shown = shown_meshes(json, &graph)?;
    check_declared(json, binary, limits, &shown)?;
    let contents = contents(json, &shown);
    let mut findings = Vec::new();
    tell_of_what_is_not_rigged(json, &graph, &shown, &mut findings);

    let edit = Edit::new(json, binary, limits);
    let mut evaluated = existing_rig::Evaluated::default();
    let frames: Vec<(Vec<Frame>, Vec<usize>)> = shown
        .iter()
        .map(|&(node, mesh)| existing_rig::frames(&edit, &graph, &mut evaluated, node, mesh))
        .collect::<Result<_, _>>()?;
    let (mut old_rig, mut kept) = (None, None);
    if let Some(old) = old_joints.as_ref().filter(|_| options.wants_old_rig()) {
        let (rig, skin) = kept_skin::read(&edit, &graph, old, &shown)?;
        old_rig = Some(rig);
        kept = (options.existing_rig == ExistingRigPolicy::Reskin).then_some(skin);
    }
    let kept_nodes: BTreeSet<usize> = kept.iter().flat_map(|kept| kept.nodes.iter().copied()).collect();
    match &old_joints {
        Some(_) => existing_rig::strip(edit.json),
        // Attributes without a skin mean nothing, and would stand beside ours.
        None => existing_rig::strip_influences(edit.json),
    }
    if old_joints.is_some() && kept.is_none() {
        findings.extend(existing_rig::strip_descriptions(edit.json));
    }
    let own = flatten::own_meshes(edit.json, &shown, limits)?;
    // Anew: strip and copies changed who uses what.
    let mut edit = Edit::new(json, binary, limits);
    for (&mesh, (frames, frame_of)) in own.iter().zip(&frames) {
        edit.bake(mesh, frames, frame_of)?;
    }
    dequantise(&mut edit)?;
    let moved = flatten::to_root(json, &graph, &shown, &kept_nodes);
    findings.extend(moved.findings);
    tell_of_changes(&shown, &own, &frames, &mut findings);
    let scenes: BTreeSet<usize> = shown.iter().flat_map(|&(node, _)| graph.scenes_of(node)).collect();
    let mut placed: Vec<Placed> = shown
        .iter()
        .zip(&own)
        .zip(&moved.nodes)
        .map(|((&(_, source_mesh), &mesh), &node)| Placed { node, mesh, source_mesh })
        .collect();
    if let Some(rig) = old_joints.as_ref().filter(|_| kept.is_none()) {
        findings.extend(remove_old_joints(json, &graph, rig, &mut placed));
    }
    flatten::make_scene_if_none(json);
    Ok(Prepared { placed, scenes: scenes.into_iter().collect(), contents, existing_rig, old_rig, kept, findings })
}

/// Nodes of the shown scene whose mesh has triangles, with that mesh.
fn shown_meshes(json: &Value, graph: &NodeGraph) -> Result<Vec<(usize, usize)>, DecodeError> {
    let meshes = items(json, "meshes");
    let mut shown = Vec::new();
    for (number, node) in items(json, "nodes").iter().enumerate() {
        let place = format!("node {number}");
        let Some(mesh) = member_reference(node, "mesh", "mesh", meshes.len(), &place)? else { continue };
        if !graph.is_shown(number) {
            continue;
        }
        const INSTANCING: &str = "EXT_mesh_gpu_instancing";
        if node.get("extensions").is_some_and(|all| all.get(INSTANCING).is_some()) {
            return Err(DecodeError::UnsupportedExtension { name: INSTANCING.into() });
        }
        let mut has_triangles = false;
        for (primitive, json) in items(&meshes[mesh], "primitives").iter().enumerate() {
            has_triangles |= triangles::has_triangles(mode(json, &format!("mesh {mesh}, primitive {primitive}"))?);
        }
        if has_triangles {
            shown.push((number, mesh));
        }
    }
    Ok(shown)
}

/// What the file holds before it is made ready.
fn contents(json: &Value, shown: &[(usize, usize)]) -> Contents {
    let meshes: BTreeSet<usize> = shown.iter().map(|&(_, mesh)| mesh).collect();
    // All primitives of a mesh have the same targets.
    let targets = |&mesh: &usize| {
        let primitives = items(&items(json, "meshes")[mesh], "primitives");
        primitives.iter().map(|primitive| items(primitive, "targets").len()).max().unwrap_or(0)
    };
    Contents {
        meshes: meshes.len(),
        animations: items(json, "animations").len(),
        morph_targets: meshes.iter().map(targets).sum(),
    }
}

/// Adds up what the accessors declare for all placed meshes, before any of it is read.
fn check_declared(
    json: &mut Value,
    binary: &mut Vec<u8>,
    limits: &Limits,
    shown: &[(usize, usize)],
) -> Result<(), DecodeError> {
    let edit = Edit::new(json, binary, limits);
    let reader = edit.reader();
    let accessors = items(edit.json, "accessors").len();
    let (mut vertices, mut faces) = (0_u64, 0_u64);
    for &(_, mesh) in shown {
        for (number, primitive) in items(&edit.json["meshes"][mesh], "primitives").iter().enumerate() {
            let place = format!("mesh {mesh}, primitive {number}");
            let count = |object: &Value, key: &str| {
                let accessor = member_reference(object, key, "accessor", accessors, &place)?;
                accessor.map(|accessor| reader.accessor(accessor)).transpose()
            };
            let Some(position) = count(&primitive["attributes"], "POSITION")? else {
                return Err(malformed(place, "it has no POSITION"));
            };
            if position.width != 3 || position.count == 0 {
                return Err(malformed(place, "its POSITION is empty or not VEC3"));
            }
            let corners = count(primitive, "indices")?.map_or(position.count, |indices| indices.count);
            vertices += position.count as u64;
            faces += triangles::count(mode(primitive, &place)?, corners) as u64;
            check_counts(vertices, faces, limits)?;
        }
    }
    Ok(())
}

fn tell_of_what_is_not_rigged(json: &Value, graph: &NodeGraph, shown: &[(usize, usize)], findings: &mut Vec<Finding>) {
    let nodes = items(json, "nodes");
    let hidden = (0..nodes.len()).filter(|&node| nodes[node].get("mesh").is_some() && !graph.is_shown(node)).count();
    if hidden > 0 {
        findings.push(Finding {
            code: "meshes_not_shown",
            parts: Vec::new(),
            severity: Severity::Info,
            message: format!("{hidden} mesh node(s) are not in the scene that is shown; they are kept, not rigged"),
            hint: "put them into the default scene to rig them".into(),
        });
    }
    let primitives = shown.iter().flat_map(|&(_, mesh)| items(&items(json, "meshes")[mesh], "primitives"));
    let thin = primitives.filter(|primitive| !triangles::has_triangles(mode(primitive, "").unwrap_or(4))).count();
    if thin > 0 {
        findings.push(Finding {
            code: "points_or_lines",
            parts: Vec::new(),
            severity: Severity::Info,
            message: format!("{thin} primitive(s) are points or lines; they follow the skeleton, but do not shape it"),
            hint: String::new(),
        });
    }
}

fn tell_of_changes(
    shown: &[(usize, usize)],
    own: &[usize],
    frames: &[(Vec<Frame>, Vec<usize>)],
    findings: &mut Vec<Finding>,
) {
    let copies = shown.iter().zip(own).filter(|((_, mesh), own)| mesh != *own).count();
    if copies > 0 {
        findings.push(Finding {
            code: "instances_duplicated",
            parts: Vec::new(),
            severity: Severity::Info,
            message: format!("{copies} node(s) shared a mesh with another and got a copy of their own"),
            hint: String::new(),
        });
    }
    let is_moved =
        |frames: &&(Vec<Frame>, Vec<usize>)| frames.0.iter().any(|frame| *frame != Frame::One(DMat4::IDENTITY));
    let moved = frames.iter().filter(is_moved).count();
    if moved > 0 {
        findings.push(Finding {
            code: "transforms_applied",
            parts: Vec::new(),
            severity: Severity::Info,
            message: format!("{moved} mesh node(s) had a transform, which is in their vertices now"),
            hint: String::new(),
        });
    }
}

/// Takes the old skeleton's nodes away, or leaves them where an extension may refer to nodes by number.
fn remove_old_joints(json: &mut Value, graph: &NodeGraph, rig: &OldJoints, placed: &mut [Placed]) -> Vec<Finding> {
    let removable = existing_rig::removable_nodes(json, graph, &rig.joints);
    let gone = |node: usize| removable.contains(&node) || rig.joints.contains(&node);
    let dropped = animations::rewrite(json, |node, path| {
        if path != "weights" && gone(node) { animations::Channel::Drop } else { animations::Channel::Keep }
    });
    let mut message =
        format!("the old rig of {} skin(s) and {} joint(s) was replaced", rig.skins.len(), rig.joints.len());
    if dropped > 0 {
        message += &format!("; {dropped} animation channel(s) of its joints went with it");
    }
    let is_understood = super::references::is_fully_understood(json);
    if is_understood {
        remove_nodes(json, &removable);
        for placed in placed {
            placed.node -= removable.range(..placed.node).count();
        }
    } else {
        message += "; its nodes stay, because an extension may refer to them";
    }
    vec![Finding {
        code: EXISTING_RIG_REPLACED,
        parts: Vec::new(),
        severity: Severity::Warning,
        message,
        hint: String::new(),
    }]
}

fn remove_nodes(json: &mut Value, removable: &BTreeSet<usize>) {
    let is_gone = |node: &Value| super::json::index(node).is_some_and(|node| removable.contains(&node));
    for (list, key) in [("scenes", "nodes"), ("nodes", "children")] {
        for holder in super::buffers::items_mut_if_any(json, list) {
            let Some(listed) = holder.get_mut(key).and_then(Value::as_array_mut) else { continue };
            listed.retain(|node| !is_gone(node));
            if listed.is_empty() {
                super::json::remove(holder, key);
            }
        }
    }
    remove_all(json, Kind::Node, removable);
}

/// Geometry is plain now, whatever it was.
fn compression_leaves(json: &mut Value, findings: &mut Vec<Finding>) {
    let is_used = |json: &Value, name: &str| items(json, "extensionsUsed").iter().any(|used| used == name);
    let names: Vec<&str> = ["KHR_mesh_quantization", "EXT_meshopt_compression", "KHR_meshopt_compression"]
        .into_iter()
        .filter(|name| is_used(json, name))
        .collect();
    names.iter().for_each(|name| document::remove_extension(json, name));
    if !names.is_empty() {
        findings.push(Finding {
            code: "geometry_decompressed",
            parts: Vec::new(),
            severity: Severity::Info,
            message: format!("the geometry was written without {}", names.join(" and ")),
            hint: "compress the result again if its size matters".into(),
        });
    }
}

type ReadMesh = (Mesh, Vec<Part>, Vec<SkinnedPrimitive>);

/// The mesh as the document holds it now.
fn read_mesh(
    json: &mut Value,
    binary: &mut Vec<u8>,
    limits: &Limits,
    placed: &[Placed],
) -> Result<ReadMesh, DecodeError> {
    let edit = Edit::new(json, binary, limits);
    let reader = edit.reader();
    let (mut mesh, mut parts, mut skinned) = (Mesh::default(), Vec::new(), Vec::new());
    for placed in placed {
        let mesh_json = &edit.json["meshes"][placed.mesh];
        let node_name = named(&edit.json["nodes"][placed.node], "node", placed.node);
        for (primitive, json) in items(mesh_json, "primitives").iter().enumerate() {
            let place = format!("mesh {}, primitive {primitive}", placed.source_mesh);
            let accessors = items(edit.json, "accessors").len();
            let position = member_reference(&json["attributes"], "POSITION", "accessor", accessors, &place)?;
            let Some(position) = position else { return Err(malformed(place, "it has no POSITION")) };
            let positions = reader.vectors::<3>(position)?;
            let start = mesh.positions.len();
            let corners = triangles::corners(&edit, json, positions.len(), &place)?;
            let to_row = |corner: u32| corner + start as u32;
            mesh.triangles.extend(triangles::of(&corners, mode(json, &place)?).into_iter().map(|t| t.map(to_row)));
            mesh.positions.extend(positions.into_iter().map(|point| DVec3::from_array(point.map(f64::from))));
            let vertices = start..mesh.positions.len();
            parts.push(Part {
                name: node_name.clone(),
                mesh: placed.source_mesh,
                primitive,
                vertices: vertices.clone(),
            });
            let rows = vertices.map(|row| row as u32).collect();
            skinned.push(SkinnedPrimitive { node: placed.node, mesh: placed.mesh, primitive, rows });
        }
    }
    Ok((mesh, parts, skinned))
}
