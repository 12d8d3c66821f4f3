//! What is said of a rig, in plain JSON: the `report` of `rig.json`, the `result` of a job.
//!
//! Nothing here depends on the clock: equal requests give equal reports.

use super::engine::Upload;
use super::options::RigOptions;
use super::perform::{Availability, MethodInfo, ModelInfo, SkinMethodInfo};
use crate::formats::{Finding, Limits, Severity};
use crate::pipelines::skin_choice::{SkinChoice, skin_unavailable};
use crate::pipelines::{self, Facts, Method, Models, Quality, Rigged, SkinMethod, Verdict};
use serde_json::{Map, Value, json};

/// The facts of a finished rig.
pub fn facts(
    method: Method,
    options: &RigOptions,
    choice: SkinChoice,
    upload: &Upload,
    rigged: &Rigged,
    models: &Models,
) -> Map<String, Value> {
    let (rig, facts) = (&rigged.rig, &rigged.facts);
    let reason = if facts.is_rigid { "each box of the character moves as a whole".to_owned() } else { choice.reason() };
    let digests: Vec<Value> =
        models.statuses().iter().map(|model| json!({"name": model.name, "sha256": model.sha256})).collect();
    object(json!({
        "method": method_used(method, options, choice, facts),
        "service_version": env!("CARGO_PKG_VERSION"),
        "models": digests,
        "options": {
            "bandwidth": facts.bandwidth,
            "max_influences": options.max_influences,
            "smooth": options.smooth,
            "prune": options.prune,
            "mirror_weights": options.mirror_weights.name(),
            "symmetry": options.symmetry.name(),
            "seed": options.seed,
        },
        "skeleton": {
            "joints": rig.skeleton.joints.len(),
            "root": rig.skeleton.joints.first().map(|joint| joint.name.clone()),
            "depth": rig.skeleton.depth(),
            "symmetric": facts.quality.mirror_error.is_some_and(|error| error < MIRRORED),
            "given": options.keeps_skeleton(),
            "boxes": facts.boxes,
            "fingers": facts.fingers,
        },
        "skin": {
            "vertices": rig.skin.rows.len(),
            "max_influences": rig.skin.rows.iter().map(Vec::len).max().unwrap_or(0),
            "unweighted": 0,
            "method": skin_method(choice, facts),
            "reason": reason,
            "by_nearest_bone": facts.vertices_by_nearest_bone,
            "mirrored": facts.vertices_mirrored,
        },
        "symmetry": {
            "score": rounded(facts.symmetry_score),
            "plane": facts.symmetry_plane.map(|(normal, point)| json!({
                "normal": normal.to_array(), "point": point.to_array(),
            })),
        },
        "orientation": orientation(upload),
        "quality": quality(&facts.quality, &rig.skeleton.joints.iter().map(|joint| joint.name.as_str()).collect::<Vec<_>>()),
        "working_mesh": {"vertices": facts.working_vertices, "triangles": facts.working_triangles},
        "input": input(upload),
        "findings": upload.findings.iter().map(finding).collect::<Vec<_>>(),
    }))
}

/// The name of what made the rig: the method, or for a skeleton that was there what weighed the vertices.
pub fn method_used(method: Method, options: &RigOptions, choice: SkinChoice, facts: &Facts) -> &'static str {
    if options.keeps_skeleton() { skin_method(choice, facts) } else { method.name() }
}

/// The name of what weighed the vertices.
fn skin_method(choice: SkinChoice, facts: &Facts) -> &'static str {
    if facts.is_rigid { RIGID_BOXES } else { choice.method.name() }
}

/// The figures of [`Quality`]; bleeding is told of the joints that do.
fn quality(quality: &Quality, names: &[&str]) -> Value {
    let bleeding = quality.bleed.iter().zip(names).filter(|(share, _)| **share >= BLEED_TOLD);
    let bleed: Map<String, Value> =
        bleeding.map(|(share, name)| ((*name).to_owned(), rounded(*share).into())).collect();
    json!({
        "verdict": quality.verdict.name(),
        "reasons": quality.reasons,
        "joints_inside": rounded(quality.joints_inside),
        "bone_outside": rounded(quality.bone_outside),
        "bleed": bleed,
        "mirror_error": quality.mirror_error.map(rounded),
        "weight_roughness": rounded(quality.roughness),
        "edge_stretch": rounded(quality.stretch),
        "volume_change": quality.volume_change.map(rounded),
    })
}

/// Less than this share of a joint's weight far from it is not worth a line.
const BLEED_TOLD: f64 = 0.005;

/// A skeleton whose joints lie so near to each other's mirror images is symmetric; in longest sides of the mesh.
const MIRRORED: f64 = 0.005;

/// The skin method of characters made of boxes.
const RIGID_BOXES: &str = "rigid_boxes";

