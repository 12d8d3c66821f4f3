//! A store of each engine with a clock of its own, and what the rules need to talk to it.

use rigsmith::jobs::clock::{Clock, ManualClock, Timestamp};
use rigsmith::jobs::store::postgres::PostgresStore;
use rigsmith::jobs::store::sqlite::SqliteStore;
use rigsmith::jobs::store::{
    Admission, Claim, EndedWithout, Ending, Finish, JobStore, LEASE, Memory, NewFiles, NewJob,
};
use rigsmith::jobs::{
    ArtifactInfo, Caller, ErrorCode, Job, JobError, JobId, JobResult, JobState, Labels, Priority, RigOptions, Stage,
};
use rigsmith::storage::NewBlob;
use sha2::{Digest, Sha256};
use sqlx::Connection;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tempfile::TempDir;

/// A store under test.
pub struct Bench {
    pub store: Arc<dyn JobStore>,
    /// Another process on the same jobs.
    pub second: Arc<dyn JobStore>,
    pub clock: Arc<ManualClock>,
    blobs: AtomicU64,
    _folder: Option<TempDir>,
}

/// 2026-11-24, half past six.
const NOW: Timestamp = Timestamp(1_795_545_000_000);

pub async fn sqlite() -> Bench {
    let folder = TempDir::new().expect("folder");
    let clock = Arc::new(ManualClock::at(NOW));
    let path = folder.path().join("jobs.db");
    let open = || SqliteStore::open(&path, clock.clone(), LEASE);
    let store = Arc::new(open().await.expect("opens"));
    let second = Arc::new(open().await.expect("opens twice"));
    Bench { store, second, clock, blobs: AtomicU64::new(0), _folder: Some(folder) }
}

/// A database of its own on the server that `tests/postgres.py` starts.
pub async fn postgres_url() -> String {
    let server = std::env::var("TEST_POSTGRES_URL").expect(
        "these tests need PostgreSQL: run them by `python3 tests/postgres.py -- cargo test --release`, as `make test` does",
    );
    let name = format!("test_{}", JobId::new());
    let mut connection = sqlx::PgConnection::connect(&server).await.expect("the server answers");
    sqlx::raw_sql(sqlx::AssertSqlSafe(format!("CREATE DATABASE {name}"))).execute(&mut connection).await.expect("made");
    let (server, _) = server.rsplit_once('/').expect("a URL with the name of a database");
    format!("{server}/{name}")
}

pub async fn postgres() -> Bench {
    let url = postgres_url().await;
    let clock = Arc::new(ManualClock::at(NOW));
    let open = || PostgresStore::open_with_clock(&url, clock.clone(), LEASE);
    let store = Arc::new(open().await.expect("opens"));
    let second = Arc::new(open().await.expect("opens twice"));
    Bench { store, second, clock, blobs: AtomicU64::new(0), _folder: None }
}

pub fn alice() -> Caller {
    Caller::named("alice")
}

pub fn bob() -> Caller {
    Caller::named("bob")
}

pub const DAY: Duration = Duration::from_secs(24 * 3600);
pub const FOR_EVER: Memory = Memory { records_time: Duration::from_secs(u32::MAX as u64), records_max: 1_000_000 };

impl Bench {
    pub fn advance(&self, time: Duration) {
        self.clock.advance(time);
    }

    pub fn now(&self) -> Timestamp {
        self.clock.now()
    }

    /// A file that was written just now; equal `content` has an equal digest and a place of its own.
    pub fn blob(&self, name: &str, content: &str) -> NewBlob {
        let number = self.blobs.fetch_add(1, Ordering::SeqCst);
        let sha256 = Sha256::digest(content).into();
        NewBlob { name: name.to_owned(), bytes: content.len() as u64, sha256, location: format!("blobs/{number}") }
    }

    /// A job of alice's to rig `content`.
    pub fn new_job(&self, content: &str) -> NewJob {
        NewJob {
            caller: alice(),
            files: NewFiles::Received { files: vec![self.blob("hero.obj", content)], memory_bytes: 100 },
            skeleton: None,
            options: RigOptions::default(),
            priority: Priority::Normal,
            labels: Labels::new(),
            timeout: Duration::from_secs(300),
            deadline: None,
            retention: DAY,
            client_id: None,
            idempotency_key: None,
            webhook: None,
            wish: [1; 32],
            recipe: [2; 32],
            use_cache: true,
            waiting_max: 1000,
            workers: 1,
            unfinished_max: None,
            asset_retention: DAY,
        }
    }

    pub async fn submit(&self, new: NewJob) -> Admission {
        self.store.submit(new).await.expect("answers")
    }

    /// Submits a job that is admitted.
    pub async fn add(&self, new: NewJob) -> JobId {
        match self.submit(new).await {
            Admission::Admitted { job, .. } => job.id,
            other => panic!("not admitted: {other:?}"),
        }
    }

    pub async fn claim(&self) -> Option<Claim> {
        self.store.claim("worker", u64::MAX).await.expect("answers")
    }

    /// Claims the job that must be next.
    pub async fn take(&self) -> Claim {
        self.claim().await.expect("a job waits")
    }

    pub async fn sweep(&self) -> rigsmith::jobs::store::Swept {
        self.store.sweep(FOR_EVER).await.expect("answers")
    }

    pub async fn job(&self, id: JobId) -> Job {
        self.store.job(&alice(), id).await.expect("answers").expect("is there")
    }

    pub async fn state(&self, id: JobId) -> JobState {
        self.job(id).await.state
    }

    /// A good end, with one artifact of `content`.
    pub fn good(&self, content: &str) -> Ending {
        let made = self.blob("rigged.glb", content);
        let artifact = ArtifactInfo {
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
            artifacts: vec![artifact],
        };
        Ending { outcome: Ok((result, vec![made])), stage: Some(Stage::Export), timings: Vec::new() }
    }

    pub fn failed(&self) -> Ending {
        let error = JobError::new(ErrorCode::NoJointsFound, "none");
        Ending { outcome: Err(EndedWithout::Failed(error)), stage: Some(Stage::Joints), timings: Vec::new() }
    }

    pub async fn finish(&self, claim: &Claim, ending: Ending) -> Finish {
        self.store.finish(claim.lease, ending).await.expect("answers")
    }

    /// Submits, claims and ends a job well.
    pub async fn done(&self, content: &str) -> JobId {
        let id = self.add(self.new_job(content)).await;
        let claim = self.take().await;
        assert_eq!(claim.lease.job, id);
        assert!(matches!(self.finish(&claim, self.good(&format!("rig of {content}"))).await, Finish::Done { .. }));
        id
    }

    /// Locations of blobs that nothing needs any more.
    pub async fn collect(&self) -> usize {
        self.store.collect().await.expect("answers").len()
    }

    pub async fn named(&self) -> usize {
        self.store.locations().await.expect("answers").len()
    }
}
