//! Which skin method is taken, and what happens where it cannot run here: said in the list of methods, refused at the door, and
//! replaced only by what the caller allowed.

use super::program::{rigsmith, sample, stderr, succeeded};
use rigsmith::jobs::{Availability, Engine, RigOptions, Rigger, SkinMethod};
use rigsmith::pipelines::LoadOptions;
use rigsmith::pipelines::skin_choice::MeasuredL1;
use serde_json::{Value, json};
use std::path::Path;

/// The shipped networks, HeterSkinNet's cut short.
fn broken_models(folder: &Path) {
    for entry in std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("models/artifacts")).expect("models") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().expect("a name");
        let mut bytes = std::fs::read(&path).expect("reads");
        if name == "heter_skin_net.onnx" {
            bytes.truncate(1000);
        }
        std::fs::write(folder.join(name), bytes).expect("writes");
    }
}

#[test]
fn a_missing_network_is_said_refused_and_replaced_only_by_what_was_allowed() {
    let folder = tempfile::tempdir().expect("folder");
    let models = folder.path().join("models");
    std::fs::create_dir(&models).expect("folder");
    broken_models(&models);
    let models = models.to_str().expect("path");
    let input = sample();
    let rig = |more: &[&str]| {
        let arguments = ["--models", models, "rig", input.to_str().expect("path"), "-o", "out.rig.json"];
        rigsmith(folder.path(), &[&arguments[..], more].concat())
    };

    let listed = rigsmith(folder.path(), &["--models", models, "methods"]);
    let text = String::from_utf8_lossy(&listed.stdout).into_owned();
    assert!(
        text.lines().next().is_some_and(|line| line.contains("NOT AVAILABLE: its skin method heter_skin_net")),
        "{text}"
    );
    let row = |name: &str| text.lines().rfind(|line| line.trim_start().starts_with(name)).expect("a row").to_owned();
    assert!(row("heter_skin_net").contains("NOT AVAILABLE") && row("heter_skin_net").contains("auto"), "{text}");
    assert!(row("geodesic_heat").contains("(available)"), "{text}");

    let refused = rig(&[]);
    assert_eq!(refused.status.code(), Some(5), "{}", stderr(&refused));
    let said = stderr(&refused);
    assert!(said.contains("model_unavailable") && said.contains("heter_skin_net") && said.contains("hint:"), "{said}");
    let refused = rig(&["--skin-fallback", "heter_skin_net"]);
    assert_eq!(refused.status.code(), Some(5), "{}", stderr(&refused));

    succeeded(&rig(&["--skin-method", "geodesic_heat"]));
    let replaced = rig(&["--skin-fallback", "geodesic_voxel,geodesic_heat"]);
    succeeded(&replaced);
    assert!(stderr(&replaced).contains("geodesic_voxel was allowed in its place"), "{}", stderr(&replaced));
    let file: Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("out.rig.json")).expect("file")).expect("JSON");
    assert_eq!(file["report"]["skin"]["method"], "geodesic_voxel");
    let findings = file["report"]["findings"].as_array().expect("findings");
    assert!(findings.iter().any(|finding| finding["code"] == "skin_fallback"), "{findings:?}");

    let options = LoadOptions { onnxruntime: None, models: Some(models.into()), threads: 1 };
    let engine = Engine::open(&options).expect("opens");
    assert!(matches!(engine.methods()[0].availability, Availability::Unavailable { .. }));
    let asked = |skin_method, skin_fallback: &[SkinMethod]| RigOptions {
        skin_method,
        skin_fallback: skin_fallback.to_vec(),
        ..RigOptions::default()
    };
    assert!(engine.unavailable(&asked(None, &[])).is_some_and(|reason| reason.contains("heter_skin_net")));
    assert_eq!(engine.unavailable(&asked(None, &[SkinMethod::RigNet])), None);
    assert_eq!(engine.unavailable(&asked(Some(SkinMethod::GeodesicHeat), &[])), None);
}

#[test]
fn the_program_says_which_method_it_took_and_why() {
    let folder = tempfile::tempdir().expect("folder");
    let listed = rigsmith(folder.path(), &["methods"]);
    let text = String::from_utf8_lossy(&listed.stdout).into_owned();
    assert!(text.lines().any(|line| line.contains("heter_skin_net") && line.contains("(available, auto)")), "{text}");
    let input = sample();
    let made =
        rigsmith(folder.path(), &["rig", input.to_str().expect("path"), "-o", "out.glb", "--report", "report.json"]);
    succeeded(&made);
    let report: Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("report.json")).expect("file")).expect("JSON");
    let reason = report["skin"]["reason"].as_str().expect("a reason");
    assert!(reason.starts_with("heter_skin_net has the least error") && reason.contains("geodesic_heat"), "{reason}");
    assert_eq!(report["skin"]["method"], json!("heter_skin_net"));
    assert!(stderr(&made).contains(reason), "{}", stderr(&made));
}

/// The rows of `docs/models.md`, in its three parts: organic, box, all.
#[test]
fn the_figures_are_those_that_were_published() {
    let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/models.md")).expect("reads");
    for method in SkinMethod::ALL {
        let start = format!("| {} | 0.", method.name());
        let skin_tables = text.split("#### Skin on the reference skeleton").skip(1);
        let published: Vec<f64> = skin_tables
            .filter_map(|table| table.lines().find(|line| line.starts_with(&start)))
            .filter_map(|line| line.split(['|', '[']).nth(2)?.trim().parse().ok())
            .collect();
        let MeasuredL1 { organic, boxes, all } = method.measured();
        assert_eq!(published, [organic, boxes, all], "{}", method.name());
    }
}
