//! Jobs from creation to their end.

use super::scripted::{Service, form, glb, request};
use rigsmith::formats::Axis;
use rigsmith::jobs::{ErrorCode, LevelOfDetail, Output};
use serde_json::json;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

#[tokio::test]
async fn a_mesh_becomes_a_job_with_a_result() {
    let service = Service::new();
    let created = service.rig("?detail=0.7&seed=3", &[], "sleep 30").await;
    assert_eq!(created.status, 202, "{}", created.text());
    let path = created.header("location").to_owned();
    let job = created.json();
    let id = job["id"].as_str().expect("an id");
    assert!(id.starts_with("rig_") && id.len() == 30, "{id}");
    assert_eq!(path, format!("/v1/rigs/{id}"));
    assert_eq!(created.header("retry-after"), "1");
    assert_eq!(job["result"], json!(null));
    let job = service.until(&path, "succeeded").await;
    assert_eq!(job["progress"], 100);
    assert_eq!(job["stage"], "export");
    assert_eq!(job["method_used"], "rignet");
    assert_eq!(job["request"]["detail"], 0.7);
    assert_eq!(job["request"]["outputs"], json!(["glb", "rig_json"]));
    assert_eq!(job["provenance"]["models"][0]["name"], "skin");
    assert_eq!(job["result"]["skeleton"]["joints"], 24);
    assert_eq!(job["warnings"][0]["code"], "scripted");
    assert!(job["timings_ms"]["joints"].as_u64().expect("a time") >= 30);
    assert!(job["timings_ms"]["queue"].is_u64());
    assert!(job["expires_at"].as_str() > job["finished_at"].as_str());
    let artifact = &job["result"]["artifacts"][0];
    assert_eq!(artifact["bytes"], glb().len());
    assert!(service.get(&path).await.header("server-timing").contains("joints;dur="));
    let url = artifact["url"].as_str().expect("a url");
    assert_eq!(service.get(url).await.bytes, glb());
    service.keeps(3);
}

#[tokio::test]
async fn every_option_arrives_from_query_form_and_json() {
    let service = Service::new();
    let json = r#"{"method": "rignet", "bandwidth": 0.05, "outputs": ["glb", "preview_png"]}"#;
    let parts = [
        ("options", None, json),
        ("texture", Some("textures\\skin.png"), "png"),
        ("seed", None, "9"),
        ("file", Some("hero.obj"), "ok"),
    ];
    let answer = service.send(form("/v1/rigs?up=+z&front=-y&max_influences=8", &[("prefer", "wait=10")], &parts)).await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    let seen = service.rigger.seen.lock().expect("not poisoned").remove(0);
    assert_eq!(seen.files.iter().map(|file| file.name.as_str()).collect::<Vec<_>>(), ["hero.obj", "textures/skin.png"]);
    assert_eq!(seen.files[1].bytes, "png");
    let options = seen.options;
    assert_eq!(options.method.as_deref(), Some("rignet"));
    assert_eq!(options.level_of_detail, LevelOfDetail::Bandwidth(0.05));
    assert_eq!((options.up, options.front), (Some(Axis::PosZ), Some(Axis::NegY)));
    assert_eq!((options.seed, options.max_influences), (9, 8));
    assert_eq!(options.outputs, [Output::Glb, Output::PreviewPng]);
}

#[tokio::test]
async fn the_main_file_of_a_form_is_found() {
    let service = Service::new();
    for parts in [
        &[("file", Some("a.mtl"), ""), ("file", Some("a.obj"), "ok")][..],
        &[("x", Some("a.bin"), "b"), ("y", Some("a.gltf"), "ok")],
        &[("only", Some("noextension"), "ok")],
        &[("file", Some("a.obj"), "ok"), ("other", Some("b.obj"), "no")],
    ] {
        let answer = service.send(form("/v1/rigs", &[("prefer", "wait=10")], parts)).await;
        assert_eq!(answer.json()["state"], "succeeded", "{}", answer.text());
    }
}

