//! About the service itself: probes, version, methods, problems.

use super::App;
use super::error::{ApiError, Code, Facts};
use super::negotiate::query;
use super::segments::Segments;
use super::views::{ModelView, models};
use crate::jobs::{Availability, MethodInfo, Refusal, SkinMethodInfo};
use crate::pipelines::skin_choice::MeasuredL1;
use axum::Json;
use axum::extract::State;
use axum::http::Uri;
use serde::Serialize;
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// `ok`, in so many words.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Status)]
pub struct StatusView {
    #[schema(example = "ok")]
    pub status: &'static str,
}

#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Version)]
pub struct VersionView {
    #[schema(example = "rigsmith")]
    pub name: &'static str,
    #[schema(example = "0.1.0")]
    pub version: &'static str,
}

/// What runs here, and up to which sizes.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = MethodList)]
pub struct MethodListView {
    #[schema(example = "list")]
    pub object: &'static str,
    pub data: Vec<MethodView>,
    /// Limits of the service, whatever the method.
    #[schema(example = json!({"upload_bytes": 104_857_600, "queue": 100, "workers": 1, "job_seconds": 300}))]
    pub limits: BTreeMap<&'static str, u64>,
}

/// A skin method and how good it is.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = SkinMethodInfo)]
pub struct SkinMethodView {
    #[schema(example = "heter_skin_net")]
    pub name: &'static str,
    /// `skin_method=auto` means this one.
    pub auto: bool,
    #[schema(example = true)]
    pub available: bool,
    /// Why it cannot run here.
    pub unavailable_reason: Option<String>,
    /// Mean L1 to the artists' weights on validation rigs: of organic characters, of box models, and of all.
    #[schema(example = json!({"organic": 0.507, "box": 0.464, "all": 0.49}))]
    pub mean_l1: BTreeMap<&'static str, f64>,
}

#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Method)]
pub struct MethodView {
    #[schema(example = "rignet")]
    pub name: String,
    #[schema(example = "RigNet")]
    pub title: String,
    pub description: String,
    #[schema(example = true)]
    pub available: bool,
    /// Why it cannot run here.
    pub unavailable_reason: Option<String>,
    /// Licence of the weights.
    #[schema(example = "CC-BY-4.0")]
    pub licence: String,
    pub models: Vec<ModelView>,
    /// What may weigh the vertices, the best first.
    pub skin_methods: Vec<SkinMethodView>,
    #[schema(example = json!({"faces": 2_000_000, "vertices": 1_000_000}))]
    pub limits: BTreeMap<&'static str, u64>,
}

/// A kind of problem.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ProblemKind)]
pub struct ProblemKindView {
    #[schema(example = "queue_full")]
    pub code: &'static str,
    /// HTTP status, when it refuses a request.
    #[schema(example = 429)]
    pub status: u16,
    #[schema(example = "The queue is full")]
    pub title: &'static str,
    #[schema(example = "The service is at its limit and refuses early. Come back after Retry-After seconds.")]
    pub meaning: &'static str,
}

#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ProblemKindList)]
pub struct ProblemKindListView {
    #[schema(example = "list")]
    pub object: &'static str,
    pub data: Vec<ProblemKindView>,
}

/// Is the process alive?
#[utoipa::path(
    get, path = "/livez", tag = "service",
    responses((status = 200, description = "Yes", body = StatusView)),
    extensions(("x-curl" = json!("curl $HOST/livez"))),
)]
pub async fn livez() -> Json<StatusView> {
    Json(StatusView { status: "ok" })
}

/// Does the service take jobs?
#[utoipa::path(
    get, path = "/readyz", tag = "service",
    responses(
        (status = 200, description = "Yes: the networks are loaded and have passed their self-tests", body = StatusView),
    ),
    extensions(("x-curl" = json!("curl $HOST/readyz"))),
)]
pub async fn readyz(State(app): State<App>) -> Result<Json<StatusView>, ApiError> {
    app.jobs.ready()?;
    Ok(Json(StatusView { status: "ok" }))
}

/// Has the service started?
///
/// For probes that wait for a slow start: `200` from the moment the networks are loaded and tested, also while the
/// service drains or when a network failed its test; `/readyz` tells those.
#[utoipa::path(
    get, path = "/startupz", tag = "service",
    responses(
        (status = 200, description = "Yes", body = StatusView),
    ),
    extensions(("x-curl" = json!("curl $HOST/startupz"))),
)]
pub async fn startupz(State(app): State<App>) -> Result<Json<StatusView>, ApiError> {
    match app.jobs.ready() {
        Err(refusal @ Refusal::Starting) => Err(refusal.into()),
        _ => Ok(Json(StatusView { status: "ok" })),
    }
}

