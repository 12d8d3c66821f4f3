//! The program as users start it: exit codes, outputs, messages.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Our own sample character.
pub fn sample() -> PathBuf {
    repository().join("tests/fixtures/sample-character.glb")
}

/// Starts the program in an empty folder, without the variables that would tell it where things are.
pub fn rigsmith(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rigsmith"))
        .args(arguments)
        .current_dir(folder)
        .env_remove("ORT_DYLIB_PATH")
        .env_remove("RIGSMITH_MODELS")
        .output()
        .expect("the program starts")
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

pub fn succeeded(output: &Output) {
    assert_eq!(output.status.code(), Some(0), "{}", stderr(output));
}

#[test]
fn one_command_makes_every_output() {
    let folder = tempfile::tempdir().expect("folder");
    let names = ["out.glb", "out.gltf", "out.rig.json", "out.txt", "out.png"];
    let input = sample();
    let mut arguments = vec!["rig", input.to_str().expect("path"), "--report", "report.json"];
    for name in names {
        arguments.extend(["-o", name]);
    }
    succeeded(&rigsmith(folder.path(), &arguments));
    let read = |name: &str| std::fs::read(folder.path().join(name)).expect(name);
    assert_eq!(&read("out.glb")[..4], b"glTF");
    assert_eq!(&read("out.png")[1..4], b"PNG");
    let document: Value = serde_json::from_slice(&read("out.gltf")).expect("glTF is JSON");
    assert_eq!(document["skins"].as_array().map(Vec::len), Some(1));
    let text = String::from_utf8(read("out.txt")).expect("text");
    assert!(text.starts_with("joints "), "{}", &text[..40]);
    let report: Value = serde_json::from_slice(&read("report.json")).expect("report is JSON");
    assert!(report["skeleton"]["joints"].as_u64().is_some_and(|joints| (2..=100).contains(&joints)));
}

#[test]
fn rig_json_has_its_fixed_layout() {
    let folder = tempfile::tempdir().expect("folder");
    succeeded(&rigsmith(folder.path(), &["rig", sample().to_str().expect("path"), "-o", "out.rig.json"]));
    let text = std::fs::read(folder.path().join("out.rig.json")).expect("rig.json");
    let rig: Value = serde_json::from_slice(&text).expect("JSON");
    assert_eq!(rig["format"], "rigsmith.rig/1");
    assert_eq!(rig["method"], "rignet");
    let joints = rig["joints"].as_array().expect("joints");
    for (index, joint) in joints.iter().enumerate() {
        match &joint["parent"] {
            Value::Null => assert_eq!(index, 0, "only the first joint has no parent"),
            parent => assert!(parent.as_u64().is_some_and(|parent| (parent as usize) < index), "{joint}"),
        }
        assert_eq!(joint["position"].as_array().map(Vec::len), Some(3));
        assert!(joint["name"].as_str().is_some_and(|name| !name.is_empty()));
    }
    for skin in rig["skins"].as_array().expect("skins") {
        let (rows, weights) = (skin["joints"].as_array().expect("rows"), skin["weights"].as_array().expect("rows"));
        assert_eq!(rows.len(), weights.len());
        for (row, weights) in rows.iter().zip(weights) {
            let weights: Vec<f64> = weights.as_array().expect("row").iter().filter_map(Value::as_f64).collect();
            assert!(!weights.is_empty() && weights.len() <= 4);
            assert_eq!(row.as_array().map(Vec::len), Some(weights.len()));
            assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-5, "{weights:?}");
        }
    }
}

