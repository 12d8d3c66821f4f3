//! Ids as callers see them: a prefix and a UUIDv7 in Crockford's base 32, lower case, so that they sort by time.

use std::fmt;
use std::str::FromStr;
use uuid::Uuid;

const DIGITS: usize = 26;
const BASE32: &[u8; 32] = b"0123456789abcdefghjkmnpqrstvwxyz";

/// The text is no id of this kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("an id is {prefix} and 26 letters and digits")]
pub struct NotAnId {
    prefix: &'static str,
}

fn write(out: &mut fmt::Formatter<'_>, prefix: &str, id: Uuid) -> fmt::Result {
    let value = id.as_u128();
    out.write_str(prefix)?;
    for place in (0..DIGITS).rev() {
        let digit = (value >> (5 * place)) & 31;
        write!(out, "{}", char::from(BASE32[digit as usize]))?;
    }
    Ok(())
}

fn read(text: &str, prefix: &'static str) -> Result<Uuid, NotAnId> {
    let no_id = NotAnId { prefix };
    let digits = text.strip_prefix(prefix).filter(|digits| digits.len() == DIGITS).ok_or(no_id)?;
    let mut value: u128 = 0;
    for byte in digits.bytes() {
        let digit = BASE32.iter().position(|known| *known == byte).ok_or(no_id)?;
        // 26 digits hold 130 bits; the first digit must leave the two topmost clear.
        value = value.checked_mul(32).ok_or(no_id)? + digit as u128;
    }
    Ok(Uuid::from_u128(value))
}

macro_rules! id {
    ($(#[$doc:meta])* $name:ident, $prefix:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(Uuid);

        impl $name {
            /// An id after all ids that this process made before.
            pub fn new() -> Self {
                Self(Uuid::now_v7())
            }

            /// As the store keeps it; sorts like the id.
            pub fn to_bytes(self) -> [u8; 16] {
                *self.0.as_bytes()
            }

            pub fn from_bytes(bytes: [u8; 16]) -> Self {
                Self(Uuid::from_bytes(bytes))
            }
        }

        impl Default for $name {
            fn default() -> Self {
                Self::new()
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                write(out, $prefix, self.0)
            }
        }

        impl FromStr for $name {
            type Err = NotAnId;

            fn from_str(text: &str) -> Result<Self, NotAnId> {
                read(text, $prefix).map(Self)
            }
        }
    };
}

id!(
    /// A job.
    JobId,
    "rig_"
);
id!(
    /// An uploaded mesh with the files that belong to it.
    AssetId,
    "ast_"
);
id!(
    /// Requests that were handed in together.
    BatchId,
    "bat_"
);
id!(
    /// An upload that arrives in parts.
    UploadId,
    "upl_"
);
id!(
    /// A place that is told what happens.
    EndpointId,
    "whe_"
);
id!(
    /// What such places are told, once for all of them.
    MessageId,
    "evt_"
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_survive_being_written_and_sort_by_age() {
        let ids: Vec<JobId> = (0..1000).map(|_| JobId::new()).collect();
        let written: Vec<String> = ids.iter().map(JobId::to_string).collect();
        assert!(written.is_sorted());
        for (id, text) in ids.iter().zip(&written) {
            assert_eq!(text.parse(), Ok(*id));
            assert_eq!(JobId::from_bytes(id.to_bytes()), *id);
        }
    }

    #[test]
    fn what_is_no_id_is_refused() {
        for text in ["", "rig_", "rig_0", "ast_00000000000000000000000000", "rig_zzzzzzzzzzzzzzzzzzzzzzzzzz"] {
            assert!(text.parse::<JobId>().is_err(), "{text}");
        }
        assert_eq!("rig_7zzzzzzzzzzzzzzzzzzzzzzzzz".parse::<JobId>().map(|id| id.0), Ok(Uuid::max()));
        assert!("ast_00000000000000000000000000".parse::<AssetId>().is_ok());
    }
}
