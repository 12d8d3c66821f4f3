//! `rigsmith batch`: a folder of meshes, here and by a service.

use super::examples::{Served, figure};
use super::program::{rigsmith, stderr, succeeded};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Three figures, of which one asks for a material, and two files that are no meshes to rig.
fn meshes(folder: &Path) {
    fs::create_dir(folder.join("in")).expect("a folder");
    let write = |name: &str, text: &str| fs::write(folder.join("in").join(name), text).expect("writes");
    let bare = figure().replace("mtllib hero.mtl\nusemtl skin\n", "");
    write("knight.obj", &figure());
    write("hero.mtl", "newmtl skin\nKd 0.8 0.6 0.5\n");
    write("squire.obj", &bare.replace("v 0.8 ", "v 0.7 "));
    write("twin.obj", &bare);
    write("twin.stl", "solid nothing\nendsolid nothing\n");
    write("notes.txt", "no mesh");
}

fn run(folder: &Path, more: &[&str]) -> Output {
    rigsmith(folder, &[&["batch", "in", "-o", "out", "--make", "glb,rig_json"], more].concat())
}

fn report(folder: &Path) -> Value {
    serde_json::from_slice(&fs::read(folder.join("out/rigsmith-batch.json")).expect("a report")).expect("JSON")
}

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

const MADE: [&str; 6] =
    ["knight.glb", "knight.rig.json", "squire.glb", "squire.rig.json", "twin.obj.glb", "twin.obj.rig.json"];

#[test]
fn a_folder_is_rigged_once_and_only_what_changed_again() {
    let folder = tempfile::tempdir().expect("folder");
    meshes(folder.path());
    let first = run(folder.path(), &[]);
    assert_eq!(first.status.code(), Some(3), "{}", stderr(&first));
    assert!(stderr(&first).contains("1 of 4 meshes have no rig"), "{}", stderr(&first));
    let said = stdout(&first);
    assert!(said.contains("3 rigs, 1 meshes without one") && said.contains("no_geometry"), "{said}");
    let written =
        |name: &str| fs::metadata(folder.path().join("out").join(name)).and_then(|facts| facts.modified()).expect(name);
    for name in MADE {
        written(name);
    }
    let told = report(folder.path());
    assert_eq!(told["counts"], serde_json::json!({"succeeded": 3, "failed": 1}));
    assert!(told["files"]["knight.obj"]["with"]["hero.mtl"].is_string(), "{told:#}");
    assert_eq!(told["files"]["twin.stl"]["error"]["code"], "no_geometry");
    let before = MADE.map(written);
    let second = run(folder.path(), &[]);
    assert!(stdout(&second).contains("3 of them were done before"), "{}", stdout(&second));
    assert_eq!(MADE.map(written), before, "nothing was done again");
    fs::write(folder.path().join("in/hero.mtl"), "newmtl skin\nKd 0.1 0.6 0.5\n").expect("writes");
    fs::remove_file(folder.path().join("out/squire.rig.json")).expect("removes");
    let third = run(folder.path(), &[]);
    assert!(stdout(&third).contains("1 of them were done before"), "{}", stdout(&third));
    for name in ["twin.stl", "twin.obj"] {
        fs::remove_file(folder.path().join("in").join(name)).expect("removes");
    }
    let fourth = run(folder.path(), &[]);
    succeeded(&fourth);
    assert!(stdout(&fourth).contains("2 of them were done before"), "{}", stdout(&fourth));
    assert!(report(folder.path())["files"]["twin.stl"].is_null(), "what is gone is forgotten");
    let other = run(folder.path(), &["--detail", "0.3"]);
    succeeded(&other);
    assert!(!stdout(&other).contains("done before"), "another detail is another rig: {}", stdout(&other));
}

#[test]
fn a_run_that_is_killed_goes_on_where_it_was() {
    let folder = tempfile::tempdir().expect("folder");
    meshes(folder.path());
    let mut killed = Command::new(env!("CARGO_BIN_EXE_rigsmith"))
        .args(["batch", "in", "-o", "out", "--make", "glb,rig_json"])
        .current_dir(folder.path())
        .env_remove("ORT_DYLIB_PATH")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("starts");
    let until = Instant::now() + Duration::from_secs(120);
    while !folder.path().join("out/rigsmith-batch.json").exists() {
        assert!(Instant::now() < until, "nothing is done");
        std::thread::sleep(Duration::from_millis(5));
    }
    killed.kill().expect("killed");
    killed.wait().expect("ended");
    let first = fs::metadata(folder.path().join("out/knight.glb")).and_then(|facts| facts.modified()).expect("made");
    let again = run(folder.path(), &[]);
    assert!(stdout(&again).contains("done before"), "{}", stdout(&again));
    assert_eq!(fs::metadata(folder.path().join("out/knight.glb")).and_then(|facts| facts.modified()).ok(), Some(first));
    assert!(MADE.iter().all(|name| folder.path().join("out").join(name).exists()));
}

#[test]
fn a_service_makes_the_same_files() {
    let folder = tempfile::tempdir().expect("folder");
    meshes(folder.path());
    run(folder.path(), &[]);
    let here = MADE.map(|name| fs::read(folder.path().join("out").join(name)).expect(name));
    fs::rename(folder.path().join("out"), folder.path().join("here")).expect("renames");
    let served = Served::start();
    let remote = run(folder.path(), &["--server", &served.host]);
    assert_eq!(remote.status.code(), Some(3), "{}", stderr(&remote));
    let there = MADE.map(|name| fs::read(folder.path().join("out").join(name)).expect(name));
    assert!(here == there, "the same bytes");
    let told = report(folder.path());
    assert_eq!(told["files"]["twin.stl"]["error"]["code"], "no_geometry", "{told:#}");
    assert!(stdout(&run(folder.path(), &["--server", &served.host])).contains("3 of them were done before"));
}

#[test]
fn what_makes_no_sense_is_refused_before_work() {
    let folder = tempfile::tempdir().expect("folder");
    fs::create_dir(folder.path().join("in")).expect("a folder");
    for more in [&["--make", "fbx"][..], &["--detail", "9"], &[]] {
        let refused = rigsmith(folder.path(), &[&["batch", "in", "-o", "out"], more].concat());
        assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    }
    fs::create_dir_all(folder.path().join("out")).expect("a folder");
    meshes(&folder.path().join("out"));
    fs::write(folder.path().join("out/rigsmith-batch.json"), "{}").expect("writes");
    let refused = rigsmith(folder.path(), &["batch", "out/in", "-o", "out"]);
    assert!(stderr(&refused).contains("is no report of rigsmith batch"), "{}", stderr(&refused));
}
