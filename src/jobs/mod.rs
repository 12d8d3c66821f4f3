//! Requests for rigs: what is asked, the queue, the workers, and the one call that does the work. Knows nothing of
//! geometry.
//!
//! 1. [`options`]  what a caller may ask for, checked field by field
//! 2. [`perform`]  [`Rigger`]: request in, artifacts out; the command line and the workers call the same function
//! 3. [`stage`]    where the work is, and how far that is
//! 4. [`failure`]  why there is no rig, by who must act

pub mod failure;
pub mod options;
pub mod perform;
pub mod stage;

pub use failure::{ErrorClass, ErrorCode, JobError};
pub use options::{
    DEFAULT_DETAIL, DEFAULT_MAX_INFLUENCES, ExistingRigPolicy, FieldError, FieldProblem, LevelOfDetail, OptionsReader,
    Output, RigOptions, Symmetry,
};
pub use perform::{
    Artifact, Availability, MethodInfo, ModelInfo, NamedFile, Outcome, Readiness, RigRequest, Rigger, Timing, Watch,
};
pub use stage::Stage;
