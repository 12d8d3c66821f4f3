//! Endpoints and deliveries: the transactions around the statements of [`endpoints`] and [`deliveries`].

use super::{Engine, SqlStore, deliveries, endpoints};
use crate::jobs::ids::{EndpointId, MessageId};
use crate::jobs::store::StoreFailure;
use crate::jobs::store::webhooks::{DELIVERY_LEASE, WebhookStore};
use crate::jobs::submission::Caller;
use crate::jobs::webhooks::{
    Delivery, DeliveryState, DueDelivery, Endpoint, EndpointChange, NewEndpoint, NewEndpointIs, Secret, Tried, Verdict,
};
use async_trait::async_trait;

#[async_trait]
impl<E: Engine> WebhookStore for SqlStore<E> {
    async fn create_endpoint(&self, new: NewEndpoint) -> Result<NewEndpointIs, StoreFailure> {
        let mut writing = self.0.write().await?;
        let made = endpoints::create(&mut *writing, &new, self.0.now()).await?;
        self.0.commit(writing).await?;
        Ok(made)
    }

    async fn endpoint(&self, caller: &Caller, id: EndpointId) -> Result<Option<Endpoint>, StoreFailure> {
        endpoints::endpoint(&mut *self.0.read().await?, caller, id).await
    }

    async fn endpoints(&self, caller: &Caller) -> Result<Vec<Endpoint>, StoreFailure> {
        endpoints::list(&mut *self.0.read().await?, caller).await
    }

    async fn change_endpoint(
        &self,
        caller: &Caller,
        id: EndpointId,
        change: EndpointChange,
    ) -> Result<Option<Endpoint>, StoreFailure> {
        let mut writing = self.0.write().await?;
        let endpoint = endpoints::change(&mut *writing, caller, id, &change).await?;
        self.0.commit(writing).await?;
        Ok(endpoint)
    }

    async fn replace_secret(
        &self,
        caller: &Caller,
        id: EndpointId,
        secret: Secret,
    ) -> Result<Option<Endpoint>, StoreFailure> {
        let mut writing = self.0.write().await?;
        let endpoint = endpoints::replace_secret(&mut *writing, caller, id, &secret, self.0.now()).await?;
        self.0.commit(writing).await?;
        Ok(endpoint)
    }

    async fn delete_endpoint(&self, caller: &Caller, id: EndpointId) -> Result<bool, StoreFailure> {
        let mut writing = self.0.write().await?;
        let deleted = endpoints::delete(&mut *writing, caller, id).await?;
        self.0.commit(writing).await?;
        Ok(deleted)
    }

    async fn test_endpoint(&self, id: EndpointId) -> Result<MessageId, StoreFailure> {
        let mut writing = self.0.write().await?;
        let message = deliveries::test(&mut *writing, id, self.0.now()).await?;
        self.0.commit(writing).await?;
        Ok(message)
    }

    async fn deliveries(
        &self,
        endpoint: EndpointId,
        state: Option<DeliveryState>,
        before: Option<MessageId>,
        count: usize,
    ) -> Result<Vec<Delivery>, StoreFailure> {
        deliveries::list(&mut *self.0.read().await?, endpoint, state, before, count).await
    }

    async fn delivery(&self, endpoint: EndpointId, message: MessageId) -> Result<Option<Delivery>, StoreFailure> {
        deliveries::delivery(&mut *self.0.read().await?, endpoint, message).await
    }

    async fn redeliver(&self, endpoint: EndpointId, message: MessageId) -> Result<bool, StoreFailure> {
        let mut writing = self.0.write().await?;
        let found = deliveries::redeliver(&mut *writing, endpoint, message, self.0.now()).await?;
        self.0.commit(writing).await?;
        Ok(found)
    }

    async fn claim_deliveries(&self, count: usize) -> Result<Vec<DueDelivery>, StoreFailure> {
        let now = self.0.now();
        // Looking costs a writer nothing, and most looks find nothing.
        let due = deliveries::due(&mut *self.0.read().await?, count, now).await?;
        if due.is_empty() {
            return Ok(Vec::new());
        }
        let mut writing = self.0.write().await?;
        let claimed = deliveries::claim(&mut *writing, due, now, now.after(DELIVERY_LEASE)).await?;
        self.0.commit(writing).await?;
        Ok(claimed)
    }

    async fn note_attempt(&self, due: &DueDelivery, tried: &Tried) -> Result<Option<Verdict>, StoreFailure> {
        let mut writing = self.0.write().await?;
        let verdict = deliveries::note(&mut *writing, due, tried, self.0.now()).await?;
        self.0.commit(writing).await?;
        Ok(verdict)
    }
}
