//! How fast each key may ask and send: token buckets. A full bucket holds all that may be used within a window, and fills
//! evenly.

use super::keys::{Key, Quota};
use std::collections::HashMap;
use std::fmt::Write;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// The buckets of all keys. There are as many as keys, so the map is bounded by the keys file.
#[derive(Debug, Default)]
pub struct Buckets(Mutex<HashMap<String, Pair>>);

#[derive(Clone, Copy, Debug)]
struct Pair {
    requests: Bucket,
    bytes: Bucket,
}

#[derive(Clone, Copy, Debug)]
struct Bucket {
    allowance: Allowance,
    tokens: f64,
    at: Instant,
}

/// What may be used within a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Allowance {
    name: &'static str,
    limit: u64,
    window: Duration,
    /// `None`: requests.
    unit: Option<&'static str>,
}

const REQUESTS: Duration = Duration::from_secs(60);
const BYTES: Duration = Duration::from_secs(3600);

impl Pair {
    fn full(quota: Quota, now: Instant) -> Self {
        let bucket = |allowance: Allowance| Bucket { allowance, tokens: allowance.limit as f64, at: now };
        let requests =
            Allowance { name: "requests", limit: quota.requests_per_minute.into(), window: REQUESTS, unit: None };
        let unit = Some("content-bytes");
        let bytes = Allowance { name: "uploads", limit: quota.upload_bytes_per_hour, window: BYTES, unit };
        Self { requests: bucket(requests), bytes: bucket(bytes) }
    }
}

impl Bucket {
    fn per_second(&self) -> f64 {
        self.allowance.limit as f64 / self.allowance.window.as_secs_f64()
    }

    fn fill(&mut self, now: Instant) {
        let passed = now.saturating_duration_since(self.at).as_secs_f64();
        self.tokens = (self.tokens + passed * self.per_second()).min(self.allowance.limit as f64);
        self.at = now;
    }

    /// Takes `amount`, or says when it will be there. What is more than the whole window's is there when the bucket is full.
    fn take(&mut self, amount: f64) -> Option<Duration> {
        let missing = amount.min(self.allowance.limit as f64) - self.tokens;
        if missing > 0.0 {
            return Some(Duration::try_from_secs_f64(missing / self.per_second()).unwrap_or(self.allowance.window));
        }
        self.tokens -= amount;
        None
    }
}

/// What is left for a key.
#[derive(Clone, Copy, Debug)]
pub struct Left(Pair);

impl Buckets {
    fn lock(&self) -> MutexGuard<'_, HashMap<String, Pair>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn with<T>(&self, key: &Key, now: Instant, change: impl FnOnce(&mut Pair) -> T) -> T {
        let mut buckets = self.lock();
        let full = Pair::full(key.quota, now);
        let pair = buckets.entry(key.id.clone()).or_insert(full);
        // The keys file may have changed.
        (pair.requests.allowance, pair.bytes.allowance) = (full.requests.allowance, full.bytes.allowance);
        pair.requests.fill(now);
        pair.bytes.fill(now);
        change(pair)
    }

    /// Takes one request of `key` at the moment `now`. `Err`: when to come back.
    pub fn ask(&self, key: &Key, now: Instant) -> Result<(), Duration> {
        self.with(key, now, |pair| pair.requests.take(1.0)).map_or(Ok(()), Err)
    }

    pub fn left(&self, key: &Key, now: Instant) -> Left {
        self.with(key, now, |pair| Left(*pair))
    }

    /// Makes room for a body of `declared` bytes, or of a length that only its end will tell; that one passes while there is
    /// anything left, and is charged as it comes. `Err`: when to come back.
    pub fn receive(self: &Arc<Self>, key: &Arc<Key>, declared: Option<u64>, now: Instant) -> Result<Charge, Duration> {
        let reserved = declared.unwrap_or(1);
        match self.with(key, now, |pair| pair.bytes.take(reserved as f64)) {
            Some(wait) => Err(wait),
            None => Ok(Charge { buckets: self.clone(), key: key.clone(), reserved }),
        }
    }
}

/// What a body takes of its key's bytes. What was reserved and did not come is given back.
#[derive(Debug)]
pub struct Charge {
    buckets: Arc<Buckets>,
    key: Arc<Key>,
    reserved: u64,
}

impl Charge {
    /// So many more bytes are here.
    pub fn received(&mut self, bytes: u64) {
        let more = bytes.saturating_sub(self.reserved);
        self.reserved -= bytes - more;
        if more > 0 {
            self.buckets.with(&self.key, Instant::now(), |pair| pair.bytes.tokens -= more as f64);
        }
    }
}

