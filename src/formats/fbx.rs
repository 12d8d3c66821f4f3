//! FBX, binary and ASCII, read by `ufbx`.
//!
//! Upload space of an FBX is its world space in glTF's convention: metres, y up, as the file's own axes and unit say.
//! Every node with a mesh is a part: its control points in file order, with all transforms applied; a mirrored node
//! keeps its outside by turned faces. Animations and morph targets are not read, which a finding says. A texture that is neither embedded nor sent is a finding,
//! not a refusal: FBX files name paths of the machine they were made on as a matter of course.
//!
//! `ufbx` is C. It gets the whole file in memory, opens nothing, and works under a memory limit, with out-of-range
//! indices refused instead of clamped.

use super::fbx_materials::Materials;
use super::fbx_skeleton::{FbxSkeleton, posed};
use super::scene::linear_from_srgb;
use super::scene_builder::{Attributes, Corner, NONE, SceneBuilder};
use super::soundness::{check_counts, check_position};
use super::{
    Asset, Axes, Axis, Contents, DecodeError, DecodeOptions, ExistingRig, ExistingRigPolicy, Finding, Format, Limits,
    Part, Place, Severity, Siblings, Source,
};
use crate::mesh::Mesh;
use glam::{DMat3, DMat4, DVec3, Vec3};
use ufbx::{CoordinateAxes, CoordinateAxis, ErrorType, IndexErrorHandling, LoadOpts};

pub(super) const FORMAT: &str = "FBX";

/// glTF's axes: x right, y up, z to the viewer.
const GLTF_AXES: CoordinateAxes = CoordinateAxes {
    right: CoordinateAxis::PositiveX,
    up: CoordinateAxis::PositiveY,
    front: CoordinateAxis::PositiveZ,
};

/// Reads an FBX file.
pub fn decode(
    _file_name: &str,
    bytes: &[u8],
    siblings: &dyn Siblings,
    limits: &Limits,
    options: &DecodeOptions,
) -> Result<Asset, DecodeError> {
    let root = load(bytes, limits)?;
    let scene: &ufbx::Scene = &root;
    check_scene(scene, limits)?;
    let mut geometry = Geometry::new(limits);
    let skeleton = if options.wants_old_rig() { FbxSkeleton::read(scene)? } else { None };
    geometry.follows_pose = options.existing_rig == ExistingRigPolicy::Reskin;
    let mut materials = Materials::new(siblings, options, limits);
    let mut meshes: Vec<&ufbx::Mesh> = Vec::new();
    for node in &scene.nodes {
        if let Some(mesh) = node.mesh.as_ref().filter(|mesh| mesh.num_triangles > 0) {
            geometry.add(node, mesh, &mut materials)?;
            meshes.push(mesh);
        }
    }
    let (triangles, mut decoded, mut findings) = geometry.builder.finish(&geometry.attributes, &geometry.positions);
    (decoded.materials, decoded.images, findings) = materials.finish(findings);
    findings.extend(space_finding(scene));
    let (skins, joints) = (scene.skin_deformers.count, scene.bones.count);
    let contents = Contents {
        meshes: scene.meshes.into_iter().filter(|mesh| mesh.num_triangles > 0).count(),
        animations: scene.anim_stacks.count,
        morph_targets: scene.blend_channels.count,
    };
    findings.extend(left_behind(scene));
    if let Some(skeleton) = skeleton.as_ref().filter(|_| options.existing_rig == ExistingRigPolicy::Reskin) {
        decoded.skeleton = Some(skeleton.scene_skeleton()?);
    }
    Ok(Asset {
        format: Format::Fbx,
        mesh: Mesh { positions: geometry.positions, triangles },
        parts: geometry.parts,
        axes: (scene.settings.axes.up != CoordinateAxis::Unknown).then_some(Axes { up: Axis::PosY, front: Axis::PosZ }),
        contents,
        existing_rig: (skins + joints > 0).then_some(ExistingRig { skins, joints }),
        old_rig: skeleton.map(|skeleton| skeleton.old_rig(&meshes)),
        findings,
        source: Source::Scene(decoded),
    })
}

