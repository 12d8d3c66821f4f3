//! `rigsmith.v1.RigService`.

use super::super::App;
use super::super::batch_orders::{self, Ordered};
use super::super::http::artifacts;
use super::super::http::authenticate::Identity;
use super::super::http::check_views::CheckView;
use super::super::http::error::ApiError;
use super::super::http::outermost::AboutJob;
use super::super::http::receive::Order;
use super::super::http::rigs::{PAGE_SIZE, cancel, find, label_named, page, page_size};
use super::super::orders::{self, Reskin};
use super::super::uploads::{self, Kept};
use super::batches::{self, Results};
use super::messages::{operation, state, structure};
use super::options::{read, request_id, source, terms};
use super::proto::google::longrunning::Operation;
use super::proto::rigsmith::v1::rig::State;
use super::proto::rigsmith::v1::rig_service_server::RigService;
use super::proto::rigsmith::v1::{
    Asset, CancelRigRequest, CheckRigRequest, CheckRigResponse, CreateBatchRequest, CreateRigRequest,
    DownloadArtifactRequest, GetRigRequest, ListBatchResultsRequest, ListRigsRequest, ListRigsResponse,
    ReskinRigRequest, Rig, UploadChunk, WatchRigRequest,
};
use super::streams::{self, Chunks, RigEvents};
use super::{deadline, identity};
use crate::jobs::{Job, JobFilter, JobState, RigOptions, Submitted};
use std::time::SystemTime;
use tonic::{Request, Response, Status, Streaming};

pub struct RigDoor {
    app: App,
}

impl RigDoor {
    pub fn new(app: &App) -> Self {
        Self { app: app.clone() }
    }

    async fn find<T>(&self, request: &Request<T>, id: &str) -> Result<(Identity, Job), ApiError> {
        let identity = identity(request);
        let job = find(&self.app, &identity.caller, id).await?;
        Ok((identity, job))
    }
}

/// A message about a job, which the log names.
fn about<T>(job: &Job, message: T) -> Response<T> {
    let mut response = Response::new(message);
    response.extensions_mut().insert(AboutJob(job.id));
    response
}

/// The deadline of a job: that of the call, unless the job has a time of its own.
fn deadline_of<T>(request: &Request<T>, timeout_seconds: Option<u64>) -> Option<SystemTime> {
    if timeout_seconds.is_some() { None } else { deadline(request) }
}

#[tonic::async_trait]
impl RigService for RigDoor {
    type WatchRigStream = RigEvents;
    type DownloadArtifactStream = Chunks;
    type ListBatchResultsStream = Results;

    async fn upload_asset(&self, request: Request<Streaming<UploadChunk>>) -> Result<Response<Asset>, Status> {
        let identity = identity(&request);
        let _permit = uploads::permit(&self.app)?;
        let (received, id) = streams::receive(&self.app, request.into_inner()).await?;
        let Kept { asset, .. } = uploads::keep(&self.app, &identity, received, request_id(&id)?).await?;
        Ok(Response::new((&asset).into()))
    }

    async fn check_rig(&self, request: Request<CheckRigRequest>) -> Result<Response<CheckRigResponse>, Status> {
        let (app, identity) = (&self.app, identity(&request));
        let CheckRigRequest { mesh, options } = request.into_inner();
        orders::admit(app, &RigOptions::default(), false).await?;
        let wishes = read(options).0.finish(app.jobs.settings())?;
        let source = source(app, mesh).await?;
        let report = app.jobs.check(&identity.caller, source, wishes.options).await.map_err(ApiError::from)?;
        let report = serde_json::to_value(CheckView::from(&report)).map_err(|error| ApiError::internal(&error))?;
        let riggable = report["riggable"].as_str().unwrap_or_default().to_owned();
        // What kind of thing it is, the message says.
        let report = report.as_object().cloned().map(|mut members| {
            members.remove("object");
            structure(&members)
        });
        Ok(Response::new(CheckRigResponse { riggable, report }))
    }

    async fn create_rig(&self, request: Request<CreateRigRequest>) -> Result<Response<Operation>, Status> {
        let (app, identity) = (&self.app, identity(&request));
        let asked = request.get_ref();
        let timeout = asked.options.as_ref().and_then(|options| options.timeout_seconds);
        let deadline = deadline_of(&request, timeout);
        let CreateRigRequest { mesh, options, request_id, client_id, no_cache } = request.into_inner();
        let terms = terms(&request_id, client_id, no_cache, deadline)?;
        let may_be_known = terms.client_id.is_some() || terms.idempotency_key.is_some();
        orders::admit(app, &RigOptions::default(), may_be_known).await?;
        let wishes = read(options).0.finish(app.jobs.settings())?;
        let order = Order { source: source(app, mesh).await?, wishes };
        let Submitted { job, .. } = orders::place(app, &identity, order, terms).await?;
        Ok(about(&job, operation(&job)))
    }

