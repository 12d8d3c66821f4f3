//! What a caller may ask for, and the words for it. [`super::options_reader`] reads it.

pub use super::options_reader::{FieldError, FieldProblem, OptionsReader};
pub use crate::formats::ExistingRigPolicy;
use crate::formats::rig_json::RigFile;
use crate::formats::{Axis, SceneSkeleton, rig_json};
pub use crate::pipelines::{Fingers, LevelOfDetail, Skeleton, SkinMethod, Symmetry};
use crate::rig::{Influence, Rig};
use serde_json::Value;
use std::sync::Arc;

pub const DEFAULT_DETAIL: f64 = 0.5;
pub const DEFAULT_MAX_INFLUENCES: usize = 4;
pub const DEFAULT_PRUNE: f64 = 0.001;

/// Options of one rig, defaults filled in.
#[derive(Clone, Debug, PartialEq)]
pub struct RigOptions {
    /// Name of a method as `rigsmith methods` lists it; `None`: the service chooses.
    pub method: Option<String>,
    pub level_of_detail: LevelOfDetail,
    pub symmetry: Symmetry,
    pub fingers: Fingers,
    /// What weighs the vertices; `None`: the service chooses.
    pub skin_method: Option<SkinMethod>,
    /// What becomes of a character made of boxes.
    pub boxes: Boxes,
    /// What may weigh them where that cannot run here, in this order.
    pub skin_fallback: Vec<SkinMethod>,
    /// A skeleton in upload space to make weights for, instead of making one. It stays as it is.
    pub skeleton: Option<Arc<GivenSkeleton>>,
    /// Names or patterns of joints of a given skeleton that must not move vertices.
    pub non_deforming: Vec<String>,
    /// Names or patterns of joints of a given skeleton that keep the weights they had.
    pub locked_joints: Vec<String>,
    /// Joints per vertex at most.
    pub max_influences: usize,
    /// How far weights run into each other along the surface, 0 to 1.
    pub smooth: f64,
    /// Weights below this share of a vertex's are dropped.
    pub prune: f64,
    /// Whether the weights of left and right are made alike.
    pub mirror_weights: Symmetry,
    pub seed: u64,
    /// Overrides what the file says or what is detected.
    pub up: Option<Axis>,
    pub front: Option<Axis>,
    pub existing_rig: ExistingRigPolicy,
    /// Distinct, in the order asked for, not empty.
    pub outputs: Vec<Output>,
}

impl Default for RigOptions {
    fn default() -> Self {
        Self {
            method: None,
            level_of_detail: LevelOfDetail::Detail(DEFAULT_DETAIL),
            symmetry: Symmetry::Auto,
            fingers: Fingers::Auto,
            skin_method: None,
            boxes: Boxes::Auto,
            skin_fallback: Vec::new(),
            skeleton: None,
            non_deforming: Vec::new(),
            locked_joints: Vec::new(),
            max_influences: DEFAULT_MAX_INFLUENCES,
            smooth: 0.0,
            prune: DEFAULT_PRUNE,
            mirror_weights: Symmetry::Off,
            seed: 0,
            up: None,
            front: None,
            existing_rig: ExistingRigPolicy::Reject,
            outputs: vec![Output::Glb, Output::RigJson],
        }
    }
}

/// A skeleton that the caller has, and its weights where some of them are to stay.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GivenSkeleton {
    pub skeleton: Skeleton,
    /// How its joints are turned and what stands about them, where its file says so.
    pub nodes: Option<SceneSkeleton>,
    /// One row per vertex of the mesh over the joints of the skeleton; none where no joint is locked.
    pub rows: Vec<Vec<Influence>>,
}

impl GivenSkeleton {
    /// The shortest `rigsmith.rig/1` file that holds it.
    pub fn to_json(&self) -> Value {
        rig_json::skeleton_json(&self.skeleton, self.nodes.as_ref(), &self.rows)
    }
}

impl From<RigFile> for GivenSkeleton {
    fn from(file: RigFile) -> Self {
        let nodes = file.nodes.clone();
        let Rig { skeleton, skin } = file.into_rig();
        Self { skeleton, nodes, rows: skin.rows }
    }
}

impl RigOptions {
    /// Whether a skeleton that is there stays, and only weights are made.
    pub fn keeps_skeleton(&self) -> bool {
        self.skeleton.is_some() || self.existing_rig == ExistingRigPolicy::Reskin
    }

    /// Every field by its name, so that [`OptionsReader`](super::OptionsReader) reads the same options back.
    pub fn to_json(&self) -> Value {
        let (detail, bandwidth) = match self.level_of_detail {
            LevelOfDetail::Detail(detail) => (Some(detail), None),
            LevelOfDetail::Bandwidth(bandwidth) => (None, Some(bandwidth)),
        };
        serde_json::json!({
            "method": self.method,
            "detail": detail,
            "bandwidth": bandwidth,
            "symmetry": self.symmetry.name(),
            "fingers": self.fingers.name(),
            "skin_method": skin_method_name(self.skin_method),
            "boxes": self.boxes.name(),
            "skin_fallback": self.skin_fallback.iter().map(|method| method.name()).collect::<Vec<_>>(),
            "skeleton": self.skeleton.as_deref().map(|given| given.to_json()),
            "non_deforming": self.non_deforming,
            "locked_joints": self.locked_joints,
            "max_influences": self.max_influences,
            "smooth": self.smooth,
            "prune": self.prune,
            "mirror_weights": self.mirror_weights.name(),
            "seed": self.seed,
            "up": axis_name(self.up),
            "front": axis_name(self.front),
            "existing_rig": self.existing_rig.name(),
            "outputs": self.outputs.iter().map(|output| output.name()).collect::<Vec<_>>(),
        })
    }
}

