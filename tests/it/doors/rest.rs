//! The table's asks over REST.

use super::asks::{Ask, Create, Door, Mesh, Said, comparable};
use crate::http::scripted::{Answer, form, request};
use axum::body::Body;
use axum::http::Request;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

impl Door<'_> {
    pub async fn ask_rest(&self, ask: Ask) -> Said {
        match ask {
            Ask::Create(create) => {
                let path = create.client_id.as_ref().map_or("/v1/rigs".to_owned(), |id| format!("/v1/rigs/{id}"));
                let answer = self.order(&path, &create).await;
                if !answer.status.is_success() {
                    return refused(&answer);
                }
                let over = self.rest("GET", answer.header("location"), &[("prefer", "wait=10")], "").await;
                Said::Fine(comparable(&over.json()))
            }
            Ask::Check(create) => {
                let answer = self.order("/v1/rigs:check", &create).await;
                said(&answer, |mut check| {
                    check.as_object_mut().expect("an object").remove("object");
                    whole(check)
                })
            }
            Ask::Get(id) => {
                let answer = self.rest("GET", &format!("/v1/rigs/{id}"), &[], "").await;
                said(&answer, |rig| comparable(&rig))
            }
            Ask::List(state, label, size, token) => {
                let mut path = "/v1/rigs?".to_owned();
                let size = if size == 0 { String::new() } else { size.to_string() };
                for (name, value) in [("state", state), ("label", label), ("page_size", &size), ("page_token", token)] {
                    if !value.is_empty() {
                        path += &format!("{name}={}&", value.replace('=', "%3D"));
                    }
                }
                let answer = self.rest("GET", &path, &[], "").await;
                said(&answer, |list| list["data"].as_array().expect("a list").iter().map(comparable).collect())
            }
            Ask::Cancel(id) => {
                let answer = self.rest("POST", &format!("/v1/rigs/{id}:cancel"), &[], "").await;
                said(&answer, |rig| rig["state"].clone())
            }
            Ask::Delete(id) => {
                let answer = self.rest("DELETE", &format!("/v1/rigs/{id}"), &[], "").await;
                if answer.status == 204 { Said::Fine(Value::Null) } else { refused(&answer) }
            }
            Ask::Reskin(id, skeleton, options) => {
                let mut path = format!("/v1/rigs/{id}:reskin?");
                for (name, value) in options.as_object().expect("options") {
                    path += &format!("{name}={}&", value.as_str().map_or_else(|| value.to_string(), str::to_owned));
                }
                let answer = self.rest("POST", &path, &[], skeleton).await;
                if !answer.status.is_success() {
                    return refused(&answer);
                }
                let over = self.rest("GET", answer.header("location"), &[("prefer", "wait=10")], "").await;
                Said::Fine(comparable(&over.json()))
            }
            Ask::Batch(defaults, items, key) => {
                let item = |(name, asset, options): &(&str, String, Value)| {
                    let mut request = options.clone();
                    request["asset"] = asset.as_str().into();
                    json!({"custom_id": name, "request": request})
                };
                let body = json!({"defaults": defaults, "items": items.iter().map(item).collect::<Vec<_>>()});
                let mut fields = vec![("content-type", "application/json")];
                fields.extend(key.as_deref().map(|key| ("idempotency-key", key)));
                let answer = self.rest("POST", "/v1/batches", &fields, &body.to_string()).await;
                if !answer.status.is_success() {
                    return refused(&answer);
                }
                Said::Fine(self.batch_over_rest(answer.header("location")).await)
            }
            Ask::Upload(files, key) => {
                let key = key.unwrap_or_default();
                let fields = [("idempotency-key", key.as_str())];
                let fields = if key.is_empty() { &[][..] } else { &fields[..] };
                let parts: Vec<_> = files.iter().map(|(name, content)| ("files", Some(*name), *content)).collect();
                let answer = self.service.send(self.signed(form("/v1/assets", fields, &parts))).await;
                said(
                    &answer,
                    |asset| json!({"sha256": asset["sha256"], "bytes": asset["bytes"], "files": asset["files"]}),
                )
            }
            Ask::Download(id, name, offset) => {
                let range = format!("bytes={offset}-");
                let fields = [("range", range.as_str())];
                let fields = if offset == 0 { &[][..] } else { &fields[..] };
                let answer = self.rest("GET", &format!("/v1/rigs/{id}/artifacts/{name}"), fields, "").await;
                match answer.status.is_success() {
                    true => Said::Fine(format!("{:x}", Sha256::digest(&answer.bytes)).into()),
                    false => refused(&answer),
                }
            }
        }
    }

    /// The counts of a batch that is over, and what became of its items.
    async fn batch_over_rest(&self, path: &str) -> Value {
        let batch = loop {
            let batch = self.rest("GET", path, &[], "").await.json();
            if batch["state"] != "running" {
                break batch;
            }
            tokio::time::sleep(std::time::Duration::from_millis(20)).await;
        };
        let results = self.rest("GET", &format!("{path}/results"), &[], "").await;
        let lines = String::from_utf8(results.bytes).expect("text");
        let results = lines.lines().map(|line| {
            let result: Value = serde_json::from_str(line).expect("JSON");
            let rig = comparable(&result["rig"]);
            let rig = if result["rig"].is_null() { Value::Null } else { rig };
            let error = &result["error"];
            json!({"custom_id": result["custom_id"], "rig": rig, "code": error["code"], "message": error["message"],
                "hint": error["hint"], "has_rig_id": result["rig_id"].is_string()})
        });
        json!({"state": batch["state"], "counts": batch["counts"], "results": results.collect::<Vec<_>>()})
    }

    async fn order(&self, path: &str, create: &Create) -> Answer {
        let mut body = create.options.clone();
        body["asset"] = match &create.mesh {
            Mesh::Asset(id) => id.as_str().into(),
            Mesh::Url(url) => json!({"url": url}),
            Mesh::Inline(media_type, bytes) => {
                json!({"inline": {"media_type": media_type, "base64": BASE64_STANDARD.encode(bytes)}})
            }
        };
        let mut fields = vec![("content-type", "application/json")];
        if let Some(key) = &create.key {
            fields.push(("idempotency-key", key));
        }
        if create.no_cache {
            fields.push(("cache-control", "no-cache"));
        }
        let method = if create.client_id.is_some() { "PUT" } else { "POST" };
        self.rest(method, path, &fields, &body.to_string()).await
    }

    async fn rest(&self, method: &str, path: &str, fields: &[(&str, &str)], body: &str) -> Answer {
        self.service.send(self.signed(request(method, path, fields, body))).await
    }

    fn signed(&self, mut request: Request<Body>) -> Request<Body> {
        if let Some(key) = &self.key {
            request.headers_mut().insert("authorization", format!("Bearer {key}").parse().expect("a field"));
        }
        request
    }
}

