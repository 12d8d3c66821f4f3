//! The published methods, one file each, composed from mesh, geometry, nets and rig.

mod boxes;
pub mod heter_skin;
mod prepared;
pub mod rignet;
pub mod shape;
mod skin;
pub mod skin_choice;
pub mod survey;
mod transfer;

pub use crate::geometry::{orientation, stance};

use crate::cancellation::{Cancellation, Cancelled};
use crate::mesh::Mesh;
pub use crate::nets::{LoadOptions, Models, NetError};
use crate::rig::detect_joints::DetectJointsError;
pub use crate::rig::detect_joints::Fineness as LevelOfDetail;
pub use crate::rig::hands::Fingers;
use crate::rig::locked_weights::Locks;
use crate::rig::skin_weights::Trim;
pub use crate::rig::verdict::{Quality, Verdict};
pub use crate::rig::{Rig, Skeleton};
use glam::{DMat3, DVec3};
use skin::SkinNets;

/// Counts the changes of results: raise it with every change of this corridor (formats to weights, files included) after which
/// the same upload, options and networks give other bytes. Results that are kept under an older revision are not given again.
/// A test holds figures of a rig beside it (`tests/it/revision.rs`).
pub const REVISION: u32 = 5;

/// A published way to make a rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Mesh graph networks; any character [Xu et al. 2020].
    RigNet,
}

impl Method {
    pub const ALL: [Self; 1] = [Self::RigNet];

    /// The name in requests, reports and file names.
    pub fn name(self) -> &'static str {
        match self {
            Self::RigNet => "rignet",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|method| method.name() == name)
    }
}

/// A way to weigh vertices over the bones of a skeleton.
///
/// The default is the best by measurement, see [`skin_choice`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SkinMethod {
    /// RigNet's skin network over volumetric geodesic distances [Xu et al. 2020, Section 4.3].
    RigNet,
    /// A network over the graph of mesh, skeleton and the links between them [Pan et al. 2021].
    HeterSkinNet,
    /// Falloff of the way through voxels of the solid [Dionne and de Lasa 2013]; asks no network.
    GeodesicVoxel,
    /// Heat that bones give off, by the same way [Baran and Popović 2007]; asks no network.
    GeodesicHeat,
}

impl SkinMethod {
    pub const ALL: [Self; 4] = [Self::RigNet, Self::HeterSkinNet, Self::GeodesicVoxel, Self::GeodesicHeat];

    /// The name in requests and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::RigNet => "rignet",
            Self::HeterSkinNet => "heter_skin_net",
            Self::GeodesicVoxel => "geodesic_voxel",
            Self::GeodesicHeat => "geodesic_heat",
        }
    }
}

/// What a method is doing; the same words in job status, traces and benchmarks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    Normalize,
    Geometry,
    Joints,
    Connect,
    Skin,
    Transfer,
}

impl Stage {
    pub const ALL: [Self; 6] =
        [Self::Normalize, Self::Geometry, Self::Joints, Self::Connect, Self::Skin, Self::Transfer];

    pub fn name(self) -> &'static str {
        match self {
            Self::Normalize => "normalize",
            Self::Geometry => "geometry",
            Self::Joints => "joints",
            Self::Connect => "connect",
            Self::Skin => "skin",
            Self::Transfer => "transfer",
        }
    }
}

/// Whether left and right are made alike.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Symmetry {
    /// Where a symmetry plane is found with enough confidence.
    #[default]
    Auto,
    /// About the best plane there is.
    On,
    Off,
}