#[tokio::test]
async fn raw_bodies_are_named_by_their_type_or_by_the_caller() {
    let service = Service::new();
    for (media_type, query, name) in [
        ("model/gltf-binary", "", "upload.glb"),
        ("model/gltf+json; charset=utf-8", "", "upload.gltf"),
        ("Model/STL", "", "upload.stl"),
        ("application/zip", "", "upload.zip"),
        ("application/octet-stream", "?file_name=a/hero.fbx", "a/hero.fbx"),
        ("application/x-www-form-urlencoded", "", "upload"),
    ] {
        let fields = [("content-type", media_type), ("prefer", "wait=10")];
        let answer = service.send(request("POST", &format!("/v1/rigs{query}"), &fields, "ok")).await;
        assert_eq!(answer.status, 200, "{}", answer.text());
        assert_eq!(answer.json()["files"][0]["name"], name);
    }
}

#[tokio::test]
async fn waiting_ends_with_the_job_or_with_the_time() {
    let service = Service::new();
    let began = Instant::now();
    let done = service.rig("", &[("prefer", "wait=20")], "sleep 50").await;
    assert_eq!((done.status.as_u16(), done.header("preference-applied")), (200, "wait=20"));
    assert!(began.elapsed() < Duration::from_secs(5));
    assert!(done.header("server-timing").contains("queue;dur="));
    let waiting = service.rig("", &[("prefer", "wait=1")], "hang").await;
    assert_eq!(waiting.status, 202);
    assert_eq!(waiting.json()["state"], "running");
    let path = waiting.header("location").to_owned();
    let looked = service.send(request("GET", &path, &[("prefer", "wait=1")], "")).await;
    assert_eq!((looked.status.as_u16(), looked.header("preference-applied")), (200, "wait=1"));
    assert_eq!(looked.json()["state"], "running");
}

#[tokio::test]
async fn the_rigged_file_itself_is_the_answer_when_it_is_asked_for() {
    let service = Service::new();
    let glb_wanted = [("accept", "model/gltf-binary")];
    let answer = service.rig("", &glb_wanted, "ok").await;
    assert_eq!((answer.status.as_u16(), answer.header("content-type")), (200, "model/gltf-binary"));
    assert_eq!(answer.bytes, glb());
    assert!(answer.header("location").starts_with("/v1/rigs/rig_"));
    let problem = service.rig("", &glb_wanted, "fail no_joints_found").await.refused(422, "no_joints_found");
    assert_eq!(problem["stage"], "joints");
    assert_eq!(problem["hint"], "change the script");
    let slow = service.rig("", &[("accept", "model/gltf-binary"), ("prefer", "wait=0")], "hang").await;
    assert_eq!((slow.status.as_u16(), slow.header("content-type")), (202, "application/json"));
}

#[tokio::test]
async fn every_failure_of_the_work_is_told_in_the_job() {
    let service = Service::new();
    for code in ErrorCode::ALL.into_iter().filter(|code| *code != ErrorCode::Canceled) {
        let job = service.finished(&format!("fail {}", code.name())).await;
        assert_eq!(job["state"], "failed");
        assert_eq!(job["error"]["code"], code.name());
        assert_eq!(job["error"]["stage"], "joints");
        assert_eq!(job["result"], json!(null));
        assert_eq!(service.get(job["error"]["type"].as_str().expect("a type")).await.status, 200);
        let direct = service.rig("", &[("accept", "model/gltf-binary")], &format!("fail {}", code.name())).await;
        assert!(direct.status.is_client_error() || direct.status.is_server_error());
        direct.refused(direct.status.as_u16(), code.name());
    }
    service.keeps(0); // failed jobs keep nothing
}

#[tokio::test]
async fn a_panic_fails_its_job_and_no_other() {
    let service = Service::with(|settings, _| settings.workers = 1);
    for _ in 0..3 {
        let job = service.finished("panic").await;
        assert_eq!(job["error"]["code"], "internal");
        assert!(!job.to_string().contains("secret"), "{job}");
    }
    assert_eq!(service.finished("ok").await["state"], "succeeded");
}

#[tokio::test]
async fn work_that_stops_without_being_asked_or_writes_bad_names_is_our_error() {
    let service = Service::new();
    for script in ["fail canceled", "names"] {
        let job = service.finished(script).await;
        assert_eq!((&job["state"], &job["error"]["code"]), (&json!("failed"), &json!("internal")));
    }
    service.keeps(0);
}

