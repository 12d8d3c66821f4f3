//! Requests for rigs: what is asked, the queue, the workers, and the one call that does the work. Knows nothing of
//! geometry.
//!
//! For doors:
//!
//! 1. [`options`]     what a caller may ask for, checked field by field by `options_reader`
//! 2. [`upload`]      [`Upload`], [`Received`]: files while they arrive; dropped, they leave nothing
//! 3. [`submission`]  [`Submission`]: who asks for what, how urgently; [`Refusal`]: why not
//! 4. [`queue`]       [`Jobs`]: the one way to jobs and assets, see below; its parts `looking` (what became of them), `checking` (a
//!    look at a mesh without a job), `exporting` (other forms of a rig), `keeping` (assets, contents), `resuming` (uploads in parts),
//!    `batching` and `notifying` stand in files of their own
//! 5. [`job`], [`asset`], [`batch`], `resumable`, [`event`], [`page`], [`webhooks`]  what a caller sees; [`failure`] why there is no rig,
//!    by who must act
//!
//! | wish | call |
//! |---|---|
//! | receive files | [`Jobs::upload`] → [`Upload::begin`], [`Upload::append`], [`Upload::finish`] → [`Received`] |
//! | receive one file in parts | [`Jobs::begin_resumable`], [`Jobs::resumable`], [`Jobs::add_to_resumable`], [`Jobs::delete_resumable`] |
//! | keep them | [`Jobs::put_asset`], [`Jobs::asset`], [`Jobs::delete_asset`] |
//! | look at a mesh | [`Jobs::check`], [`Jobs::check_asset`] → [`Check`] |
//! | a job | [`Jobs::submit`] of [`Submission::new`]`(caller, source, options)`; [`Submitted::replayed`] tells a repetition |
//! | look | [`Jobs::get`], [`Jobs::get_by_client_id`], [`Jobs::list`], [`Jobs::wait`] |
//! | watch | [`Jobs::events`] → [`Events::next`]: snapshot, state, progress, warning, artifact, done |
//! | stop | [`Jobs::cancel`], [`Jobs::delete`] |
//! | bytes | [`Jobs::open`] by digest → [`Content::stream`](crate::storage::Content::stream) |
//! | many at once | [`Jobs::create_batch`], [`Jobs::batch`], [`Jobs::batch_items`], [`Jobs::cancel_batch`]; whoever reads the requests of the items feeds the queue: [`Jobs::open_batches`], [`Jobs::pending_items`], [`Jobs::settle_item`], [`Jobs::conclude_batches`] |
//! | tell callers | [`Jobs::create_endpoint`] and its neighbours in `notifying`; whoever reaches the endpoints sends: [`Jobs::claim_deliveries`], [`Jobs::note_attempt`] |
//! | repeat any other POST | [`Jobs::recall`], [`Jobs::remember`] |
//! | end | [`Jobs::drain`], [`Jobs::idle`], [`Jobs::stop_running`], [`Jobs::close`] |
//!
//! Everything is scoped by [`Caller`]: what belongs to one caller is not there for another.
//!
//! For the work: [`perform`] ([`Rigger`]: request in, artifacts out; [`Engine`] is the real one) and [`stage`].
//!
//! Behind the queue: [`store`] (where jobs are written down, and the rules that hold for them), `worker` (threads),
//! `keeper` (leases, deadlines, retention), `running` (work in progress), [`memory`], [`cores`], `recipe` (what makes
//! two requests the same).

pub mod asset;
pub mod batch;
mod batching;
pub mod check;
mod checking;
pub mod clock;
mod core;
pub mod cores;
mod counted;
mod engine;
pub mod event;
mod exporting;
pub mod failure;
mod given_joints;
mod history;
pub mod ids;
pub mod job;
mod joint_pattern;
mod keeper;
mod keeping;
mod looking;
pub mod memory;
mod notifying;
pub mod options;
mod options_reader;
pub mod page;
pub mod perform;
pub mod queue;
mod recipe;
mod report;
mod resumable;
mod resuming;
mod running;
mod settings;
mod skeleton;
pub mod stage;
pub mod store;
pub mod submission;
pub mod upload;
mod watchers;
pub mod webhooks;
mod worker;

pub use asset::{Asset, PutAsset};
pub use batch::{Batch, BatchCounts, BatchItem, ItemState, NewBatch, NewItem, OpenBatch, PendingItem, Settled};
pub use check::{Check, Riggable};
pub use engine::{Engine, check_file};
pub use event::{Event, EventKind};
pub use failure::{ErrorClass, ErrorCode, JobError, PassedLimit};
pub use history::Events;
pub use ids::{AssetId, BatchId, EndpointId, JobId, MessageId, NotAnId, UploadId};
pub use job::{ArtifactInfo, FileInfo, Job, JobRequest, JobResult, JobState, Notice};
pub use looking::Denied;
pub use options::{
    Boxes, DEFAULT_DETAIL, DEFAULT_MAX_INFLUENCES, ExistingRigPolicy, FieldError, FieldProblem, Fingers, GivenSkeleton,
    LevelOfDetail, OptionsReader, Output, RigOptions, Skeleton, SkinMethod, Symmetry,
};
pub use page::{NoPage, Page};
pub use perform::{
    Artifact, Availability, MethodInfo, ModelInfo, NamedFile, Outcome, Readiness, RigRequest, Rigger, SkinMethodInfo,
    Timing, Watch,
};
pub use queue::{Jobs, StartError};
pub use resumable::{NewResumable, NotAdded, Resumable, ResumableState};
pub use settings::Settings;
pub use skeleton::{canonical_skeleton, read_skeleton};
pub use stage::Stage;
pub use store::{Counts, JobFilter, Remembered, StoreFailure};
pub use submission::{Caller, Labels, Missing, Priority, Refusal, Source, Submission, Submitted};
pub use upload::{Received, Upload, asset_sha256};
pub use webhooks::JobWebhook;