    async fn get_rig(&self, request: Request<GetRigRequest>) -> Result<Response<Rig>, Status> {
        let (_, job) = self.find(&request, &request.get_ref().id).await?;
        Ok(about(&job, Rig::from(&job)))
    }

    async fn list_rigs(&self, request: Request<ListRigsRequest>) -> Result<Response<ListRigsResponse>, Status> {
        let identity = identity(&request);
        let asked = request.into_inner();
        let mut filter = JobFilter { state: state_named(asked.state)?, label: None };
        if !asked.label.is_empty() {
            filter.label = Some(label_named(&asked.label)?);
        }
        let count = if asked.page_size == 0 { PAGE_SIZE } else { page_size(&asked.page_size.to_string())? };
        let token = Some(asked.page_token.as_str()).filter(|token| !token.is_empty());
        let page = page(&self.app, &identity.caller, &filter, token, count).await?;
        Ok(Response::new(ListRigsResponse {
            rigs: page.jobs.iter().map(Rig::from).collect(),
            next_page_token: page.next_page_token.unwrap_or_default(),
        }))
    }

    async fn watch_rig(&self, request: Request<WatchRigRequest>) -> Result<Response<RigEvents>, Status> {
        let (identity, job) = self.find(&request, &request.get_ref().id).await?;
        let events = self.app.jobs.events(&identity.caller, job.id, request.get_ref().after_sequence).await;
        let events = events.map_err(ApiError::from)?;
        let events = events.ok_or_else(|| ApiError::not_found("such job any more; it was deleted"))?;
        Ok(about(&job, streams::watch(&self.app, events)))
    }

    async fn cancel_rig(&self, request: Request<CancelRigRequest>) -> Result<Response<Rig>, Status> {
        let job = cancel(&self.app, &identity(&request).caller, &request.get_ref().id).await?;
        Ok(about(&job, Rig::from(&job)))
    }

    async fn reskin_rig(&self, request: Request<ReskinRigRequest>) -> Result<Response<Operation>, Status> {
        let (identity, job) = self.find(&request, &request.get_ref().id).await?;
        let asked = request.get_ref();
        let timeout = asked.options.as_ref().and_then(|options| options.timeout_seconds);
        let deadline = deadline_of(&request, timeout);
        let ReskinRigRequest { skeleton, options, request_id, no_cache, .. } = request.into_inner();
        let terms = terms(&request_id, String::new(), no_cache, deadline)?;
        let (wishes, fields) = read(options);
        let reskin = Reskin::prepare(&self.app, job, wishes, &fields)?;
        let Submitted { job, .. } = reskin.place(&self.app, &identity, &skeleton, terms).await?;
        Ok(about(&job, operation(&job)))
    }

    async fn download_artifact(&self, request: Request<DownloadArtifactRequest>) -> Result<Response<Chunks>, Status> {
        let (_, job) = self.find(&request, &request.get_ref().id).await?;
        let asked = request.get_ref();
        let artifact = artifacts::named(&job, &asked.name)?;
        Ok(about(&job, streams::download(&self.app, artifact, asked.offset).await?))
    }

    async fn create_batch(&self, request: Request<CreateBatchRequest>) -> Result<Response<Operation>, Status> {
        let identity = identity(&request);
        let (members, id) = batches::read(request.into_inner())?;
        let Ordered { batch, .. } =
            batch_orders::place_members(&self.app, &identity, members, request_id(&id)?).await?;
        Ok(Response::new(batches::operation(&batch)))
    }

    async fn list_batch_results(&self, request: Request<ListBatchResultsRequest>) -> Result<Response<Results>, Status> {
        let caller = identity(&request).caller;
        let batch = batch_orders::find(&self.app, &caller, &request.get_ref().id).await?;
        Ok(Response::new(batches::results(&self.app, caller, batch.id)))
    }
}

/// The state that a filter names; the first value of the enum stands for every state.
fn state_named(number: i32) -> Result<Option<JobState>, ApiError> {
    let named = State::try_from(number);
    let named = named.map_err(|_| ApiError::field("state", format!("{number} is no state of a rig")))?;
    Ok(JobState::ALL.into_iter().find(|known| state(*known) == named))
}
