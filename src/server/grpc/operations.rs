//! `google.longrunning.Operations`: jobs as every client library of long-running operations knows them.

use super::super::App;
use super::super::http::error::ApiError;
use super::super::http::negotiate::WAIT_MAX;
use super::super::http::rigs::{PAGE_SIZE, after, cancel, delete, find, page, page_size};
use super::identity;
use super::messages::operation;
use super::proto::google::longrunning::operations_server::Operations;
use super::proto::google::longrunning::{
    CancelOperationRequest, DeleteOperationRequest, GetOperationRequest, ListOperationsRequest, ListOperationsResponse,
    Operation, WaitOperationRequest,
};
use crate::jobs::JobFilter;
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

/// The job that an operation is named after.
fn job_id(name: &str) -> Result<&str, ApiError> {
    let id = name.strip_prefix(COLLECTION).and_then(|rest| rest.strip_prefix('/'));
    id.ok_or_else(|| ApiError::not_found("such operation").hint("operations are named operations/{rig}"))
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
        let job = find(&self.app, &identity(&request).caller, job_id(&request.get_ref().name)?).await?;
        Ok(Response::new(operation(&job)))
    }

    /// Forgets the job and its files, which are the result of the operation.
    async fn delete_operation(&self, request: Request<DeleteOperationRequest>) -> Result<Response<()>, Status> {
        delete(&self.app, &identity(&request).caller, job_id(&request.get_ref().name)?).await?;
        Ok(Response::new(()))
    }

    async fn cancel_operation(&self, request: Request<CancelOperationRequest>) -> Result<Response<()>, Status> {
        cancel(&self.app, &identity(&request).caller, job_id(&request.get_ref().name)?).await?;
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
        let job = find(&self.app, &caller, job_id(&name)?).await?;
        let job = after(&self.app, &caller, job, Some(asked)).await?;
        Ok(Response::new(operation(&job)))
    }
}
