//! `grpc.health.v1.Health`: what `/readyz` says.

use super::super::App;
use super::proto::google::longrunning::operations_server;
use super::proto::rigsmith::v1::rig_service_server;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_server::Health;
use tonic_health::pb::{HealthCheckRequest, HealthCheckResponse};

/// How often a watched service is looked at.
const LOOK: Duration = Duration::from_secs(1);

pub struct HealthDoor {
    app: App,
}

impl HealthDoor {
    pub fn new(app: &App) -> Self {
        Self { app: app.clone() }
    }
}

/// The empty name stands for the whole; every other service is as ready as that.
fn is_known(service: &str) -> bool {
    ["", rig_service_server::SERVICE_NAME, operations_server::SERVICE_NAME].contains(&service)
}

fn status(app: &App, service: &str) -> ServingStatus {
    match app.jobs.ready() {
        _ if !is_known(service) => ServingStatus::ServiceUnknown,
        Ok(()) => ServingStatus::Serving,
        Err(_) => ServingStatus::NotServing,
    }
}

fn answer(status: ServingStatus) -> HealthCheckResponse {
    HealthCheckResponse { status: status.into() }
}

#[tonic::async_trait]
impl Health for HealthDoor {
    type WatchStream = ReceiverStream<Result<HealthCheckResponse, Status>>;

    async fn check(&self, request: Request<HealthCheckRequest>) -> Result<Response<HealthCheckResponse>, Status> {
        match status(&self.app, &request.get_ref().service) {
            ServingStatus::ServiceUnknown => Err(Status::not_found("there is no such service")),
            status => Ok(Response::new(answer(status))),
        }
    }

    /// Tells how the service is, then every change.
    async fn watch(&self, request: Request<HealthCheckRequest>) -> Result<Response<Self::WatchStream>, Status> {
        let (app, service) = (self.app.clone(), request.into_inner().service);
        let (told, changes) = mpsc::channel(1);
        tokio::spawn(async move {
            let mut closing = app.closing.subscribe();
            let mut last = None;
            loop {
                let now = status(&app, &service);
                if last != Some(now) && told.send(Ok(answer(now))).await.is_err() {
                    return;
                }
                last = Some(now);
                tokio::select! {
                    () = tokio::time::sleep(LOOK) => {}
                    () = told.closed() => return,
                    _ = closing.wait_for(|closing| *closing) => return,
                }
            }
        });
        Ok(Response::new(ReceiverStream::new(changes)))
    }
}
