//! What the job store on PostgreSQL can carry: workers that do no work take jobs, tell of stages and end them, as fast as
//! the database answers. Prints figures as JSON for `tests/reliability/scale.py`.
//!
//!     cargo run --release --example stub_workers URL WORKERS JOBS WAITING CALLERS
//!
//! WORKERS tasks share one process for each eight of them, JOBS jobs of CALLERS callers are done, and WAITING wait at any
//! time.

use rigsmith::jobs::store::postgres::PostgresStore;
use rigsmith::jobs::store::{Admission, Ending, Finish, JobStore, LEASE, NewFiles, NewJob, StoreFailure};
use rigsmith::jobs::{ArtifactInfo, Caller, JobResult, Labels, Priority, RigOptions, Stage};
use rigsmith::storage::NewBlob;
use sha2::{Digest, Sha256};
use std::error::Error;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::task::JoinSet;

/// Tasks that share the connections of one process.
const TOGETHER: usize = 8;
/// Stages that a job of some seconds tells of: four a second at most.
const STAGES: [Stage; 6] =
    [Stage::Ingest, Stage::Normalize, Stage::Geometry, Stage::Joints, Stage::Skin, Stage::Export];
const RETENTION: Duration = Duration::from_secs(24 * 3600);

fn blob(name: &str, content: &str) -> NewBlob {
    let sha256 = Sha256::digest(format!("{name} {content}")).into();
    NewBlob { name: name.to_owned(), bytes: 100_000, sha256, location: format!("blobs/{name}-{content}") }
}

fn new_job(number: usize, callers: usize) -> NewJob {
    let file = blob("hero.glb", &number.to_string());
    NewJob {
        caller: Caller::named(&format!("caller {}", number % callers)),
        files: NewFiles::Received { files: vec![file], memory_bytes: 150 << 20 },
        skeleton: None,
        options: RigOptions::default(),
        priority: Priority::Normal,
        labels: Labels::new(),
        timeout: Duration::from_secs(300),
        deadline: None,
        retention: RETENTION,
        client_id: None,
        idempotency_key: Some(format!("request {number}")),
        wish: [1; 32],
        recipe: [2; 32],
        use_cache: true,
        waiting_max: 1_000_000,
        workers: 0,
        unfinished_max: None,
        asset_retention: RETENTION,
        webhook: None,
    }
}

fn good(number: usize) -> Ending {
    let made: Vec<NewBlob> = ["rigged.glb", "rigged.rig.json"].map(|name| blob(name, &number.to_string())).to_vec();
    let artifact = |made: &NewBlob| ArtifactInfo {
        name: made.name.clone(),
        media_type: "model/gltf-binary".to_owned(),
        bytes: made.bytes,
        sha256: made.sha256,
    };
    let result = JobResult {
        method_used: "rignet".to_owned(),
        models: Vec::new(),
        report: serde_json::Map::new(),
        findings: Vec::new(),
        artifacts: made.iter().map(artifact).collect(),
    };
    Ending { outcome: Ok((result, made)), stage: Some(Stage::Export), timings: Vec::new() }
}

/// What all tasks count together.
#[derive(Default)]
struct Counts {
    submitted: AtomicUsize,
    done: AtomicUsize,
    looks: AtomicUsize,
    submit_micros: AtomicUsize,
    claim_micros: AtomicUsize,
}

async fn submit(
    store: Arc<PostgresStore>,
    counts: Arc<Counts>,
    (jobs, waiting, callers): (usize, usize, usize),
) -> Result<(), StoreFailure> {
    loop {
        while counts.submitted.load(Ordering::SeqCst) >= counts.done.load(Ordering::SeqCst) + waiting {
            tokio::time::sleep(Duration::from_millis(1)).await;
            if counts.done.load(Ordering::SeqCst) >= jobs {
                return Ok(());
            }
        }
        let number = counts.submitted.fetch_add(1, Ordering::SeqCst);
        if number >= jobs {
            return Ok(());
        }
        let began = Instant::now();
        let admission = store.submit(new_job(number, callers)).await?;
        assert!(matches!(admission, Admission::Admitted { .. }), "{admission:?}");
        counts.submit_micros.fetch_add(began.elapsed().as_micros() as usize, Ordering::SeqCst);
    }
}

async fn work(store: Arc<PostgresStore>, name: String, counts: Arc<Counts>, jobs: usize) -> Result<(), StoreFailure> {
    while counts.done.load(Ordering::SeqCst) < jobs {
        let began = Instant::now();
        counts.looks.fetch_add(1, Ordering::SeqCst);
        let Some(claim) = store.claim(&name, u64::MAX).await? else {
            tokio::time::sleep(Duration::from_millis(10)).await;
            continue;
        };
        counts.claim_micros.fetch_add(began.elapsed().as_micros() as usize, Ordering::SeqCst);
        for stage in STAGES {
            store.advance(claim.lease, stage).await?;
        }
        store.extend(&[claim.lease]).await?;
        let number = counts.done.fetch_add(1, Ordering::SeqCst);
        let finish = store.finish(claim.lease, good(number)).await?;
        assert!(matches!(finish, Finish::Done { .. }), "{finish:?}");
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [url, workers, jobs, waiting, callers] = arguments.as_slice() else {
        return Err("URL WORKERS JOBS WAITING CALLERS".into());
    };
    let (workers, jobs): (usize, usize) = (workers.parse()?, jobs.parse()?);
    let (waiting, callers): (usize, usize) = (waiting.parse()?, callers.parse()?);
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    runtime.block_on(async {
        let counts = Arc::new(Counts::default());
        let mut stores = Vec::new();
        for _ in 0..workers.div_ceil(TOGETHER) + 1 {
            stores.push(Arc::new(PostgresStore::open(url, LEASE).await?));
        }
        let mut tasks = JoinSet::new();
        let door = stores.pop().ok_or("no store")?;
        for _ in 0..TOGETHER {
            tasks.spawn(submit(door.clone(), counts.clone(), (jobs, waiting, callers)));
        }
        while counts.submitted.load(Ordering::SeqCst) < waiting.min(jobs) {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        let began = Instant::now();
        for number in 0..workers {
            let store = stores[number / TOGETHER].clone();
            tasks.spawn(work(store, format!("stub {number}"), counts.clone(), jobs));
        }
        while let Some(ended) = tasks.join_next().await {
            ended??;
        }
        let seconds = began.elapsed().as_secs_f64();
        let count = |counter: &AtomicUsize| counter.load(Ordering::SeqCst) as f64;
        let done = count(&counts.done);
        let figures = serde_json::json!({
            "workers": workers, "jobs": done, "waiting": waiting, "callers": callers,
            "seconds": seconds, "jobs_per_second": done / seconds,
            "submit_ms": count(&counts.submit_micros) / 1000.0 / done,
            "claim_ms": count(&counts.claim_micros) / 1000.0 / done,
            "looks_per_job": count(&counts.looks) / done,
        });
        println!("{figures}");
        Ok(())
    })
}