/// What the caller may choose.
#[derive(Clone, Debug, PartialEq)]
pub struct RigOptions {
    pub method: Method,
    pub level_of_detail: LevelOfDetail,
    pub symmetry: Symmetry,
    /// Which fingers a predicted skeleton gets.
    pub fingers: Fingers,
    pub skin_method: SkinMethod,
    /// Whether a character made of boxes gets its joints from them,
    pub boxes: bool,
    /// and whether its boxes move as a whole, whatever the skin method.
    pub rigid_boxes: bool,
    /// Most joints that may move one vertex, 1 to 8.
    pub max_influences: usize,
    /// How far weights run into each other along the surface, 0 (as the method gives them) to 1.
    pub smooth: f64,
    /// Weights below this share of a vertex's are dropped, 0 to 0.5.
    pub prune: f64,
    /// Whether the weights of left and right are made alike.
    pub mirror_weights: Symmetry,
    /// Fixes every choice that is not decided by the mesh.
    pub seed: u64,
}

impl Default for RigOptions {
    fn default() -> Self {
        Self {
            method: Method::RigNet,
            level_of_detail: LevelOfDetail::Detail(0.5),
            symmetry: Symmetry::Auto,
            fingers: Fingers::Auto,
            skin_method: SkinMethod::default(),
            boxes: true,
            rigid_boxes: true,
            max_influences: Trim::USUAL.max_influences,
            smooth: 0.0,
            prune: Trim::WEIGHT_MIN,
            mirror_weights: Symmetry::Off,
            seed: 0,
        }
    }
}

impl RigOptions {
    /// What is cut off each vertex's weights.
    fn trim(&self) -> Trim {
        Trim { max_influences: self.max_influences, weight_min: self.prune }
    }
}

/// A mesh to rig and which way it stands.
#[derive(Clone, Copy, Debug)]
pub struct Subject<'a> {
    /// In upload space.
    pub mesh: &'a Mesh,
    /// Turns upload space so that y is up and the character faces +z. A rotation, or a reflection for left-handed
    /// uploads.
    pub to_upright: DMat3,
}

/// A skeleton that is there, and what of it takes part.
#[derive(Clone, Copy, Debug)]
pub struct Given<'a> {
    /// In upload space.
    pub skeleton: &'a Skeleton,
    /// `[J]`: joints that may move vertices; `None`: all.
    pub deforms: Option<&'a [bool]>,
    /// Joints that keep the weights they had.
    pub locks: Option<Locks<'a>>,
}

impl<'a> From<&'a Skeleton> for Given<'a> {
    fn from(skeleton: &'a Skeleton) -> Self {
        Self { skeleton, deforms: None, locks: None }
    }
}

/// How the work is watched and stopped from outside.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    pub cancellation: &'a Cancellation,
    /// Told when a stage begins.
    pub on_stage: &'a (dyn Fn(Stage) + Sync),
}

impl Watch<'_> {
    /// Begins a stage, unless the work was cancelled.
    pub fn enter(&self, stage: Stage) -> Result<(), RigError> {
        self.cancellation.check()?;
        (self.on_stage)(stage);
        Ok(())
    }
}

/// A rig in upload space and what was decided on the way.
#[derive(Clone, Debug, PartialEq)]
pub struct Rigged {
    pub rig: Rig,
    pub facts: Facts,
}

/// What was found and decided, for the report.
#[derive(Clone, Debug, PartialEq)]
pub struct Facts {
    pub working_vertices: usize,
    pub working_triangles: usize,
    /// Unit normal and a point of the mirror plane in upload space, where one was used.
    pub symmetry_plane: Option<(DVec3, DVec3)>,
    /// 0 to 1: how well the best vertical plane mirrors the shape.
    pub symmetry_score: f64,
    /// The mean-shift bandwidth that was used, in the normalised frame; `None` for a skeleton that was given or made of boxes.
    pub bandwidth: Option<f64>,
    /// The number of boxes, where the character is made of them and this was made use of.
    pub boxes: Option<usize>,
    /// Fingers of the predicted skeleton; 0 for one that was given.
    pub fingers: usize,
    /// Whether every box moves as a whole.
    pub is_rigid: bool,
    /// Share of joints inside the solid.
    pub joints_inside: f64,
    /// Joints of a given skeleton that are nowhere near the mesh, by index.
    pub joints_far_outside: Vec<usize>,
    /// Vertices that no bone's weights reached; they follow the nearest bone.
    pub vertices_by_nearest_bone: usize,
    /// Vertices that have the mean of both sides' weights; `None` unless sides were to be made alike.
    pub vertices_mirrored: Option<usize>,
    /// How good the rig of the working mesh is, by what can be measured without knowing the right answer.
    pub quality: Quality,
}

