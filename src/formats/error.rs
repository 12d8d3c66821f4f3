//! Why an upload is refused. One variant per refusal; each knows its stable code and the sender's next step.

use super::rig_json::RigFileError;
use std::fmt;

/// Why an upload is not a mesh that can be worked on. Every variant is the sender's to fix.
///
/// Messages name the thing and the values; the next step is in [`DecodeError::hint`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DecodeError {
    #[error("the file is empty")]
    Empty,
    /// `seen` with its article: "a Blender 4.2 file", "a PNG image".
    #[error("{seen} is not a mesh format that is read here")]
    UnsupportedFormat { seen: String },
    #[error("the file requires the extension {name}, which is not supported")]
    UnsupportedExtension { name: String },
    /// A known format that uses something which is not read.
    #[error("{format}: {feature} is not supported")]
    UnsupportedFeature { format: &'static str, feature: String },
    /// The bytes break the rules of their format.
    #[error("{format}: {place}: {problem}")]
    Malformed { format: &'static str, place: Place, problem: String },
    /// The file declares more than it holds. `what` in words: "vertex data", "BIN chunk".
    #[error("{format}: {what} needs {needed} bytes, but {available} are there")]
    Truncated { format: &'static str, what: String, needed: u64, available: u64 },
    /// `what` is the thing referred to: "vertex", "texture coordinate", "accessor".
    #[error("{format}: {place} refers to {what} {index}, but the file has {count}")]
    IndexOutOfRange { format: &'static str, place: Place, what: &'static str, index: i64, count: usize },
    #[error("{format}: {place}: a {what} is {value}, which is not a finite number of usable size")]
    NonFinite { format: &'static str, place: Place, what: &'static str, value: f64 },
    #[error("the file has {vertices} vertices, but no triangles")]
    NoTriangles { vertices: usize },
    #[error("the file is a point cloud: {points} points and no faces")]
    PointCloud { points: usize },
    #[error("the mesh has no extent: its longest side is {longest_side}")]
    ZeroExtent { longest_side: f64 },
    #[error("none of the {faces} faces has an area")]
    AllDegenerate { faces: usize },
    /// `name` as the referring file spells it.
    #[error("the file refers to {name}, which was not sent")]
    MissingResource { name: String },
    #[error("the file is already rigged: {skins} skin(s), {joints} joint(s)")]
    AlreadyRigged { skins: usize, joints: usize },
    #[error("the file has no skeleton to keep")]
    NotRigged,
    /// The skeleton that came with the file cannot be kept.
    #[error(transparent)]
    OldRig(#[from] RigFileError),
    #[error("{what} has {found} bytes, more than the limit of {limit}")]
    TooLarge { what: String, found: u64, limit: u64 },
    #[error("the mesh has {found} vertices, more than the limit of {limit}")]
    TooManyVertices { found: u64, limit: u64 },
    #[error("the mesh has {found} faces, more than the limit of {limit}")]
    TooManyFaces { found: u64, limit: u64 },
    /// `what` in the plural: "nodes", "materials", "archive entries".
    #[error("the file has {found} {what}, more than the limit of {limit}")]
    TooMany { what: &'static str, found: u64, limit: u64 },
    #[error("{format}: {what} is nested deeper than the limit of {limit}")]
    TooDeep { format: &'static str, what: &'static str, limit: u64 },
    #[error("{format}: the node graph has a cycle through node {node}")]
    CyclicNodes { format: &'static str, node: usize },
    #[error("the archive unpacks to more than {limit} times its size")]
    ZipBomb { limit: u64 },
    #[error("the archive entry {name:?} would leave the archive's folder")]
    UnsafePath { name: String },
    #[error("the archive entry {name:?} is encrypted")]
    EncryptedArchive { name: String },
    #[error("the archive holds another archive, {name:?}, and no mesh file")]
    NestedArchive { name: String },
}

/// Where in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// 1-based.
    Line(usize),
    /// Offset from the start of the file.
    Byte(u64),
    /// A named thing: "accessor 3", "vertex 17", "mesh \"Body\", primitive 0".
    Element(String),
}

impl fmt::Display for Place {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(formatter, "line {line}"),
            Self::Byte(offset) => write!(formatter, "byte {offset}"),
            Self::Element(name) => formatter.write_str(name),
        }
    }
}

/// A limit that an upload exceeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExceededLimit {
    pub name: &'static str,
    pub max: u64,
    /// `None` where counting on would cost what the limit is there to save.
    pub actual: Option<u64>,
}

impl DecodeError {
    /// The stable code that scripts match on.
    pub fn code(&self) -> &'static str {
        match self {
            Self::UnsupportedFormat { .. } => "unsupported_media_type",
            Self::UnsupportedExtension { .. } => "unsupported_extension",
            Self::Empty
            | Self::UnsupportedFeature { .. }
            | Self::Malformed { .. }
            | Self::Truncated { .. }
            | Self::IndexOutOfRange { .. }
            | Self::TooDeep { .. }
            | Self::CyclicNodes { .. }
            | Self::UnsafePath { .. }
            | Self::EncryptedArchive { .. }
            | Self::NestedArchive { .. } => "unreadable_mesh",
            Self::NonFinite { .. } => "non_finite_vertices",
            Self::NoTriangles { .. }
            | Self::PointCloud { .. }
            | Self::ZeroExtent { .. }
            | Self::AllDegenerate { .. } => "no_geometry",
            Self::MissingResource { .. } => "missing_resource",
            Self::AlreadyRigged { .. } => "already_rigged",
            Self::NotRigged => "skeleton_invalid",
            Self::OldRig(error) => error.code(),
            Self::TooLarge { .. } | Self::TooMany { .. } => "too_large",
            Self::TooManyVertices { .. } => "too_many_vertices",
            Self::TooManyFaces { .. } => "too_many_faces",
            Self::ZipBomb { .. } => "zip_bomb",
        }
    }

    /// What the sender can do about it, as one sentence without a full stop.
    pub fn hint(&self) -> String {
        match self {
            Self::Empty => "send the file again; no bytes arrived".into(),
            Self::UnsupportedFormat { .. } => {
                "export as GLB, glTF, OBJ, PLY, STL or FBX, or a zip of one of these".into()
            }
            Self::UnsupportedExtension { name } => format!("export without {name}"),
            Self::UnsupportedFeature { feature, .. } => format!("export without {feature}, or as GLB"),
            Self::Malformed { .. } | Self::IndexOutOfRange { .. } | Self::CyclicNodes { .. } => {
                "open the file in a modelling program and export it again".into()
            }
            Self::Truncated { .. } => "the file seems cut off; send it again in full".into(),
            Self::NonFinite { what, .. } => format!("remove or repair the {what} and export again"),
            Self::NoTriangles { .. } => "export the mesh with its faces".into(),
            Self::PointCloud { .. } => "reconstruct a surface from the points first".into(),
            Self::ZeroExtent { .. } => {
                "its points coincide, or are too far from the origin to be told apart: export it at its real size, near the origin".into()
            }
            Self::AllDegenerate { .. } => "check the mesh in a modelling program; its faces are lines or points".into(),
            Self::MissingResource { name } => {
                format!("send {name} along, or everything in one zip, or export as GLB, which holds all in one file")
            }
            Self::AlreadyRigged { .. } => {
                "set existing_rig to replace to rig it anew, or to reskin to keep its skeleton and make new weights"
                    .into()
            }
            Self::NotRigged => "send a file with a skin or bones, or a skeleton of its own beside the mesh".into(),
            Self::OldRig(error) => error.hint().into(),
            Self::TooLarge { .. } => "make the textures smaller or decimate the mesh".into(),
            Self::TooManyVertices { limit, .. } => format!("decimate below {limit} vertices"),
            Self::TooManyFaces { limit, .. } => format!("decimate below {limit} faces"),
            Self::TooMany { what, limit, .. } => format!("join or remove {what} until there are at most {limit}"),
            Self::TooDeep { what, limit, .. } => format!("flatten {what} to at most {limit} levels"),
            Self::ZipBomb { .. } => "zip only the mesh and its textures, or send the files unpacked".into(),
            Self::UnsafePath { .. } => "zip the folder's content with relative names".into(),
            Self::EncryptedArchive { .. } => "zip it without a password".into(),
            Self::NestedArchive { .. } => "unpack the inner archive and zip its files".into(),
        }
    }

    /// The limit that the upload exceeds, for refusals of that kind.
    pub fn limit(&self) -> Option<ExceededLimit> {
        let (name, max, actual) = match self {
            Self::TooLarge { found, limit, .. } => ("bytes", limit, Some(found)),
            Self::TooManyVertices { found, limit } => ("vertices", limit, Some(found)),
            Self::TooManyFaces { found, limit } => ("faces", limit, Some(found)),
            Self::TooMany { what, found, limit } => (*what, limit, Some(found)),
            Self::TooDeep { limit, .. } => ("depth", limit, None),
            Self::ZipBomb { limit } => ("unzip_ratio", limit, None),
            _ => return None,
        };
        Some(ExceededLimit { name, max: *max, actual: actual.copied() })
    }
}