#[tokio::test]
async fn a_waiting_job_is_canceled_at_once_and_a_running_one_when_it_yields() {
    let service = Service::with(|settings, _| settings.workers = 1);
    let running = service.rig("", &[], "hang").await.header("location").to_owned();
    service.until(&running, "running").await;
    let waiting = service.rig("", &[], "ok").await.header("location").to_owned();
    let behind = service.rig("", &[], "ok").await.header("location").to_owned();
    assert_eq!(service.get(&behind).await.json()["queue_position"], 2);
    let cancel = |path: &str| request("POST", &format!("{path}:cancel"), &[], "");
    assert_eq!(service.send(cancel(&waiting)).await.json()["state"], "canceled");
    assert_eq!(service.get(&behind).await.json()["queue_position"], 1);
    let asked = service.send(cancel(&running)).await.json();
    assert_eq!(asked["cancel_requested"], true);
    let ended = service.until(&running, "canceled").await;
    assert_eq!((&ended["error"], &ended["links"]["cancel"]), (&json!(null), &json!(null)));
    assert_eq!(service.send(cancel(&running)).await.status, 200, "asking twice is asking once");
    service.until(&behind, "succeeded").await;
    service.send(cancel(&behind)).await.refused(409, "not_cancelable");
    let direct = service.rig("", &[("accept", "model/gltf-binary")], "fail canceled").await;
    direct.refused(500, "internal");
}

