//! Requests for rigs: what is asked, the queue, the workers, and the one call that does the work. Knows nothing of
//! geometry.
//!
//! 1. [`options`]  what a caller may ask for, checked field by field
//! 2. [`perform`]  [`Rigger`]: request in, artifacts out; the command line and the workers call the same function
//!    ([`Engine`] is the real one)
//! 3. [`stage`]    where the work is, and how far that is
//! 4. [`failure`]  why there is no rig, by who must act
//! 5. [`upload`]   files while they arrive
//! 6. [`queue`]    [`Jobs`]: submit, look, wait, cancel, delete; the one way to jobs for every door
//! 7. [`job`]      what a caller sees
//!
//! Behind the queue: `ledger` (all jobs, as plain data) and `worker` (threads). Durable jobs will replace these two.

mod engine;
pub mod failure;
pub mod job;
mod ledger;
pub mod options;
pub mod perform;
pub mod queue;
mod report;
mod skeleton;
pub mod stage;
pub mod upload;
mod worker;

pub use engine::{Engine, check_file};
pub use failure::{ErrorClass, ErrorCode, JobError};
pub use job::{ArtifactInfo, FileInfo, Job, JobId, JobRequest, JobResult, JobState};
pub use ledger::Denied;
pub use options::{
    DEFAULT_DETAIL, DEFAULT_MAX_INFLUENCES, ExistingRigPolicy, FieldError, FieldProblem, LevelOfDetail, OptionsReader,
    Output, RigOptions, Skeleton, SkinMethod, Symmetry,
};
pub use perform::{
    Artifact, Availability, MethodInfo, ModelInfo, NamedFile, Outcome, Readiness, RigRequest, Rigger, Timing, Watch,
};
pub use queue::{Jobs, Refusal, Settings};
pub use skeleton::read_skeleton;
pub use stage::Stage;
pub use upload::{Received, Upload};