/// The file as `ufbx` reads it.
pub(super) fn load(bytes: &[u8], limits: &Limits) -> Result<ufbx::SceneRoot, DecodeError> {
    ufbx::load_memory(bytes, load_options(bytes, limits)).map_err(|error| refusal(&error, bytes, limits))
}

fn load_options<'a>(bytes: &[u8], limits: &Limits) -> LoadOpts<'a> {
    let mut options = LoadOpts::default();
    options.temp_allocator.memory_limit = limits.fbx_memory_bytes_max;
    options.result_allocator.memory_limit = limits.fbx_memory_bytes_max;
    options.file_format = ufbx::FileFormat::Fbx;
    options.file_size_estimate = bytes.len() as u64;
    options.ignore_animation = true;
    options.skip_skin_vertices = true;
    options.load_external_files = false;
    options.node_depth_limit = u32::try_from(limits.depth_max).unwrap_or(u32::MAX);
    options.index_error_handling = IndexErrorHandling::AbortLoading;
    options.target_axes = GLTF_AXES;
    options.target_unit_meters = 1.0;
    options
}

/// What `ufbx` says, in our words.
fn refusal(error: &ufbx::Error, bytes: &[u8], limits: &Limits) -> DecodeError {
    let malformed = |problem: String| DecodeError::Malformed {
        format: FORMAT,
        place: Place::Element("the file".into()),
        problem: if error.info().is_empty() { problem } else { format!("{problem} ({})", error.info()) },
    };
    let limit = limits.fbx_memory_bytes_max as u64;
    match error.type_ {
        ErrorType::EmptyFile => DecodeError::Empty,
        ErrorType::TruncatedFile => malformed(format!("it is cut off after {} bytes", bytes.len())),
        ErrorType::MemoryLimit | ErrorType::AllocationLimit | ErrorType::OutOfMemory => {
            DecodeError::TooLarge { what: "the content of the FBX file".into(), found: limit + 1, limit }
        }
        ErrorType::NodeDepthLimit => {
            DecodeError::TooDeep { format: FORMAT, what: "the node graph", limit: limits.depth_max as u64 }
        }
        ErrorType::BadIndex => malformed("an index is out of range".into()),
        ErrorType::UnsupportedVersion => {
            DecodeError::UnsupportedFeature { format: FORMAT, feature: format!("this file version {}", error.info()) }
        }
        _ => malformed(error.description.to_lowercase()),
    }
}

/// Counts of everything, instances included, before anything is copied.
fn check_scene(scene: &ufbx::Scene, limits: &Limits) -> Result<(), DecodeError> {
    let (found, limit) = (scene.nodes.count as u64, limits.nodes_max as u64);
    if found > limit {
        return Err(DecodeError::TooMany { what: "nodes", found, limit });
    }
    let (mut vertices, mut faces, mut corners) = (0_u64, 0_u64, 0_u64);
    for mesh in scene.nodes.into_iter().filter_map(|node| node.mesh.as_ref()) {
        vertices = vertices.saturating_add(mesh.num_vertices as u64);
        faces = faces.saturating_add(mesh.num_triangles as u64);
        let values = mesh.vertex_normal.values.count + mesh.vertex_uv.values.count + mesh.vertex_color.values.count;
        corners = corners.saturating_add((mesh.num_indices + values) as u64);
    }
    check_counts(vertices, faces, limits)?;
    // Each of the indices, normals, texture coordinates and colours: three per face, or as many as vertices.
    let (what, limit) = ("face corners", 12 * limits.faces_max as u64 + 3 * limits.vertices_max as u64);
    if corners > limit {
        return Err(DecodeError::TooMany { what, found: corners, limit });
    }
    let has_faces = scene.meshes.into_iter().any(|mesh| mesh.num_triangles > 0);
    if !has_faces && vertices > 0 {
        return Err(DecodeError::NoTriangles { vertices: vertices as usize });
    }
    if !has_faces && scene.nurbs_surfaces.count > 0 {
        let feature = "a NURBS surface without polygons".into();
        return Err(DecodeError::UnsupportedFeature { format: FORMAT, feature });
    }
    Ok(())
}

