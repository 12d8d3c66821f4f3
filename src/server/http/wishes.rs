//! What a create request says beside its mesh: the options of the rig, and how the job is to be treated. One reader
//! for query parameters, form fields and JSON.

use super::error::ApiError;
use super::webhooks;
use crate::config::nearest;
use crate::jobs::webhooks::MessageType;
use crate::jobs::{FieldError, FieldProblem, JobWebhook, Labels, OptionsReader, Priority, RigOptions, Settings};
use serde_json::{Value, json};
use std::time::Duration;

/// Everything that a create request says.
#[derive(Clone, Debug)]
pub struct Wishes {
    pub options: RigOptions,
    pub priority: Priority,
    pub labels: Labels,
    pub timeout: Option<Duration>,
    pub retention: Option<Duration>,
    pub webhook: Option<JobWebhook>,
}

/// Fields of the job, beside those of [`OptionsReader::FIELDS`].
pub const JOB_FIELDS: &[&str] = &["priority", "timeout_seconds", "retention_hours", "labels", "webhook"];
const LABELS_MAX: usize = 16;
const LABEL_NAME_MAX: usize = 64;
const LABEL_VALUE_MAX: usize = 256;

/// Fields that callers of other services know, or that are to come, and what to do instead. Refused rather than
/// ignored; a field that [`OptionsReader`] has learnt is read before this list is looked at.
const NOT_HERE: &[(&str, &str)] = &[
    ("category", "every kind of character is rigged the same way"),
    ("up_axis", "it is called up here"),
    ("forward_axis", "it is called front here"),
    ("max_joints", "detail decides how many joints there are"),
    ("skinning", "skin_method, max_influences, smooth and prune are fields of their own"),
    ("naming", "joints are numbered"),
    ("root_joint", "the root is the joint that the method finds"),
    ("leaf_joints", "there are none beyond the joints that the method finds"),
    ("height_meters", "the scale of the file is kept"),
    ("animation", "no clip is made"),
    ("fallback", "skin_fallback names what may weigh in place of a method that cannot run here"),
    ("expert", "bandwidth is a field of its own"),
];

/// Collects fields from any number of places, then gives the wishes or every refusal at once.
#[derive(Clone, Debug, Default)]
pub struct WishesReader {
    options: OptionsReader,
    priority: Option<Priority>,
    timeout: Option<u64>,
    retention: Option<u64>,
    labels: Option<Labels>,
    webhook: Option<JobWebhook>,
    errors: Vec<FieldError>,
}

impl WishesReader {
    /// Whether there is a field of this name.
    pub fn reads(field: &str) -> bool {
        JOB_FIELDS.contains(&field) || OptionsReader::FIELDS.contains(&field)
    }

    /// A field as text; `labels` are `name=value,name=value`, a `webhook` is its URL.
    pub fn text(&mut self, field: &str, text: &str) {
        if JOB_FIELDS.contains(&field) {
            let value = match field {
                "labels" => labels_of_text(text),
                "priority" => Ok(Value::from(text.trim())),
                "webhook" => Ok(json!({"url": text.trim()})),
                _ => Ok(text.trim().parse::<u64>().map_or_else(|_| Value::from(text), Value::from)),
            };
            match value {
                Ok(value) => self.job_field(field, &value),
                Err(detail) => self.refuse(field, detail),
            }
        } else if self.is_known(field) {
            self.options.text(field, text);
        }
    }

    pub fn json(&mut self, field: &str, value: &Value) {
        if JOB_FIELDS.contains(&field) {
            if !value.is_null() {
                self.job_field(field, value);
            }
        } else if self.is_known(field) {
            self.options.json(field, value);
        }
    }

    /// Whether the options have the field; notes a refusal when not.
    fn is_known(&mut self, field: &str) -> bool {
        if OptionsReader::FIELDS.contains(&field) {
            return true;
        }
        let known: Vec<&str> = OptionsReader::FIELDS.iter().chain(JOB_FIELDS).copied().collect();
        let detail = match NOT_HERE.iter().find(|(name, _)| *name == field) {
            Some((_, instead)) => format!("is not supported by this version: {instead}"),
            None => {
                let near = nearest(field, &known).map(|near| format!(", did you mean {near}?")).unwrap_or_default();
                format!("no such field{near}; there are {}", known.join(", "))
            }
        };
        let field = field.chars().take(60).collect();
        self.errors.push(FieldError { field, problem: FieldProblem::Unknown, detail });
        false
    }

