//! Bytes to meshes and rigs to bytes. Untrusted input is checked here and nowhere after.
//!
//! No I/O: further files of an upload (buffers, textures, materials) are asked for through [`Siblings`].

mod archive;
mod detect;
mod error;
pub mod fbx;
mod fbx_materials;
mod fbx_skeleton;
pub mod gltf;
mod limits;
mod mtl;
pub mod npz;
pub mod obj;
mod obj_statements;
mod old_rig;
pub mod ply;
mod ply_header;
mod polygon;
pub mod preview;
pub mod rig_json;
pub mod rignet_text;
mod scene;
mod scene_builder;
mod siblings;
mod skeleton_nodes;
mod soundness;
pub mod stl;
mod text;
mod textures;
mod zip_directory;

pub use detect::{is_fbx, refuse_foreign};
pub use error::{DecodeError, ExceededLimit, Place};
pub use fbx_skeleton::read_skeleton as read_fbx_skeleton;
pub use limits::Limits;
pub use old_rig::OldRig;
pub use scene::{Alpha, Image, ImageType, Material, Scene, SceneNode, ScenePrimitive, SceneSkeleton};
pub use siblings::{NoSiblings, Siblings, relative_name};

use crate::mesh::Mesh;
use detect::Kind;
use glam::DVec3;
use siblings::BoundedSiblings;
use std::ops::Range;

/// The code of the finding that an old rig was taken away.
pub const EXISTING_RIG_REPLACED: &str = "existing_rig_replaced";

/// Reads one upload. What it is, its first bytes say, then the extension of `file_name`; `siblings` are the files sent
/// with it. Every limit is checked before memory is spent for what it limits.
pub fn decode(
    file_name: &str,
    bytes: &[u8],
    siblings: &dyn Siblings,
    limits: &Limits,
    options: &DecodeOptions,
) -> Result<Asset, DecodeError> {
    let found = bytes.len() as u64;
    if found > limits.bytes_max {
        return Err(DecodeError::TooLarge { what: "the file".into(), found, limit: limits.bytes_max });
    }
    match detect::detect(file_name, bytes)? {
        Kind::Mesh(format) => decode_as(format, file_name, bytes, siblings, limits, options),
        Kind::Zip => archive::decode(bytes, limits, options),
    }
}

/// Reads `bytes` as `format`, whatever they look like.
pub fn decode_as(
    format: Format,
    file_name: &str,
    bytes: &[u8],
    siblings: &dyn Siblings,
    limits: &Limits,
    options: &DecodeOptions,
) -> Result<Asset, DecodeError> {
    let bounded = BoundedSiblings::new(siblings, bytes.len() as u64, limits);
    let asset = match format {
        Format::Glb | Format::Gltf => gltf::decode(file_name, bytes, &bounded, limits, options),
        Format::Obj => obj::decode(file_name, bytes, &bounded, limits, options),
        Format::Ply => ply::decode(file_name, bytes, &bounded, limits, options),
        Format::Stl => stl::decode(file_name, bytes, &bounded, limits, options),
        Format::Fbx => fbx::decode(file_name, bytes, &bounded, limits, options),
    };
    bounded.check()?;
    let mut asset = asset?;
    if let (Some(rig), ExistingRigPolicy::Reject) = (asset.existing_rig, options.existing_rig) {
        return Err(DecodeError::AlreadyRigged { skins: rig.skins, joints: rig.joints });
    }
    if options.existing_rig == ExistingRigPolicy::Reskin && asset.old_rig.is_none() {
        return Err(DecodeError::NotRigged);
    }
    asset.findings.extend(soundness::check(&asset.mesh, &asset.parts, limits)?);
    Ok(asset)
}

/// What the sender chose about reading the file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DecodeOptions {
    pub existing_rig: ExistingRigPolicy,
    /// Leave a texture out, with a finding, where the file refers to one that was not sent; otherwise that is refused.
    pub allow_missing_textures: bool,
    /// Read [`Asset::old_rig`] even if its skeleton goes.
    pub old_rig: bool,
}

impl DecodeOptions {
    fn wants_old_rig(&self) -> bool {
        self.old_rig || self.existing_rig == ExistingRigPolicy::Reskin
    }
}

/// What to do with a file that is rigged already.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ExistingRigPolicy {
    #[default]
    Reject,
    /// Read it as if it had no rig; [`Asset::existing_rig`] says what was there.
    Replace,
    /// Keep its skeleton as it is, for new weights.
    Reskin,
}

