//! What a create request says, as JSON, as parameters, and as it is told back with the job.
//!
//! Defaults stand in the texts alone: generated clients send a parameter that has a `default` always, and then it contradicts
//! the same field of the body.

use super::words::{
    BoxesName, ExistingRigName, FingersName, OutputName, PriorityName, RigEventName, SkinMethodName, SymmetryName,
};
use crate::jobs::options::{axis_name, skin_method_name};
use crate::jobs::{JobRequest, LevelOfDetail, RigOptions};
use serde::Serialize;
use std::collections::BTreeMap;
use utoipa::{IntoParams, ToSchema};

/// Options of a rig; each may be given as query parameter, form field or member of the JSON part `options`.
#[derive(Debug, Serialize, ToSchema, IntoParams)]
#[schema(as = RigOptions)]
#[into_params(parameter_in = Query)]
pub struct OptionsView {
    /// A method of `GET /v1/methods`, or `auto`, which it is unless given.
    #[param(required = false)]
    #[schema(example = "auto", required = false)]
    pub method: String,
    /// How many joints: 0 (few) to 1 (many); 0.5 unless given. Not together with `bandwidth`.
    #[param(required = false, minimum = 0, maximum = 1)]
    #[schema(example = 0.5, minimum = 0, maximum = 1, required = false)]
    pub detail: Option<f64>,
    /// For experts: RigNet's mean-shift bandwidth in units of the longest side; larger means fewer joints.
    #[param(required = false, minimum = 0.005, maximum = 0.5)]
    #[schema(example = json!(null), minimum = 0.005, maximum = 0.5, required = false)]
    pub bandwidth: Option<f64>,
    /// Whether left and right are made alike; `auto` unless given.
    #[param(required = false, value_type = SymmetryName)]
    #[schema(example = "auto", required = false, value_type = SymmetryName)]
    pub symmetry: &'static str,
    /// `auto` (unless given): hands whose shape shows three or more fingers get the joints of these, others keep what the networks
    /// find, but for two ends. `on`: the same with less to speak for a hand, and two ends stay. `off`: none.
    #[param(required = false, value_type = FingersName)]
    #[schema(example = "auto", required = false, value_type = FingersName)]
    pub fingers: &'static str,
    /// What weighs the vertices; `auto` unless given.
    #[param(required = false, value_type = SkinMethodName)]
    #[schema(example = "auto", required = false, value_type = SkinMethodName)]
    pub skin_method: &'static str,
    /// A character made of boxes: `auto` (unless given) puts joints where its boxes touch and moves each box as a whole, unless a
    /// `skin_method` is named; `off` rigs it like any other.
    #[param(required = false, value_type = BoxesName)]
    #[schema(example = "auto", required = false, value_type = BoxesName)]
    pub boxes: &'static str,
    /// Skin methods that may take the place of one that cannot run here, in this order; none unless given. `result.skin.reason` and a
    /// warning say so when one does. In a query or form, separated by commas.
    #[param(required = false, style = Form, explode = false, value_type = Vec<String>)]
    #[schema(example = json!([]), required = false, value_type = Vec<String>)]
    pub skin_fallback: Vec<&'static str>,
    /// A skeleton to make weights for, instead of making one: the text of a `rig.json`, of which `format`, `joints`, `nodes` and
    /// `skin_order` are read; in JSON also as an object. It stays as it is. A job shows how many joints it has.
    #[param(required = false)]
    #[schema(example = json!(null), required = false)]
    pub skeleton: Option<String>,
    /// Joints of a skeleton that is there which must not move vertices, such as targets of inverse kinematics: names, or patterns
    /// with `*` and `?`. They stay in the skeleton, without weights. In a query or form, separated by commas.
    #[param(required = false, style = Form, explode = false)]
    #[schema(example = json!(["IK_*"]), required = false)]
    pub non_deforming: Vec<String>,
    /// Joints of a skeleton that is there which keep the weights that they have in the file, or in the `skins` of `skeleton`; the others
    /// share what is left. Named as `non_deforming`.
    #[param(required = false, style = Form, explode = false)]
    #[schema(example = json!(["Head"]), required = false)]
    pub locked_joints: Vec<String>,
    /// Joints per vertex at most; 4 unless given.
    #[param(required = false, minimum = 1, maximum = 8)]
    #[schema(example = 4, minimum = 1, maximum = 8, required = false)]
    pub max_influences: usize,
    /// How far weights run into each other along the surface, never across a gap: 0 (as the method gives them, unless given) to 1.
    #[param(required = false, minimum = 0, maximum = 1)]
    #[schema(example = 0.0, minimum = 0, maximum = 1, required = false)]
    pub smooth: f64,
    /// Weights below this share of a vertex's are dropped; 0.001 unless given.
    #[param(required = false, minimum = 0, maximum = 0.5)]
    #[schema(example = 0.001, minimum = 0, maximum = 0.5, required = false)]
    pub prune: f64,
    /// Whether the weights of left and right are made alike, where both mesh and joints are; `off` unless given.
    #[param(required = false, value_type = SymmetryName)]
    #[schema(example = "off", required = false, value_type = SymmetryName)]
    pub mirror_weights: &'static str,
    /// The same bytes for the same seed; 0 unless given.
    #[param(required = false, minimum = 0)]
    #[schema(example = 0, minimum = 0, required = false)]
    pub seed: u64,
    /// Which way is up: `auto` (unless given), `x`, `-x`, `y`, `-y`, `z` or `-z`.
    #[param(required = false)]
    #[schema(example = "auto", required = false)]
    pub up: &'static str,
    /// Which way the character faces, in the same words.
    #[param(required = false)]
    #[schema(example = "auto", required = false)]
    pub front: &'static str,
    /// For a file that has a skeleton; `reject` unless given. `reskin` keeps it as it is, with names, order, orientations and all
    /// other nodes, and makes new weights.
    #[param(required = false, value_type = ExistingRigName)]
    #[schema(example = "reject", required = false, value_type = ExistingRigName)]
    pub existing_rig: &'static str,
    /// Files to make; `glb` and `rig_json` unless given. In a query or form, separated by commas.
    #[param(required = false, style = Form, explode = false, value_type = Vec<OutputName>)]
    #[schema(example = json!(["glb", "rig_json"]), required = false, value_type = Vec<OutputName>)]
    pub outputs: Vec<&'static str>,
}