#[tokio::test]
async fn canceling_while_a_caller_waits_for_the_file_answers_the_caller() {
    let service = Service::new();
    let waiting = service.rig("", &[("accept", "model/gltf-binary")], "hang");
    let canceling = async {
        for _ in 0..500 {
            let jobs = service.get("/v1/rigs?state=running").await.json();
            if let Some(id) = jobs["data"][0]["id"].as_str() {
                return service.send(request("POST", &format!("/v1/rigs/{id}:cancel"), &[], "")).await;
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        panic!("never ran");
    };
    let (answer, _) = tokio::join!(waiting, canceling);
    answer.refused(409, "canceled");
}

#[tokio::test]
async fn no_more_jobs_run_than_there_are_workers() {
    let service = Service::new();
    let mut paths = Vec::new();
    for number in 0..6 {
        paths.push(service.rig("", &[], &format!("sleep {}", 200 + number)).await.header("location").to_owned());
    }
    for path in &paths {
        service.until(path, "succeeded").await;
    }
    assert_eq!(service.rigger.running_most.load(Ordering::SeqCst), 2);
}

#[tokio::test]
async fn progress_never_falls_and_states_only_go_forward() {
    let service = Service::new();
    let path = service.rig("", &[], "sleep 100").await.header("location").to_owned();
    let order = ["queued", "running", "succeeded"];
    let (mut progress, mut rank) = (0, 0);
    for _ in 0..500 {
        let job = service.get(&path).await.json();
        let now = job["progress"].as_u64().expect("progress");
        let state = job["state"].as_str().expect("state");
        let rank_now = order.iter().position(|name| *name == state).expect("a state of the way to success");
        assert!(now >= progress && rank_now >= rank, "{job:#}");
        assert_eq!(now == 100, state == "succeeded");
        (progress, rank) = (now, rank_now);
        if state == "succeeded" {
            return;
        }
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    panic!("did not succeed");
}

#[tokio::test]
async fn a_job_that_takes_too_long_is_stopped() {
    let service = Service::with(|settings, _| settings.job_time_max = Duration::from_millis(50));
    let job = service.finished("hang").await;
    assert_eq!(job["error"]["code"], "timeout");
    assert_eq!(job["error"]["stage"], "joints");
    service.rig("", &[("accept", "model/gltf-binary")], "hang").await.refused(504, "timeout");
}

#[tokio::test]
async fn jobs_are_listed_newest_first_in_pages() {
    let service = Service::new();
    let mut ids = Vec::new();
    for script in ["ok", "fail no_joints_found", "ok", "ok"] {
        ids.insert(0, service.finished(script).await["id"].clone());
    }
    let page = |path: String| {
        let service = &service;
        async move {
            let page = service.get(&path).await.json();
            let found: Vec<_> = page["data"].as_array().expect("data").iter().map(|job| job["id"].clone()).collect();
            (found, page["next_page_token"].as_str().map(str::to_owned))
        }
    };
    let (first, token) = page("/v1/rigs?page_size=3".to_owned()).await;
    assert_eq!(first, ids[..3]);
    let (second, end) = page(format!("/v1/rigs?page_size=3&page_token={}", token.expect("a token"))).await;
    assert_eq!((&second[..], end), (&ids[3..], None));
    assert_eq!(page("/v1/rigs?state=failed".to_owned()).await.0, ids[2..3]);
}

#[tokio::test]
async fn deleting_forgets_a_job_and_its_files_but_not_while_it_runs() {
    let service = Service::with(|settings, _| settings.workers = 1);
    let done = service.rig("", &[("prefer", "wait=10")], "ok").await.header("location").to_owned();
    let running = service.rig("", &[], "hang").await.header("location").to_owned();
    service.until(&running, "running").await;
    let waiting = service.rig("", &[], "ok").await.header("location").to_owned();
    let delete = |path: &str| request("DELETE", path, &[], "");
    service.send(delete(&running)).await.refused(409, "conflict");
    for path in [&done, &waiting] {
        assert_eq!(service.send(delete(path)).await.status, 204);
        service.get(path).await.refused(404, "not_found");
        service.send(delete(path)).await.refused(404, "not_found");
    }
    service.get(&format!("{done}/artifacts")).await.refused(404, "not_found");
    service.keeps(1); // the upload of the running job
}

#[tokio::test]
async fn results_expire_by_time_and_then_are_gone() {
    let service = Service::with(|settings, _| settings.keep_time = Duration::from_millis(80));
    let path = service.rig("", &[("prefer", "wait=10")], "ok").await.header("location").to_owned();
    let job = service.until(&path, "expired").await;
    assert_eq!(job["result"]["artifacts"], json!([]));
    assert_eq!(job["result"]["skeleton"]["joints"], 24, "what is small stays");
    service.get(&format!("{path}/artifacts")).await.refused(410, "expired");
    service.get(&format!("{path}/artifacts/rigged.glb")).await.refused(410, "expired");
    service.keeps(0);
}

#[tokio::test]
async fn what_is_oldest_makes_room_for_new_uploads() {
    let service = Service::storing(3_000_000, |_, _| {});
    let script = |number: usize| format!("ok {number} {}", "x".repeat(500_000));
    let mut paths = Vec::new();
    for number in 0..8 {
        let done = service.rig("", &[("prefer", "wait=10")], &script(number)).await;
        assert_eq!(done.json()["state"], "succeeded", "{number}");
        paths.push(done.header("location").to_owned());
    }
    assert_eq!(service.state_of(paths.last().expect("a path")).await, "succeeded");
    service.rig("", &[], &format!("ok {}", "x".repeat(3_100_000))).await.refused(429, "queue_full");
}

#[tokio::test]
async fn only_so_many_final_jobs_are_remembered() {
    let service = Service::with(|settings, _| settings.records_max = 3);
    for _ in 0..5 {
        service.finished("ok").await;
    }
    for _ in 0..500 {
        if service.get("/v1/rigs").await.json()["data"].as_array().expect("data").len() == 3 {
            // Equal jobs share their upload and both artifacts.
            return service.keeps(3);
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    panic!("all are remembered");
}

#[tokio::test]
async fn a_check_answers_without_a_job() {
    let service = Service::new();
    let check = |script: &str| request("POST", "/v1/rigs:check?detail=1", &[("content-type", "model/obj")], script);
    let checked = service.send(check("ok")).await;
    assert_eq!((checked.status.as_u16(), &checked.json()["riggable"]), (200, &json!("yes")));
    service.send(check("fail no_geometry")).await.refused(422, "no_geometry");
    service.send(check("panic")).await.refused(500, "internal");
    assert_eq!(service.get("/v1/rigs").await.json()["data"], json!([]));
    service.keeps(0);
}