impl Drop for Charge {
    fn drop(&mut self) {
        if self.reserved > 0 {
            self.buckets.with(&self.key, Instant::now(), |pair| pair.bytes.tokens += self.reserved as f64);
        }
    }
}

impl Left {
    /// `RateLimit-Policy`, as of draft-ietf-httpapi-ratelimit-headers.
    pub fn policy(&self) -> String {
        self.listed(|bucket| {
            let Allowance { limit, window, unit, .. } = bucket.allowance;
            let unit = unit.map(|unit| format!(";qu=\"{unit}\"")).unwrap_or_default();
            format!("q={limit};w={}{unit}", window.as_secs())
        })
    }

    /// `RateLimit`: what remains, and the seconds until the bucket is full again.
    pub fn state(&self) -> String {
        self.listed(|bucket| {
            let missing = bucket.allowance.limit as f64 - bucket.tokens;
            format!("r={};t={}", bucket.tokens.max(0.0) as u64, (missing / bucket.per_second()).ceil() as u64)
        })
    }

    fn listed(&self, told: impl Fn(&Bucket) -> String) -> String {
        let mut list = String::new();
        for bucket in [&self.0.requests, &self.0.bytes] {
            let comma = if list.is_empty() { "" } else { ", " };
            // Writing to a string cannot fail.
            let _ = write!(list, "{comma}\"{}\";{}", bucket.allowance.name, told(bucket));
        }
        list
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::server::keys::test_key;

    fn quota(requests_per_minute: u32, upload_bytes_per_hour: u64) -> Quota {
        Quota { requests_per_minute, jobs: 1, upload_bytes_per_hour }
    }

    #[test]
    fn a_minute_of_requests_may_come_at_once_and_then_they_come_evenly() {
        let (buckets, began) = (Buckets::default(), Instant::now());
        let key = test_key("a", quota(6, 7200));
        let at = |seconds: f64| buckets.ask(&key, began + Duration::from_secs_f64(seconds));
        let state = |seconds: f64| buckets.left(&key, began + Duration::from_secs_f64(seconds)).state();
        for left in (0..6).rev() {
            assert_eq!(at(0.0), Ok(()));
            assert!(state(0.0).starts_with(&format!("\"requests\";r={left};t=")), "{}", state(0.0));
        }
        let other = test_key("b", quota(6, 7200));
        assert_eq!(buckets.ask(&other, began), Ok(()));
        let fresh = buckets.left(&other, began);
        assert_eq!(fresh.state(), "\"requests\";r=5;t=10, \"uploads\";r=7200;t=0", "each key has its own");
        assert_eq!(fresh.policy(), "\"requests\";q=6;w=60, \"uploads\";q=7200;w=3600;qu=\"content-bytes\"");
        assert!(at(0.0).is_err());
        let refused = at(4.0).expect_err("refused");
        assert!((refused.as_secs_f64() - 6.0).abs() < 1e-6, "{refused:?}");
        assert_eq!(at(10.01), Ok(()), "one came back after ten seconds");
        assert!(at(10.02).is_err());
        assert!(state(600.0).starts_with("\"requests\";r=6;"), "never more than a minute's worth");
    }

    #[test]
    fn an_hour_of_bytes_may_come_at_once_and_what_does_not_come_is_given_back() {
        let (buckets, key) = (Arc::new(Buckets::default()), Arc::new(test_key("a", quota(6, 3_600))));
        let now = Instant::now();
        let left = || buckets.with(&key, now, |pair| pair.bytes.tokens.round() as i64);
        let mut half = buckets.receive(&key, Some(2_000), now).expect("passes");
        let wait = buckets.receive(&key, Some(2_600), now).expect_err("there are 1,600 left");
        assert!((wait.as_secs_f64() - 1_000.0).abs() < 1e-6, "a byte comes back each second: {wait:?}");
        half.received(500);
        drop(half);
        assert_eq!(left(), 3_100, "1,500 never came");
        let mut unmeasured = buckets.receive(&key, None, now).expect("something is left");
        unmeasured.received(5_000);
        drop(unmeasured);
        assert_eq!(left(), -1_900);
        assert!(buckets.receive(&key, None, now).is_err(), "first the debt is paid");
        assert!(
            buckets.receive(&key, Some(10_000), now + Duration::from_secs(5_600)).is_ok(),
            "a full bucket lets it pass"
        );
    }
}
