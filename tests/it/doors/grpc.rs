//! The table's asks over gRPC.

use super::asks::{Ask, Create, Door, Mesh, Said, comparable};
use axum::Router;
use prost::Message;
use prost_types::value::Kind;
use rigsmith::server::grpc::proto::google::longrunning::operation::Result as OperationResult;
use rigsmith::server::grpc::proto::google::longrunning::operations_client::OperationsClient;
use rigsmith::server::grpc::proto::google::longrunning::{DeleteOperationRequest, Operation, WaitOperationRequest};
use rigsmith::server::grpc::proto::google::rpc;
use rigsmith::server::grpc::proto::rigsmith::v1::mesh::Mesh as MeshIs;
use rigsmith::server::grpc::proto::rigsmith::v1::rig::State;
use rigsmith::server::grpc::proto::rigsmith::v1::rig_service_client::RigServiceClient;
use rigsmith::server::grpc::proto::rigsmith::v1::upload_chunk::Part;
use rigsmith::server::grpc::proto::rigsmith::v1::{self as proto, Rig, RigOptions};
use serde_json::{Map, Value, json};
use sha2::{Digest, Sha256};
use tonic::{Request, Status};

impl Door<'_> {
    pub fn rigs(&self) -> RigServiceClient<Router> {
        RigServiceClient::new(self.service.router.clone())
    }

    pub fn operations(&self) -> OperationsClient<Router> {
        OperationsClient::new(self.service.router.clone())
    }

    /// A call with the key, when there is one.
    pub fn call<T>(&self, message: T) -> Request<T> {
        let mut request = Request::new(message);
        if let Some(key) = &self.key {
            request.metadata_mut().insert("authorization", format!("Bearer {key}").parse().expect("a field"));
        }
        request
    }

    pub async fn ask_grpc(&self, ask: Ask) -> Said {
        self.asked_grpc(ask).await.unwrap_or_else(|status| refused(&status))
    }

    async fn asked_grpc(&self, ask: Ask) -> Result<Said, Status> {
        let mut rigs = self.rigs();
        Ok(Said::Fine(match ask {
            Ask::Create(create) => {
                let asked = proto::CreateRigRequest {
                    mesh: mesh(&create),
                    options: Some(options(&create.options)),
                    request_id: create.key.unwrap_or_default(),
                    client_id: create.client_id.unwrap_or_default(),
                    no_cache: create.no_cache,
                };
                let operation = rigs.create_rig(self.call(asked)).await?.into_inner();
                comparable(&self.over(operation).await?)
            }
            Ask::Check(create) => {
                let asked = proto::CheckRigRequest { mesh: mesh(&create), options: Some(options(&create.options)) };
                let checked = rigs.check_rig(self.call(asked)).await?.into_inner();
                let report = object(checked.report.expect("a report"));
                assert_eq!(report["riggable"], checked.riggable);
                report
            }
            Ask::Get(id) => {
                let rig = rigs.get_rig(self.call(proto::GetRigRequest { id })).await?;
                comparable(&rig_json(rig.into_inner()))
            }
            Ask::List(state, label, page_size, page_token) => {
                let state = [State::Queued, State::Running, State::Succeeded, State::Failed, State::Canceled]
                    .into_iter()
                    .find(|known| name(*known) == state);
                let asked = proto::ListRigsRequest {
                    state: state.unwrap_or(State::Unspecified).into(),
                    label: label.to_owned(),
                    page_size,
                    page_token: page_token.to_owned(),
                };
                let list = rigs.list_rigs(self.call(asked)).await?.into_inner();
                list.rigs.into_iter().map(|rig| comparable(&rig_json(rig))).collect()
            }
            Ask::Cancel(id) => {
                let rig = rigs.cancel_rig(self.call(proto::CancelRigRequest { id })).await?;
                rig_json(rig.into_inner())["state"].clone()
            }
            Ask::Delete(id) => {
                let asked = DeleteOperationRequest { name: format!("operations/{id}") };
                self.operations().delete_operation(self.call(asked)).await?;
                Value::Null
            }
            Ask::Reskin(id, skeleton, wanted) => {
                let asked = proto::ReskinRigRequest {
                    id,
                    skeleton: skeleton.as_bytes().to_vec().into(),
                    options: Some(options(&wanted)),
                    ..proto::ReskinRigRequest::default()
                };
                let operation = rigs.reskin_rig(self.call(asked)).await?.into_inner();
                comparable(&self.over(operation).await?)
            }
            Ask::Batch(defaults, items, key) => {
                let items = items.into_iter().map(|(name, asset, wanted)| proto::BatchItem {
                    custom_id: name.to_owned(),
                    asset,
                    options: Some(options(&wanted)),
                });
                let asked = proto::CreateBatchRequest {
                    defaults: Some(options(&defaults)),
                    items: items.collect(),
                    items_asset: String::new(),
                    request_id: key.unwrap_or_default(),
                };
                let operation = rigs.create_batch(self.call(asked)).await?.into_inner();
                self.batch_over_grpc(operation).await?
            }
            Ask::Upload(files, key) => {
                let chunks = files.iter().flat_map(|(name, content)| {
                    let file = proto::UploadFile { name: (*name).to_owned(), main: false };
                    let halves = content.as_bytes().split_at(content.len() / 2);
                    let data = [halves.0, halves.1].map(|half| Part::Data(half.to_vec().into()));
                    [Part::File(file)].into_iter().chain(data)
                });
                let id = key.unwrap_or_default();
                let chunks: Vec<_> =
                    chunks.map(|part| proto::UploadChunk { part: Some(part), request_id: id.clone() }).collect();
                let asset = rigs.upload_asset(self.call(tokio_stream::iter(chunks))).await?.into_inner();
                json!({"sha256": asset.sha256, "bytes": asset.bytes, "files": files_json(asset.files)})
            }
            Ask::Download(id, name, offset) => {
                let asked = proto::DownloadArtifactRequest { id, name: name.to_owned(), offset };
                let mut chunks = rigs.download_artifact(self.call(asked)).await?.into_inner();
                let first = chunks.message().await?.expect("a first message");
                let (artifact, mut bytes) = (first.artifact.expect("what the file is"), first.data.to_vec());
                while let Some(chunk) = chunks.message().await? {
                    bytes.extend_from_slice(&chunk.data);
                }
                assert_eq!(artifact.bytes, offset + bytes.len() as u64);
                format!("{:x}", Sha256::digest(&bytes)).into()
            }
        }))
    }

    /// The counts of a batch that is over, and what became of its items.
    async fn batch_over_grpc(&self, operation: Operation) -> Result<Value, Status> {
        let asked = WaitOperationRequest { name: operation.name.clone(), timeout: None };
        let operation = self.operations().wait_operation(self.call(asked)).await?.into_inner();
        let told = operation.metadata.expect("metadata");
        assert_eq!((operation.done, told.type_url.as_str()), (true, "type.googleapis.com/rigsmith.v1.Batch"));
        let batch = proto::Batch::decode(&*told.value).expect("a batch");
        assert!(batch.end_time.is_some());
        let asked = proto::ListBatchResultsRequest { id: batch.id.clone() };
        let mut stream = self.rigs().list_batch_results(self.call(asked)).await?.into_inner();
        let mut results = Vec::new();
        while let Some(proto::BatchResult { custom_id, result, rig_id }) = stream.message().await? {
            let (rig, error) = match result.expect("a result") {
                proto::batch_result::Result::Rig(rig) => (comparable(&rig_json(rig)), None),
                proto::batch_result::Result::Error(error) => (Value::Null, Some(error)),
            };
            let said = |text: fn(&proto::RigError) -> &String| {
                error.as_ref().map(|error| text(error).clone()).filter(|text| !text.is_empty())
            };
            results.push(json!({"custom_id": custom_id, "rig": rig, "code": said(|error| &error.code),
                "message": said(|error| &error.message), "hint": said(|error| &error.hint), "has_rig_id": !rig_id.is_empty()}));
        }
        let counts = json!({"queued": batch.queued, "running": batch.running, "succeeded": batch.succeeded,
            "failed": batch.failed, "canceled": batch.canceled});
        let state = batch.state().as_str_name().to_lowercase();
        Ok(json!({"state": state, "counts": counts, "results": results}))
    }

    /// The rig of an operation once it is over; the operation tells the same.
    async fn over(&self, operation: Operation) -> Result<Value, Status> {
        let asked = WaitOperationRequest { name: operation.name.clone(), timeout: None };
        let operation = self.operations().wait_operation(self.call(asked)).await?.into_inner();
        assert!(operation.done);
        let id = operation.name.strip_prefix("operations/").expect("a name").to_owned();
        let rig = self.rigs().get_rig(self.call(proto::GetRigRequest { id })).await?.into_inner();
        match operation.result.expect("an end") {
            OperationResult::Response(any) => {
                assert_eq!(any.type_url, "type.googleapis.com/rigsmith.v1.Rig");
                assert_eq!(Rig::decode(&*any.value).expect("a rig"), rig);
            }
            OperationResult::Error(error) => {
                let reason = info(&error.details).reason;
                assert_eq!(rig.error.as_ref().map(|error| error.code.clone()), Some(reason));
            }
        }
        Ok(rig_json(rig))
    }
}

