//! `google.longrunning.Operations`: jobs and batches as every client library of long-running operations knows them.

use super::super::App;
use super::super::batch_orders;
use super::super::http::error::{ApiError, Code};
use super::super::http::negotiate::WAIT_MAX;
use super::super::http::rigs::{PAGE_SIZE, after, cancel, delete, find, page, page_size};
use super::messages::operation;
use super::proto::google::longrunning::operations_server::Operations;
use super::proto::google::longrunning::{
    CancelOperationRequest, DeleteOperationRequest, GetOperationRequest, ListOperationsRequest, ListOperationsResponse,
    Operation, WaitOperationRequest,
};
use super::{batches, identity};
use crate::jobs::{BatchId, JobFilter};
use std::time::Duration;
use tonic::{Request, Response, Status};

pub struct OperationsDoor {
    app: App,
}

impl OperationsDoor {
    pub fn new(app: &App) -> Self {
        Self { app: app.clone() }
    }
}

const COLLECTION: &str = "operations";

/// What an operation is named after.
enum Named<'name> {
    Job(&'name str),
    Batch(&'name str),
}

fn named(name: &str) -> Result<Named<'_>, ApiError> {
    let id = name.strip_prefix(COLLECTION).and_then(|rest| rest.strip_prefix('/')).ok_or_else(|| {
        ApiError::not_found("such operation").hint("operations are named operations/{rig} or operations/{batch}")
    })?;
    Ok(if id.parse::<BatchId>().is_ok() { Named::Batch(id) } else { Named::Job(id) })
}

#[tonic::async_trait]
impl Operations for OperationsDoor {
    async fn list_operations(
        &self,
        request: Request<ListOperationsRequest>,
    ) -> Result<Response<ListOperationsResponse>, Status> {
        let identity = identity(&request);
        let asked = request.into_inner();
        if !asked.name.is_empty() && asked.name != COLLECTION {
            return Err(ApiError::field("name", format!("is neither empty nor {COLLECTION}")).into());
        }
        if !asked.filter.is_empty() {
            return Err(ApiError::field("filter", "is not supported; ListRigs filters by state and label").into());
        }
        let count = if asked.page_size == 0 { PAGE_SIZE } else { page_size(&asked.page_size.to_string())? };
        let token = Some(asked.page_token.as_str()).filter(|token| !token.is_empty());
        let page = page(&self.app, &identity.caller, &JobFilter::default(), token, count).await?;
        Ok(Response::new(ListOperationsResponse {
            operations: page.jobs.iter().map(operation).collect(),
            next_page_token: page.next_page_token.unwrap_or_default(),
            unreachable: Vec::new(),
        }))
    }

    async fn get_operation(&self, request: Request<GetOperationRequest>) -> Result<Response<Operation>, Status> {
        let caller = identity(&request).caller;
        Ok(Response::new(match named(&request.get_ref().name)? {
            Named::Job(id) => operation(&find(&self.app, &caller, id).await?),
            Named::Batch(id) => batches::operation(&batch_orders::find(&self.app, &caller, id).await?),
        }))
    }

    /// Forgets the job and its files, which are the result of the operation.
    async fn delete_operation(&self, request: Request<DeleteOperationRequest>) -> Result<Response<()>, Status> {
        match named(&request.get_ref().name)? {
            Named::Job(id) => delete(&self.app, &identity(&request).caller, id).await?,
            Named::Batch(_) => {
                return Err(ApiError::new(Code::MethodNotAllowed, "a batch is not deleted; it is forgotten in time")
                    .hint("CancelOperation ends it; DeleteOperation forgets each of its rigs")
                    .into());
            }
        }
        Ok(Response::new(()))
    }

    async fn cancel_operation(&self, request: Request<CancelOperationRequest>) -> Result<Response<()>, Status> {
        let caller = identity(&request).caller;
        match named(&request.get_ref().name)? {
            Named::Job(id) => _ = cancel(&self.app, &caller, id).await?,
            Named::Batch(id) => _ = batch_orders::cancel(&self.app, &caller, id).await?,
        }
        Ok(Response::new(()))
    }

    /// As long as asked, and no longer than a request of REST may wait.
    async fn wait_operation(&self, request: Request<WaitOperationRequest>) -> Result<Response<Operation>, Status> {
        let caller = identity(&request).caller;
        let WaitOperationRequest { name, timeout } = request.into_inner();
        let asked = match timeout.map(Duration::try_from) {
            None => WAIT_MAX,
            Some(Ok(time)) => time.min(WAIT_MAX),
            Some(Err(_)) => return Err(ApiError::field("timeout", "is negative").into()),
        };
        Ok(Response::new(match named(&name)? {
            Named::Job(id) => {
                let job = find(&self.app, &caller, id).await?;
                operation(&after(&self.app, &caller, job, Some(asked)).await?)
            }
            Named::Batch(id) => {
                let batch = batch_orders::find(&self.app, &caller, id).await?;
                batches::operation(&batch_orders::after(&self.app, &caller, batch, asked).await?)
            }
        }))
    }
}
