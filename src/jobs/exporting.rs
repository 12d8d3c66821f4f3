//! Other files of a rig that was made: the upload is decoded again and written with the weights of the job's `rig.json`.
//! No network runs, so the same rig comes out in another form within moments.

use super::engine::{decoded, encode_rig};
use super::failure::{ErrorCode, JobError};
use super::job::{FileInfo, Job};
use super::options::Output;
use super::perform::{Artifact, RigRequest};
use super::queue::Jobs;
use super::submission::{Missing, Refusal};
use super::worker;
use crate::formats::gltf::{EncodeOptions, JointNames};
use crate::formats::preview::PreviewOptions;
use crate::formats::{Axes, Axis, rig_json};
use serde_json::{Map, Value};
use std::time::Duration;

impl Jobs {
    /// Another file of a job that succeeded with a `rig.json`.
    pub async fn export(&self, job: &Job, output: Output, max_influences: Option<usize>) -> Result<Artifact, Refusal> {
        let core = self.core().clone();
        let Ok(permit) = core.checks.clone().try_acquire_owned() else {
            let waiting = self.counts().await?.queued;
            return Err(Refusal::QueueFull { waiting, retry_after: Duration::from_secs(1) });
        };
        let mut made = job.result.iter().flat_map(|result| &result.artifacts);
        let rig = made.find(|artifact| artifact.name == Output::RigJson.file_name());
        let rig = rig.ok_or(Refusal::NotFound(Missing::Job))?;
        let rig = FileInfo { name: rig.name.clone(), bytes: rig.bytes, sha256: rig.sha256 };
        let rig = self.load_files(&[rig], Missing::Job).await?.pop().ok_or(Refusal::NotFound(Missing::Job))?;
        let files = self.load_files(&job.request.files, Missing::Job).await?;
        let mut options = job.request.options.clone();
        options.max_influences = max_influences.unwrap_or(options.max_influences);
        let request = RigRequest { files, options, skeleton: None };
        let span = tracing::Span::current();
        let work = move || {
            let (_permit, _entered) = (permit, span.enter());
            worker::guarded(|| export_file(&request, &rig.bytes, output)).map_err(Refusal::Check)
        };
        tokio::task::spawn_blocking(work).await.unwrap_or(Err(Refusal::Draining))
    }
}

/// `output` of the upload in `request` with the rig of a `rig.json` that was made for it.
pub fn export_file(request: &RigRequest, rig: &[u8], output: Output) -> Result<Artifact, JobError> {
    let unusable = |cause: String| JobError::new(ErrorCode::OutputInvalid, cause).hint("rig the mesh again");
    let asset = decoded(request)?;
    let file = rig_json::read(rig).map_err(|error| unusable(error.to_string()))?;
    let (method, report, nodes) = (file.method.clone(), file.report.clone(), file.nodes.clone());
    let rig = file.into_rig();
    let (rows, vertices) = (rig.skin.rows.len(), asset.mesh.positions.len());
    if rows != vertices {
        return Err(unusable(format!("the rig is for {rows} vertices, and the mesh has {vertices}")));
    }
    let report = match report {
        Value::Object(report) => report,
        _ => Map::new(),
    };
    // Its names are those that the first files have.
    let influences_max = request.options.max_influences;
    let options = EncodeOptions { influences_max, names: JointNames::AsGiven, nodes, ..EncodeOptions::default() };
    encode_rig(output, &asset, axes_in(&report), &rig, &options, &method, &report)
}

/// How the character stood when it was rigged, as the report of its rig says; y up and facing +z where it does not.
fn axes_in(report: &Map<String, Value>) -> Axes {
    let usual = PreviewOptions::default().axes;
    let axis = |name: &str| {
        let told: Option<[f64; 3]> =
            report.get("orientation").and_then(|told| serde_json::from_value(told[name].clone()).ok());
        told.and_then(|told| Axis::along(told.into()))
    };
    Axes { up: axis("up").unwrap_or(usual.up), front: axis("front").unwrap_or(usual.front) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::perform::NamedFile;
    use crate::jobs::{Outcome, RigOptions};
    use serde_json::json;

    const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n";

    fn request() -> RigRequest {
        let file = NamedFile { name: "square.obj".to_owned(), bytes: SQUARE.into() };
        RigRequest { files: vec![file], options: RigOptions::default(), skeleton: None }
    }

    fn rig(rows: usize) -> Vec<u8> {
        let joint = |index: usize| json!({"name": format!("joint_{index}"), "parent": index.checked_sub(1), "position": [0.5, index, 0.0]});
        let skin = json!({"joints": vec![vec![1, 0]; rows], "weights": vec![vec![0.75, 0.25]; rows]});
        let document = json!({"format": rig_json::FORMAT, "method": "rignet", "joints": [joint(0), joint(1)], "skins": [skin], "report": {}});
        document.to_string().into_bytes()
    }

    #[test]
    fn a_rig_is_written_again_in_any_form_and_with_fewer_influences() {
        let first = export_file(&request(), &rig(4), Output::RigJson).expect("written");
        let again = export_file(&request(), &first.bytes, Output::RigJson).expect("written again");
        assert_eq!(first, again, "what was written is what is read");
        let glb = export_file(&request(), &first.bytes, Output::Glb).expect("written");
        assert_eq!(&glb.bytes[..4], b"glTF");
        let mut single = request();
        single.options.max_influences = 1;
        let single = export_file(&single, &rig(4), Output::Gltf).expect("written");
        let document: Value = serde_json::from_slice(&single.bytes).expect("JSON");
        assert_eq!(document["skins"][0]["joints"].as_array().map(Vec::len), Some(2));
        let outcome =
            Outcome { artifacts: vec![glb], report: Map::new(), findings: vec![], method_used: String::new() };
        assert!(outcome.artifact(Output::Glb).is_some(), "the name is that of the first file");
    }

    #[test]
    fn a_rig_of_another_mesh_is_refused() {
        let error = export_file(&request(), &rig(5), Output::Glb).expect_err("refused");
        assert_eq!(error.code, ErrorCode::OutputInvalid);
        assert!(error.message.contains("5 vertices"), "{error}");
    }
}
