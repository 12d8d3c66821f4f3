//! Webhooks, as far as they are kept here. Whoever can reach the endpoints sends what is due.

use super::ids::{EndpointId, MessageId};
use super::queue::Jobs;
use super::store::StoreFailure;
use super::submission::Caller;
use super::webhooks::{
    Delivery, DeliveryState, DueDelivery, Endpoint, EndpointChange, NewEndpoint, NewEndpointIs, Secret, Tried, Verdict,
};

impl Jobs {
    pub async fn create_endpoint(&self, new: NewEndpoint) -> Result<NewEndpointIs, StoreFailure> {
        self.core().jobs.create_endpoint(new).await
    }

    pub async fn endpoint(&self, caller: &Caller, id: EndpointId) -> Result<Option<Endpoint>, StoreFailure> {
        self.core().jobs.endpoint(caller, id).await
    }

    /// The caller's endpoints, oldest first.
    pub async fn endpoints(&self, caller: &Caller) -> Result<Vec<Endpoint>, StoreFailure> {
        self.core().jobs.endpoints(caller).await
    }

    /// The endpoint as it is afterwards; `None`: there is none.
    pub async fn change_endpoint(
        &self,
        caller: &Caller,
        id: EndpointId,
        change: EndpointChange,
    ) -> Result<Option<Endpoint>, StoreFailure> {
        self.core().jobs.change_endpoint(caller, id, change).await
    }

    /// From now on `secret` signs; the one before signs too, for a time.
    pub async fn replace_secret(
        &self,
        caller: &Caller,
        id: EndpointId,
        secret: Secret,
    ) -> Result<Option<Endpoint>, StoreFailure> {
        self.core().jobs.replace_secret(caller, id, secret).await
    }

    /// `false`: there was none.
    pub async fn delete_endpoint(&self, caller: &Caller, id: EndpointId) -> Result<bool, StoreFailure> {
        self.core().jobs.delete_endpoint(caller, id).await
    }

    /// Makes a message that tells nothing. Whose endpoint it is was asked before, here and below.
    pub async fn test_endpoint(&self, id: EndpointId) -> Result<MessageId, StoreFailure> {
        self.core().jobs.test_endpoint(id).await
    }

    /// What an endpoint was told, newest first, older than `before`.
    pub async fn deliveries(
        &self,
        endpoint: EndpointId,
        state: Option<DeliveryState>,
        before: Option<MessageId>,
        count: usize,
    ) -> Result<Vec<Delivery>, StoreFailure> {
        self.core().jobs.deliveries(endpoint, state, before, count).await
    }

    pub async fn delivery(&self, endpoint: EndpointId, message: MessageId) -> Result<Option<Delivery>, StoreFailure> {
        self.core().jobs.delivery(endpoint, message).await
    }

    /// A delivery is due now, and tried as often as a new one. `false`: there is none.
    pub async fn redeliver(&self, endpoint: EndpointId, message: MessageId) -> Result<bool, StoreFailure> {
        self.core().jobs.redeliver(endpoint, message).await
    }

    /// What is to be sent now, at most `count`; it is sent by nobody else meanwhile.
    pub async fn claim_deliveries(&self, count: usize) -> Result<Vec<DueDelivery>, StoreFailure> {
        self.core().jobs.claim_deliveries(count).await
    }

    /// Says how an attempt went, and hears what follows. `None`: somebody else sends it meanwhile, or it is not wanted any more.
    pub async fn note_attempt(&self, due: &DueDelivery, tried: &Tried) -> Result<Option<Verdict>, StoreFailure> {
        self.core().jobs.note_attempt(due, tried).await
    }
}
