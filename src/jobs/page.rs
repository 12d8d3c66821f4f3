//! Pages of a list, and the tokens that lead from one to the next.

use super::ids::JobId;
use super::job::Job;
use super::store::{JobFilter, StoreFailure};
use crate::storage::hex;
use sha2::{Digest, Sha256};

/// Part of a list, newest first.
#[derive(Clone, Debug)]
pub struct Page {
    pub jobs: Vec<Job>,
    /// Leads to the next page; `None` on the last one.
    pub next_page_token: Option<String>,
}

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
pub enum NoPage {
    #[error("the page token was not given by this service for this list")]
    BadToken,
    #[error(transparent)]
    Unavailable(#[from] StoreFailure),
}

/// Digits of the list's digest in a token: enough to tell that a token belongs to another list.
const DIGEST_BYTES: usize = 4;

fn digest_of(filter: &JobFilter) -> String {
    let said = serde_json::json!([filter.state.map(|state| state.name()), filter.label]);
    let digest = Sha256::digest(said.to_string());
    hex(&digest[..DIGEST_BYTES])
}

/// The token of the page that begins after `last`. Opaque to callers: its form may change.
pub fn token(last: JobId, filter: &JobFilter) -> String {
    format!("{}{}", hex(&last.to_bytes()), digest_of(filter))
}

/// The job after which the page begins.
pub fn read_token(token: &str, filter: &JobFilter) -> Result<JobId, NoPage> {
    let id = token.strip_suffix(digest_of(filter).as_str()).filter(|id| id.len() == 32).ok_or(NoPage::BadToken)?;
    let id = u128::from_str_radix(id, 16).map_err(|_| NoPage::BadToken)?;
    Ok(JobId::from_bytes(id.to_be_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::JobState;

    #[test]
    fn a_token_leads_back_to_its_place_in_its_list_alone() {
        let (id, all) = (JobId::new(), JobFilter::default());
        let failed = JobFilter { state: Some(JobState::Failed), ..JobFilter::default() };
        assert_eq!(read_token(&token(id, &all), &all).expect("its own"), id);
        for wrong in [token(id, &failed), String::new(), "é".repeat(20), format!("x{}", token(id, &all))] {
            assert!(read_token(&wrong, &all).is_err(), "{wrong}");
        }
    }
}
