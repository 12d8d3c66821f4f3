//! The gRPC door (`proto/rigsmith/v1/rigging.proto`): the same functions as REST, on the same port, behind the same keys.
//! Handlers read a message, call what REST calls, and write a message.

mod batches;
mod body;
mod health;
mod messages;
mod operations;
mod options;
pub mod proto;
mod rigs;
mod status;
mod streams;

pub use status::{refused_with, write_refusal};

use self::body::TimedBody;
use self::health::HealthDoor;
use self::operations::OperationsDoor;
use self::proto::google::longrunning::operations_server::OperationsServer;
use self::proto::rigsmith::v1::rig_service_server::RigServiceServer;
use self::rigs::RigDoor;
use super::App;
use super::http::authenticate::Identity;
use super::http::sink::Deadline;
use axum::Router;
use axum::body::Body;
use axum::extract::Request;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use axum::routing::post_service;
use std::convert::Infallible;
use std::time::{Duration, SystemTime};
use tonic::Status;
use tonic::server::NamedService;
use tonic_health::pb::health_server::HealthServer;
use tower::{Service, ServiceExt};

/// A message from a caller: a mesh within a request, or a skeleton. Longer ones are refused before they are read.
const MESSAGE_BYTES_MAX: usize = 6 << 20;
const TIMEOUT: &str = "grpc-timeout";

/// Every gRPC service.
pub fn routes(app: &App) -> Router<App> {
    let rigs = RigServiceServer::new(RigDoor::new(app)).max_decoding_message_size(MESSAGE_BYTES_MAX);
    let mut router = add(Router::new(), app, rigs);
    router = add(router, app, OperationsServer::new(OperationsDoor::new(app)));
    router = add(router, app, HealthServer::new(HealthDoor::new(app)));
    // Both versions are about: older clients ask for the first alone.
    router = match reflection().build_v1() {
        Ok(service) => add(router, app, service),
        Err(error) => undescribed(router, &error),
    };
    match reflection().build_v1alpha() {
        Ok(service) => add(router, app, service),
        Err(error) => undescribed(router, &error),
    }
}

/// What there is to describe: our services, and those that describe and probe them.
fn reflection() -> tonic_reflection::server::Builder<'static> {
    tonic_reflection::server::Builder::configure()
        .include_reflection_service(false)
        .register_encoded_file_descriptor_set(proto::DESCRIPTORS)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        .register_encoded_file_descriptor_set(tonic_reflection::pb::v1::FILE_DESCRIPTOR_SET)
        .register_encoded_file_descriptor_set(tonic_reflection::pb::v1alpha::FILE_DESCRIPTOR_SET)
}

/// Descriptors are compiled in; a test sees that they can be read.
fn undescribed(router: Router<App>, error: &dyn std::error::Error) -> Router<App> {
    tracing::error!(%error, "gRPC reflection is off: the descriptors cannot be read");
    router
}

fn add<S>(router: Router<App>, app: &App, service: S) -> Router<App>
where
    S: Service<axum::http::Request<tonic::body::Body>, Error = Infallible>
        + NamedService
        + Clone
        + Send
        + Sync
        + 'static,
    S::Response: IntoResponse,
    S::Future: Send,
{
    let app = app.clone();
    let timed = move |request: Request| {
        request.map(|body: Body| tonic::body::Body::new(TimedBody::new(body, Deadline::of(&app))))
    };
    router.route(&format!("/{}/{{method}}", S::NAME), post_service(service.map_request(timed)))
}

/// Whether a request speaks gRPC.
pub fn is_grpc(headers: &HeaderMap) -> bool {
    let declared = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok());
    declared.is_some_and(|declared| declared.starts_with("application/grpc"))
}

/// Whether everybody may ask: probes and descriptions tell nothing of anybody's work.
pub fn is_open(path: &str) -> bool {
    path.starts_with("/grpc.health.") || path.starts_with("/grpc.reflection.")
}

/// What stock clients expect of a service that is not there.
pub fn no_such_method(path: &str) -> Response {
    Status::unimplemented(format!("there is no {path} here; reflection lists every service")).into_http()
}

/// Who asks, as [`super::http::authenticate`] found out.
fn identity<T>(request: &tonic::Request<T>) -> Identity {
    request.extensions().get::<Identity>().cloned().unwrap_or_else(Identity::anonymous)
}

/// When the caller stops to wait for the answer.
fn deadline<T>(request: &tonic::Request<T>) -> Option<SystemTime> {
    let timeout = request.metadata().get(TIMEOUT)?.to_str().ok()?;
    SystemTime::now().checked_add(timeout_of(timeout)?)
}

/// `grpc-timeout`: at most eight digits and a unit (gRPC over HTTP/2, "Requests").
fn timeout_of(text: &str) -> Option<Duration> {
    let (digits, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
    if !(1..=8).contains(&digits.len()) || !digits.bytes().all(|digit| digit.is_ascii_digit()) {
        return None;
    }
    let count: u64 = digits.parse().ok()?;
    Some(match unit {
        "H" => Duration::from_secs(count * 3600),
        "M" => Duration::from_secs(count * 60),
        "S" => Duration::from_secs(count),
        "m" => Duration::from_millis(count),
        "u" => Duration::from_micros(count),
        "n" => Duration::from_nanos(count),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn timeouts_are_read_as_the_protocol_says() {
        for (text, expected) in [
            ("90S", Some(Duration::from_secs(90))),
            ("2H", Some(Duration::from_secs(7200))),
            ("3M", Some(Duration::from_secs(180))),
            ("1500m", Some(Duration::from_millis(1500))),
            ("99999999n", Some(Duration::from_nanos(99_999_999))),
            ("", None),
            ("S", None),
            ("5", None),
            ("-5S", None),
            ("123456789S", None),
            ("5é", None),
        ] {
            assert_eq!(timeout_of(text), expected, "{text:?}");
        }
    }

    #[test]
    fn the_compiled_descriptors_can_be_read() {
        assert!(reflection().build_v1().is_ok() && reflection().build_v1alpha().is_ok());
    }
}