fn mesh(create: &Create) -> Option<proto::Mesh> {
    let mesh = match &create.mesh {
        Mesh::Asset(id) => MeshIs::Asset(id.clone()),
        Mesh::Url(url) => MeshIs::Fetched(proto::FetchedMesh { url: url.clone(), sha256: String::new() }),
        Mesh::Inline(media_type, data) => {
            MeshIs::Inline(proto::InlineMesh { media_type: (*media_type).to_owned(), data: data.clone().into() })
        }
    };
    Some(proto::Mesh { mesh: Some(mesh) })
}

/// Options from JSON members, each of its field's type.
fn options(members: &Value) -> RigOptions {
    let mut options = RigOptions::default();
    for (name, value) in members.as_object().expect("options") {
        let text = || Some(value.as_str().expect("a text").to_owned());
        match name.as_str() {
            "method" => options.method = text(),
            "detail" => options.detail = value.as_f64(),
            "bandwidth" => options.bandwidth = value.as_f64(),
            "symmetry" => options.symmetry = text(),
            "fingers" => options.fingers = text(),
            "boxes" => options.boxes = text(),
            "max_influences" => options.max_influences = value.as_u64().map(|number| number as u32),
            "skin_fallback" => options.skin_fallback = names(value),
            "non_deforming" => options.non_deforming = names(value),
            "locked_joints" => options.locked_joints = names(value),
            "smooth" => options.smooth = value.as_f64(),
            "prune" => options.prune = value.as_f64(),
            "mirror_weights" => options.mirror_weights = text(),
            "seed" => options.seed = value.as_u64(),
            "up" => options.up = text(),
            "existing_rig" => options.existing_rig = text(),
            "priority" => options.priority = text(),
            "timeout_seconds" => options.timeout_seconds = value.as_u64(),
            "skeleton" => options.skeleton = text(),
            "outputs" => options.outputs = names(value),
            "labels" => {
                let labels = value.as_object().expect("labels").iter();
                options.labels =
                    labels.map(|(name, value)| (name.clone(), value.as_str().expect("a text").to_owned())).collect();
            }
            "webhook" => {
                let url = value["url"].as_str().expect("a url").to_owned();
                let events = value["events"].as_array().into_iter().flatten();
                let events = events.map(|name| name.as_str().expect("a text").to_owned()).collect();
                options.webhook = Some(proto::Webhook { url, events });
            }
            other => panic!("the table has no field {other}"),
        }
    }
    options
}