/// What becomes of a character made of boxes, as in block games.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Boxes {
    /// Joints where its boxes touch; each box moves as a whole, unless a skin method is named.
    Auto,
    /// It is rigged like any other.
    Off,
}

/// A file to make.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    Glb,
    Gltf,
    RigJson,
    RignetTxt,
    PreviewPng,
}

/// Values a word may have, with the one spelling used at every door.
pub trait Words: Sized + Copy + PartialEq + 'static {
    const WORDS: &'static [(&'static str, Self)];

    fn parse(word: &str) -> Option<Self> {
        Self::WORDS.iter().find(|(name, _)| *name == word).map(|(_, value)| *value)
    }

    fn word(self) -> &'static str {
        Self::WORDS.iter().find(|(_, value)| *value == self).map_or("", |(name, _)| *name)
    }

    fn words() -> Vec<&'static str> {
        Self::WORDS.iter().map(|(name, _)| *name).collect()
    }

    fn choices() -> String {
        Self::words().join(", ")
    }
}

impl Words for Symmetry {
    const WORDS: &'static [(&'static str, Self)] =
        &[("auto", Symmetry::Auto), ("on", Symmetry::On), ("off", Symmetry::Off)];
}

impl Words for Fingers {
    const WORDS: &'static [(&'static str, Self)] =
        &[("auto", Fingers::Auto), ("on", Fingers::On), ("off", Fingers::Off)];
}

impl Words for Boxes {
    const WORDS: &'static [(&'static str, Self)] = &[("auto", Boxes::Auto), ("off", Boxes::Off)];
}

impl Words for Option<SkinMethod> {
    const WORDS: &'static [(&'static str, Self)] = &[
        ("auto", None),
        (SkinMethod::RigNet.name(), Some(SkinMethod::RigNet)),
        (SkinMethod::HeterSkinNet.name(), Some(SkinMethod::HeterSkinNet)),
        (SkinMethod::GeodesicVoxel.name(), Some(SkinMethod::GeodesicVoxel)),
        (SkinMethod::GeodesicHeat.name(), Some(SkinMethod::GeodesicHeat)),
    ];
}

impl Words for SkinMethod {
    const WORDS: &'static [(&'static str, Self)] = &[
        (Self::RigNet.name(), Self::RigNet),
        (Self::HeterSkinNet.name(), Self::HeterSkinNet),
        (Self::GeodesicVoxel.name(), Self::GeodesicVoxel),
        (Self::GeodesicHeat.name(), Self::GeodesicHeat),
    ];
}

impl Words for ExistingRigPolicy {
    const WORDS: &'static [(&'static str, Self)] = &[
        ("reject", ExistingRigPolicy::Reject),
        ("replace", ExistingRigPolicy::Replace),
        ("reskin", ExistingRigPolicy::Reskin),
    ];
}

impl Words for Output {
    const WORDS: &'static [(&'static str, Self)] = &[
        ("glb", Output::Glb),
        ("gltf", Output::Gltf),
        ("rig_json", Output::RigJson),
        ("rignet_txt", Output::RignetTxt),
        ("preview_png", Output::PreviewPng),
    ];
}

/// The word for a skin method; `auto` for `None`.
pub fn skin_method_name(method: Option<SkinMethod>) -> &'static str {
    method.word()
}

impl Symmetry {
    pub fn name(self) -> &'static str {
        self.word()
    }
}

impl Fingers {
    pub fn name(self) -> &'static str {
        self.word()
    }
}

impl Boxes {
    pub fn name(self) -> &'static str {
        self.word()
    }
}

impl ExistingRigPolicy {
    pub fn name(self) -> &'static str {
        self.word()
    }
}

impl Output {
    pub fn name(self) -> &'static str {
        self.word()
    }

    /// The name of the artifact.
    pub fn file_name(self) -> &'static str {
        match self {
            Self::Glb => "rigged.glb",
            Self::Gltf => "rigged.gltf",
            Self::RigJson => "rig.json",
            Self::RignetTxt => "rignet.txt",
            Self::PreviewPng => "preview.png",
        }
    }

    pub fn media_type(self) -> &'static str {
        match self {
            Self::Glb => "model/gltf-binary",
            Self::Gltf => "model/gltf+json",
            Self::RigJson => "application/json",
            Self::RignetTxt => "text/plain; charset=utf-8",
            Self::PreviewPng => "image/png",
        }
    }
}

/// `+y` and the like; `auto` for `None`.
pub fn axis_name(axis: Option<Axis>) -> &'static str {
    axis.map_or("auto", Axis::name)
}
