//! What is particular to jobs in a file: schemas of earlier and later versions, and files that cannot be written.

use rigsmith::jobs::clock::SteadyClock;
use rigsmith::jobs::store::sqlite::{MIGRATOR, SqliteStore};
use rigsmith::jobs::store::{JobFilter, JobStore, LEASE, StoreFailure};
use rigsmith::jobs::{Caller, ErrorCode, JobState};
use sqlx::sqlite::{SqliteConnectOptions, SqlitePool};
use std::path::Path;
use std::sync::Arc;

async fn open(path: &Path) -> Result<SqliteStore, StoreFailure> {
    SqliteStore::open(path, Arc::new(SteadyClock::default()), LEASE).await
}

async fn file(path: &Path) -> SqlitePool {
    let options = SqliteConnectOptions::new().filename(path).create_if_missing(true);
    SqlitePool::connect_with(options).await.expect("opens")
}

/// Jobs as version 1 wrote them: one that waits, one that ran when its process ended, one that succeeded, one that
/// failed.
const JOBS_OF_VERSION_1: &str = r#"
    INSERT INTO blobs VALUES (x'11', 4, 'blobs/upload', 0);
    INSERT INTO blobs VALUES (zeroblob(32), 4, 'blobs/zero', 0);
    INSERT INTO jobs (id, caller, options, labels, files, priority, timeout_ms, retention_ms, memory_bytes, state,
        attempt, losses, worker, lease_until, created_at, queued_at, started_at, finished_at, expires_at, result, error)
    VALUES
    (x'01900000000070008000000000000001', '', '{"method":null,"detail":0.5}', '{"project":"x"}',
     '[{"name":"a.obj","bytes":4,"sha256":"0000000000000000000000000000000000000000000000000000000000000000"}]',
     0, 300000, 86400000, 1000, 'queued', 0, 0, NULL, NULL, 1, 1, NULL, NULL, NULL, NULL, NULL),
    (x'01900000000070008000000000000002', '', '{"seed":7}', '{}', '[]',
     0, 300000, 86400000, 1000, 'running', 1, 0, 'w', 2, 1, 1, 2, NULL, NULL, NULL, NULL),
    (x'01900000000070008000000000000003', '', '{}', '{}', '[]',
     0, 300000, 86400000, 1000, 'succeeded', 1, 0, NULL, NULL, 1, 1, 2, 3, 4102444800000,
     '{"method_used":"rignet","models":[],"report":{"skeleton":{"joints":24}},"findings":[],"artifacts":[]}', NULL),
    (x'01900000000070008000000000000004', '', '{"an_option_of_the_past":1}', '{}', '[]',
     0, 300000, 86400000, 1000, 'failed', 1, 0, NULL, NULL, 1, 1, 2, 3, NULL, NULL,
     '{"code":"no_joints_found","stage":"joints","message":"none","hint":"","limit":null}');
    INSERT INTO job_labels SELECT id, 'project', 'x' FROM jobs WHERE state = 'queued';
"#;

#[tokio::test]
async fn jobs_of_version_1_go_on() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("jobs.db");
    let old = file(&path).await;
    MIGRATOR.run_to(1, &old).await.expect("version 1");
    sqlx::raw_sql(JOBS_OF_VERSION_1).execute(&old).await.expect("old jobs");
    old.close().await;

    let store = open(&path).await.expect("migrates");
    store.lose_all().await.expect("answers");
    let jobs = store.list(&Caller::anonymous(), &JobFilter::default(), None, 100).await.expect("answers");
    let states: Vec<JobState> = jobs.iter().map(|job| job.state).collect();
    assert_eq!(states, [JobState::Failed, JobState::Succeeded, JobState::Queued, JobState::Queued]);
    assert_eq!(jobs[0].error.as_ref().map(|error| error.code), Some(ErrorCode::NoJointsFound));
    assert_eq!(jobs[1].result.as_ref().map(|result| result.report["skeleton"]["joints"].as_u64()), Some(Some(24)));
    assert_eq!((jobs[2].request.options.seed, jobs[2].cached), (7, false));
    let claim = store.claim("worker", u64::MAX).await.expect("answers").expect("the oldest waits");
    assert_eq!((claim.lease.job, claim.files[0].1.location.as_str()), (jobs[3].id, "blobs/zero"));
    assert_eq!(claim.job.request.labels["project"], "x");
    let retried = store.claim("worker", u64::MAX).await.expect("answers").expect("the lost one waits again");
    assert_eq!((retried.lease.job, retried.lease.attempt), (jobs[2].id, 2));
}

/// What no version can work on: an option of the past, and a file that is not there.
const JOBS_OF_NOBODY: &str = r#"
    INSERT INTO jobs (id, caller, options, labels, files, priority, timeout_ms, retention_ms, memory_bytes, state,
        created_at, queued_at)
    VALUES
    (x'01900000000070008000000000000001', '', '{"an_option_of_the_past":1}', '{}', '[]',
     0, 300000, 86400000, 1000, 'queued', 1, 1),
    (x'01900000000070008000000000000002', '', '{}', '{}',
     '[{"name":"a.obj","bytes":4,"sha256":"0000000000000000000000000000000000000000000000000000000000000000"}]',
     0, 300000, 86400000, 1000, 'queued', 1, 1);
"#;

#[tokio::test]
async fn jobs_that_cannot_be_worked_on_end_instead_of_blocking_the_queue() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("jobs.db");
    let store = open(&path).await.expect("opens");
    sqlx::raw_sql(JOBS_OF_NOBODY).execute(&file(&path).await).await.expect("jobs");
    for _ in 0..2 {
        assert!(store.claim("worker", u64::MAX).await.expect("answers").is_none());
    }
    let jobs = store.list(&Caller::anonymous(), &JobFilter::default(), None, 100).await.expect("answers");
    assert_eq!(jobs.len(), 2);
    for job in jobs {
        assert_eq!((job.state, job.error.map(|error| error.code)), (JobState::Failed, Some(ErrorCode::Internal)));
    }
}

#[tokio::test]
async fn every_version_leads_to_the_same_schema() {
    let mut schemas = Vec::new();
    for version in MIGRATOR.iter().map(|migration| migration.version) {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("jobs.db");
        let old = file(&path).await;
        MIGRATOR.run_to(version, &old).await.expect("an earlier version");
        old.close().await;
        open(&path).await.expect("migrates").close().await;
        let schema: Vec<String> =
            sqlx::query_scalar("SELECT sql FROM sqlite_schema WHERE sql IS NOT NULL ORDER BY name")
                .fetch_all(&file(&path).await)
                .await
                .expect("a schema");
        schemas.push(schema);
    }
    assert!(schemas.len() >= 2 && schemas.windows(2).all(|pair| pair[0] == pair[1]));
}

#[tokio::test]
async fn a_file_of_a_later_version_is_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("jobs.db");
    open(&path).await.expect("opens").close().await;
    let newer = file(&path).await;
    sqlx::query(
        "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) \
         VALUES (9999, 'from the future', 1, x'00', 0)",
    )
    .execute(&newer)
    .await
    .expect("writes");
    newer.close().await;
    let refused = open(&path).await.err().expect("refused");
    assert!(refused.to_string().contains("9999"), "{refused}");
}

#[tokio::test]
async fn a_file_that_is_no_database_is_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("jobs.db");
    std::fs::write(&path, "not a database, and longer than a header of one hundred bytes ".repeat(4)).expect("writes");
    let refused = open(&path).await.err().expect("refused");
    assert!(refused.to_string().contains("not a database"), "{refused}");
}
