//! The items of a batch, as they come in. One that cannot be read fails alone, under its name or the number of its line.

use super::error::{ApiError, Code};
use crate::jobs::Source;
use crate::jobs::{ErrorCode, NewItem, Settings};
use crate::server::batches::{reader, source, written};
use serde_json::{Map, Value};
use std::collections::HashMap;

/// Items within JSON,
pub const ITEMS_MAX: usize = 1000;
/// and in lines.
pub const LINES_MAX: usize = 50_000;
const CUSTOM_ID_MAX: usize = 128;

/// What the JSON of a batch says.
#[derive(Debug)]
pub struct Wanted {
    pub defaults: Map<String, Value>,
    pub items: Items,
}

#[derive(Debug)]
pub enum Items {
    Inline(Vec<Value>),
    /// Lines that were uploaded before.
    Asset(String),
}

impl Wanted {
    pub fn read(mut members: Map<String, Value>, settings: &Settings) -> Result<Self, ApiError> {
        let defaults = match members.shift_remove("defaults") {
            None | Some(Value::Null) => Map::new(),
            Some(Value::Object(defaults)) => defaults,
            Some(_) => return Err(ApiError::field("defaults", "is not an object")),
        };
        let mut options = defaults.clone();
        options.shift_remove("asset");
        reader(&options).finish(settings)?;
        let items = match members.shift_remove("items") {
            Some(Value::Array(items)) => Items::Inline(items),
            Some(Value::String(asset)) => Items::Asset(asset),
            Some(_) => return Err(ApiError::field("items", "is neither a list nor the id of an asset")),
            None => return Err(ApiError::field("items", "is missing")),
        };
        match members.keys().next() {
            Some(other) => Err(ApiError::unknown_field(other, "defaults, items")),
            None => Ok(Self { defaults, items }),
        }
    }
}

pub fn of_values(values: Vec<Value>, defaults: &Map<String, Value>) -> Result<Vec<NewItem>, ApiError> {
    counted(values.len(), ITEMS_MAX, "send more as application/jsonl, with an item in each line")?;
    Ok(named_once(values.into_iter().map(Ok), defaults))
}

/// Lines without anything are passed over.
pub fn of_lines(lines: &[u8], defaults: &Map<String, Value>) -> Result<Vec<NewItem>, ApiError> {
    let lines: Vec<&[u8]> =
        lines.split(|byte| *byte == b'\n').filter(|line| !line.iter().all(u8::is_ascii_whitespace)).collect();
    counted(lines.len(), LINES_MAX, "send them in several batches")?;
    let values = lines.into_iter().map(|line| {
        serde_json::from_slice(line)
            .map_err(|error| ApiError::new(Code::InvalidJson, format!("the line is not JSON: {error}")))
    });
    Ok(named_once(values, defaults))
}

fn counted(count: usize, max: usize, hint: &str) -> Result<(), ApiError> {
    match count {
        0 => Err(ApiError::field("items", "is empty")),
        count if count > max => Err(ApiError::field("items", format!("{count} items are more than {max}")).hint(hint)),
        _ => Ok(()),
    }
}

/// Items in order; the second of a name fails.
fn named_once(values: impl Iterator<Item = Result<Value, ApiError>>, defaults: &Map<String, Value>) -> Vec<NewItem> {
    let mut known: HashMap<String, usize> = HashMap::new();
    let mut items = Vec::new();
    for (position, value) in values.enumerate() {
        let mut item = item(position, value, defaults);
        match known.get(&item.custom_id) {
            Some(first) => {
                let detail = format!("{:?} is the name of item {} too", item.custom_id, first + 1);
                item.error = Some(written(&ApiError::field("custom_id", detail)));
            }
            None => _ = known.insert(item.custom_id.clone(), position),
        }
        items.push(item);
    }
    items
}

