//! What happens to a job, as a numbered list that a watcher can take up again where it stopped.

use super::failure::JobError;
use super::job::{ArtifactInfo, Job, JobState, Notice};
use super::stage::Stage;
use std::time::SystemTime;

/// One entry of a job's history. Numbers rise without gaps from 1 and survive a restart.
#[derive(Clone, Debug)]
pub struct Event {
    pub sequence: u64,
    pub at: SystemTime,
    pub kind: EventKind,
}

#[derive(Clone, Debug)]
pub enum EventKind {
    /// The job as it is: the first thing that a new watcher gets. Carries the number of the last event before it.
    Snapshot(Box<Job>),
    State {
        state: JobState,
        attempt: u32,
    },
    /// A stage began. At most four a second.
    Progress {
        stage: Stage,
        progress: u8,
    },
    Warning(Notice),
    Artifact(ArtifactInfo),
    /// Nothing more will happen. Look at the job for its result.
    Done {
        state: JobState,
        error: Option<JobError>,
    },
}

impl EventKind {
    /// The event's name in a stream.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Snapshot(_) => "snapshot",
            Self::State { .. } => "state",
            Self::Progress { .. } => "progress",
            Self::Warning(_) => "warning",
            Self::Artifact(_) => "artifact",
            Self::Done { .. } => "done",
        }
    }
}
