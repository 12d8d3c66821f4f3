//! Tickets: words that let their bearer watch one rig for a short time. A browser's `EventSource` can send no header, so the
//! key would have to stand in the address, and addresses end up in logs; a ticket opens nothing else, and soon not even that.
//!
//! A ticket is signed with a secret of the process, and not written down: after a restart, ask for another.

use base64::Engine;
use base64::prelude::BASE64_URL_SAFE_NO_PAD;
use hmac::{Hmac, Mac};
use sha2::Sha256;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Long enough for a browser to come back after a break in the line.
pub const LIFETIME: Duration = Duration::from_secs(300);
const TAG_BYTES: usize = 32;
const TIME_BYTES: usize = 8;

/// Signs tickets and knows its own.
pub struct Tickets {
    secret: [u8; 32],
}

impl Tickets {
    pub fn new() -> Result<Self, getrandom::Error> {
        let mut secret = [0; 32];
        getrandom::fill(&mut secret)?;
        Ok(Self { secret })
    }

    /// A ticket to the events of `rig` (its id), for as long as the key with `key_id` is known.
    pub fn issue(&self, rig: &str, key_id: &str, expires_at: SystemTime) -> String {
        let seconds = expires_at.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs().to_be_bytes();
        let tag = self.signed(rig, key_id, seconds).finalize().into_bytes();
        BASE64_URL_SAFE_NO_PAD.encode([&tag[..], &seconds, key_id.as_bytes()].concat())
    }

    /// The id of the key that a ticket stands for, if it is ours, for `rig`, and not too old.
    pub fn key_id(&self, ticket: &str, rig: &str, now: SystemTime) -> Option<String> {
        let bytes = BASE64_URL_SAFE_NO_PAD.decode(ticket).ok()?;
        let (tag, rest) = bytes.split_at_checked(TAG_BYTES)?;
        let (seconds, key_id) = rest.split_at_checked(TIME_BYTES)?;
        let (seconds, key_id) = (seconds.try_into().ok()?, std::str::from_utf8(key_id).ok()?);
        // Compares in constant time.
        self.signed(rig, key_id, seconds).verify_slice(tag).ok()?;
        let expires_at = UNIX_EPOCH.checked_add(Duration::from_secs(u64::from_be_bytes(seconds)))?;
        (now <= expires_at).then(|| key_id.to_owned())
    }

    fn signed(&self, rig: &str, key_id: &str, seconds: [u8; TIME_BYTES]) -> Hmac<Sha256> {
        // The other constructor refuses keys of a wrong length; this one takes the block that HMAC pads keys to.
        let mut block = [0; 64];
        block[..self.secret.len()].copy_from_slice(&self.secret);
        let mut mac = <Hmac<Sha256> as hmac::digest::KeyInit>::new(&block.into());
        // Lengths first, so that no two sets of words are the same bytes.
        for part in [rig.as_bytes(), key_id.as_bytes(), &seconds] {
            mac.update(&(part.len() as u64).to_be_bytes());
            mac.update(part);
        }
        mac
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ticket_is_for_one_rig_and_a_short_time_and_cannot_be_changed() {
        let tickets = Tickets::new().expect("random bytes");
        let expires_at = UNIX_EPOCH + Duration::from_secs(1_000);
        let ticket = tickets.issue("rig_1", "key_a", expires_at);
        assert_eq!(tickets.key_id(&ticket, "rig_1", expires_at).as_deref(), Some("key_a"));
        assert_eq!(tickets.key_id(&ticket, "rig_2", expires_at), None, "another rig");
        assert_eq!(tickets.key_id(&ticket, "rig_1", expires_at + Duration::from_secs(1)), None, "too late");
        let other = Tickets::new().expect("random bytes");
        assert_eq!(other.key_id(&ticket, "rig_1", expires_at), None, "another process");
        let bytes = BASE64_URL_SAFE_NO_PAD.decode(&ticket).expect("base64");
        for index in 0..bytes.len() {
            let mut changed = bytes.clone();
            changed[index] ^= 1;
            let changed = BASE64_URL_SAFE_NO_PAD.encode(changed);
            assert_eq!(tickets.key_id(&changed, "rig_1", UNIX_EPOCH), None, "byte {index}");
            let shorter = BASE64_URL_SAFE_NO_PAD.encode(&bytes[..index]);
            assert_eq!(tickets.key_id(&shorter, "rig_1", UNIX_EPOCH), None, "{index} bytes");
        }
    }
}