fn item(position: usize, value: Result<Value, ApiError>, defaults: &Map<String, Value>) -> NewItem {
    let unnamed = || format!("item-{}", position + 1);
    let failed = |custom_id, error: &ApiError| NewItem {
        custom_id,
        request: "{}".to_owned(),
        asset: None,
        error: Some(written(error)),
    };
    let mut members = match value {
        Ok(Value::Object(members)) => members,
        Ok(_) => return failed(unnamed(), &ApiError::new(Code::InvalidJson, "the item is not an object")),
        Err(error) => return failed(unnamed(), &error),
    };
    let custom_id = match members.shift_remove("custom_id") {
        Some(Value::String(name)) if is_name(&name) => name,
        _ => {
            let detail = format!("is no text of 1 to {CUSTOM_ID_MAX} characters without control characters");
            return failed(unnamed(), &ApiError::field("custom_id", detail));
        }
    };
    let request = match (members.shift_remove("request"), members.keys().next()) {
        (_, Some(other)) => return failed(custom_id, &ApiError::unknown_field(other, "custom_id, request")),
        (Some(Value::Object(request)), None) => request,
        _ => return failed(custom_id, &ApiError::field("request", "is missing, or not an object")),
    };
    let mut whole = defaults.clone();
    whole.extend(request);
    match source(whole.get("asset").cloned()) {
        Ok(Source::Asset(asset)) => {
            NewItem { custom_id, request: Value::Object(whole).to_string(), asset: Some(asset), error: None }
        }
        Ok(_) => failed(custom_id, &ApiError::field("asset", "is not the id of an asset")),
        Err(error) => failed(custom_id, &error),
    }
}

fn is_name(name: &str) -> bool {
    (1..=CUSTOM_ID_MAX).contains(&name.chars().count()) && !name.chars().any(char::is_control)
}

pub fn unsupported(seen: &str) -> ApiError {
    let detail = format!("the body is declared as {seen:?}, and a batch is JSON");
    ApiError::new(Code::Work(ErrorCode::UnsupportedMediaType), detail)
        .hint("send application/json with items, or application/jsonl with an item in each line")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    const ASSET: &str = "ast_00000000000000000000000000";

    #[test]
    fn what_cannot_be_read_fails_alone_and_order_stays() {
        let good = json!({"custom_id": "a", "request": {"asset": ASSET, "seed": 1}}).to_string();
        let lines = [
            good.as_str(),
            "",
            "nonsense",
            "[]",
            r#"{"custom_id": "b"}"#,
            r#"{"custom_id": "c", "request": {}, "more": 1}"#,
            r#"{"custom_id": "d", "request": {"asset": {"inline": {}}}}"#,
            r#"{"custom_id": 5, "request": {}}"#,
            good.as_str(),
        ];
        let defaults = Map::from_iter([("seed".to_owned(), json!(7)), ("detail".to_owned(), json!(0.2))]);
        let items = of_lines(lines.join("\n").as_bytes(), &defaults).expect("a batch");
        let names: Vec<&str> = items.iter().map(|item| item.custom_id.as_str()).collect();
        assert_eq!(names, ["a", "item-2", "item-3", "b", "c", "d", "item-7", "a"]);
        assert_eq!(
            items.iter().map(|item| item.error.is_none()).collect::<Vec<_>>(),
            [true, false, false, false, false, false, false, false]
        );
        let request: Value = serde_json::from_str(&items[0].request).expect("JSON");
        assert_eq!(request, json!({"seed": 1, "detail": 0.2, "asset": ASSET}));
        assert!(items[7].error.as_ref().is_some_and(|error| error.contains("item 1 too")));
    }

    #[test]
    fn a_batch_has_items_and_not_too_many() {
        let none = Map::new();
        assert!(of_lines(b"\n\n", &none).is_err() && of_values(Vec::new(), &none).is_err());
        let many = |count| vec![json!({}); count];
        assert!(of_values(many(ITEMS_MAX), &none).is_ok() && of_values(many(ITEMS_MAX + 1), &none).is_err());
        let lines = |count| "{}\n".repeat(count);
        assert!(of_lines(lines(LINES_MAX).as_bytes(), &none).is_ok());
        assert!(of_lines(lines(LINES_MAX + 1).as_bytes(), &none).is_err());
    }
}