fn names(list: &Value) -> Vec<String> {
    list.as_array().expect("a list").iter().map(|name| name.as_str().expect("a text").to_owned()).collect()
}

fn name(state: State) -> String {
    state.as_str_name().to_lowercase()
}

/// A rig in the words of REST. What is empty here is `null` there.
pub fn rig_json(rig: Rig) -> Value {
    let text = |text: String| if text.is_empty() { Value::Null } else { text.into() };
    let time = |time: Option<prost_types::Timestamp>| time.map(|time| time.to_string());
    let state = name(rig.state());
    let wanted = rig.options.expect("options");
    let provenance = rig.provenance.expect("a provenance");
    let models: Vec<Value> = provenance
        .models
        .into_iter()
        .map(|model| json!({"name": model.name, "sha256": model.sha256, "self_test": model.self_test}))
        .collect();
    let warnings = rig.warnings.into_iter().map(|finding| {
        json!({"code": finding.code, "severity": finding.severity, "message": finding.message, "hint": finding.hint, "where": finding.r#where})
    });
    let result = rig.result.map(|result| {
        let mut members = object(result.report.expect("a report"));
        let artifacts = result.artifacts.into_iter().map(|artifact| {
            let proto::Artifact { name, media_type, bytes, sha256 } = artifact;
            json!({"name": name, "media_type": media_type, "bytes": bytes, "sha256": sha256})
        });
        members["artifacts"] = artifacts.collect();
        members
    });
    let error = rig.error.map(|error| {
        json!({"code": error.code, "stage": text(error.stage), "message": error.message, "hint": text(error.hint), "retryable": error.retryable})
    });
    // In two parts: one is more than the macro takes.
    let mut request = json!({
        "method": wanted.method, "detail": wanted.detail, "bandwidth": wanted.bandwidth, "symmetry": wanted.symmetry,
        "skin_method": wanted.skin_method, "boxes": wanted.boxes, "fingers": wanted.fingers, "skeleton": wanted.skeleton,
        "max_influences": wanted.max_influences,
        "smooth": wanted.smooth, "prune": wanted.prune, "mirror_weights": wanted.mirror_weights,
        "skin_fallback": wanted.skin_fallback, "non_deforming": wanted.non_deforming, "locked_joints": wanted.locked_joints,
        "seed": wanted.seed, "up": wanted.up, "front": wanted.front, "existing_rig": wanted.existing_rig,
        "outputs": wanted.outputs,
    });
    let treated = json!({
        "priority": wanted.priority, "timeout_seconds": wanted.timeout_seconds,
        "retention_hours": wanted.retention_hours, "labels": wanted.labels,
        "webhook": wanted.webhook.map(|webhook| json!({"url": webhook.url, "events": webhook.events})),
    });
    request.as_object_mut().expect("an object").extend(treated.as_object().expect("an object").clone());
    json!({
        "id": rig.id,
        "state": state,
        "stage": text(rig.stage),
        "progress": rig.progress,
        "attempt": rig.attempt,
        "cancel_requested": rig.cancel_requested,
        "queue_position": rig.queue_position,
        "request": request,
        "client_id": text(rig.client_id),
        "asset": text(rig.asset),
        "files": files_json(rig.files),
        "method_used": text(rig.method_used),
        "provenance": {
            "asset_sha256": provenance.asset_sha256, "service_version": provenance.service_version,
            "models": models, "cached": provenance.cached,
        },
        "timings_ms": rig.timings_ms,
        "warnings": warnings.collect::<Vec<_>>(),
        "result": result,
        "error": error,
        "started_at": time(rig.start_time),
        "finished_at": time(rig.end_time),
        "expires_at": time(rig.expire_time),
    })
}

fn files_json(files: Vec<proto::StoredFile>) -> Value {
    files.into_iter().map(|file| json!({"name": file.name, "bytes": file.bytes, "sha256": file.sha256})).collect()
}

/// A struct as JSON; whole numbers are written as such, as REST does.
pub fn object(message: prost_types::Struct) -> Value {
    Value::Object(message.fields.into_iter().map(|(name, member)| (name, value(member))).collect::<Map<_, _>>())
}

fn value(message: prost_types::Value) -> Value {
    match message.kind.expect("a kind") {
        Kind::NullValue(_) => Value::Null,
        Kind::BoolValue(truth) => truth.into(),
        Kind::NumberValue(number) if number.fract() == 0.0 => (number as i64).into(),
        Kind::NumberValue(number) => number.into(),
        Kind::StringValue(text) => text.into(),
        Kind::ListValue(list) => list.values.into_iter().map(value).collect(),
        Kind::StructValue(inner) => object(inner),
    }
}

/// A detail of this type.
pub fn detail<M: Message + Default>(details: &[prost_types::Any], name: &str) -> Option<M> {
    let url = format!("type.googleapis.com/google.rpc.{name}");
    details.iter().find(|any| any.type_url == url).map(|any| M::decode(&*any.value).expect(name))
}

pub fn details(status: &Status) -> Vec<prost_types::Any> {
    let told = rpc::Status::decode(status.details()).expect("a google.rpc.Status");
    assert_eq!((told.code, told.message.as_str()), (status.code() as i32, status.message()));
    told.details
}

pub fn info(details: &[prost_types::Any]) -> rpc::ErrorInfo {
    detail(details, "ErrorInfo").expect("every refusal tells its reason")
}

pub fn refused(status: &Status) -> Said {
    let details = details(status);
    let rpc::ErrorInfo { reason, domain, metadata } = info(&details);
    assert_eq!(domain, "rigsmith");
    let told = |name: &str| metadata.get(name).cloned().unwrap_or_default();
    assert_eq!(told("type"), format!("/v1/problems/{reason}"));
    let limit = match metadata.get("limit") {
        None => Value::Null,
        Some(name) => json!({
            "name": name,
            "max": told("limit_max").parse::<u64>().expect("a number"),
            "actual": told("limit_actual").parse::<u64>().ok(),
        }),
    };
    let fields = detail::<rpc::BadRequest>(&details, "BadRequest").unwrap_or_default().field_violations;
    Said::Refused {
        code: reason,
        hint: told("hint"),
        retryable: told("retryable") == "true",
        retry: detail::<rpc::RetryInfo>(&details, "RetryInfo").is_some(),
        fields: fields.into_iter().map(|field| (field.field, field.description)).collect(),
        limit,
    }
}
