//! Every example of README.md and of docs/api.md, webhooks.md and operation.md, run as a reader would: with curl and the program,
//! against a service that was started for it. (The Python of docs/webhooks.md and docs/grpc.md is run by tests/checks; a service of
//! many machines by tests/reliability.)

use super::program::sample;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// A service of the built program, in a folder of its own.
pub struct Served {
    process: Child,
    pub host: String,
    folder: tempfile::TempDir,
}

impl Served {
    pub fn start() -> Self {
        Self::with(&[])
    }

    fn with(settings: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("folder");
        let mut process = Command::new(env!("CARGO_BIN_EXE_rigsmith"))
            .args(["serve", "--listen", "127.0.0.1:0", "--data", "data"])
            .args(settings)
            .current_dir(folder.path())
            .env_remove("ORT_DYLIB_PATH")
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        let mut line = String::new();
        BufReader::new(process.stdout.take().expect("standard output")).read_line(&mut line).expect("a line");
        let host = line.split_whitespace().find(|word| word.starts_with("http://")).expect("an address").to_owned();
        Self { process, host, folder }
    }

    /// Runs `script` beside `hero.glb`, `hero.obj`, `hero.mtl` and a folder `heroes`, stopping at the first command that fails.
    pub fn run(&self, script: &str) -> String {
        let folder = self.folder.path();
        if !folder.join("hero.glb").exists() {
            std::fs::copy(sample(), folder.join("hero.glb")).expect("copies");
            std::fs::create_dir(folder.join("heroes")).expect("a folder");
            std::fs::copy(sample(), folder.join("heroes/hero.glb")).expect("copies");
            std::fs::write(folder.join("hero.obj"), figure()).expect("writes");
            std::fs::write(folder.join("hero.mtl"), "newmtl skin\nKd 0.8 0.6 0.5\n").expect("writes");
        }
        let programs = Path::new(env!("CARGO_BIN_EXE_rigsmith")).parent().expect("a folder");
        let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap_or_default());
        let output = Command::new("bash")
            .args(["-euo", "pipefail", "-c", script])
            .current_dir(folder)
            .env("HOST", &self.host)
            .env("PATH", path)
            .output()
            .expect("bash");
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        assert!(output.status.success(), "{script}\n{}\n{}", text(&output.stdout), text(&output.stderr));
        text(&output.stdout)
    }

    pub fn file(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.folder.path().join(name)).expect(name)
    }

    pub fn put(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.folder.path().join(name), bytes).expect(name);
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// A body with arms and legs, as boxes that overlap.
pub fn figure() -> String {
    let boxes = [
        ([-0.15, 0.8, -0.1], [0.15, 1.45, 0.1]),
        ([-0.1, 1.45, -0.1], [0.1, 1.7, 0.1]),
        ([0.1, 1.3, -0.05], [0.8, 1.42, 0.05]),
        ([-0.8, 1.3, -0.05], [-0.1, 1.42, 0.05]),
        ([0.02, 0.0, -0.07], [0.14, 0.85, 0.07]),
        ([-0.14, 0.0, -0.07], [-0.02, 0.85, 0.07]),
    ];
    let mut text = "mtllib hero.mtl\nusemtl skin\n".to_owned();
    for (index, (low, high)) in boxes.iter().enumerate() {
        for corner in 0..8 {
            let at = |axis: usize| if corner >> axis & 1 == 1 { high[axis] } else { low[axis] };
            text += &format!("v {} {} {}\n", at(0), at(1), at(2));
        }
        for face in [[1, 3, 4, 2], [5, 6, 8, 7], [1, 2, 6, 5], [3, 7, 8, 4], [1, 5, 7, 3], [2, 4, 8, 6]] {
            let [a, b, c, d] = face.map(|corner| corner + 8 * index);
            text += &format!("f {a} {b} {c} {d}\n");
        }
    }
    text
}

fn document(name: &str) -> String {
    std::fs::read_to_string(PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(name)).expect(name)
}

