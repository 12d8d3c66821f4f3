//! How fast each key may ask: a token bucket per key. A full bucket holds the requests of one minute, and fills evenly.

use super::keys::Key;
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// The buckets of all keys. There are as many as keys, so the map is bounded by the keys file.
#[derive(Debug, Default)]
pub struct Buckets(Mutex<HashMap<String, Bucket>>);

#[derive(Clone, Copy, Debug)]
struct Bucket {
    tokens: f64,
    at: Instant,
}

/// What is left for a key after a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Left {
    pub limit: u32,
    pub remaining: u32,
    /// Until the bucket is full again.
    pub full_in: Duration,
    /// `None`: the request may pass. Else: when to come back.
    pub refused_for: Option<Duration>,
}

const WINDOW: Duration = Duration::from_secs(60);

impl Buckets {
    /// Takes one token of `key` at the moment `now`.
    pub fn take(&self, key: &Key, now: Instant) -> Left {
        let limit = key.quota.requests_per_minute;
        let capacity = f64::from(limit);
        let per_second = capacity / WINDOW.as_secs_f64();
        let mut buckets = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let bucket = buckets.entry(key.id.clone()).or_insert(Bucket { tokens: capacity, at: now });
        let passed = now.saturating_duration_since(bucket.at).as_secs_f64();
        bucket.tokens = (bucket.tokens + passed * per_second).min(capacity);
        bucket.at = now;
        let refused_for = if bucket.tokens >= 1.0 {
            bucket.tokens -= 1.0;
            None
        } else {
            Some(Duration::from_secs_f64((1.0 - bucket.tokens) / per_second))
        };
        Left {
            limit,
            remaining: bucket.tokens as u32,
            full_in: Duration::from_secs_f64((capacity - bucket.tokens) / per_second),
            refused_for,
        }
    }
}

impl Left {
    /// `RateLimit-Policy`, as of draft-ietf-httpapi-ratelimit-headers.
    pub fn policy(&self) -> String {
        format!("\"requests\";q={};w={}", self.limit, WINDOW.as_secs())
    }

    /// `RateLimit`.
    pub fn state(&self) -> String {
        format!("\"requests\";r={};t={}", self.remaining, self.full_in.as_secs_f64().ceil() as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::server::keys::{Quota, test_key};

    #[test]
    fn a_minute_of_requests_may_come_at_once_and_then_they_come_evenly() {
        let (buckets, began) = (Buckets::default(), Instant::now());
        let key = test_key("a", Quota { requests_per_minute: 6, jobs: 1 });
        let at = |seconds: f64| buckets.take(&key, began + Duration::from_secs_f64(seconds));
        for left in (0..6).rev() {
            let taken = at(0.0);
            assert_eq!((taken.remaining, taken.refused_for), (left, None));
        }
        let other = test_key("b", Quota { requests_per_minute: 6, jobs: 1 });
        assert_eq!(buckets.take(&other, began).remaining, 5, "each key has its own");
        assert!(at(0.0).refused_for.is_some());
        let refused = at(4.0).refused_for.expect("refused");
        assert!((refused.as_secs_f64() - 6.0).abs() < 1e-6, "{refused:?}");
        assert_eq!(at(10.01).refused_for, None, "one came back after ten seconds");
        assert!(at(10.02).refused_for.is_some());
        assert_eq!(at(600.0).remaining, 5, "never more than a minute's worth");
    }
}