#[test]
fn the_same_request_gives_the_same_bytes_for_any_number_of_threads() {
    let folder = tempfile::tempdir().expect("folder");
    let input = sample();
    for (threads, name) in [("1", "one"), ("2", "two"), ("2", "again")] {
        let (glb, json) = (format!("{name}.glb"), format!("{name}.rig.json"));
        let input = input.to_str().expect("path");
        succeeded(&rigsmith(folder.path(), &["rig", input, "--threads", threads, "-o", &glb, "-o", &json]));
    }
    let read = |name: String| std::fs::read(folder.path().join(name)).expect("output");
    for kind in ["glb", "rig.json"] {
        let one = read(format!("one.{kind}"));
        assert!(one == read(format!("two.{kind}")), "{kind} differs between 1 and 2 threads");
        assert!(one == read(format!("again.{kind}")), "{kind} differs between two runs");
    }
}

#[test]
fn bad_arguments_end_with_2_and_name_the_argument() {
    let folder = tempfile::tempdir().expect("folder");
    let input = sample();
    let input = input.to_str().expect("path");
    for (arguments, word) in [
        (vec!["rig", input, "-o", "out.glb", "--detail", "7"], "detail"),
        (vec!["rig", input, "-o", "out.glb", "--detail", "0.5", "--bandwidth", "0.05"], "bandwidth"),
        (vec!["rig", input, "-o", "out.blend"], "out.blend"),
        (vec!["rig", input], "output"),
        (vec!["rig", "no-such-file.glb", "-o", "out.glb"], "no-such-file.glb"),
        (vec!["polish", input], "polish"),
    ] {
        let output = rigsmith(folder.path(), &arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(word), "{arguments:?}: {}", stderr(&output));
    }
    assert_eq!(std::fs::read_dir(folder.path()).expect("folder").count(), 0, "a refused request leaves nothing");
}

#[test]
fn a_refused_file_ends_with_3_its_code_and_the_next_step() {
    let folder = tempfile::tempdir().expect("folder");
    std::fs::write(folder.path().join("empty.glb"), b"").expect("writes");
    std::fs::write(folder.path().join("points.obj"), b"v 0 0 0\nv 1 0 0\nv 0 1 0\n").expect("writes");
    for (name, code) in [("empty.glb", "unreadable_mesh"), ("points.obj", "no_geometry")] {
        let output = rigsmith(folder.path(), &["rig", name, "-o", "out.glb"]);
        assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
        assert!(stderr(&output).contains(code) && stderr(&output).contains("hint:"), "{}", stderr(&output));
        assert!(!folder.path().join("out.glb").exists());
    }
}

#[test]
fn a_missing_runtime_or_models_folder_names_the_remedy() {
    let folder = tempfile::tempdir().expect("folder");
    let runtime = rigsmith(folder.path(), &["methods", "--onnxruntime", "nowhere/libonnxruntime.so"]);
    assert_eq!(runtime.status.code(), Some(5), "{}", stderr(&runtime));
    assert!(stderr(&runtime).contains("make ort"), "{}", stderr(&runtime));
    let models = rigsmith(folder.path(), &["methods", "--models", "nowhere"]);
    assert_eq!(models.status.code(), Some(5), "{}", stderr(&models));
    assert!(stderr(&models).contains("RIGSMITH_MODELS"), "{}", stderr(&models));
}

#[test]
fn a_network_with_another_digest_makes_its_method_unavailable_and_says_so() {
    let folder = tempfile::tempdir().expect("folder");
    let models = folder.path().join("models");
    std::fs::create_dir(&models).expect("folder");
    for entry in std::fs::read_dir(repository().join("models/artifacts")).expect("models") {
        let path = entry.expect("entry").path();
        if path.is_file() {
            std::fs::copy(&path, models.join(path.file_name().expect("name"))).expect("copies");
        }
    }
    let network = models.join("rignet_root.onnx");
    let mut bytes = std::fs::read(&network).expect("network");
    *bytes.last_mut().expect("bytes") ^= 1;
    std::fs::write(&network, bytes).expect("writes");
    let output = rigsmith(folder.path(), &["methods", "--models", "models"]);
    succeeded(&output);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("NOT AVAILABLE") && text.contains("rignet_root") && text.contains("digest"), "{text}");
    let input = sample();
    let rig = rigsmith(folder.path(), &["rig", input.to_str().expect("path"), "--models", "models", "-o", "out.glb"]);
    assert_eq!(rig.status.code(), Some(5), "{}", stderr(&rig));
    assert!(stderr(&rig).contains("model_unavailable"), "{}", stderr(&rig));
}

