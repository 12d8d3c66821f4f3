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
//! A message may arrive twice, and later than the next one: its id is the same each time, and its sequence says where it belongs.
//!
//! [Standard Webhooks 1.0]: https://www.standardwebhooks.com

use super::batch::Batch;
use super::ids::{EndpointId, MessageId};
use super::job::{Job, JobState};
use super::submission::Caller;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use sha2::{Digest, Sha256};
use std::fmt;
use std::time::{Duration, SystemTime};

/// How long an endpoint may take to answer.
pub const ANSWER_TIME: Duration = Duration::from_secs(15);
/// How long after the try before it each try is made.
pub const SCHEDULE: [Duration; 10] = [
    Duration::ZERO,
    Duration::from_secs(5),
    Duration::from_secs(5 * 60),
    Duration::from_secs(30 * 60),
    Duration::from_secs(2 * 3600),
    Duration::from_secs(5 * 3600),
    Duration::from_secs(10 * 3600),
    Duration::from_secs(14 * 3600),
    Duration::from_secs(20 * 3600),
    Duration::from_secs(24 * 3600),
];
/// A try is later than the schedule says by up to this part, so that what failed together is not tried together.
const JITTER: f64 = 0.2;
/// How long an endpoint that is overloaded is left alone when it does not say.
pub const REST: Duration = Duration::from_secs(30);
/// No endpoint is left alone for longer, whatever it says.
pub const RETRY_AFTER_MAX: Duration = Duration::from_secs(24 * 3600);
/// How long both secrets sign after one was replaced.
pub const ROTATION_TIME: Duration = Duration::from_secs(24 * 3600);
/// How long messages and what became of them are kept. Longer than any message is tried.
pub const KEEP_TIME: Duration = Duration::from_secs(15 * 24 * 3600);
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

    /// How often a message is tried before it is given up.
    fn tries_max(self) -> usize {
        match self {
            Self::Test => 1,
            _ => SCHEDULE.len(),
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
    pub url: String,
    /// A word of the caller's own on it.
    pub description: String,
    /// What it is told, at least one.
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

/// An endpoint to write down.
#[derive(Clone, Debug)]
pub struct NewEndpoint {
    pub caller: Caller,
    pub url: String,
    pub description: String,
    pub events: Vec<MessageType>,
    pub secret: Secret,
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
    /// The newest first.
    pub secrets: Vec<Secret>,
}

/// How an attempt went.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tried {
    pub duration: Duration,
    pub status: Option<u16>,
    pub error: Option<String>,
    pub retry_after: Option<Duration>,
}

/// What follows from an attempt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    Delivered,
    Again(Duration),
    GivenUp,
    /// Given up, and nothing more is to be sent there.
    Gone,
}

impl Verdict {
    /// As the metrics name it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Delivered => "delivered",
            Self::Again(_) => "retried",
            Self::GivenUp => "given_up",
            Self::Gone => "gone",
        }
    }
}

impl Tried {
    fn delivered(&self) -> bool {
        self.status.is_some_and(|status| (200..300).contains(&status))
    }

    /// How long nothing at all is to be sent there.
    pub fn rest(&self) -> Option<Duration> {
        let overloaded = self.status.is_some_and(|status| [429, 502, 503, 504].contains(&status));
        overloaded.then(|| self.retry_after.map_or(REST, |time| time.min(RETRY_AFTER_MAX)))
    }

    /// What follows when this was try number `tries` of a message. `chance` is from 0 to 1.
    pub fn verdict(&self, kind: MessageType, tries: usize, chance: f64) -> Verdict {
        if self.delivered() {
            return Verdict::Delivered;
        }
        if self.status == Some(410) {
            return Verdict::Gone;
        }
        match SCHEDULE.get(tries).filter(|_| tries < kind.tries_max()) {
            Some(time) => {
                let wanted = self.retry_after.map_or(Duration::ZERO, |time| time.min(RETRY_AFTER_MAX));
                Verdict::Again(time.mul_f64(1.0 + JITTER * chance.clamp(0.0, 1.0)).max(wanted))
            }
            None => Verdict::GivenUp,
        }
    }
}

/// A number from 0 to 1 that differs from delivery to delivery and from try to try.
pub fn chance(message: MessageId, endpoint: EndpointId, tries: usize) -> f64 {
    let digest = Sha256::new()
        .chain_update(message.to_bytes())
        .chain_update(endpoint.to_bytes())
        .chain_update((tries as u64).to_be_bytes())
        .finalize();
    f64::from(digest[0]) / f64::from(u8::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tried(status: u16, retry_after: Option<u64>) -> Tried {
        let (status, retry_after) = (Some(status).filter(|status| *status > 0), retry_after.map(Duration::from_secs));
        Tried { duration: Duration::ZERO, status, error: None, retry_after }
    }

    #[test]
    fn what_an_endpoint_answers_decides_what_follows() {
        for status in [200, 202, 204, 299] {
            assert_eq!(tried(status, None).verdict(MessageType::RigFailed, 1, 0.0), Verdict::Delivered, "{status}");
        }
        assert_eq!(tried(410, None).verdict(MessageType::RigFailed, 1, 0.0), Verdict::Gone);
        for status in [0, 199, 301, 400, 404, 500] {
            let failed = tried(status, None);
            assert_eq!(failed.verdict(MessageType::RigFailed, 1, 0.0), Verdict::Again(SCHEDULE[1]), "{status}");
            assert_eq!(failed.rest(), None, "{status}");
        }
        for status in [429, 502, 503, 504] {
            assert_eq!(tried(status, None).rest(), Some(REST), "{status}");
            assert_eq!(tried(status, Some(90)).rest(), Some(Duration::from_secs(90)), "{status}");
        }
    }

    #[test]
    fn tries_keep_to_the_schedule_and_to_retry_after_whichever_is_later() {
        let failed = tried(500, None);
        for (tries, time) in SCHEDULE.iter().enumerate().skip(1) {
            let earliest = failed.verdict(MessageType::RigStarted, tries, 0.0);
            let latest = failed.verdict(MessageType::RigStarted, tries, 1.0);
            assert_eq!((earliest, latest), (Verdict::Again(*time), Verdict::Again(time.mul_f64(1.2))));
        }
        assert_eq!(failed.verdict(MessageType::RigStarted, SCHEDULE.len(), 0.0), Verdict::GivenUp);
        assert_eq!(failed.verdict(MessageType::Test, 1, 0.0), Verdict::GivenUp, "a test is tried once");
        let again = |seconds, tries| tried(503, Some(seconds)).verdict(MessageType::RigStarted, tries, 0.0);
        assert_eq!(again(60, 1), Verdict::Again(Duration::from_secs(60)));
        assert_eq!(again(60, 2), Verdict::Again(SCHEDULE[2]));
        assert_eq!(again(u64::MAX / 2, 1), Verdict::Again(RETRY_AFTER_MAX));
        // However late each try is, the message is known as long as it is tried.
        assert!(RETRY_AFTER_MAX.mul_f64(1.0 + JITTER) * (SCHEDULE.len() as u32 - 1) < KEEP_TIME);
    }

    #[test]
    fn secrets_have_the_form_that_libraries_take_and_are_not_written_to_logs() {
        let secret = Secret::from_bytes([7; 32]);
        assert_eq!(secret.text(), "whsec_BwcHBwcHBwcHBwcHBwcHBwcHBwcHBwcHBwcHBwcHBwc=");
        assert!(!format!("{secret:?}").contains("BwcH"));
        assert_ne!(Secret::new().expect("random bytes"), Secret::new().expect("random bytes"));
    }
}
