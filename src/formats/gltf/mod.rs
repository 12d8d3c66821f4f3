//! glTF 2.0, as JSON with buffers or as GLB. Khronos Group, glTF 2.0 specification.
//!
//! [`decode`] reads a file into a [`Document`] that only lacks its skin; [`encode_glb`] and [`encode_gltf`] add the skin.
//! Spaces: upload space is the world space of the document's rest pose, metres, y up.

mod accessors;
mod animations;
mod bake;
mod buffers;
mod container;
mod decode;
mod document;
mod encode;
mod existing_rig;
mod flatten;
mod json;
mod kept_skin;
mod layout_check;
mod meshopt;
mod node_graph;
mod references;
mod scene_document;
mod skeleton;
mod skin_check;
mod skin_weights;
mod triangles;

pub use decode::decode;
pub use encode::{EncodeError, EncodeOptions, JointNames, encode_glb, encode_gltf, joint_names};
pub use skeleton::{is_glb, read_skeleton};
pub use skin_weights::WeightFormat;

use serde_json::Value;
use std::fmt;

/// For messages.
const FORMAT: &str = "glTF";

/// Stands in `asset.generator` of everything that is written.
const GENERATOR: &str = concat!("rigsmith ", env!("CARGO_PKG_VERSION"));

/// A document that is whole but for its skin.
///
/// All buffers are joined into one; mesh nodes that will be skinned stand at the root of their scenes without a transform,
/// each with a mesh of its own whose positions are in world space; no skin is left of those that came with the file, and their
/// joints only where they are kept.
#[derive(Clone)]
pub struct Document {
    json: Value,
    binary: Vec<u8>,
    /// Chunks of a GLB file besides JSON and BIN.
    other_chunks: Vec<(u32, Vec<u8>)>,
    skinned: Vec<SkinnedPrimitive>,
    /// The joints that the file came with, where they are to be used.
    kept: Option<kept_skin::KeptSkin>,
    /// Scenes that show a mesh to be skinned; its joints must be in them too.
    scenes: Vec<usize>,
}

/// A primitive that gets joints and weights.
#[derive(Clone, Debug)]
struct SkinnedPrimitive {
    node: usize,
    mesh: usize,
    primitive: usize,
    /// Row of the asset's mesh, for each vertex in accessor order.
    rows: Vec<u32>,
}

impl fmt::Debug for Document {
    /// What it holds, in counts: a document may be a hundred megabytes.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count = |list: &str| json::items(&self.json, list).len();
        formatter
            .debug_struct("Document")
            .field("nodes", &count("nodes"))
            .field("meshes", &count("meshes"))
            .field("accessors", &count("accessors"))
            .field("binary_bytes", &self.binary.len())
            .field("skinned_primitives", &self.skinned.len())
            .finish_non_exhaustive()
    }
}