#[test]
fn check_tells_of_the_mesh_without_networks() {
    let folder = tempfile::tempdir().expect("folder");
    let input = sample();
    let output = rigsmith(folder.path(), &["check", input.to_str().expect("path"), "--json"]);
    succeeded(&output);
    let check: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(check["riggable"], "yes");
    assert!(check["mesh"]["components"].as_u64().is_some_and(|count| count >= 1), "{check}");
    assert!(check["estimate"]["seconds"].as_f64().is_some_and(|seconds| seconds > 0.0), "{check}");
}

#[test]
fn methods_lists_networks_with_digest_licence_and_self_test() {
    let folder = tempfile::tempdir().expect("folder");
    let output = rigsmith(folder.path(), &["methods"]);
    succeeded(&output);
    let text = String::from_utf8_lossy(&output.stdout);
    for word in ["rignet", "available", "licence", "sha256", "rignet_skin", "heter_skin_net", "passed"] {
        assert!(text.contains(word), "{word} is missing in:\n{text}");
    }
}

#[test]
fn more_detail_never_gives_fewer_joints() {
    let folder = tempfile::tempdir().expect("folder");
    let input = sample();
    let mut last = 0;
    for detail in ["0", "0.25", "0.5", "0.75", "1"] {
        let arguments = ["rig", input.to_str().expect("path"), "--detail", detail, "-o", "out.rig.json"];
        succeeded(&rigsmith(folder.path(), &arguments));
        let text = std::fs::read(folder.path().join("out.rig.json")).expect("rig.json");
        let rig: Value = serde_json::from_slice(&text).expect("JSON");
        let joints = rig["joints"].as_array().map_or(0, Vec::len);
        assert!((2..=100).contains(&joints), "{joints} joints at detail {detail}");
        assert!(joints >= last, "{joints} joints at detail {detail}, {last} below it");
        last = joints;
    }
}

#[test]
fn the_runtime_reports_nothing_and_leaves_nothing_in_the_home_folder() {
    let (folder, home) = (tempfile::tempdir().expect("folder"), tempfile::tempdir().expect("home"));
    let output = Command::new(env!("CARGO_BIN_EXE_rigsmith"))
        .arg("methods")
        .current_dir(folder.path())
        .env("HOME", home.path())
        .env_remove("XDG_CACHE_HOME")
        .env_remove("ORT_DISABLE_TELEMETRY")
        .output()
        .expect("the program starts");
    succeeded(&output);
    let left: Vec<_> =
        std::fs::read_dir(home.path()).expect("home").map(|entry| entry.expect("entry").path()).collect();
    assert!(left.is_empty(), "{left:?}");
}

/// Lines of standard output that name `setting`.
fn setting<'a>(output: &'a str, name: &str) -> &'a str {
    let line = output.lines().find(|line| line.trim_start_matches("# ").starts_with(name));
    line.unwrap_or_else(|| panic!("{name} is missing in:\n{output}"))
}