fn said(answer: &Answer, fine: impl FnOnce(Value) -> Value) -> Said {
    if answer.status.is_success() { Said::Fine(fine(answer.json())) } else { refused(answer) }
}

fn refused(answer: &Answer) -> Said {
    let problem = answer.json();
    let text = |name: &str| problem[name].as_str().unwrap_or_default().to_owned();
    // What one door says in a field of the header, the other says in a field of the message.
    let fields = problem["errors"].as_array().into_iter().flatten().map(|error| {
        let field = match error["field"].as_str().expect("a field") {
            "Idempotency-Key" => "request_id",
            "id" => "client_id",
            field => field,
        };
        (field.to_owned(), error["detail"].as_str().expect("a detail").to_owned())
    });
    Said::Refused {
        code: text("code"),
        hint: text("hint"),
        retryable: problem["retryable"].as_bool().expect("a truth"),
        retry: answer.headers.contains_key("retry-after"),
        fields: fields.collect(),
        limit: problem["limit"].clone(),
    }
}

/// Numbers without a fraction as whole ones: in a `google.protobuf.Struct` all are alike.
fn whole(value: Value) -> Value {
    match value {
        Value::Number(number) => match number.as_f64() {
            Some(real) if real.fract() == 0.0 => (real as i64).into(),
            _ => Value::Number(number),
        },
        Value::Array(members) => members.into_iter().map(whole).collect(),
        Value::Object(members) => members.into_iter().map(|(name, member)| (name, whole(member))).collect(),
        other => other,
    }
}
