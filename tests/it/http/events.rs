//! Watching a job.

use super::scripted::{Service, request};
use serde_json::{Value, json};
use std::time::Duration;

struct Event {
    id: u64,
    name: String,
    data: Value,
}

/// Reads a stream as the standard says: blocks of lines, of which those that begin with a colon count for nothing.
fn events(text: &str) -> Vec<Event> {
    let blocks = text.split("\n\n").filter(|block| block.contains("data:"));
    blocks
        .map(|block| {
            let field = |name: &str| block.lines().find_map(|line| line.strip_prefix(name)).unwrap_or_default().trim();
            Event {
                id: field("id:").parse().expect("a number"),
                name: field("event:").to_owned(),
                data: serde_json::from_str(field("data:")).expect("JSON"),
            }
        })
        .collect()
}

#[tokio::test]
async fn a_watcher_sees_a_snapshot_then_what_happens_and_the_end() {
    let service = Service::new();
    let path = service.rig("", &[], "sleep 300").await.header("location").to_owned();
    let answer = service.get(&format!("{path}/events")).await;
    assert_eq!((answer.status.as_u16(), answer.header("content-type")), (200, "text/event-stream"));
    assert_eq!((answer.header("cache-control"), answer.header("x-accel-buffering")), ("no-store", "no"));
    let text = String::from_utf8(answer.bytes).expect("text");
    assert!(text.starts_with("retry: "), "{text}");
    let seen = events(&text);
    assert_eq!(seen[0].name, "snapshot");
    assert_eq!(seen[0].data["links"]["self"], path.as_str());
    assert!(seen.windows(2).all(|pair| pair[0].id < pair[1].id), "ids rise");
    let names: Vec<&str> = seen.iter().map(|event| event.name.as_str()).collect();
    for name in ["progress", "warning", "artifact", "done"] {
        assert!(names.contains(&name), "{name} in {names:?}");
    }
    let last = seen.last().expect("events");
    assert_eq!((last.name.as_str(), &last.data["state"]), ("done", &json!("succeeded")));
    let progress: Vec<u64> = seen
        .iter()
        .filter(|event| event.name == "progress")
        .filter_map(|event| event.data["progress"].as_u64())
        .collect();
    assert!(progress.is_sorted() && progress.len() <= 4, "{progress:?}");
}

#[tokio::test]
async fn a_watcher_takes_up_where_it_stopped_and_is_told_when_there_is_no_more() {
    let service = Service::new();
    let path = service.rig("", &[("prefer", "wait=10")], "ok").await.header("location").to_owned();
    let resume = |id: String| request("GET", &format!("{path}/events"), &[("last-event-id", &id)], "");
    let all = events(&service.send(resume("0".to_owned())).await.text());
    assert_eq!(all.iter().map(|event| event.id).collect::<Vec<_>>(), (1..=all.len() as u64).collect::<Vec<_>>());
    let (third, last) = (all[2].id, all.last().expect("events").id);
    let rest = events(&service.send(resume(third.to_string())).await.text());
    assert_eq!(rest.iter().map(|event| event.id).collect::<Vec<_>>(), (third + 1..=last).collect::<Vec<_>>());
    assert_eq!(service.send(resume(last.to_string())).await.status, 204);
    let lost = events(&service.send(resume((last + 100).to_string())).await.text());
    assert_eq!(lost[0].name, "snapshot", "an id of another life begins anew");
    service.send(resume("x".to_owned())).await.refused(400, "invalid_parameter");
    service.get("/v1/rigs/rig_00000000000000000000000000/events").await.refused(404, "not_found");
}

#[tokio::test]
async fn a_failure_and_a_cancellation_end_the_stream() {
    let service = Service::new();
    let path = service.rig("", &[("prefer", "wait=10")], "fail no_joints_found").await.header("location").to_owned();
    let seen = events(&service.get(&format!("{path}/events")).await.text());
    let done = seen.last().expect("events");
    assert_eq!((done.name.as_str(), &done.data["error"]["code"]), ("done", &json!("no_joints_found")));
    let running = service.rig("", &[], "hang").await.header("location").to_owned();
    service.until(&running, "running").await;
    let events_path = format!("{running}/events");
    let stopping = async {
        tokio::time::sleep(Duration::from_millis(100)).await;
        service.send(request("POST", &format!("{running}:cancel"), &[], "")).await
    };
    let (watched, _) = tokio::join!(service.get(&events_path), stopping);
    let seen = events(&watched.text());
    assert_eq!(seen.last().map(|event| &event.data["state"]), Some(&json!("canceled")));
}
