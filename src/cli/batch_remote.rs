//! A batch that a service works on: assets, one request for all of them, results as they come.

use super::batch::{Input, Rigged, Run};
use super::batch_report::{Entry, Why};
use super::client::Client;
use super::failure::Failure;
use super::files::{Form, InputFile, ReadSiblings};
use rigsmith::formats::{DecodeOptions, Limits, decode};
use rigsmith::jobs::RigOptions;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;

/// Items of one request.
const LINES_MAX: usize = 50_000;
/// How often the service is asked how far it is.
const LOOK: Duration = Duration::from_secs(1);

pub struct Remote {
    client: Client,
}

impl Remote {
    pub fn new(server: &str, key: Option<&str>) -> Self {
        Self { client: Client::of(server, key) }
    }

    /// The networks that decide the result, as the service tells them, and its version.
    pub fn models(&self) -> Result<Value, Failure> {
        let methods = self.client.json("/v1/methods")?;
        let models = methods["data"].as_array().into_iter().flatten().flat_map(|method| method["models"].as_array());
        let models: Value = models.flatten().map(|model| json!([model["name"], model["sha256"]])).collect();
        Ok(json!({"service": self.client.json("/version")?["version"], "networks": models}))
    }

    /// Uploads a mesh with the files that it asks for. Gives the asset's id, or why it is none.
    fn upload(&self, file: &InputFile, siblings: &ReadSiblings) -> Result<Result<String, Why>, Failure> {
        // Only to learn which files it asks for; whether it can be rigged is for the service to say.
        let _ = decode(&file.name, &file.bytes, siblings, &Limits::default(), &DecodeOptions::default());
        let mut form = Form::new();
        form.file("file", &file.name, &file.bytes);
        for (name, bytes) in siblings.found() {
            form.file("with", &name, &bytes);
        }
        let (content_type, body) = form.finish();
        let answer = self.client.post("/v1/assets", &[("content-type", &content_type)], &body)?;
        Ok(answer.map(|asset| text(&asset["id"])).map_err(|problem| why(&problem, "detail")))
    }
}

fn text(value: &Value) -> String {
    value.as_str().unwrap_or_default().to_owned()
}

fn why(error: &Value, message: &str) -> Why {
    Why { code: text(&error["code"]), message: text(&error[message]), hint: text(&error["hint"]) }
}

/// Has `inputs` rigged by the service; notes each as it is over.
pub fn work(remote: &Remote, run: &mut Run, options: &RigOptions, inputs: &[Input]) -> Result<(), Failure> {
    for inputs in inputs.chunks(LINES_MAX) {
        let mut sent: BTreeMap<&str, (&Input, Entry)> = BTreeMap::new();
        let mut lines = String::new();
        for input in inputs {
            run.say(format!("sending {}", input.name));
            let file = InputFile::read(&input.path)?;
            let siblings = ReadSiblings::new(&file.siblings);
            let uploaded = remote.upload(&file, &siblings)?;
            let entry = Entry::of(&file.bytes, siblings.digests(), Duration::ZERO);
            match uploaded {
                Err(why) => run.note(input, entry, Err(why))?,
                Ok(asset) => {
                    let mut request = options.to_json();
                    request["asset"] = asset.into();
                    lines += &json!({"custom_id": input.name, "request": request}).to_string();
                    lines.push('\n');
                    sent.insert(&input.name, (input, entry));
                }
            }
        }
        if !sent.is_empty() {
            follow(remote, run, &lines, sent)?;
        }
    }
    Ok(())
}

/// Sends a batch and notes its results until there are no more.
fn follow(
    remote: &Remote,
    run: &mut Run,
    lines: &str,
    mut sent: BTreeMap<&str, (&Input, Entry)>,
) -> Result<(), Failure> {
    let client = &remote.client;
    // The same meshes sent again, as after a run that was cut off, are the same batch.
    let key = super::batch_report::digest(lines.as_bytes());
    let fields = [("content-type", "application/jsonl"), ("idempotency-key", key.as_str())];
    let batch = client.post("/v1/batches", &fields, lines.as_bytes())?.map_err(|problem| Failure::problem(&problem))?;
    let path = text(&batch["links"]["self"]);
    let results = text(&batch["links"]["results"]);
    let mut known_over = 0;
    loop {
        let batch = client.json(&path)?;
        let count = |name: &str| batch["counts"][name].as_u64().unwrap_or(0);
        let over = count("succeeded") + count("failed") + count("canceled");
        run.say(format!("{} running, {} waiting", count("running"), count("queued")));
        if over > known_over {
            known_over = over;
            let lines = client.bytes(&results)?;
            for line in lines.split(|byte| *byte == b'\n').filter(|line| !line.is_empty()) {
                let result: Value = serde_json::from_slice(line)
                    .map_err(|error| Failure::internal(format!("a result is no JSON: {error}"), "try again"))?;
                if let Some((input, entry)) = sent.remove(result["custom_id"].as_str().unwrap_or_default()) {
                    note(client, run, input, entry, &result)?;
                }
            }
        }
        if sent.is_empty() {
            return Ok(());
        }
        if !batch["finished_at"].is_null() && over == known_over {
            let missing = sent.keys().next().copied().unwrap_or_default();
            return Err(Failure::internal(
                format!("the batch is over without {missing}"),
                "run the same command again",
            ));
        }
        std::thread::sleep(LOOK);
    }
}

fn note(client: &Client, run: &mut Run, input: &Input, mut entry: Entry, result: &Value) -> Result<(), Failure> {
    let rig = &result["rig"];
    if rig.is_null() {
        return run.note(input, entry, Err(why(&result["error"], "message")));
    }
    let stages = rig["timings_ms"].as_object().into_iter().flatten().filter(|(stage, _)| *stage != "queue");
    entry.seconds = stages.filter_map(|(_, ms)| ms.as_u64()).sum::<u64>() as f64 / 1000.0;
    let made = rig["result"]["artifacts"].as_array().cloned().unwrap_or_default();
    let mut files = BTreeMap::new();
    for output in run.outputs() {
        if let Some(artifact) = made.iter().find(|artifact| artifact["name"] == output.file_name()) {
            files.insert(output.file_name().to_owned(), client.bytes(&text(&artifact["url"]))?);
        } else {
            let gone = "its files are no longer kept by the service".to_owned();
            let hint = "run the same command again".to_owned();
            return run.note(input, entry, Err(Why { code: "expired".to_owned(), message: gone, hint }));
        }
    }
    let joints = rig["result"]["skeleton"]["joints"].as_u64().unwrap_or(0);
    run.note(input, entry, Ok(Rigged { joints, files }))
}
