//! The work itself: an upload's bytes in, artifacts out. The command line and the workers call the same function.

use super::check::Check;
use super::failure::{ErrorCode, JobError};
use super::given_joints::GivenJoints;
use super::options::{Boxes, Output, RigOptions};
use super::perform::{Artifact, MethodInfo, Outcome, Readiness, RigRequest, Rigger, Watch};
use super::report;
use super::skeleton::read_skeleton;
use super::stage::Stage;
use crate::formats::gltf::{EncodeOptions, JointNames, encode_glb, encode_gltf};
use crate::formats::preview::{self, PreviewOptions};
use crate::formats::{
    self, Asset, Axes, Axis, DecodeError, DecodeOptions, Finding, Limits, Severity, Siblings, rig_json, rignet_text,
};
use crate::pipelines::skin_choice::{SkinChoice, choose_skin};
use crate::pipelines::{self, LoadOptions, Method, Models, Rig, RigError, Rigged, Subject, orientation};

/// Makes rigs with the networks of one models folder.
pub struct Engine {
    models: Models,
    limits: Limits,
}

impl Engine {
    /// Loads and tests the networks. A network that fails makes its method unavailable; see [`Rigger::methods`].
    pub fn open(options: &LoadOptions) -> Result<Self, pipelines::NetError> {
        Ok(Self { models: Models::load(options)?, limits: Limits::default() })
    }

    /// Rigs one file and makes what `options.outputs` names.
    pub fn rig_file(
        &self,
        file_name: &str,
        bytes: &[u8],
        siblings: &dyn Siblings,
        options: &RigOptions,
        watch: &Watch,
    ) -> Result<Outcome, JobError> {
        let method = method_of(options)?;
        if options.skeleton.is_some() && options.existing_rig == formats::ExistingRigPolicy::Reskin {
            let message = "existing_rig=reskin keeps the skeleton of the file, and another skeleton was sent with it";
            let hint = "leave the skeleton out, or send existing_rig=replace to put it in the place of the file's";
            return Err(JobError::new(ErrorCode::SkeletonInvalid, message).hint(hint));
        }
        let choice = choose_skin(options.skin_method, &options.skin_fallback, &self.models)
            .map_err(|error| rig_failure(&error, watch))?;
        let mut upload = Upload::read(file_name, bytes, siblings, options, &self.limits, watch)?;
        let subject = Subject { mesh: &upload.asset.mesh, to_upright: upload.orientation.rotation() };
        let on_stage = |stage| watch.enter(Stage::from(stage));
        let pipeline_watch = pipelines::Watch { cancellation: watch.cancellation(), on_stage: &on_stage };
        let wanted = pipeline_options(method, options, choice);
        let joints = GivenJoints::of(options, &upload.asset).map_err(|error| staged(error, watch))?;
        let rigged = match &joints {
            None => pipelines::rig(subject, &self.models, &wanted, pipeline_watch),
            Some(joints) => pipelines::skin(subject, joints.given(), &self.models, &wanted, pipeline_watch),
        };
        let rigged = rigged.map_err(|error| rig_failure(&error, watch))?;
        watch.check()?;
        watch.enter(Stage::Export);
        upload.findings.extend(report::findings(&rigged, choice, options));
        let method_used = report::method_used(method, options, choice, &rigged.facts);
        let facts = report::facts(method, options, choice, &upload, &rigged, &self.models);
        let artifacts = options
            .outputs
            .iter()
            .map(|&output| encode(output, &upload, &rigged, method_used, options, &facts))
            .collect::<Result<Vec<_>, _>>()?;
        watch.check()?;
        Ok(Outcome { artifacts, report: facts, findings: upload.findings, method_used: method_used.to_owned() })
    }
}

/// What would be rigged and what was noticed, without running a network.
pub fn check_file(
    file_name: &str,
    bytes: &[u8],
    siblings: &dyn Siblings,
    options: &RigOptions,
    watch: &Watch,
) -> Result<Check, JobError> {
    let method = method_of(options)?;
    // A check tells of an existing rig, or that there is none, rather than refusing the file.
    let lenient = RigOptions { existing_rig: formats::ExistingRigPolicy::Replace, ..options.clone() };
    let mut upload = Upload::read(file_name, bytes, siblings, &lenient, &Limits::default(), watch)?;
    if options.existing_rig != formats::ExistingRigPolicy::Replace {
        upload.findings.retain(|finding| finding.code != formats::EXISTING_RIG_REPLACED);
    }
    Ok(Check::of(method, options, upload))
}

/// The upload of `request`, decoded as it was for its rig.
pub(super) fn decoded(request: &RigRequest) -> Result<Asset, JobError> {
    let (main, siblings) = request.split()?;
    let options = DecodeOptions { existing_rig: request.options.existing_rig, ..DecodeOptions::default() };
    formats::decode(&main.name, &main.bytes, &siblings, &Limits::default(), &options)
        .map_err(|error| refusal(&error, &Watch::unattended()))
}