fn space_finding(scene: &ufbx::Scene) -> Option<Finding> {
    let (axes, unit) = (scene.settings.axes, scene.settings.unit_meters);
    (axes.up != CoordinateAxis::PositiveY || unit != 1.0).then(|| Finding {
        code: "converted_space",
        parts: Vec::new(),
        severity: Severity::Info,
        message: format!("the file's space (up {:?}, unit {unit} m) was converted to y up and metres", axes.up),
        hint: String::new(),
    })
}

/// What an FBX file can hold and the GLB that is made of it does not.
fn left_behind(scene: &ufbx::Scene) -> Option<Finding> {
    // Programs write a stack, though nothing moves.
    let moves = |stack: &ufbx::AnimStack| stack.layers.into_iter().any(|layer| layer.anim_values.count > 0);
    let animations = scene.anim_stacks.into_iter().filter(|stack| moves(stack)).count();
    let held = [(animations, "animation(s)"), (scene.blend_channels.count, "morph target(s)")];
    let held: Vec<String> =
        held.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect();
    (!held.is_empty()).then(|| Finding {
        code: "fbx_left_behind",
        parts: Vec::new(),
        severity: Severity::Warning,
        message: format!("{} of the FBX file are not read, so the result does not have them", held.join(" and ")),
        hint: "export the character as GLB from the program that made it, and send that: a GLB keeps them".into(),
    })
}

/// All mesh nodes placed in the world, one after another.
struct Geometry<'a> {
    builder: SceneBuilder<'a>,
    attributes: Attributes,
    positions: Vec<DVec3>,
    parts: Vec<Part>,
    /// Place skinned vertices where the bones of the file have them, so that a skeleton that is kept fits.
    follows_pose: bool,
}

impl<'a> Geometry<'a> {
    fn new(limits: &'a Limits) -> Self {
        Self {
            builder: SceneBuilder::new(limits),
            attributes: Attributes::default(),
            positions: Vec::new(),
            parts: Vec::new(),
            follows_pose: false,
        }
    }

    fn add(&mut self, node: &ufbx::Node, mesh: &ufbx::Mesh, materials: &mut Materials) -> Result<(), DecodeError> {
        let name = node.element.name.to_string();
        let m = &node.geometry_to_world;
        let linear = DMat3::from_cols_array(&[m.m00, m.m10, m.m20, m.m01, m.m11, m.m21, m.m02, m.m12, m.m22]);
        let origin = DVec3::new(m.m03, m.m13, m.m23);
        let first_row = self.positions.len();
        let frames = if self.follows_pose { posed(node, mesh)? } else { None };
        for (index, vertex) in mesh.vertices.iter().enumerate() {
            let place = DVec3::new(vertex.x, vertex.y, vertex.z);
            let position = match &frames {
                None => linear * place + origin,
                Some(frames) => frames[index].transform_point3(place),
            };
            check_position(position, FORMAT, || Place::Element(format!("vertex {index} of {name:?}")))?;
            self.positions.push(position);
        }
        let first = self.add_attributes(mesh, linear, frames.as_deref());
        let part = self.parts.len();
        let vertices = first_row..self.positions.len();
        self.parts.push(Part { name: name.clone(), mesh: part, primitive: 0, vertices });
        let scene_node = self.builder.add_node(name.clone())?;
        let is_mirrored = linear.determinant() < 0.0;
        let broken = |face: usize| DecodeError::Malformed {
            format: FORMAT,
            place: Place::Element(format!("face {face} of {name:?}")),
            problem: "its corners are not in the file".into(),
        };
        for (index, face) in mesh.faces.iter().enumerate() {
            let begin = face.index_begin as usize;
            let mut corners = (begin..begin.saturating_add(face.num_indices as usize))
                .map(|corner| first.corner(mesh, corner, first_row, self.positions.len()))
                .collect::<Option<Vec<Corner>>>()
                .ok_or_else(|| broken(index))?;
            if is_mirrored {
                corners.reverse();
            }
            let material = mesh.face_material.get(index).map_or(0, |&material| material as usize);
            let material = materials.index(node, mesh, material)?;
            self.builder.add_polygon(scene_node, material, &corners, &self.positions)?;
        }
        Ok(())
    }