/// What is worth telling about the rig besides its facts.
pub fn findings(rigged: &Rigged, choice: SkinChoice, options: &RigOptions) -> Vec<Finding> {
    let Facts { vertices_by_nearest_bone, joints_inside, ref joints_far_outside, .. } = rigged.facts;
    let mut findings = Vec::new();
    if let Some(boxes) = rigged.facts.boxes {
        findings.push(Finding {
            code: "made_of_boxes",
            parts: Vec::new(),
            severity: Severity::Info,
            message: match rigged.facts.is_rigid {
                true => format!("the character is made of {boxes} boxes: each moves as a whole"),
                false => format!("the character is made of {boxes} boxes: its joints lie where they touch"),
            },
            hint: "send `boxes: off` to rig it like any other".into(),
        });
    }
    if choice.in_place_of.is_some() {
        findings.push(Finding {
            code: "skin_fallback",
            parts: Vec::new(),
            severity: Severity::Warning,
            message: choice.reason(),
            hint: "ask the operator to have the networks repaired".into(),
        });
    }
    if let Some(first) = joints_far_outside.first().and_then(|&joint| rigged.rig.skeleton.joints.get(joint)) {
        findings.push(Finding {
            code: "joints_far_outside",
            parts: Vec::new(),
            severity: Severity::Warning,
            message: format!(
                "{} of {} joints are nowhere near the mesh, the first is {:?}",
                joints_far_outside.len(),
                rigged.rig.skeleton.joints.len(),
                first.name
            ),
            hint: "check that skeleton and mesh have the same unit, axes and place".into(),
        });
    }
    if vertices_by_nearest_bone > 0 {
        findings.push(Finding {
            code: "vertices_by_nearest_bone",
            parts: Vec::new(),
            severity: Severity::Info,
            message: format!(
                "{vertices_by_nearest_bone} vertices got no weights of their own and follow the nearest bone"
            ),
            hint: "check these parts in a pose".into(),
        });
    }
    if rigged.facts.vertices_mirrored == Some(0) {
        findings.push(Finding {
            code: "weights_not_mirrored",
            parts: Vec::new(),
            severity: Severity::Warning,
            message: "no weights were made alike: mesh and skeleton have no left and right that match".into(),
            hint: "place the joints of both sides alike, or leave mirror_weights out".into(),
        });
    }
    if joints_inside < JOINTS_INSIDE_USUAL {
        findings.push(Finding {
            code: "joints_outside",
            parts: Vec::new(),
            severity: Severity::Warning,
            message: format!("only {:.0} % of the joints lie inside the mesh", joints_inside * 100.0),
            hint: match options.keeps_skeleton() {
                true => "check that the skeleton fits the mesh".into(),
                false => "check the skeleton; another `detail` may place it better".into(),
            },
        });
    }
    if rigged.facts.quality.verdict == Verdict::Poor {
        findings.push(Finding {
            code: "poor_quality",
            parts: Vec::new(),
            severity: Severity::Warning,
            message: format!("the rig is poor: {}", rigged.facts.quality.reasons.join("; ")),
            hint: "look at it in motion; edit the skeleton and ask for new weights".into(),
        });
    }
    findings
}

/// Below this share of joints inside the solid a rig deserves a look. Artists' rigs of the validation characters have
/// their joints inside but for ends of ears, feet and props.
const JOINTS_INSIDE_USUAL: f64 = 0.7;

/// A method as the service lists it.
pub fn method_info(method: Method, models: &Models, limits: &Limits) -> MethodInfo {
    let (title, description) = match method {
        Method::RigNet => (
            "RigNet",
            "A skeleton for any character by mesh graph networks [Xu et al. 2020, Neural Rigging for Articulated \
             Characters], skin weights by the method that skin_method names",
        ),
    };
    MethodInfo {
        name: method.name().into(),
        title: title.into(),
        description: description.into(),
        availability: availability(pipelines::unavailable(method, models).or_else(|| default_skin_unavailable(models))),
        licence: models.licence().weights.clone(),
        // Any skin network may have a part in its rigs, so all are its networks: a kept result is of all their digests.
        models: models
            .statuses()
            .iter()
            .map(|model| ModelInfo {
                name: model.name.into(),
                sha256: model.sha256.clone(),
                self_test: model.failure.clone().unwrap_or_else(|| "passed".into()),
            })
            .collect(),
        skin_methods: skin_methods(models),
        limits: vec![
            ("bytes", limits.bytes_max),
            ("vertices", limits.vertices_max as u64),
            ("faces", limits.faces_max as u64),
            ("nodes", limits.nodes_max as u64),
            ("unzip_ratio", limits.unzip_ratio_max),
        ],
    }
}

fn availability(unavailable: Option<String>) -> Availability {
    unavailable.map_or(Availability::Available, |reason| Availability::Unavailable { reason })
}

/// Why a request that names no skin method would fail.
fn default_skin_unavailable(models: &Models) -> Option<String> {
    let best = SkinMethod::best();
    let reason = skin_unavailable(best, models)?;
    Some(format!(
        "its skin method {} is not available ({reason}); requests that name another skin_method run",
        best.name()
    ))
}

fn skin_methods(models: &Models) -> Vec<SkinMethodInfo> {
    let mut methods = SkinMethod::ALL;
    methods.sort_by(|a, b| a.measured().all.total_cmp(&b.measured().all));
    let info = |method: SkinMethod| SkinMethodInfo {
        name: method.name(),
        availability: availability(skin_unavailable(method, models)),
        is_auto: method == SkinMethod::best(),
        mean_l1: method.measured(),
    };
    methods.into_iter().map(info).collect()
}

fn orientation(upload: &Upload) -> Value {
    json!({
        "up": upload.orientation.up.to_array(),
        "front": upload.orientation.front.to_array(),
        "given": upload.orientation_given,
        "confidence": rounded(upload.orientation.confidence),
    })
}

fn input(upload: &Upload) -> Value {
    let asset = &upload.asset;
    json!({
        "format": asset.format.name(),
        "vertices": asset.mesh.positions.len(),
        "faces": asset.mesh.triangles.len(),
        "primitives": asset.parts.len(),
    })
}

fn finding(finding: &Finding) -> Value {
    let severity = match finding.severity {
        Severity::Info => "info",
        Severity::Warning => "warning",
    };
    let Finding { code, parts, message, hint, .. } = finding;
    json!({"code": code, "severity": severity, "message": message, "hint": hint, "where": parts})
}

/// Three decimals: more would claim a precision that scores do not have.
fn rounded(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}

fn object(value: Value) -> Map<String, Value> {
    match value {
        Value::Object(fields) => fields,
        _ => Map::new(),
    }
}