/// Why this mesh was not rigged.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    #[error("the mesh has no extent: all its vertices are at one place")]
    NoExtent,
    #[error("no joints were found: {tried}")]
    NoJointsFound { tried: String },
    #[error("vertex {vertex} has the locked joints {joints}, but max_influences is {limit}")]
    NoRoomForLocked { vertex: usize, joints: String, limit: usize },
    #[error("method {method} is not available: {reason}")]
    MethodUnavailable { method: &'static str, reason: String },
    #[error(transparent)]
    Net(NetError),
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl From<NetError> for RigError {
    fn from(error: NetError) -> Self {
        match error {
            NetError::Cancelled(cancelled) => Self::Cancelled(cancelled),
            other => Self::Net(other),
        }
    }
}

impl From<DetectJointsError> for RigError {
    fn from(error: DetectJointsError) -> Self {
        match error {
            DetectJointsError::NotFound { tried } => Self::NoJointsFound { tried },
            DetectJointsError::Cancelled(cancelled) => Self::Cancelled(cancelled),
        }
    }
}

impl RigError {
    /// The stable code of `user-expectations` for errors of a job.
    pub fn code(&self) -> &'static str {
        match self {
            Self::NoExtent => "no_geometry",
            Self::NoJointsFound { .. } => "no_joints_found",
            Self::NoRoomForLocked { .. } => "not_riggable",
            Self::MethodUnavailable { .. } => "model_unavailable",
            Self::Net(NetError::NotFinite { .. }) => "numerical_failure",
            Self::Net(_) => "internal",
            Self::Cancelled(_) => "canceled",
        }
    }

    /// The next step for the sender; empty where there is none.
    pub fn hint(&self) -> &'static str {
        match self {
            Self::NoExtent => "export the mesh again and check its scale",
            Self::NoJointsFound { .. } => "try a higher `detail`, or check that the mesh is one character, upright",
            Self::NoRoomForLocked { .. } => {
                "raise max_influences, so that one joint more than the locked ones fits, or lock fewer"
            }
            Self::MethodUnavailable { .. } => "see GET /v1/methods or `rigsmith methods` for what runs here",
            Self::Net(error) => error.hint(),
            Self::Cancelled(_) => "",
        }
    }
}

/// Rigs `subject` by the method that `options` name.
pub fn rig(subject: Subject, models: &Models, options: &RigOptions, watch: Watch) -> Result<Rigged, RigError> {
    let unavailable =
        |reason: &str| RigError::MethodUnavailable { method: options.method.name(), reason: reason.to_owned() };
    let skin_nets = SkinNets::of(options.skin_method, models)?;
    match options.method {
        Method::RigNet => rignet::rig(subject, models.rignet().map_err(unavailable)?, skin_nets, options, watch),
    }
}

/// Weighs the vertices of `subject` over the `given` joints, by the skin method that `options` name. The skeleton stays as it is.
pub fn skin<'a>(
    subject: Subject,
    given: impl Into<Given<'a>>,
    models: &Models,
    options: &RigOptions,
    watch: Watch,
) -> Result<Rigged, RigError> {
    skin::skin(subject, given.into(), SkinNets::of(options.skin_method, models)?, options, watch)
}

/// Why `method` cannot make skeletons here; `None` when it can.
pub fn unavailable(method: Method, models: &Models) -> Option<String> {
    match method {
        Method::RigNet => models.rignet().err().map(str::to_owned),
    }
}
