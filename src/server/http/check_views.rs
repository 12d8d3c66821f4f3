//! What a check says, over the wire. The command line prints the same.

use super::views::FindingView;
use super::words::{CategoryName, PoseName, RiggableName};
use crate::formats::{ExistingRig, Format};
use crate::jobs::Check;
use crate::pipelines::stance::{Category, Pose};
use crate::pipelines::survey::Survey;
use serde::Serialize;
use utoipa::ToSchema;

/// What would be rigged.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Check)]
pub struct CheckView {
    #[schema(example = "check")]
    pub object: &'static str,
    #[schema(value_type = RiggableName, example = "yes")]
    pub riggable: &'static str,
    #[schema(example = "rignet")]
    pub suggested_method: &'static str,
    #[schema(value_type = CategoryName, example = "biped")]
    pub category: &'static str,
    /// 0 (unknown) to 1.
    #[schema(example = 0.96, minimum = 0, maximum = 1)]
    pub category_confidence: f64,
    #[schema(value_type = PoseName, example = "a")]
    pub pose: &'static str,
    pub symmetry: Option<SymmetryView>,
    pub orientation: OrientationView,
    pub mesh: MeshView,
    pub existing: ExistingView,
    pub estimate: Option<EstimateView>,
    pub findings: Vec<FindingView>,
}

/// The best vertical mirror plane.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = SymmetryPlane)]
pub struct SymmetryView {
    pub plane: PlaneView,
    /// How well it mirrors the shape, 0 to 1. From 0.75 on, left and right are made alike.
    #[schema(example = 0.97, minimum = 0, maximum = 1)]
    pub score: f64,
}

/// A plane in the file's space.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Plane)]
pub struct PlaneView {
    /// Of unit length.
    #[schema(example = json!([1.0, 0.0, 0.0]))]
    pub normal: [f64; 3],
    #[schema(example = json!([0.0, 0.0, 0.0]))]
    pub point: [f64; 3],
}

/// Which way the character stands, in the file's space.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Orientation)]
pub struct OrientationView {
    #[schema(example = json!([0.0, 1.0, 0.0]))]
    pub up: [f64; 3],
    #[schema(example = json!([0.0, 0.0, 1.0]))]
    pub front: [f64; 3],
    /// By the request or the file, rather than guessed.
    #[schema(example = true)]
    pub given: bool,
    #[schema(example = 1.0, minimum = 0, maximum = 1)]
    pub confidence: f64,
}

/// Facts of a mesh. `null` where nothing of it has an area.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Mesh)]
pub struct MeshView {
    /// `glb`, `gltf`, `obj`, `ply`, `stl` or `fbx`.
    #[schema(example = "glb")]
    pub format: &'static str,
    #[schema(example = 2_500)]
    pub vertices: usize,
    #[schema(example = 4_996)]
    pub faces: usize,
    #[schema(example = 3)]
    pub meshes: usize,
    #[schema(example = 5)]
    pub primitives: usize,
    /// Connected parts.
    #[schema(example = 7)]
    pub components: Option<usize>,
    /// Edges with one face.
    #[schema(example = 96)]
    pub boundary_edges: Option<usize>,
    /// Edges with more than two faces.
    #[schema(example = 0)]
    pub nonmanifold_edges: Option<usize>,
    /// Faces without an area, or listed twice.
    #[schema(example = 0)]
    pub degenerate_faces: Option<usize>,
    /// Whether the surface passes through itself, as clothes that sink into a body do; `null` where there are too many faces to
    /// tell in time.
    #[schema(example = false)]
    pub self_intersecting: Option<bool>,
    /// Extent along the up axis, in the file's unit.
    #[schema(example = 1.8)]
    pub height: Option<f64>,
}

/// What the file brings along.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Existing)]
pub struct ExistingView {
    #[schema(example = 0)]
    pub skins: usize,
    #[schema(example = 0)]
    pub joints: usize,
    #[schema(example = 1)]
    pub animations: usize,
    /// Of all meshes together.
    #[schema(example = 12)]
    pub morph_targets: usize,
}

/// What rigging it will take, roughly.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Estimate)]
pub struct EstimateView {
    /// Of one core.
    #[schema(example = 1.2)]
    pub seconds: f64,
    #[schema(example = 220)]
    pub memory_mib: u64,
}

/// Three decimals: more would claim a precision that scores do not have.
fn rounded(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}

impl From<&Check> for CheckView {
    fn from(check: &Check) -> Self {
        let survey = check.survey.as_ref();
        let stance = survey.map(|survey| survey.stance);
        Self {
            object: "check",
            riggable: check.riggable.name(),
            suggested_method: check.suggested_method,
            category: stance.map_or(Category::Unknown, |stance| stance.category).name(),
            category_confidence: rounded(stance.map_or(0.0, |stance| stance.confidence)),
            pose: stance.map_or(Pose::Unknown, |stance| stance.pose).name(),
            symmetry: survey.map(|&Survey { symmetry_plane: (normal, point), symmetry_score, .. }| SymmetryView {
                plane: PlaneView { normal: normal.to_array(), point: point.to_array() },
                score: rounded(symmetry_score),
            }),
            orientation: OrientationView {
                up: check.orientation.up.to_array(),
                front: check.orientation.front.to_array(),
                given: check.orientation_given,
                confidence: rounded(check.orientation.confidence),
            },
            mesh: MeshView::from(check),
            existing: ExistingView::from(check),
            estimate: survey
                .map(|survey| EstimateView { seconds: rounded(survey.seconds), memory_mib: survey.memory_mib }),
            findings: check.findings.iter().map(FindingView::from).collect(),
        }
    }
}

impl From<&Check> for MeshView {
    fn from(check: &Check) -> Self {
        let survey = check.survey.as_ref();
        Self {
            format: Format::name(check.format),
            vertices: check.vertices,
            faces: check.faces,
            meshes: check.contents.meshes,
            primitives: check.primitives,
            components: survey.map(|survey| survey.components),
            boundary_edges: survey.map(|survey| survey.boundary_edges),
            nonmanifold_edges: survey.map(|survey| survey.nonmanifold_edges),
            degenerate_faces: survey.map(|survey| survey.degenerate_faces),
            self_intersecting: survey.and_then(|survey| survey.self_intersecting),
            height: survey.map(|survey| survey.height),
        }
    }
}

impl From<&Check> for ExistingView {
    fn from(check: &Check) -> Self {
        let ExistingRig { skins, joints } = check.existing_rig.unwrap_or(ExistingRig { skins: 0, joints: 0 });
        let (animations, morph_targets) = (check.contents.animations, check.contents.morph_targets);
        Self { skins, joints, animations, morph_targets }
    }
}
