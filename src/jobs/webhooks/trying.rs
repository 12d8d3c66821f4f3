//! When a message is tried, and what follows from how that went.

use super::MessageType;
use crate::jobs::ids::{EndpointId, MessageId};
use sha2::{Digest, Sha256};
use std::time::Duration;

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
/// How long messages and what became of them are kept. Longer than any message is tried.
pub const KEEP_TIME: Duration = Duration::from_secs(15 * 24 * 3600);

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

    /// How long nothing at all is to be sent to the endpoint.
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
        match SCHEDULE.get(tries).filter(|_| tries < tries_max(kind)) {
            Some(time) => {
                let wanted = self.retry_after.map_or(Duration::ZERO, |time| time.min(RETRY_AFTER_MAX));
                Verdict::Again(time.mul_f64(1.0 + JITTER * chance.clamp(0.0, 1.0)).max(wanted))
            }
            None => Verdict::GivenUp,
        }
    }
}

/// How often a message is tried before it is given up.
fn tries_max(kind: MessageType) -> usize {
    match kind {
        MessageType::Test => 1,
        _ => SCHEDULE.len(),
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
}