#[test]
fn config_shows_what_is_in_force_and_whence() {
    let folder = tempfile::tempdir().expect("folder");
    std::fs::write(folder.path().join("r.toml"), "workers = 2\nqueue = 7\nuploads = 8\n").expect("writes");
    let output = Command::new(env!("CARGO_BIN_EXE_rigsmith"))
        .args(["config", "--config", "r.toml", "--queue", "9"])
        .current_dir(folder.path())
        .env("RIGSMITH_UPLOADS", "10")
        .env("RIGSMITH_WORKER", "3")
        .env("RIGSMITH_OTLP_HEADERS", "authorization=Bearer s3cret")
        .output()
        .expect("the program starts");
    succeeded(&output);
    let text = String::from_utf8_lossy(&output.stdout);
    for (name, value, origin) in [
        ("workers", "2", "file r.toml"),
        ("queue", "9", "flag"),
        ("uploads", "10", "environment RIGSMITH_UPLOADS"),
        ("upload_mib", "100", "default"),
        ("otlp_headers", "\"***\"", "environment RIGSMITH_OTLP_HEADERS"),
        ("keys", "", "unset"),
    ] {
        let line = setting(&text, name);
        assert!(line.ends_with(&format!("# {origin}")), "{line}");
        assert!(value.is_empty() || line.starts_with(&format!("{name} = {value}")), "{line}");
    }
    assert!(!text.contains("s3cret"), "{text}");
    assert!(stderr(&output).contains("RIGSMITH_WORKER is no setting; did you mean RIGSMITH_WORKERS?"));
    std::fs::write(folder.path().join("again.toml"), &*text).expect("writes");
    succeeded(&rigsmith(folder.path(), &["config", "--config", "again.toml"]));
}

#[test]
fn a_configuration_that_cannot_be_meant_is_refused_with_the_nearest_name() {
    let folder = tempfile::tempdir().expect("folder");
    for (text, said) in [
        ("worker = 2", "did you mean \"workers\"?"),
        ("queue = 0", "at least 1"),
        ("listen = \"nowhere\"", "listen"),
        ("[server]\nworkers = 2", "no setting \"server\""),
        ("workers", "is not TOML"),
    ] {
        std::fs::write(folder.path().join("r.toml"), text).expect("writes");
        for command in ["config", "serve"] {
            let output = rigsmith(folder.path(), &[command, "--config", "r.toml"]);
            assert_eq!(output.status.code(), Some(2), "{text}: {}", stderr(&output));
            assert!(
                stderr(&output).contains(said) && stderr(&output).contains("r.toml"),
                "{text}: {}",
                stderr(&output)
            );
        }
    }
    assert_eq!(rigsmith(folder.path(), &["config", "--config", "missing.toml"]).status.code(), Some(2));
}

#[test]
fn serving_others_without_keys_is_refused_unless_it_is_said() {
    let folder = tempfile::tempdir().expect("folder");
    let refused = rigsmith(folder.path(), &["serve", "--listen", "0.0.0.0:0"]);
    assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("--allow-anonymous") && stderr(&refused).contains("keys new"));
    let made = rigsmith(folder.path(), &["keys", "new", "studio", "--jobs", "9"]);
    succeeded(&made);
    let secret = String::from_utf8_lossy(&made.stdout).trim().to_owned();
    assert!(secret.starts_with("rsk_") && secret.len() > 40, "{secret}");
    let list = rigsmith(folder.path(), &["keys", "list"]);
    let list = String::from_utf8_lossy(&list.stdout).into_owned();
    assert!(list.contains("studio") && list.contains("jobs 9") && !list.contains(&secret), "{list}");
    let id = list.split_whitespace().next().expect("an id");
    succeeded(&rigsmith(folder.path(), &["keys", "remove", id]));
    let empty = rigsmith(folder.path(), &["serve", "--listen", "0.0.0.0:0", "--keys", "keys.toml"]);
    assert_eq!(empty.status.code(), Some(2), "{}", stderr(&empty));
}