    fn job_field(&mut self, field: &str, value: &Value) {
        let twice = match field {
            "priority" => self.priority.is_some(),
            "timeout_seconds" => self.timeout.is_some(),
            "retention_hours" => self.retention.is_some(),
            "webhook" => self.webhook.is_some(),
            _ => self.labels.is_some(),
        };
        if twice {
            return self.refuse(field, "given twice; send it once".to_owned());
        }
        let read = match field {
            "priority" => priority(value).map(|priority| self.priority = Some(priority)),
            "timeout_seconds" => whole(value).map(|seconds| self.timeout = Some(seconds)),
            "retention_hours" => whole(value).map(|hours| self.retention = Some(hours)),
            "webhook" => webhook(value).map(|webhook| self.webhook = Some(webhook)),
            _ => labels(value).map(|labels| self.labels = Some(labels)),
        };
        if let Err(detail) = read {
            self.refuse(field, detail);
        }
    }

    /// Notes a refusal of `field`.
    pub fn refuse(&mut self, field: &str, detail: String) {
        self.errors.push(FieldError { field: field.to_owned(), problem: FieldProblem::Invalid, detail });
    }

    /// The wishes, within what `settings` allow.
    pub fn finish(mut self, settings: &Settings) -> Result<Wishes, ApiError> {
        let seconds_max = settings.job_time_max.as_secs();
        let hours_max = settings.keep_time.as_secs().div_ceil(3600);
        for (field, given, max) in
            [("timeout_seconds", self.timeout, seconds_max), ("retention_hours", self.retention, hours_max)]
        {
            if given.is_some_and(|given| given > max) {
                self.refuse(
                    field,
                    format!("{} is more than {max}, the most that this service gives", given.unwrap_or(0)),
                );
            }
        }
        let Self { options, priority, timeout, retention, labels, webhook, mut errors } = self;
        let options = options.finish().unwrap_or_else(|refused| {
            errors.extend(refused);
            RigOptions::default()
        });
        if !errors.is_empty() {
            return Err(ApiError::fields(errors));
        }
        Ok(Wishes {
            options,
            priority: priority.unwrap_or_default(),
            labels: labels.unwrap_or_default(),
            timeout: timeout.map(Duration::from_secs),
            retention: retention.map(|hours| Duration::from_secs(hours * 3600).min(settings.keep_time)),
            webhook,
        })
    }
}

fn priority(value: &Value) -> Result<Priority, String> {
    let names = || Priority::ALL.map(Priority::name).join(", ");
    let named = value.as_str().and_then(Priority::named);
    named.ok_or_else(|| format!("{} is not one of {}", shown(value), names()))
}

fn whole(value: &Value) -> Result<u64, String> {
    let number = value.as_u64().filter(|number| (1..=1_000_000).contains(number));
    number.ok_or_else(|| format!("{} is not a whole number from 1", shown(value)))
}

fn labels(value: &Value) -> Result<Labels, String> {
    let members = value.as_object().ok_or_else(|| format!("{} is not an object of names and texts", shown(value)))?;
    if members.len() > LABELS_MAX {
        return Err(format!("{} labels are more than {LABELS_MAX}", members.len()));
    }
    let read = members.iter().map(|(name, value)| {
        let value = value.as_str().ok_or_else(|| format!("the value of {name:?} is not a text"))?;
        label(name, value)
    });
    read.collect()
}

/// A label whose name and value are fit to be kept.
pub fn label(name: &str, value: &str) -> Result<(String, String), String> {
    let fit = |letter: char| letter.is_ascii_alphanumeric() || ['.', '-', '_', '/'].contains(&letter);
    if !(1..=LABEL_NAME_MAX).contains(&name.len()) || !name.chars().all(fit) {
        let name: String = name.chars().take(LABEL_NAME_MAX).collect();
        return Err(format!("{name:?} is no name: 1 to {LABEL_NAME_MAX} letters, digits, `.`, `-`, `_` or `/`"));
    }
    if value.len() > LABEL_VALUE_MAX || value.chars().any(char::is_control) {
        return Err(format!("the value of {name:?} has more than {LABEL_VALUE_MAX} bytes, or control characters"));
    }
    Ok((name.to_owned(), value.to_owned()))
}