#[test]
fn the_examples_of_the_api_do_what_they_say() {
    let text = document("docs/api.md");
    let blocks: Vec<&str> = text.split("```sh\n").skip(1).filter_map(|rest| rest.split("```").next()).collect();
    assert!(blocks.len() >= 8, "the blocks are found");
    let served = Served::start();
    // One shell for all, since later blocks use what earlier ones have set.
    let said = served.run(&blocks.join("\n"));
    for name in ["rigged.glb", "hero-rigged.glb"] {
        assert_eq!(&served.file(name)[..4], b"glTF", "{name}");
    }
    assert_eq!(served.file("again.glb"), served.file("hero.glb"));
    assert!(served.file("exported.glb") == served.file("rigged.glb"), "an export is the file that the job made");
    let gltf: serde_json::Value = serde_json::from_slice(&served.file("hero.gltf")).expect("JSON");
    assert_eq!(gltf["skins"].as_array().map(Vec::len), Some(1));
    let upload: serde_json::Value = serde_json::from_slice(&served.file("upload.json")).expect("JSON");
    assert!(upload["asset"].is_string() && upload["offset"] == upload["length"], "{upload}");
    let results = String::from_utf8(served.file("results.jsonl")).expect("text");
    let results: Vec<serde_json::Value> =
        results.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    assert_eq!((&results[0]["custom_id"], &results[0]["rig"]["state"]), (&"few".into(), &"succeeded".into()));
    assert_eq!(results[1]["error"]["code"], "invalid_parameter");
    assert!(served.file("rigged/hero.rig.json").starts_with(b"{"));
    for word in ["event: snapshot", "event: done", "\"riggable\"", "\"knights\"", "hero-v3"] {
        assert!(said.contains(word), "{word} in\n{said}");
    }
}

/// The indented lines of a document that call one of `programs`, continued lines joined.
fn commands(name: &str, programs: &[&str]) -> Vec<String> {
    let text = document(name);
    let mut commands: Vec<String> = Vec::new();
    let mut continued = false;
    for line in text.lines().filter_map(|line| line.strip_prefix("    ")) {
        let line = line.trim();
        if continued {
            let last = commands.last_mut().expect("a first line");
            last.push_str(line);
        } else if line.split(' ').next().is_some_and(|program| programs.contains(&program)) {
            commands.push(line.to_owned());
        } else {
            continue;
        }
        let last = commands.last_mut().expect("a line");
        continued = last.ends_with('\\');
        if continued {
            last.truncate(last.len() - 1);
        }
    }
    commands
}

#[test]
fn the_examples_of_webhooks_do_what_they_say() {
    let served = Served::with(&["--outgoing"]);
    let upload = r#"curl -sS --fail-with-body -F file=@hero.glb "$HOST/v1/assets""#;
    let asset: serde_json::Value = serde_json::from_str(&served.run(upload)).expect("JSON");
    let mut ids = format!("ASSET={}; ENDPOINT=; ", asset["id"].as_str().expect("an id"));
    let commands = commands("docs/webhooks.md", &["curl"]);
    assert!(commands.len() >= 5, "{commands:#?}");
    let mut said = Vec::new();
    for command in commands {
        let answer: serde_json::Value = serde_json::from_str(&served.run(&(ids.clone() + &command))).expect("JSON");
        if let Some(made) = answer["id"].as_str().filter(|id| id.starts_with("whe_")) {
            ids += &format!("ENDPOINT={made}; ");
        }
        said.push(answer);
    }
    assert!(said[0]["secret"].as_str().is_some_and(|secret| secret.starts_with("whsec_")), "{said:#?}");
    assert_eq!(said[2]["data"].as_array().map(Vec::len), Some(1), "the test is listed");
    let wanted = serde_json::json!(["rig.succeeded"]);
    assert!(
        said.iter().any(|answer| answer["request"]["webhook"]["events"] == wanted),
        "one rig tells of itself: {said:#?}"
    );
}

#[test]
fn the_examples_of_settings_and_keys_do_what_they_say() {
    let served = Served::start();
    served.run("echo 'upload_mib = 200' > rigsmith.toml");
    // Services that run until they are stopped are started by `program` and by tests/reliability/machines.py.
    let ends = |command: &String| !command.starts_with("rigsmith serve") && !command.starts_with("rigsmith worker");
    let commands = commands("docs/operation.md", &["rigsmith"]);
    let said: Vec<String> =
        commands.iter().filter(|command| ends(command)).map(|command| served.run(command)).collect();
    assert!(said.len() >= 3, "{commands:#?}");
    assert!(said[0].contains("upload_mib = 200"), "{}", said[0]);
    assert!(said[2].contains("studio"), "{}", said[2]);
}

#[test]
fn the_examples_of_the_readme_do_what_they_say() {
    let commands = commands("README.md", &["curl", "target/release/rigsmith"]);
    assert!(commands.len() >= 5, "{commands:#?}");
    let served = Served::start();
    let sample = sample();
    for command in commands {
        let command = command
            .replace("http://127.0.0.1:8080", &served.host)
            .replace("tests/fixtures/sample-character.glb", sample.to_str().expect("path"))
            .replace("target/release/rigsmith", "rigsmith");
        served.run(&command);
    }
    assert_eq!(&served.file("rigged.glb")[..4], b"glTF");
}
