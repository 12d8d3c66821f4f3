//! What requests have in common: the mesh, the options, and how often the same request may come. Options are read by the
//! reader that REST has, so that words, ranges and refusals are the same.

use super::super::App;
use super::super::http::error::ApiError;
use super::super::http::fetch::Wanted;
use super::super::http::wishes::WishesReader;
use super::super::http::{idempotency, media};
use super::super::orders::{self, Terms};
use super::super::uploads::{self, asset_id};
use super::proto::rigsmith::v1::mesh::Mesh as MeshIs;
use super::proto::rigsmith::v1::{FetchedMesh, InlineMesh, Mesh, RigOptions, Webhook};
use crate::jobs::Source;
use serde_json::{Map, Value, json};
use std::time::SystemTime;

/// A reader of the fields that are set, and their names.
pub fn read(options: Option<RigOptions>) -> (WishesReader, Vec<&'static str>) {
    let given = given(options.unwrap_or_default());
    let mut reader = WishesReader::default();
    given.iter().for_each(|(name, value)| reader.json(name, value));
    (reader, given.into_iter().map(|(name, _)| name).collect())
}

/// The fields that are set as members of a JSON object.
pub fn members(options: RigOptions) -> Map<String, Value> {
    given(options).into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

fn given(options: RigOptions) -> Vec<(&'static str, Value)> {
    let RigOptions {
        method,
        detail,
        bandwidth,
        symmetry,
        fingers,
        skin_method,
        boxes,
        skin_fallback,
        skeleton,
        non_deforming,
        locked_joints,
        max_influences,
        smooth,
        prune,
        mirror_weights,
        seed,
        up,
        front,
        existing_rig,
        outputs,
        priority,
        timeout_seconds,
        retention_hours,
        labels,
        webhook,
    } = options;
    let list = |names: Vec<String>| if names.is_empty() { None } else { Some(Value::from(names)) };
    let labels = labels.into_iter().map(|(name, value)| (name, Value::from(value))).collect::<Map<_, _>>();
    let labels = if labels.is_empty() { None } else { Some(Value::Object(labels)) };
    let fields = [
        ("method", method.map(Value::from)),
        ("detail", detail.map(number)),
        ("bandwidth", bandwidth.map(number)),
        ("symmetry", symmetry.map(Value::from)),
        ("fingers", fingers.map(Value::from)),
        ("skin_method", skin_method.map(Value::from)),
        ("boxes", boxes.map(Value::from)),
        ("skin_fallback", list(skin_fallback)),
        ("skeleton", skeleton.map(Value::from)),
        ("non_deforming", list(non_deforming)),
        ("locked_joints", list(locked_joints)),
        ("max_influences", max_influences.map(Value::from)),
        ("smooth", smooth.map(number)),
        ("prune", prune.map(number)),
        ("mirror_weights", mirror_weights.map(Value::from)),
        ("seed", seed.map(Value::from)),
        ("up", up.map(Value::from)),
        ("front", front.map(Value::from)),
        ("existing_rig", existing_rig.map(Value::from)),
        ("outputs", list(outputs)),
        ("priority", priority.map(Value::from)),
        ("timeout_seconds", timeout_seconds.map(Value::from)),
        ("retention_hours", retention_hours.map(Value::from)),
        ("labels", labels),
        ("webhook", webhook.map(told)),
    ];
    fields.into_iter().filter_map(|(name, value)| Some((name, value?))).collect()
}

/// Where a job wants told what becomes of it, as REST has it.
fn told(webhook: Webhook) -> Value {
    let Webhook { url, events } = webhook;
    let events = if events.is_empty() { Value::Null } else { Value::from(events) };
    json!({"url": url, "events": events})
}

/// JSON has no word for what is not finite, and would take it for "not given"; as text it is refused.
fn number(value: f64) -> Value {
    if value.is_finite() { Value::from(value) } else { Value::from(value.to_string()) }
}

/// The mesh that a request names or brings.
pub async fn source(app: &App, mesh: Option<Mesh>) -> Result<Source, ApiError> {
    match mesh.and_then(|mesh| mesh.mesh) {
        Some(MeshIs::Asset(id)) => asset_id(&id).map(Source::Asset),
        Some(MeshIs::Inline(InlineMesh { media_type, data })) => {
            let name = media::name_for(&media_type)?;
            uploads::inline(app, &name, data).await.map(Source::Upload)
        }
        Some(MeshIs::Fetched(FetchedMesh { url, sha256 })) => {
            let sha256 = Some(sha256.as_str()).filter(|text| !text.is_empty());
            Wanted::new(url, sha256)?.fetch(app).await.map(Source::Upload)
        }
        None => Err(ApiError::field("mesh", "is missing").hint("UploadAsset keeps a mesh and gives its id")),
    }
}

/// What a request says of its job beside what it is to make. Empty texts are texts that were not set.
pub fn terms(
    request_id: &str,
    client_id: String,
    no_cache: bool,
    deadline: Option<SystemTime>,
) -> Result<Terms, ApiError> {
    let client_id = if client_id.is_empty() { None } else { Some(orders::client_id("client_id", client_id)?) };
    Ok(Terms { client_id, idempotency_key: self::request_id(request_id)?, use_cache: !no_cache, deadline })
}

/// The idempotency key of a request, when it has one.
pub fn request_id(text: &str) -> Result<Option<String>, ApiError> {
    if text.is_empty() { Ok(None) } else { idempotency::checked("request_id", text).map(Some) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::OptionsReader;
    use crate::server::grpc::proto::DESCRIPTORS;
    use crate::server::http::wishes::JOB_FIELDS;
    use prost::Message;
    use std::collections::BTreeSet;

    #[test]
    fn the_message_has_every_option_of_rest_and_no_other() {
        let files = prost_types::FileDescriptorSet::decode(DESCRIPTORS).expect("descriptors").file;
        let messages = files.iter().filter(|file| file.package() == "rigsmith.v1").flat_map(|file| &file.message_type);
        let options = messages.into_iter().find(|message| message.name() == "RigOptions").expect("a message");
        let fields: BTreeSet<&str> = options.field.iter().map(|field| field.name()).collect();
        assert_eq!(fields, OptionsReader::FIELDS.iter().chain(JOB_FIELDS).copied().collect());
    }

    #[test]
    fn fields_that_are_not_set_are_not_given_and_what_is_not_finite_is_refused() {
        assert!(read(None).1.is_empty());
        let settings = crate::jobs::Settings::default();
        for detail in [f64::NAN, f64::INFINITY] {
            let (reader, fields) = read(Some(RigOptions { detail: Some(detail), ..RigOptions::default() }));
            assert_eq!(fields, ["detail"]);
            assert!(reader.finish(&settings).is_err(), "{detail}");
        }
    }
}