/// How the job is treated.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = JobWishes)]
pub struct WishesView {
    /// What runs first when jobs wait; `normal` unless given.
    #[schema(example = "normal", required = false, value_type = PriorityName)]
    pub priority: &'static str,
    /// Longest run.
    #[schema(example = 300, minimum = 1, required = false)]
    pub timeout_seconds: u64,
    /// How long results are kept.
    #[schema(example = 24, minimum = 1, required = false)]
    pub retention_hours: u64,
    /// Words of your own, to find it by; 16 at most.
    #[schema(example = json!({"project": "knights"}), required = false)]
    pub labels: BTreeMap<String, String>,
    /// Where you want told what becomes of this rig, beside your webhook endpoints.
    #[schema(example = json!(null), required = false)]
    pub webhook: Option<JobWebhookView>,
}

/// Where you want told what becomes of one rig. Signed with the secret of your webhook endpoint without `url`.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = RigWebhook)]
pub struct JobWebhookView {
    /// `https`, on the public internet.
    #[schema(example = "https://studio.example/hooks/hero")]
    pub url: String,
    /// Everything that happens to it unless given.
    #[schema(value_type = Vec<RigEventName>, required = false, example = json!(["rig.succeeded", "rig.failed"]))]
    pub events: Vec<&'static str>,
}

/// The same as query parameters or fields of a form.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
pub struct WishesParameters {
    /// What runs first when jobs wait; `normal` unless given.
    #[param(example = "normal", value_type = Option<PriorityName>)]
    pub priority: Option<String>,
    /// Longest run; at most what `GET /v1/methods` says.
    #[param(minimum = 1, example = 120)]
    pub timeout_seconds: Option<u64>,
    /// How long results are kept; at most what `GET /v1/methods` says.
    #[param(minimum = 1, example = 2)]
    pub retention_hours: Option<u64>,
    /// Words of your own, to find it by: `name=value,name=value`.
    #[param(example = "project=knights")]
    pub labels: Option<String>,
    /// Where you want told what becomes of this rig; in JSON, `events` says of what.
    #[param(example = json!(null))]
    pub webhook: Option<String>,
}