/// A decoded upload: one mesh to rig, and all that is needed to give the same file back with a skin.
#[derive(Debug)]
pub struct Asset {
    pub format: Format,
    /// All parts one after another, in upload space (glTF: world space of the rest pose).
    pub mesh: Mesh,
    /// Which vertices of `mesh` belong to which primitive. Covers `mesh.positions` without gaps, in order.
    pub parts: Vec<Part>,
    /// What the file says of its axes; `None` for formats that say nothing (OBJ, PLY, STL).
    pub axes: Option<Axes>,
    /// What the file holds, in counts.
    pub contents: Contents,
    /// A skeleton and skin that came with the file.
    pub existing_rig: Option<ExistingRig>,
    /// The same in full, where [`DecodeOptions`] ask for it.
    pub old_rig: Option<OldRig>,
    /// What was noticed while reading, for the report.
    pub findings: Vec<Finding>,
    /// What the output is made from.
    pub source: Source,
}

impl Asset {
    /// An asset of one part: every file vertex in file order.
    fn from_scene(format: Format, name: &str, mesh: Mesh, scene: Scene, findings: Vec<Finding>) -> Self {
        let parts = vec![Part { name: name.into(), mesh: 0, primitive: 0, vertices: 0..mesh.positions.len() }];
        let contents = Contents { meshes: scene.nodes.len(), ..Contents::default() };
        let source = Source::Scene(scene);
        Self { format, mesh, parts, axes: None, contents, existing_rig: None, old_rig: None, findings, source }
    }
}

/// The rest of an upload: what is given back besides the rig.
#[derive(Debug)]
pub enum Source {
    /// The glTF document itself; the output is this document, plus a skin.
    Gltf(Box<gltf::Document>),
    /// Any other format; the output is written from scratch.
    Scene(Scene),
}

/// One primitive of one placed mesh. A glTF mesh used by two nodes makes two parts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Name of the node, object or file, for people.
    pub name: String,
    /// glTF: index of the mesh in the uploaded document. Other formats: 0.
    pub mesh: usize,
    /// glTF: index of the primitive in its mesh. Other formats: 0.
    pub primitive: usize,
    /// Rows of [`Asset::mesh`]'s positions; in accessor order (glTF) or file order (OBJ, PLY, STL).
    pub vertices: Range<usize>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    Glb,
    Gltf,
    Obj,
    Ply,
    Stl,
    Fbx,
}

impl Format {
    /// For reports and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Glb => "glb",
            Self::Gltf => "gltf",
            Self::Obj => "obj",
            Self::Ply => "ply",
            Self::Stl => "stl",
            Self::Fbx => "fbx",
        }
    }
}

/// Which way is up and which way a character faces, as signed unit axes of upload space.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Axes {
    pub up: Axis,
    pub front: Axis,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    PosX,
    NegX,
    PosY,
    NegY,
    PosZ,
    NegZ,
}

impl Axis {
    pub const ALL: [Self; 6] = [Self::PosX, Self::NegX, Self::PosY, Self::NegY, Self::PosZ, Self::NegZ];

    /// The unit vector along it.
    pub fn direction(self) -> DVec3 {
        match self {
            Self::PosX => DVec3::X,
            Self::NegX => DVec3::NEG_X,
            Self::PosY => DVec3::Y,
            Self::NegY => DVec3::NEG_Y,
            Self::PosZ => DVec3::Z,
            Self::NegZ => DVec3::NEG_Z,
        }
    }

    /// The axis that a unit vector lies along; `None` between the axes.
    pub fn along(direction: DVec3) -> Option<Self> {
        Self::ALL.into_iter().find(|axis| axis.direction() == direction)
    }

    /// As requests and reports spell it.
    pub fn name(self) -> &'static str {
        match self {
            Self::PosX => "+x",
            Self::NegX => "-x",
            Self::PosY => "+y",
            Self::NegY => "-y",
            Self::PosZ => "+z",
            Self::NegZ => "-z",
        }
    }
}

impl Part {
    /// Its name, and its number where the mesh has more than one primitive before it.
    pub fn label(&self) -> String {
        match self.primitive {
            0 => self.name.clone(),
            primitive => format!("{}, primitive {primitive}", self.name),
        }
    }
}

/// What a file holds as it was sent, beside the mesh that is rigged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Contents {
    /// Meshes that are rigged; one that is placed twice counts once.
    pub meshes: usize,
    pub animations: usize,
    /// Of all these meshes.
    pub morph_targets: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExistingRig {
    pub skins: usize,
    pub joints: usize,
}

/// Something worth telling the sender that did not stop the work.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Stable, snake_case.
    pub code: &'static str,
    /// Labels of the parts that it is about, at most a few; empty: the whole file.
    pub parts: Vec<String>,
    pub severity: Severity,
    /// What was found, with names and counts.
    pub message: String,
    /// The next step for the sender; empty when there is none.
    pub hint: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    Info,
    Warning,
}