/// A decoded upload and which way it stands.
pub(super) struct Upload {
    pub asset: Asset,
    pub orientation: orientation::Orientation,
    /// Whether the axes were given (by caller or file) rather than guessed.
    pub orientation_given: bool,
    pub findings: Vec<Finding>,
}

impl Upload {
    fn read(
        file_name: &str,
        bytes: &[u8],
        siblings: &dyn Siblings,
        options: &RigOptions,
        limits: &Limits,
        watch: &Watch,
    ) -> Result<Self, JobError> {
        watch.check()?;
        watch.enter(Stage::Ingest);
        let decode_options = DecodeOptions {
            existing_rig: options.existing_rig,
            old_rig: !options.locked_joints.is_empty(),
            ..DecodeOptions::default()
        };
        let asset = formats::decode(file_name, bytes, siblings, limits, &decode_options)
            .map_err(|error| refusal(&error, watch))?;
        watch.check()?;
        watch.enter(Stage::Check);
        let mut findings = asset.findings.clone();
        let (orientation, given) = orientation_of(&asset, options, &mut findings).ok_or_else(|| {
            JobError::new(ErrorCode::NotRiggable, "up and front lie on one line")
                .hint("name both, up and front, as the character stands in the file")
                .at(Stage::Check)
        })?;
        Ok(Self { asset, orientation, orientation_given: given, findings })
    }
}

impl Rigger for Engine {
    fn perform(&self, request: &RigRequest, watch: &Watch) -> Result<Outcome, JobError> {
        let (main, siblings) = request.split()?;
        let mut options = request.options.clone();
        if let Some(bytes) = &request.skeleton {
            options.skeleton = Some(read_skeleton(bytes, !options.locked_joints.is_empty())?);
        }
        self.rig_file(&main.name, &main.bytes, &siblings, &options, watch)
    }

    fn check(&self, request: &RigRequest, watch: &Watch) -> Result<Check, JobError> {
        let (main, siblings) = request.split()?;
        check_file(&main.name, &main.bytes, &siblings, &request.options, watch)
    }

    fn engine_version(&self) -> String {
        format!("{}/{}", env!("CARGO_PKG_VERSION"), pipelines::REVISION)
    }

    fn methods(&self) -> Vec<MethodInfo> {
        Method::ALL.into_iter().map(|method| report::method_info(method, &self.models, &self.limits)).collect()
    }

    fn unavailable(&self, options: &RigOptions) -> Option<String> {
        let method = method_of(options).ok()?;
        // A skeleton that is there needs no network for its joints. One that comes beside the options is not seen here, so the
        // job itself may still find that it could have run.
        if let Some(reason) = pipelines::unavailable(method, &self.models).filter(|_| !options.keeps_skeleton()) {
            return Some(format!("method {} cannot run here: {reason}", method.name()));
        }
        choose_skin(options.skin_method, &options.skin_fallback, &self.models).err().map(|error| error.to_string())
    }

    fn ready(&self) -> Readiness {
        let reasons: Vec<String> =
            Method::ALL.into_iter().filter_map(|method| pipelines::unavailable(method, &self.models)).collect();
        if reasons.len() < Method::ALL.len() {
            Readiness::Ready
        } else {
            Readiness::Unavailable { reason: reasons.join("; ") }
        }
    }
}

fn method_of(options: &RigOptions) -> Result<Method, JobError> {
    let Some(name) = &options.method else { return Ok(Method::RigNet) };
    Method::from_name(name).ok_or_else(|| {
        let known = Method::ALL.map(Method::name).join(", ");
        JobError::new(ErrorCode::ModelUnavailable, format!("there is no method {name:?}"))
            .hint(format!("name one of {known}, or leave it out"))
    })
}

fn pipeline_options(method: Method, options: &RigOptions, choice: SkinChoice) -> pipelines::RigOptions {
    pipelines::RigOptions {
        method,
        level_of_detail: options.level_of_detail,
        symmetry: options.symmetry,
        fingers: options.fingers,
        skin_method: choice.method,
        boxes: options.boxes == Boxes::Auto,
        rigid_boxes: options.boxes == Boxes::Auto && options.skin_method.is_none() && options.smooth == 0.0,
        max_influences: options.max_influences,
        smooth: options.smooth,
        prune: options.prune,
        mirror_weights: options.mirror_weights,
        seed: options.seed,
    }
}