#[test]
fn a_check_tells_what_stands_there_and_the_rig_is_told_the_same() {
    let folder = tempfile::tempdir().expect("folder");
    let sample = sample();
    let path = sample.to_str().expect("path");
    let output = rigsmith(folder.path(), &["check", path, "--json"]);
    succeeded(&output);
    let check: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!((&check["riggable"], &check["category"]), (&"yes".into(), &"biped".into()), "{check:#}");
    assert!(check["category_confidence"].as_f64().is_some_and(|share| share > 0.5), "{check:#}");
    assert!(["t", "a"].contains(&check["pose"].as_str().expect("a pose")), "{check:#}");
    let normal: Vec<f64> = serde_json::from_value(check["symmetry"]["plane"]["normal"].clone()).expect("a normal");
    assert!(normal[0] > 0.99 && check["symmetry"]["score"].as_f64().is_some_and(|score| score > 0.75), "{check:#}");
    for count in ["vertices", "faces", "meshes", "primitives", "components"] {
        assert!(check["mesh"][count].as_u64().is_some_and(|count| count > 0), "{count}: {check:#}");
    }
    for count in ["skins", "joints", "animations", "morph_targets"] {
        assert!(check["existing"][count].is_u64(), "{count}: {check:#}");
    }
    succeeded(&rigsmith(folder.path(), &["rig", path, "-o", "out.rig.json", "--report", "report.json"]));
    let report = std::fs::read(folder.path().join("report.json")).expect("a report");
    let report: Value = serde_json::from_slice(&report).expect("JSON");
    let (found, told) = (check["findings"].as_array().expect("a list"), report["findings"].as_array().expect("a list"));
    assert!(told.starts_with(found), "{told:#?} does not begin with {found:#?}");
}

#[test]
fn processes_that_share_half_of_what_they_need_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let database = ["--database", "postgres://rigs@127.0.0.1:9/rigs"];
    let storage = ["--storage", "s3://rigs?endpoint=http://127.0.0.1:9"];
    for (arguments, said) in [
        (vec!["serve", "--listen", "127.0.0.1:0", "--workers", "0"], "nobody would do the work"),
        (["serve", "--listen", "127.0.0.1:0"].into_iter().chain(database).collect(), "both --database and --storage"),
        (["serve", "--listen", "127.0.0.1:0"].into_iter().chain(storage).collect(), "both --database and --storage"),
        (["worker"].into_iter().chain(database).collect(), "of the service that it works for"),
    ] {
        let refused = rigsmith(folder.path(), &arguments);
        assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
        assert!(stderr(&refused).contains(said), "{}", stderr(&refused));
    }
}

/// Results never take the place of what was sent, nor of each other.
#[test]
fn what_was_sent_is_never_written_over() {
    let folder = tempfile::tempdir().expect("folder");
    let sent = std::fs::read(sample()).expect("the sample");
    std::fs::write(folder.path().join("hero.glb"), &sent).expect("a copy");
    let skeleton =
        r#"{"format": "rigsmith.rig/1", "joints": [{"name": "hips", "parent": null, "position": [0, 1, 0]}]}"#;
    std::fs::write(folder.path().join("own.rig.json"), skeleton).expect("a skeleton");
    for (arguments, said) in [
        (vec!["rig", "hero.glb", "-o", "hero.glb"], "hero.glb is what was sent"),
        (vec!["rig", "hero.glb", "-o", "out.glb", "--report", "./hero.glb"], "hero.glb is what was sent"),
        (vec!["rig", "hero.glb", "-o", "out.glb", "-o", "./out.glb"], "named for two results"),
        (vec!["rig", "hero.glb", "-o", "out.rig.json", "--report", "out.rig.json"], "named for two results"),
        (vec!["rig", "hero.glb", "-o", "no/such/folder/out.glb"], "cannot be written"),
        (vec!["skin", "hero.glb", "--skeleton", "own.rig.json", "-o", "own.rig.json"], "own.rig.json is what was sent"),
        (vec!["batch", ".", "-o", "."], "name another folder"),
    ] {
        let refused = rigsmith(folder.path(), &arguments);
        assert_eq!(refused.status.code(), Some(2), "{arguments:?}: {}", stderr(&refused));
        assert!(stderr(&refused).contains(said), "{arguments:?}: {}", stderr(&refused));
    }
    assert_eq!(std::fs::read(folder.path().join("hero.glb")).expect("still there"), sent);
    assert_eq!(std::fs::read_dir(folder.path()).expect("folder").count(), 2);
}

