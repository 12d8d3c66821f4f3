//! Webhooks, as far as they are written down.
//!
//! 1. **Writing.** A message is written in the transaction that makes the change that it tells of, with one delivery for each
//!    endpoint of the caller that is enabled and wants it; where the job itself says where, one more.
//! 2. **Taking.** [`WebhookStore::claim_deliveries`] gives what is due to one sender under a lease; one that is not heard of again
//!    sends it to somebody else. The number of the attempt is the fencing token.
//! 3. **Manners.** An endpoint gets [`TOGETHER`] messages at a time; one that fails, a single one, the oldest first. While some
//!    are under way to it, no more are given out.
//! 4. **Ending.** A delivery that is over begins anew when its caller asks for it, and not otherwise.

use super::StoreFailure;
use crate::jobs::ids::{EndpointId, MessageId};
use crate::jobs::submission::Caller;
use crate::jobs::webhooks::{
    Delivery, DeliveryState, DueDelivery, Endpoint, EndpointChange, NewEndpoint, NewEndpointIs, Secret, Tried, Verdict,
};
use async_trait::async_trait;
use std::time::Duration;

/// Whoever sends a message is taken for lost when it was not heard of for this long; longer than a message may take.
pub const DELIVERY_LEASE: Duration = Duration::from_secs(60);
/// Messages under way to one endpoint at the same time.
pub const TOGETHER: usize = 8;
/// Attempts of one delivery that are remembered.
pub const ATTEMPTS_KEPT: usize = 32;

/// Where endpoints and what they are told are written down. See the module for its rules.
#[async_trait]
pub trait WebhookStore: Send + Sync {
    async fn create_endpoint(&self, new: NewEndpoint) -> Result<NewEndpointIs, StoreFailure>;

    async fn endpoint(&self, caller: &Caller, id: EndpointId) -> Result<Option<Endpoint>, StoreFailure>;

    /// Oldest first.
    async fn endpoints(&self, caller: &Caller) -> Result<Vec<Endpoint>, StoreFailure>;

    /// `None`: there is none.
    async fn change_endpoint(
        &self,
        caller: &Caller,
        id: EndpointId,
        change: EndpointChange,
    ) -> Result<Option<Endpoint>, StoreFailure>;

    /// From now on `secret` signs; the one before signs too, for a time.
    async fn replace_secret(
        &self,
        caller: &Caller,
        id: EndpointId,
        secret: Secret,
    ) -> Result<Option<Endpoint>, StoreFailure>;

    /// With all that it was told and was to be told. `false`: there was none.
    async fn delete_endpoint(&self, caller: &Caller, id: EndpointId) -> Result<bool, StoreFailure>;

    /// Writes a message down that tells nothing.
    async fn test_endpoint(&self, id: EndpointId) -> Result<MessageId, StoreFailure>;

    /// Newest first, older than `before`, at most `count`.
    async fn deliveries(
        &self,
        endpoint: EndpointId,
        state: Option<DeliveryState>,
        before: Option<MessageId>,
        count: usize,
    ) -> Result<Vec<Delivery>, StoreFailure>;

    async fn delivery(&self, endpoint: EndpointId, message: MessageId) -> Result<Option<Delivery>, StoreFailure>;

    /// A delivery is due now, and tried as often as a new one. `false`: there is none.
    async fn redeliver(&self, endpoint: EndpointId, message: MessageId) -> Result<bool, StoreFailure>;

    /// What is due, at most `count`.
    async fn claim_deliveries(&self, count: usize) -> Result<Vec<DueDelivery>, StoreFailure>;

    /// Says how an attempt went, and hears what follows. `None`: it is not the current one any more.
    async fn note_attempt(&self, due: &DueDelivery, tried: &Tried) -> Result<Option<Verdict>, StoreFailure>;
}
