//! The one call that does the work, for the command line and for the workers.

use super::check::Check;
use super::failure::{ErrorCode, JobError};
use super::options::{Output, RigOptions};
use super::stage::Stage;
use crate::cancellation::{Cancellation, Cancelled};
use crate::formats::{Finding, Siblings};
use crate::pipelines::skin_choice::MeasuredL1;
use bytes::Bytes;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Makes rigs. One value serves all workers at once.
pub trait Rigger: Send + Sync {
    /// Rigs the first file of `request`. Looks at `watch` between steps and says where it is.
    fn perform(&self, request: &RigRequest, watch: &Watch) -> Result<Outcome, JobError>;

    /// What would be rigged, without doing it: findings and an estimate. Fast (below 2 s), no networks.
    fn check(&self, request: &RigRequest, watch: &Watch) -> Result<Check, JobError>;

    /// Names what decides a result beside files, options and networks: equal requests under another version are done anew.
    fn engine_version(&self) -> String;

    /// Every method this build knows, also those that cannot run here.
    fn methods(&self) -> Vec<MethodInfo>;

    /// Why a job with `options` cannot run here; `None` when it can.
    fn unavailable(&self, options: &RigOptions) -> Option<String> {
        let wanted = options.method.as_ref()?;
        let methods = self.methods();
        match &methods.iter().find(|method| method.name == *wanted)?.availability {
            Availability::Available => None,
            Availability::Unavailable { reason } => Some(format!("method {wanted} cannot run here: {reason}")),
        }
    }

    /// Whether the networks are loaded and have passed their self-tests.
    fn ready(&self) -> Readiness;
}

/// A mesh to rig: its files, the main one first, and what is wanted.
#[derive(Clone, Debug, PartialEq)]
pub struct RigRequest {
    pub files: Vec<NamedFile>,
    pub options: RigOptions,
    /// `rig.json` with a skeleton to keep: only the skin is made.
    pub skeleton: Option<Bytes>,
}

impl RigRequest {
    /// The file to rig and those sent with it.
    pub fn split(&self) -> Result<(&NamedFile, SentAlong<'_>), JobError> {
        let (main, others) = self
            .files
            .split_first()
            .ok_or_else(|| JobError::new(ErrorCode::UnreadableMesh, "no file was sent").hint("send a mesh"))?;
        Ok((main, SentAlong(others)))
    }
}

/// The further files of an upload.
pub struct SentAlong<'a>(&'a [NamedFile]);

impl Siblings for SentAlong<'_> {
    fn read(&self, name: &str) -> Option<Vec<u8>> {
        self.0.iter().find(|file| file.name == name).map(|file| file.bytes.to_vec())
    }
}

/// A file of an upload. `name` is relative, with `/` between folders, and leaves the upload by no path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamedFile {
    pub name: String,
    pub bytes: Bytes,
}

/// What the work gives back.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Distinct names.
    pub artifacts: Vec<Artifact>,
    /// `skeleton`, `skin` and whatever else is worth saying; becomes the job's `result`, beside its `artifacts`.
    pub report: serde_json::Map<String, serde_json::Value>,
    pub findings: Vec<Finding>,
    /// Name of the method that made the rig.
    pub method_used: String,
}

impl Outcome {
    pub fn artifact(&self, output: Output) -> Option<&Artifact> {
        self.artifacts.iter().find(|artifact| artifact.name == output.file_name())
    }

    pub fn joint_count(&self) -> u64 {
        self.report.get("skeleton").and_then(|skeleton| skeleton.get("joints")?.as_u64()).unwrap_or(0)
    }

    /// What weighed the vertices, and why that: one sentence.
    pub fn skin_reason(&self) -> Option<&str> {
        self.report.get("skin")?.get("reason")?.as_str()
    }

    /// The report with what differs from run to run: the time that each stage took, in milliseconds.
    pub fn timed_report(&self, watch: &Watch) -> serde_json::Map<String, serde_json::Value> {
        let mut report = self.report.clone();
        let millis = |timing: &Timing| (timing.duration.as_micros() as f64 / 1000.0).into();
        let timings: serde_json::Map<String, serde_json::Value> =
            watch.timings().iter().map(|timing| (timing.stage.name().to_owned(), millis(timing))).collect();
        report.insert("timings_ms".into(), timings.into());
        report
    }
}

