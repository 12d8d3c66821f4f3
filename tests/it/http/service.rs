//! The service about itself.

use super::scripted::{Service, request};
use rigsmith::jobs::OptionsReader;
use rigsmith::server::http::error::Code;
use rigsmith::server::http::wishes::JOB_FIELDS;
use serde_json::{Value, json};
use std::collections::BTreeSet;

#[tokio::test]
async fn methods_show_what_runs_and_the_limits() {
    let service = Service::new();
    let methods = service.get("/v1/methods").await.json();
    assert_eq!(methods["data"][0]["available"], true);
    assert_eq!(methods["data"][0]["models"][0]["self_test"], "passed");
    assert_eq!(methods["data"][1]["unavailable_reason"], "no networks");
    assert_eq!(methods["data"][0]["limits"]["faces"], 2_000_000);
    assert_eq!(methods["limits"]["upload_bytes"], 100 * 1024 * 1024);
    assert_eq!(methods["limits"]["workers"], 2);
}

#[tokio::test]
async fn every_code_has_a_page_and_one_meaning() {
    let service = Service::new();
    let mut names = BTreeSet::new();
    for code in Code::all() {
        let facts = code.facts();
        assert!(names.insert(facts.code), "{} twice", facts.code);
        let page = service.get(&format!("/v1/problems/{}", facts.code)).await.json();
        assert_eq!(
            (page["status"].as_u64(), &page["title"]),
            (Some(facts.status.as_u16().into()), &json!(facts.title))
        );
        assert!(facts.status.is_client_error() || facts.status.is_server_error());
    }
    let listed = service.get("/v1/problems").await.json();
    assert_eq!(listed["data"].as_array().expect("data").len(), names.len());
}

#[tokio::test]
async fn request_ids_are_echoed_when_they_are_fit_for_a_log() {
    let service = Service::new();
    let echoed = service.send(request("GET", "/livez", &[("x-request-id", "abc-123")], "")).await;
    assert_eq!(echoed.header("x-request-id"), "abc-123");
    for unfit in ["with blank", &"x".repeat(129)] {
        let made = service.send(request("GET", "/livez", &[("x-request-id", unfit)], "")).await;
        assert_eq!(made.header("x-request-id").len(), 32);
    }
    assert_eq!(service.get("/version").await.json()["name"], "rigsmith");
}

#[tokio::test]
async fn every_answer_says_how_long_it_took() {
    let answer = Service::new().get("/livez").await;
    let total = answer.header("server-timing").strip_prefix("total;dur=").and_then(|ms| ms.parse::<f64>().ok());
    assert!(total.is_some_and(|ms| ms < 10_000.0), "{}", answer.header("server-timing"));
}

/// All `$ref`s of the document lead somewhere, and every operation is complete.
#[tokio::test]
async fn the_description_is_whole() {
    let service = Service::new();
    let document = service.get("/v1/openapi.json").await.json();
    assert_eq!(document["openapi"].as_str().map(|version| &version[..3]), Some("3.1"));
    let mut references = Vec::new();
    collect_references(&document, &mut references);
    for reference in references {
        assert!(document.pointer(reference.trim_start_matches('#')).is_some(), "{reference} leads nowhere");
    }
    let paths = document["paths"].as_object().expect("paths");
    for path in [
        "/v1/rigs",
        "/v1/rigs/{id}",
        "/v1/rigs/{id}:cancel",
        "/v1/rigs/{id}/artifacts/{name}",
        "/v1/methods",
        "/readyz",
    ] {
        assert!(paths.contains_key(path), "{path}");
    }
    for (path, operations) in paths {
        for (verb, operation) in operations.as_object().expect("operations") {
            assert!(operation["summary"].is_string(), "{verb} {path} has no summary");
            assert!(operation["x-curl"].is_string(), "{verb} {path} has no example");
            for (status, response) in operation["responses"].as_object().expect("responses") {
                let refuses = status.starts_with(['4', '5']);
                assert_eq!(
                    refuses,
                    response["content"]["application/problem+json"].is_object(),
                    "{verb} {path} {status}"
                );
            }
        }
    }
}

fn collect_references<'a>(value: &'a Value, references: &mut Vec<&'a str>) {
    match value {
        Value::Object(members) => {
            references.extend(members.get("$ref").and_then(Value::as_str));
            members.values().for_each(|member| collect_references(member, references));
        }
        Value::Array(values) => values.iter().for_each(|member| collect_references(member, references)),
        _ => {}
    }
}

#[tokio::test]
async fn the_description_names_every_option() {
    let document = Service::new().get("/v1/openapi.json").await.json();
    let parameters = document["paths"]["/v1/rigs"]["post"]["parameters"].as_array().expect("parameters");
    let described: BTreeSet<&str> = parameters
        .iter()
        .filter(|p| p["in"] == "query" && p["name"] != "file_name")
        .filter_map(|p| p["name"].as_str())
        .collect();
    assert_eq!(described, OptionsReader::FIELDS.iter().chain(JOB_FIELDS).copied().collect());
    assert!(parameters.iter().all(|parameter| parameter["required"] != true), "no option is required");
}

#[tokio::test]
async fn pages_load_nothing_from_elsewhere() {
    let service = Service::new();
    for path in ["/", "/docs"] {
        let page = service.get(path).await;
        assert!(page.header("content-type").starts_with("text/html"));
        assert!(page.header("content-security-policy").contains("default-src 'self'"));
        for word in ["src=\"http", "href=\"http", "@import", "url(http"] {
            assert!(!page.text().contains(word), "{path}: {word}");
        }
    }
}