/// Where it may go is asked when the job is ordered.
fn webhook(value: &Value) -> Result<JobWebhook, String> {
    let members = value.as_object().ok_or_else(|| format!("{} is not an object with url and events", shown(value)))?;
    if let Some(other) = members.keys().find(|name| !["url", "events"].contains(&name.as_str())) {
        return Err(format!("has no {other:?}; there are url and events"));
    }
    let url = members.get("url").and_then(Value::as_str).ok_or("has no url that is a text")?;
    let events = match members.get("events") {
        None | Some(Value::Null) => MessageType::OF_RIGS.to_vec(),
        Some(given) => webhooks::events(given, &MessageType::OF_RIGS).map_err(|detail| format!("events: {detail}"))?,
    };
    Ok(JobWebhook { url: url.to_owned(), events })
}

fn labels_of_text(text: &str) -> Result<Value, String> {
    let pairs = text.split(',').map(str::trim).filter(|pair| !pair.is_empty()).map(|pair| {
        let (name, value) = pair.split_once('=').ok_or_else(|| format!("{pair:?} is not name=value"))?;
        Ok((name.trim().to_owned(), Value::from(value.trim())))
    });
    pairs.collect::<Result<serde_json::Map<_, _>, String>>().map(Value::Object)
}

fn shown(value: &Value) -> String {
    value.to_string().chars().take(60).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(fields: &[(&str, Value)]) -> Result<Wishes, ApiError> {
        let mut reader = WishesReader::default();
        fields.iter().for_each(|(field, value)| reader.json(field, value));
        reader.finish(&Settings::default())
    }

    #[test]
    fn every_field_is_read_from_text_and_from_json() {
        let mut reader = WishesReader::default();
        for (field, text) in [
            ("priority", "low"),
            ("timeout_seconds", "20"),
            ("retention_hours", "2"),
            ("labels", "a=b, c=d=e"),
            ("webhook", " https://a.example/ "),
            ("detail", "1"),
        ] {
            reader.text(field, text);
        }
        let from_text = reader.finish(&Settings::default()).expect("reads");
        let from_json = read(&[
            ("priority", json!("low")),
            ("timeout_seconds", json!(20)),
            ("retention_hours", json!(2)),
            ("labels", json!({"a": "b", "c": "d=e"})),
            ("webhook", json!({"url": "https://a.example/"})),
            ("detail", json!(1)),
        ])
        .expect("reads");
        for wishes in [&from_text, &from_json] {
            assert_eq!((wishes.priority, wishes.timeout), (Priority::Low, Some(Duration::from_secs(20))));
            assert_eq!(wishes.retention, Some(Duration::from_secs(7200)));
            assert_eq!(wishes.labels.get("c").map(String::as_str), Some("d=e"));
            let webhook = JobWebhook { url: "https://a.example/".to_owned(), events: MessageType::OF_RIGS.to_vec() };
            assert_eq!(wishes.webhook, Some(webhook));
        }
        assert_eq!(from_text.options, from_json.options);
    }

    #[test]
    fn what_cannot_be_done_is_refused_by_name() {
        for (field, value) in [
            ("priority", json!("urgent")),
            ("timeout_seconds", json!(0)),
            ("timeout_seconds", json!(301)),
            ("retention_hours", json!(25)),
            ("labels", json!(["a"])),
            ("labels", json!({"a b": "c"})),
            ("labels", json!({"a": 1})),
            ("webhook", json!("https://example.com")),
            ("webhook", json!({"events": ["rig.failed"]})),
            ("webhook", json!({"url": "https://example.com", "events": []})),
            ("webhook", json!({"url": "https://example.com", "events": ["batch.completed"]})),
            ("webhook", json!({"url": "https://example.com", "secret": "x"})),
            ("colour", json!("red")),
        ] {
            assert!(read(&[(field, value.clone())]).is_err(), "{field} {value}");
        }
    }

    #[test]
    fn no_field_is_both_supported_and_not() {
        assert!(JOB_FIELDS.iter().all(|field| !NOT_HERE.iter().any(|(name, _)| name == field)));
    }
}