/// A file that was made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Artifact {
    /// ASCII letters, digits, `.`, `-` and `_`.
    pub name: String,
    pub media_type: &'static str,
    pub bytes: Vec<u8>,
}

/// A method and whether it can run here.
#[derive(Clone, Debug, PartialEq)]
pub struct MethodInfo {
    pub name: String,
    pub title: String,
    /// For people: what it is good for, with the citation.
    pub description: String,
    pub availability: Availability,
    /// Licence of the weights.
    pub licence: String,
    pub models: Vec<ModelInfo>,
    /// What may weigh the vertices, the best first.
    pub skin_methods: Vec<SkinMethodInfo>,
    /// What an upload may have at most, as in `("faces", 2_000_000)`.
    pub limits: Vec<(&'static str, u64)>,
}

/// A skin method, whether it can run here, and how good it is.
#[derive(Clone, Debug, PartialEq)]
pub struct SkinMethodInfo {
    pub name: &'static str,
    pub availability: Availability,
    /// `auto` means this one.
    pub is_auto: bool,
    /// Mean error on validation rigs.
    pub mean_l1: MeasuredL1,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Availability {
    Available,
    Unavailable { reason: String },
}

/// A network of a method.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelInfo {
    pub name: String,
    /// Lower-case hexadecimal.
    pub sha256: String,
    /// What the known-answer test at start gave: `passed`, or why not.
    pub self_test: String,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Readiness {
    /// Networks are being loaded and tested.
    Starting,
    Ready,
    /// No method can run; the reason.
    Unavailable {
        reason: String,
    },
}

/// The view of running work from outside: it may be asked to stop, and it tells where it is.
pub struct Watch {
    cancellation: Cancellation,
    on_enter: Box<dyn Fn(Stage) + Send + Sync>,
    /// Stages entered, each with its moment.
    entered: Mutex<Vec<(Stage, Instant)>>,
}

/// Wall time spent in one stage, all visits together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    pub stage: Stage,
    pub duration: Duration,
}

impl Watch {
    pub fn new(cancellation: Cancellation, on_enter: impl Fn(Stage) + Send + Sync + 'static) -> Self {
        Self { cancellation, on_enter: Box::new(on_enter), entered: Mutex::default() }
    }

    /// Nobody cancels and nobody looks.
    pub fn unattended() -> Self {
        Self::new(Cancellation::default(), |_| {})
    }

    /// The work begins `stage`; the stage before it is over.
    pub fn enter(&self, stage: Stage) {
        self.entered.lock().unwrap_or_else(PoisonError::into_inner).push((stage, Instant::now()));
        (self.on_enter)(stage);
    }

    pub fn cancellation(&self) -> &Cancellation {
        &self.cancellation
    }

    pub fn check(&self) -> Result<(), Cancelled> {
        self.cancellation.check()
    }

    /// The stage entered last.
    pub fn stage(&self) -> Option<Stage> {
        self.entered.lock().unwrap_or_else(PoisonError::into_inner).last().map(|(stage, _)| *stage)
    }

    /// Time per stage in stage order; the last one lasts until now.
    pub fn timings(&self) -> Vec<Timing> {
        let now = Instant::now();
        let entered = self.entered.lock().unwrap_or_else(PoisonError::into_inner);
        let ends = entered.iter().skip(1).map(|(_, at)| *at).chain([now]);
        let visits: Vec<(Stage, Duration)> =
            entered.iter().zip(ends).map(|((stage, from), to)| (*stage, to.duration_since(*from))).collect();
        Stage::ALL
            .into_iter()
            .filter(|stage| visits.iter().any(|(visited, _)| visited == stage))
            .map(|stage| {
                let duration = visits.iter().filter(|(visited, _)| *visited == stage).map(|(_, time)| *time).sum();
                Timing { stage, duration }
            })
            .collect()
    }
}
