//! Webhooks: what callers are told when their rigs and batches change, as [Standard Webhooks 1.0] has it. A message is written
//! down together with the change that it tells of, once for each endpoint that wants it, and sent until it is taken.
//!
//! | an endpoint answers | what follows |
//! |---|---|
//! | `2xx` within [`ANSWER_TIME`] | the message is delivered |
//! | `410` | the message has failed, and the endpoint is disabled |
//! | `429`, `502`, `503`, `504` | the endpoint is left alone for `Retry-After`, or [`REST`]; then as below |
//! | anything else, or nothing | tried again by [`SCHEDULE`], and no sooner than `Retry-After` says |
//!
//! What a single job wants told goes where it says, and an answer there is about that message alone.
//!
//! A message may arrive twice, and later than the next one: its id is the same each time, and its sequence says where it belongs.
//!
//! [Standard Webhooks 1.0]: https://www.standardwebhooks.com

mod trying;

pub use trying::{ANSWER_TIME, KEEP_TIME, REST, RETRY_AFTER_MAX, SCHEDULE, Tried, Verdict, chance};

use super::batch::Batch;
use super::ids::{EndpointId, MessageId};
use super::job::{Job, JobState};
use super::submission::Caller;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use std::fmt;
use std::time::{Duration, SystemTime};

/// How long both secrets sign after one was replaced.
pub const ROTATION_TIME: Duration = Duration::from_secs(24 * 3600);
/// Endpoints that one caller may have.
pub const ENDPOINTS_MAX: usize = 16;

/// What a message tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum MessageType {
    /// Work on a rig began for the first time.
    RigStarted,
    RigSucceeded,
    RigFailed,
    RigCanceled,
    /// All items of a batch are over.
    BatchCompleted,
    /// Nothing: the caller wants to see one arrive.
    Test,
}

impl MessageType {
    /// Those that an endpoint may ask for.
    pub const ALL: [Self; 5] =
        [Self::RigStarted, Self::RigSucceeded, Self::RigFailed, Self::RigCanceled, Self::BatchCompleted];

    /// Those that tell of a rig.
    pub const OF_RIGS: [Self; 4] = [Self::RigStarted, Self::RigSucceeded, Self::RigFailed, Self::RigCanceled];

    pub fn name(self) -> &'static str {
        match self {
            Self::RigStarted => "rig.started",
            Self::RigSucceeded => "rig.succeeded",
            Self::RigFailed => "rig.failed",
            Self::RigCanceled => "rig.canceled",
            Self::BatchCompleted => "batch.completed",
            Self::Test => "webhook.test",
        }
    }

    /// One that an endpoint may ask for.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// What tells that a job ended in `state`.
    pub fn of_end(state: JobState) -> Option<Self> {
        match state {
            JobState::Succeeded => Some(Self::RigSucceeded),
            JobState::Failed => Some(Self::RigFailed),
            JobState::Canceled => Some(Self::RigCanceled),
            JobState::Queued | JobState::Running | JobState::Expired => None,
        }
    }
}

/// What signs messages. Never shown but to its caller, when it is made.
#[derive(Clone, PartialEq, Eq)]
pub struct Secret([u8; 32]);

impl Secret {
    pub fn new() -> Result<Self, getrandom::Error> {
        let mut bytes = [0; 32];
        getrandom::fill(&mut bytes)?;
        Ok(Self(bytes))
    }

    pub fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    pub fn to_bytes(&self) -> [u8; 32] {
        self.0
    }

    /// As libraries for receivers take it.
    pub fn text(&self) -> String {
        format!("whsec_{}", BASE64_STANDARD.encode(self.0))
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("whsec_***")
    }
}

/// A place that a caller wants to be told.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    pub id: EndpointId,
    /// `None`: the one endpoint of its caller that signs, and logs, what single jobs want told ([`JobWebhook`]).
    pub url: Option<String>,
    /// A word of the caller's own on it.
    pub description: String,
    /// What it is told; of what belongs to single jobs, they decide.
    pub events: Vec<MessageType>,
    /// It is told nothing while this is false; what was to be tried again waits.
    pub enabled: bool,
    /// Why the service has disabled it.
    pub disabled_reason: Option<String>,
    /// Since when nothing was taken there; `None`: the last message was.
    pub failing_since: Option<SystemTime>,
    pub created_at: SystemTime,
    pub secret: Secret,
}