/// The axes that the caller names, else those of the file, else a guess. Second: whether nothing was guessed.
/// `None` where up and front lie on one line.
fn orientation_of(
    asset: &Asset,
    options: &RigOptions,
    findings: &mut Vec<Finding>,
) -> Option<(orientation::Orientation, bool)> {
    let from_file = asset.axes;
    let guess = match (from_file, options.up, options.front) {
        (None, up, front) if up.is_none() || front.is_none() => Some(orientation::guess_orientation(&asset.mesh)),
        _ => None,
    };
    let direction = |axis: Axis| axis.direction();
    let file_up = from_file.map(|Axes { up, .. }| direction(up));
    let file_front = from_file.map(|Axes { front, .. }| direction(front));
    let up = options.up.map(direction).or(file_up).or(guess.map(|guess| guess.up))?;
    let front = options.front.map(direction).or(file_front).or(guess.map(|guess| guess.front))?;
    let front = match up.cross(front).length_squared() > 0.5 {
        true => front,
        // A named up axis may lie along the file's or the guessed front: any other axis will do then.
        false if options.front.is_none() => orientation::any_front(up),
        false => return None,
    };
    let confidence = guess.map_or(1.0, |guess| guess.confidence);
    if let Some(guess) = guess {
        findings.push(Finding {
            code: "orientation_guessed",
            parts: Vec::new(),
            severity: if guess.confidence < 0.5 { Severity::Warning } else { Severity::Info },
            message: match (options.up, options.front) {
                (Some(_), _) => format!("the file does not say where its character faces: took {}", axis_words(front)),
                (None, Some(_)) => format!("the file does not say which way is up: took {}", axis_words(up)),
                (None, None) => format!(
                    "the file does not say which way is up: took {} as up and {} as front (confidence {:.2})",
                    axis_words(up),
                    axis_words(front),
                    guess.confidence
                ),
            },
            hint: "name them by up and front if this is wrong".into(),
        });
    }
    Some((orientation::Orientation { up, front, confidence }, guess.is_none()))
}

fn axis_words(direction: glam::DVec3) -> &'static str {
    Axis::along(direction).map_or("another direction", Axis::name)
}

fn refusal(error: &DecodeError, watch: &Watch) -> JobError {
    let code = ErrorCode::named(error.code()).unwrap_or(ErrorCode::UnreadableMesh);
    let refused =
        JobError { limit: error.limit().map(Into::into), ..JobError::new(code, error.to_string()).hint(error.hint()) };
    staged(refused, watch)
}

fn rig_failure(error: &RigError, watch: &Watch) -> JobError {
    let code = ErrorCode::named(error.code()).unwrap_or(ErrorCode::Internal);
    staged(JobError::new(code, error.to_string()).hint(error.hint()), watch)
}

fn staged(error: JobError, watch: &Watch) -> JobError {
    match watch.stage() {
        Some(stage) => error.at(stage),
        None => error,
    }
}

fn encode(
    output: Output,
    upload: &Upload,
    rigged: &Rigged,
    method: &str,
    wanted: &RigOptions,
    facts: &serde_json::Map<String, serde_json::Value>,
) -> Result<Artifact, JobError> {
    let names = if wanted.keeps_skeleton() { JointNames::AsGiven } else { JointNames::Plain };
    let nodes = wanted.skeleton.as_ref().and_then(|given| given.nodes.clone());
    let options = EncodeOptions { influences_max: wanted.max_influences, names, nodes, ..EncodeOptions::default() };
    encode_rig(output, &upload.asset, axes_of(&upload.orientation), &rigged.rig, &options, method, facts)
}

fn axes_of(orientation: &orientation::Orientation) -> Axes {
    let usual = PreviewOptions::default().axes;
    Axes {
        up: Axis::along(orientation.up).unwrap_or(usual.up),
        front: Axis::along(orientation.front).unwrap_or(usual.front),
    }
}

/// One file of a rig. `facts` go into `rig.json`; `axes` are those by which a picture is taken.
pub(super) fn encode_rig(
    output: Output,
    asset: &Asset,
    axes: Axes,
    rig: &Rig,
    options: &EncodeOptions,
    method: &str,
    facts: &serde_json::Map<String, serde_json::Value>,
) -> Result<Artifact, JobError> {
    let invalid = |cause: String| {
        JobError::new(ErrorCode::OutputInvalid, format!("{} was not written: {cause}", output.name()))
            .at(Stage::Export)
            .hint("report this as a bug, with the file")
    };
    let bytes = match output {
        Output::Glb => encode_glb(asset, rig, options).map_err(|error| invalid(error.to_string()))?,
        Output::Gltf => encode_gltf(asset, rig, options).map_err(|error| invalid(error.to_string()))?,
        Output::RigJson => {
            rig_json::write(asset, rig, options.nodes.as_ref(), options.names, method, &facts.clone().into())
        }
        Output::RignetTxt => rignet_text::write(asset, rig).into_bytes(),
        Output::PreviewPng => {
            preview::preview_png(&asset.mesh, rig, &PreviewOptions { axes, ..PreviewOptions::default() })
        }
    };
    Ok(Artifact { name: output.file_name().into(), media_type: output.media_type(), bytes })
}