/// One skeleton is weighed over: the one that was sent, or the one of the file.
#[test]
fn two_skeletons_at_once_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let input = sample();
    let input = input.to_str().expect("path");
    let skeleton =
        r#"{"format": "rigsmith.rig/1", "joints": [{"name": "hips", "parent": null, "position": [0, 1, 0]}]}"#;
    std::fs::write(folder.path().join("own.rig.json"), skeleton).expect("a skeleton");
    for (arguments, said) in [
        (vec!["--skeleton", "own.rig.json", "--existing-rig", "reskin"], "leave out one of them"),
        (vec!["--existing-rig", "replace"], "leave out --existing-rig"),
    ] {
        let refused = rigsmith(folder.path(), &[&["skin", input, "-o", "out.glb"][..], &arguments[..]].concat());
        assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
        assert!(stderr(&refused).contains(said), "{}", stderr(&refused));
    }
}

/// The picture is taken from where the character faces, whichever axis that is.
#[test]
fn a_character_that_lies_is_drawn_upright() {
    let folder = tempfile::tempdir().expect("folder");
    let standing = "v 0 0 0\nv 0.4 0 0\nv 0.4 1 0\nv 0 1 0\nv 0 0 0.2\nv 0.4 0 0.2\nv 0.4 1 0.2\nv 0 1 0.2\n";
    let lying: String = standing
        .lines()
        .map(|line| {
            let place: Vec<&str> = line.split(' ').skip(1).collect();
            // Up is z, and what faced +z faces -y.
            format!("v {} -{} {}\n", place[0], place[2], place[1])
        })
        .collect();
    let faces = "f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";
    let picture = |name: &str, vertices: &str, axes: &[&str]| {
        std::fs::write(folder.path().join(format!("{name}.obj")), format!("{vertices}{faces}")).expect("a mesh");
        let (input, output) = (format!("{name}.obj"), format!("{name}.png"));
        let arguments = [&["rig", &input, "-o", &output, "--boxes", "off"], axes].concat();
        succeeded(&rigsmith(folder.path(), &arguments));
        let file = std::fs::File::open(folder.path().join(output)).expect("a picture");
        let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().expect("a PNG");
        let mut pixels = vec![0; reader.output_buffer_size().expect("a small one")];
        reader.next_frame(&mut pixels).expect("its pixels");
        pixels
    };
    let upright = picture("upright", standing, &["--up", "y", "--front", "z"]);
    let turned = picture("lying", &lying, &["--up", "z", "--front=-y"]);
    let others = upright.iter().zip(&turned).filter(|(a, b)| a.abs_diff(**b) > 8).count();
    assert_eq!(upright.len(), turned.len());
    // Other roundings move an edge by a pixel; another view is another picture.
    assert!(others * 1000 < upright.len(), "{others} of {} values differ", upright.len());
}

#[test]
fn an_axis_along_the_files_up_is_refused_and_not_dropped() {
    let folder = tempfile::tempdir().expect("folder");
    let input = sample();
    let refused = rigsmith(folder.path(), &["check", input.to_str().expect("path"), "--front", "y"]);
    assert_eq!(refused.status.code(), Some(4), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("one line"), "{}", stderr(&refused));
}

#[test]
fn a_reader_that_leaves_ends_the_program_quietly() {
    use std::io::Read;
    use std::process::Stdio;
    let mut command = Command::new(env!("CARGO_BIN_EXE_rigsmith"));
    let mut running =
        command.arg("openapi").stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
    drop(running.stdout.take());
    let mut said = String::new();
    running.stderr.take().expect("its stderr").read_to_string(&mut said).expect("text");
    assert_eq!((running.wait().expect("an end").code(), said.as_str()), (Some(141), ""));
}