/// Where one job wants told what becomes of it, beside the endpoints of its caller.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct JobWebhook {
    pub url: String,
    /// Of [`MessageType::OF_RIGS`], at least one.
    pub events: Vec<MessageType>,
}

/// An endpoint to write down.
#[derive(Clone, Debug)]
pub struct NewEndpoint {
    pub caller: Caller,
    /// As in [`Endpoint`].
    pub url: Option<String>,
    pub description: String,
    pub events: Vec<MessageType>,
    pub secret: Secret,
}

/// What became of a new endpoint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NewEndpointIs {
    Made(Endpoint),
    /// The caller has [`ENDPOINTS_MAX`] already.
    TooMany,
    /// The caller has one without a URL already.
    Second(EndpointId),
}

/// What is to be different about an endpoint.
#[derive(Clone, Debug, Default)]
pub struct EndpointChange {
    pub url: Option<String>,
    pub description: Option<String>,
    pub events: Option<Vec<MessageType>>,
    pub enabled: Option<bool>,
}

/// What happened, as it was at that moment.
#[derive(Clone, Debug)]
pub struct Message {
    pub id: MessageId,
    pub kind: MessageType,
    pub at: SystemTime,
    pub subject: Subject,
}

/// What a message is about.
#[derive(Clone, Debug)]
pub enum Subject {
    Rig(Box<Job>),
    Batch(Box<Batch>),
    Endpoint(EndpointId),
}

impl Message {
    /// Of two messages about the same rig, the later one has the higher number.
    pub fn sequence(&self) -> u64 {
        match &self.subject {
            Subject::Rig(job) => job.sequence,
            Subject::Batch(_) | Subject::Endpoint(_) => 1,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeliveryState {
    /// It is to be tried, or tried again.
    Pending,
    Delivered,
    /// Given up.
    Failed,
}

impl DeliveryState {
    pub const ALL: [Self; 3] = [Self::Pending, Self::Delivered, Self::Failed];

    pub fn name(self) -> &'static str {
        match self {
            Self::Pending => "pending",
            Self::Delivered => "delivered",
            Self::Failed => "failed",
        }
    }

    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.name() == name)
    }
}

/// What became of a message at one endpoint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Delivery {
    pub message: MessageId,
    pub kind: MessageType,
    pub at: SystemTime,
    pub state: DeliveryState,
    /// `None` unless pending.
    pub next_attempt_at: Option<SystemTime>,
    /// The newest ones, in order.
    pub attempts: Vec<Attempt>,
}

/// One try to deliver a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attempt {
    /// From 1.
    pub number: u32,
    pub at: SystemTime,
    pub duration: Duration,
    /// What the endpoint answered; `None`: nothing.
    pub status: Option<u16>,
    /// Why that is no delivery.
    pub error: Option<String>,
}

/// A message to be sent now.
#[derive(Clone, Debug)]
pub struct DueDelivery {
    pub message: Message,
    pub endpoint: EndpointId,
    /// The number of this attempt, which is its fencing token.
    pub attempt: u32,
    pub url: String,
    /// Where it goes was said by one job, and is no matter of the endpoint's.
    pub of_one_job: bool,
    /// The newest first.
    pub secrets: Vec<Secret>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_have_the_form_that_libraries_take_and_are_not_written_to_logs() {
        let secret = Secret::from_bytes([7; 32]);
        assert_eq!(secret.text(), "whsec_BwcHBwcHBwcHBwcHBwcHBwcHBwcHBwcHBwcHBwcHBwc=");
        assert!(!format!("{secret:?}").contains("BwcH"));
        assert_ne!(Secret::new().expect("random bytes"), Secret::new().expect("random bytes"));
    }
}