    /// Copies the mesh's attribute values and tells where they begin.
    fn add_attributes(&mut self, mesh: &ufbx::Mesh, linear: DMat3, frames: Option<&[DMat4]>) -> FirstValues {
        let first = FirstValues {
            normal: self.attributes.normals.len(),
            texture_coordinate: self.attributes.texture_coordinates.len(),
            color: self.attributes.colors.len(),
            has_normal_per_corner: frames.is_some(),
        };
        // Normals go by the inverse transpose; of a singular transform nothing is left of them.
        let moved = |linear: DMat3, normal: &ufbx::Vec3| {
            let normal = linear.inverse().transpose() * DVec3::new(normal.x, normal.y, normal.z);
            normal.try_normalize().unwrap_or(DVec3::ZERO).as_vec3()
        };
        let given = &mesh.vertex_normal;
        match frames {
            None => self.attributes.normals.extend(given.values.iter().map(|normal| moved(linear, normal))),
            // Every vertex turns in its own way, so corners that shared a normal may no longer.
            Some(frames) => self.attributes.normals.extend(given.indices.iter().zip(mesh.vertex_indices.iter()).map(
                |(&normal, &vertex)| {
                    let frame = frames.get(vertex as usize).map_or(linear, |frame| DMat3::from_mat4(*frame));
                    given.values.get(normal as usize).map_or(Vec3::ZERO, |normal| moved(frame, normal))
                },
            )),
        }
        // FBX counts v from the bottom of the image, glTF from its top.
        let coordinates = mesh.vertex_uv.values.iter().map(|uv| [uv.x as f32, (1.0 - uv.y) as f32]);
        self.attributes.texture_coordinates.extend(coordinates);
        let linear_light = |value: f64| linear_from_srgb((value as f32).clamp(0.0, 1.0));
        let colors = mesh.vertex_color.values.iter().map(|color| {
            [linear_light(color.x), linear_light(color.y), linear_light(color.z), (color.w as f32).clamp(0.0, 1.0)]
        });
        self.attributes.colors.extend(colors);
        first
    }
}

/// Where the values of one mesh begin in [`Attributes`].
struct FirstValues {
    normal: usize,
    texture_coordinate: usize,
    color: usize,
    /// Normals stand by corner, not by the mesh's list.
    has_normal_per_corner: bool,
}

impl FirstValues {
    /// The corner at `index` of the mesh's index lists; `None` if its vertex is not there.
    fn corner(&self, mesh: &ufbx::Mesh, index: usize, first_row: usize, row_count: usize) -> Option<Corner> {
        let row = first_row + *mesh.vertex_indices.get(index)? as usize;
        if row >= row_count {
            return None;
        }
        let value = |indices: &[u32], count: usize, first: usize| match indices.get(index) {
            Some(&value) if (value as usize) < count => (first + value as usize) as u32,
            _ => NONE,
        };
        let (normal, uv, color) = (&mesh.vertex_normal, &mesh.vertex_uv, &mesh.vertex_color);
        Some(Corner {
            mesh_row: row as u32,
            normal: match self.has_normal_per_corner {
                true if index < normal.indices.count => (self.normal + index) as u32,
                true => NONE,
                false => value(&normal.indices, normal.values.count, self.normal),
            },
            texture_coordinate: value(&uv.indices, uv.values.count, self.texture_coordinate),
            color: value(&color.indices, color.values.count, self.color),
        })
    }
}