/// Which version runs.
#[utoipa::path(
    get, path = "/version", tag = "service",
    responses((status = 200, description = "Name and version", body = VersionView)),
    extensions(("x-curl" = json!("curl $HOST/version"))),
)]
pub async fn version() -> Json<VersionView> {
    Json(VersionView { name: env!("CARGO_PKG_NAME"), version: env!("CARGO_PKG_VERSION") })
}

/// List methods and limits.
#[utoipa::path(
    get, path = "/v1/methods", tag = "service",
    responses(
        (status = 200, description = "Every method this build knows, also those that cannot run here", body = MethodListView),
    ),
    extensions(("x-curl" = json!("curl $HOST/v1/methods"))),
)]
pub async fn list_methods(State(app): State<App>, uri: Uri) -> Result<Json<MethodListView>, ApiError> {
    query(&uri, &[])?;
    let settings = app.jobs.settings();
    let limits = BTreeMap::from([
        ("upload_bytes", app.limits.upload_bytes_max),
        ("uploads", app.limits.uploads_max as u64),
        ("open_uploads", app.limits.open_uploads_max as u64),
        ("queue", settings.queue_max as u64),
        ("workers", settings.workers as u64),
        ("job_seconds", settings.job_time_max.as_secs()),
        ("keep_seconds", settings.keep_time.as_secs()),
    ]);
    let data = app.jobs.methods().iter().map(MethodView::from).collect();
    Ok(Json(MethodListView { object: "list", data, limits }))
}

/// List kinds of problems.
#[utoipa::path(
    get, path = "/v1/problems", tag = "service",
    responses((status = 200, description = "Every code that an error may have", body = ProblemKindListView)),
    extensions(("x-curl" = json!("curl $HOST/v1/problems"))),
)]
pub async fn list_problems() -> Json<ProblemKindListView> {
    Json(ProblemKindListView { object: "list", data: Code::all().map(kind).collect() })
}

/// What a code means.
#[utoipa::path(
    get, path = "/v1/problems/{code}", tag = "service",
    params(("code" = String, Path, description = "Code of an error", example = "queue_full")),
    responses(
        (status = 200, description = "Its meaning", body = ProblemKindView),
    ),
    extensions(("x-curl" = json!("curl $HOST/v1/problems/queue_full"))),
)]
pub async fn get_problem(Segments(code): Segments<String>) -> Result<Json<ProblemKindView>, ApiError> {
    let known = Code::all().map(kind).find(|known| known.code == code);
    known.map(Json).ok_or_else(|| ApiError::not_found("such code").hint("GET /v1/problems lists them"))
}

fn kind(code: Code) -> ProblemKindView {
    let Facts { code, status, title, meaning } = code.facts();
    ProblemKindView { code, status: status.as_u16(), title, meaning }
}

fn why_unavailable(availability: &Availability) -> Option<String> {
    match availability {
        Availability::Available => None,
        Availability::Unavailable { reason } => Some(reason.clone()),
    }
}

impl From<&SkinMethodInfo> for SkinMethodView {
    fn from(method: &SkinMethodInfo) -> Self {
        let MeasuredL1 { organic, boxes, all } = method.mean_l1;
        let unavailable_reason = why_unavailable(&method.availability);
        Self {
            name: method.name,
            auto: method.is_auto,
            available: unavailable_reason.is_none(),
            unavailable_reason,
            mean_l1: BTreeMap::from([("organic", organic), ("box", boxes), ("all", all)]),
        }
    }
}

impl From<&MethodInfo> for MethodView {
    fn from(method: &MethodInfo) -> Self {
        let unavailable_reason = why_unavailable(&method.availability);
        Self {
            name: method.name.clone(),
            title: method.title.clone(),
            description: method.description.clone(),
            available: unavailable_reason.is_none(),
            unavailable_reason,
            licence: method.licence.clone(),
            models: models(&method.models),
            skin_methods: method.skin_methods.iter().map(SkinMethodView::from).collect(),
            limits: method.limits.iter().copied().collect(),
        }
    }
}