/// What was asked, defaults filled in.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = RigRequest)]
pub struct RequestView {
    #[serde(flatten)]
    pub options: OptionsView,
    #[serde(flatten)]
    pub wishes: WishesView,
}

/// A create request in JSON: an asset, and any of the options.
#[derive(Serialize, ToSchema)]
#[schema(as = CreateRig)]
pub struct CreateView {
    #[schema(example = "ast_01jdf5fj5rfxm8s1m2q1d2zt8v")]
    pub asset: AssetSourceView,
    #[serde(flatten)]
    pub options: OptionsView,
    #[serde(flatten)]
    pub wishes: WishesView,
}

/// Id of an asset, a small mesh in the request itself, or where the mesh is.
#[derive(Serialize, ToSchema)]
#[serde(untagged)]
#[schema(as = AssetSource)]
pub enum AssetSourceView {
    Id(String),
    Inline { inline: InlineView },
    Fetched(FetchedView),
}

/// A mesh elsewhere, where the operator allows fetching.
#[derive(Serialize, ToSchema)]
#[schema(as = FetchedMesh)]
pub struct FetchedView {
    #[schema(example = "https://example.com/hero.glb")]
    pub url: String,
    /// Of its bytes, hexadecimal; refused when they differ.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
}

/// A mesh of 4 MiB at most.
#[derive(Serialize, ToSchema)]
#[schema(as = InlineMesh)]
pub struct InlineView {
    /// As `Content-Type` would say.
    #[schema(example = "model/gltf-binary")]
    pub media_type: String,
    /// Its bytes in base64, with padding.
    #[schema(example = "Z2xURgIAAAA=")]
    pub base64: String,
}

/// Which file to write of a rig.
#[derive(ToSchema)]
#[schema(as = ExportRig)]
pub struct ExportView {
    #[schema(value_type = OutputName, example = "gltf")]
    pub output: String,
    /// Joints per vertex at most, if not as the rig was asked for. Not more than were made.
    #[schema(example = 2, minimum = 1, maximum = 8)]
    pub max_influences: Option<usize>,
}

impl From<&RigOptions> for OptionsView {
    fn from(options: &RigOptions) -> Self {
        let (detail, bandwidth) = match options.level_of_detail {
            LevelOfDetail::Detail(detail) => (Some(detail), None),
            LevelOfDetail::Bandwidth(bandwidth) => (None, Some(bandwidth)),
        };
        Self {
            method: options.method.clone().unwrap_or_else(|| "auto".to_owned()),
            detail,
            bandwidth,
            symmetry: options.symmetry.name(),
            fingers: options.fingers.name(),
            skin_method: skin_method_name(options.skin_method),
            boxes: options.boxes.name(),
            skin_fallback: options.skin_fallback.iter().map(|method| method.name()).collect(),
            skeleton: options.skeleton.as_ref().map(|given| format!("{} joints", given.skeleton.joints.len())),
            non_deforming: options.non_deforming.clone(),
            locked_joints: options.locked_joints.clone(),
            max_influences: options.max_influences,
            smooth: options.smooth,
            prune: options.prune,
            mirror_weights: options.mirror_weights.name(),
            seed: options.seed,
            up: axis_name(options.up),
            front: axis_name(options.front),
            existing_rig: options.existing_rig.name(),
            outputs: options.outputs.iter().map(|output| output.name()).collect(),
        }
    }
}

impl From<&JobRequest> for WishesView {
    fn from(request: &JobRequest) -> Self {
        Self {
            priority: request.priority.name(),
            timeout_seconds: request.timeout.as_secs(),
            retention_hours: request.retention.as_secs().div_ceil(3600),
            labels: request.labels.clone(),
            webhook: request.webhook.as_ref().map(|webhook| JobWebhookView {
                url: webhook.url.clone(),
                events: webhook.events.iter().map(|event| event.name()).collect(),
            }),
        }
    }
}
