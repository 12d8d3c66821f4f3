//! The description of the interface, for machines at `/v1/openapi.json` and for people at `/docs`.

use super::{artifacts, rigs, service};
use axum::Json;
use axum::http::header;
use axum::response::{Html, IntoResponse};
use utoipa::OpenApi;

#[derive(OpenApi)]
#[openapi(
    info(
        title = "Rigsmith",
        description = "Rigs characters: send a mesh, get the same file back with a skeleton and skin weights.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0"),
    ),
    servers((url = "/", description = "This service")),
    tags(
        (name = "rigs", description = "A mesh in, a rig out."),
        (name = "artifacts", description = "The files that were made."),
        (name = "service", description = "What runs here, and how it is."),
    ),
    paths(
        rigs::create_rig, rigs::get_rig, rigs::list_rigs, rigs::cancel_rig, rigs::delete_rig, rigs::check_rig,
        artifacts::list_artifacts, artifacts::get_artifact,
        service::list_methods, service::list_problems, service::get_problem,
        service::livez, service::readyz, service::startupz, service::version,
    ),
)]
struct Description;

/// The OpenAPI 3.1 document.
pub async fn openapi() -> impl IntoResponse {
    Json(Description::openapi())
}

/// The same for people; a page that draws itself from the document and loads nothing else.
pub async fn docs() -> impl IntoResponse {
    page(include_str!("docs.html"))
}

/// A page to try the service with a file.
pub async fn front() -> impl IntoResponse {
    page(include_str!("front.html"))
}

fn page(html: &'static str) -> impl IntoResponse {
    const POLICY: &str = "default-src 'self'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; \
                          img-src 'self' data: blob:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'";
    ([(header::CONTENT_SECURITY_POLICY, POLICY), (header::CACHE_CONTROL, "no-cache")], Html(html))
}
