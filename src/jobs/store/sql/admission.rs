//! A job is written down, or found; uploads become assets.

use super::rows::{self, JOB};
use super::{Columns, Connection, Lock, append, int, millis, reading, sql};
use crate::jobs::asset::Asset;
use crate::jobs::clock::Timestamp;
use crate::jobs::event::EventKind;
use crate::jobs::ids::{AssetId, JobId};
use crate::jobs::job::{FileInfo, Job, JobState};
use crate::jobs::store::{Admission, IDEMPOTENCY_TIME, NewFiles, NewJob, StoreFailure, codec};
use crate::jobs::submission::{Caller, Missing};
use crate::jobs::upload::{asset_sha256, identity};
use crate::storage::{NewBlob, hex};
use sha2::{Digest, Sha256};
use sqlx::AssertSqlSafe;
use std::time::SystemTime;

/// The files of a new job, as far as they are kept already.
struct Files {
    infos: Vec<FileInfo>,
    asset: Option<AssetId>,
    memory_bytes: u64,
}

pub async fn submit(connection: &mut impl Connection, new: &NewJob, now: Timestamp) -> Result<Admission, StoreFailure> {
    reserve(connection, new).await?;
    let known = match &new.files {
        NewFiles::Received { .. } => None,
        NewFiles::Asset(id) => match asset(connection, &new.caller, *id).await? {
            Some((asset, memory_bytes)) => Some(Files { infos: asset.files, asset: Some(*id), memory_bytes }),
            None => return Ok(Admission::Missing(Missing::Asset)),
        },
        NewFiles::Job(id) => match files_of_job(connection, &new.caller, *id).await? {
            Some(files) => Some(files),
            None => return Ok(Admission::Missing(Missing::Job)),
        },
    };
    let digest = files_digest(new, known.as_ref());
    let (fingerprint, cache_key) = (joined(&new.wish, &digest), joined(&new.recipe, &digest));
    if let Some(found) = repetition(connection, new, &fingerprint, now).await? {
        return Ok(found);
    }
    let earlier = if new.use_cache { earlier_result(connection, &cache_key, now).await? } else { None };
    if earlier.is_none()
        && let Some(refused) = no_room(connection, new).await?
    {
        return Ok(refused);
    }
    let (files, mut kept) = match (known, &new.files) {
        (None, NewFiles::Received { files, memory_bytes }) => {
            let upload = UploadToKeep { files, memory_bytes: *memory_bytes, explicit: false };
            let put = keep_files(connection, &new.caller, upload, now, now.after(new.asset_retention)).await?;
            (Files { infos: put.asset.files, asset: Some(put.asset.id), memory_bytes: *memory_bytes }, put.kept)
        }
        (Some(files), _) => {
            touch(connection, files.asset, now, now.after(new.asset_retention)).await?;
            (files, Vec::new())
        }
        (None, _) => return Ok(Admission::Missing(Missing::Asset)),
    };
    if let Some(skeleton) = &new.skeleton {
        kept.extend(rows::name_blobs(connection, std::slice::from_ref(skeleton), now).await?);
    }
    let id = JobId::new();
    insert(connection, id, new, &files, (&fingerprint, &cache_key), now).await?;
    let skeleton = new.skeleton.iter().map(|skeleton| skeleton.sha256);
    rows::hold_blobs(connection, id, files.infos.iter().map(|file| file.sha256).chain(skeleton)).await?;
    append(connection, id, now, &[EventKind::State { state: JobState::Queued, attempt: 0 }]).await?;
    if let Some(earlier) = earlier {
        succeed_at_once(connection, id, &earlier, now, now.after(new.retention)).await?;
    }
    if let Some(key) = &new.idempotency_key {
        note_key(connection, &new.caller, key, &fingerprint, id, now).await?;
    }
    let job = reading::snapshot(connection, id).await?;
    let job = job.ok_or_else(|| StoreFailure::new(&"a new job is not there"))?;
    Ok(Admission::Admitted { job: Box::new(job), kept })
}

/// Keeps others from the same key, id and quota until this request is decided, and from the blobs that it names.
async fn reserve(connection: &mut impl Connection, new: &NewJob) -> Result<(), StoreFailure> {
    let caller = new.caller.name();
    let name = |kind, name| Lock::Name { kind, caller, name };
    if new.unfinished_max.is_some() {
        connection.lock(name("quota", "")).await?;
    }
    if let Some(key) = &new.idempotency_key {
        connection.lock(name("key", key)).await?;
    }
    if let Some(client_id) = &new.client_id {
        connection.lock(name("id", client_id)).await?;
    }
    connection.lock(Lock::Naming).await?;
    Ok(())
}

fn joined(first: &[u8; 32], second: &[u8; 32]) -> [u8; 32] {
    Sha256::new().chain_update(first).chain_update(second).finalize().into()
}

/// Digest of the files and the skeleton of a new job.
fn files_digest(new: &NewJob, known: Option<&Files>) -> [u8; 32] {
    let files = match (&new.files, known) {
        (NewFiles::Received { files, .. }, _) => identity(files.iter().map(|file| (file.name.as_str(), &file.sha256))),
        (_, Some(known)) => identity(known.infos.iter().map(|file| (file.name.as_str(), &file.sha256))),
        (_, None) => [0; 32],
    };
    new.skeleton.as_ref().map_or(files, |skeleton| joined(&files, &skeleton.sha256))
}

/// The job that the same request made before, by its idempotency key or by the caller's id.
async fn repetition(
    connection: &mut impl Connection,
    new: &NewJob,
    fingerprint: &[u8; 32],
    now: Timestamp,
) -> Result<Option<Admission>, StoreFailure> {
    if let Some(key) = &new.idempotency_key {
        let row = sql("SELECT fingerprint, job FROM idempotency WHERE caller = $1 AND key = $2 AND expires_at > $3")
            .bind(new.caller.name())
            .bind(key.as_str())
            .bind(now.0)
            .optional(connection)
            .await?;
        if let Some(row) = row {
            let job = row.get::<Option<&[u8]>>("job")?.map(rows::bytes).transpose()?.map(JobId::from_bytes);
            return match job {
                Some(id) if row.get::<&[u8]>("fingerprint")? == fingerprint => {
                    let job = reading::snapshot(connection, id).await?;
                    Ok(job.map(|job| Admission::Replayed(Box::new(job))))
                }
                _ => Ok(Some(Admission::IdempotencyMismatch)),
            };
        }
    }
    if let Some(client_id) = &new.client_id {
        let row = sql("SELECT id, fingerprint FROM jobs WHERE caller = $1 AND client_id = $2")
            .bind(new.caller.name())
            .bind(client_id.as_str())
            .optional(connection)
            .await?;
        if let Some(row) = row {
            if row.get::<Option<&[u8]>>("fingerprint")? != Some(fingerprint) {
                return Ok(Some(Admission::ClientIdTaken));
            }
            let job = reading::snapshot(connection, rows::job_id(&row)?).await?;
            return Ok(job.map(|job| Admission::Replayed(Box::new(job))));
        }
    }
    Ok(None)
}

async fn no_room(connection: &mut impl Connection, new: &NewJob) -> Result<Option<Admission>, StoreFailure> {
    let counts = reading::counts(connection).await?;
    if counts.queued >= new.waiting_max.saturating_add(new.workers.saturating_sub(counts.running)) {
        return Ok(Some(Admission::QueueFull { waiting: counts.queued }));
    }
    let Some(unfinished_max) = new.unfinished_max else { return Ok(None) };
    let unfinished =
        sql("SELECT count(*) AS unfinished FROM jobs WHERE caller = $1 AND state IN ('queued', 'running')")
            .bind(new.caller.name())
            .one(connection)
            .await?;
    let unfinished = usize::try_from(unfinished.get::<i64>("unfinished")?).unwrap_or(0);
    Ok((unfinished >= unfinished_max).then_some(Admission::QuotaExceeded { unfinished }))
}

async fn insert(
    connection: &mut impl Connection,
    id: JobId,
    new: &NewJob,
    files: &Files,
    (fingerprint, cache_key): (&[u8; 32], &[u8; 32]),
    now: Timestamp,
) -> Result<(), StoreFailure> {
    sql("INSERT INTO jobs (id, caller, client_id, options, labels, files, skeleton, asset, priority, timeout_ms, \
         retention_ms, deadline_at, memory_bytes, state, created_at, queued_at, fingerprint, cache_key, webhook) \
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, 'queued', $14, $15, $16, $17, $18)")
    .bind(id.to_bytes())
    .bind(new.caller.name())
    .bind(new.client_id.as_deref())
    .bind(new.options.to_json().to_string())
    .bind(codec::labels(&new.labels).to_string())
    .bind(codec::files(&files.infos).to_string())
    .bind(new.skeleton.as_ref().map(|skeleton| skeleton.sha256))
    .bind(files.asset.map(|asset| asset.to_bytes()))
    .bind(rows::priority(new.priority))
    .bind(millis(new.timeout))
    .bind(millis(new.retention))
    .bind(new.deadline.map(|deadline| deadline.0))
    .bind(int(files.memory_bytes))
    .bind(now.0)
    .bind(now.0)
    .bind(*fingerprint)
    .bind(*cache_key)
    .bind(new.webhook.as_ref().map(|webhook| codec::webhook(webhook).to_string()))
    .execute(connection)
    .await?;
    for (name, value) in &new.labels {
        sql("INSERT INTO job_labels (job, name, value) VALUES ($1, $2, $3)")
            .bind(id.to_bytes())
            .bind(name.as_str())
            .bind(value.as_str())
            .execute(connection)
            .await?;
    }
    Ok(())
}

/// A kept result of an equal job.
async fn earlier_result(
    connection: &mut impl Connection,
    cache_key: &[u8; 32],
    now: Timestamp,
) -> Result<Option<Job>, StoreFailure> {
    let query = format!(
        "{JOB} WHERE cache_key = $1 AND state = 'succeeded' AND expires_at > $2 ORDER BY finished_at DESC LIMIT 1"
    );
    let row = sql(AssertSqlSafe(query)).bind(*cache_key).bind(now.0).optional(connection).await?;
    row.map(|row| rows::job(&row)).transpose()
}

/// Ends a job that was just written down with the result of an earlier one.
async fn succeed_at_once(
    connection: &mut impl Connection,
    id: JobId,
    earlier: &Job,
    now: Timestamp,
    expires_at: Timestamp,
) -> Result<(), StoreFailure> {
    let Some(result) = &earlier.result else { return Ok(()) };
    sql("UPDATE jobs SET state = 'succeeded', stage = $1, progress = 100, started_at = $2, finished_at = $3, \
         expires_at = $4, queue_ms = 0, result = $5, cached = 1 WHERE id = $6")
    .bind(earlier.stage.map(|stage| stage.name()))
    .bind(now.0)
    .bind(now.0)
    .bind(expires_at.0)
    .bind(codec::result(result).to_string())
    .bind(id.to_bytes())
    .execute(connection)
    .await?;
    rows::hold_blobs(connection, id, result.artifacts.iter().map(|artifact| artifact.sha256)).await?;
    append(connection, id, now, &super::ending::success(result)).await
}

async fn note_key(
    connection: &mut impl Connection,
    caller: &Caller,
    key: &str,
    fingerprint: &[u8; 32],
    id: JobId,
    now: Timestamp,
) -> Result<(), StoreFailure> {
    sql("INSERT INTO idempotency (caller, key, fingerprint, job, expires_at) VALUES ($1, $2, $3, $4, $5) \
         ON CONFLICT (caller, key) DO UPDATE SET fingerprint = excluded.fingerprint, job = excluded.job, \
         answer = NULL, expires_at = excluded.expires_at")
    .bind(caller.name())
    .bind(key)
    .bind(*fingerprint)
    .bind(id.to_bytes())
    .bind(now.after(IDEMPOTENCY_TIME).0)
    .execute(connection)
    .await?;
    Ok(())
}

/// Files that are an asset now.
pub struct Put {
    pub asset: Asset,
    pub created: bool,
    /// Locations of the blobs that were not there before.
    pub kept: Vec<String>,
}

/// Files to keep as an asset.
#[derive(Clone, Copy)]
pub struct UploadToKeep<'a> {
    /// The main one first.
    pub files: &'a [NewBlob],
    pub memory_bytes: u64,
    /// Sent as an asset, rather than with a job.
    pub explicit: bool,
}

/// Keeps files as an asset of `caller`, or finds them.
pub async fn keep_files(
    connection: &mut impl Connection,
    caller: &Caller,
    upload: UploadToKeep<'_>,
    now: Timestamp,
    expires_at: Timestamp,
) -> Result<Put, StoreFailure> {
    let UploadToKeep { files, memory_bytes, explicit } = upload;
    let identity = identity(files.iter().map(|file| (file.name.as_str(), &file.sha256)));
    connection.lock(Lock::Name { kind: "asset", caller: caller.name(), name: &hex(&identity) }).await?;
    let known = sql("SELECT id FROM assets WHERE caller = $1 AND identity = $2")
        .bind(caller.name())
        .bind(identity)
        .optional(connection)
        .await?;
    if let Some(row) = known {
        let id = AssetId::from_bytes(rows::bytes(row.get("id")?)?);
        touch(connection, Some(id), now, expires_at).await?;
        sql("UPDATE assets SET explicit = explicit | $1 WHERE id = $2")
            .bind(i64::from(explicit))
            .bind(id.to_bytes())
            .execute(connection)
            .await?;
        let found = asset(connection, caller, id).await?;
        let (asset, _) = found.ok_or_else(|| StoreFailure::new(&"an asset is not there"))?;
        return Ok(Put { asset, created: false, kept: Vec::new() });
    }
    let id = AssetId::new();
    let kept = rows::name_blobs(connection, files, now).await?;
    let info = |file: &NewBlob| FileInfo { name: file.name.clone(), bytes: file.bytes, sha256: file.sha256 };
    let infos: Vec<FileInfo> = files.iter().map(info).collect();
    sql("INSERT INTO assets (id, caller, identity, files, memory_bytes, explicit, created_at, used_at, expires_at) \
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)")
    .bind(id.to_bytes())
    .bind(caller.name())
    .bind(identity)
    .bind(codec::files(&infos).to_string())
    .bind(int(memory_bytes))
    .bind(i64::from(explicit))
    .bind(now.0)
    .bind(now.0)
    .bind(expires_at.0)
    .execute(connection)
    .await?;
    for file in files {
        sql("INSERT INTO asset_blobs (asset, sha256) VALUES ($1, $2) ON CONFLICT DO NOTHING")
            .bind(id.to_bytes())
            .bind(file.sha256)
            .execute(connection)
            .await?;
    }
    let asset = Asset {
        id,
        sha256: asset_sha256(&infos),
        files: infos,
        created_at: SystemTime::from(now),
        expires_at: SystemTime::from(expires_at),
    };
    Ok(Put { asset, created: true, kept })
}

/// An asset that is used lives on.
async fn touch(
    connection: &mut impl Connection,
    id: Option<AssetId>,
    now: Timestamp,
    expires_at: Timestamp,
) -> Result<(), StoreFailure> {
    let Some(id) = id else { return Ok(()) };
    sql("UPDATE assets SET used_at = CASE WHEN used_at < $1 THEN $1 ELSE used_at END, \
         expires_at = CASE WHEN expires_at < $2 THEN $2 ELSE expires_at END WHERE id = $3")
    .bind(now.0)
    .bind(expires_at.0)
    .bind(id.to_bytes())
    .execute(connection)
    .await?;
    Ok(())
}

/// An asset and the memory that rigging it is expected to need.
pub async fn asset(
    connection: &mut impl Connection,
    caller: &Caller,
    id: AssetId,
) -> Result<Option<(Asset, u64)>, StoreFailure> {
    let row = sql("SELECT files, memory_bytes, created_at, expires_at FROM assets WHERE id = $1 AND caller = $2")
        .bind(id.to_bytes())
        .bind(caller.name())
        .optional(connection)
        .await?;
    let Some(row) = row else { return Ok(None) };
    let files = codec::files_from(&codec::parse(row.get("files")?, "files")?)?;
    let time = |column| Ok::<_, StoreFailure>(SystemTime::from(Timestamp(row.get(column)?)));
    let (created_at, expires_at) = (time("created_at")?, time("expires_at")?);
    let memory_bytes = u64::try_from(row.get::<i64>("memory_bytes")?).unwrap_or(0);
    Ok(Some((Asset { id, sha256: asset_sha256(&files), files, created_at, expires_at }, memory_bytes)))
}

/// The files of an earlier job, while all of them are kept.
async fn files_of_job(
    connection: &mut impl Connection,
    caller: &Caller,
    id: JobId,
) -> Result<Option<Files>, StoreFailure> {
    let row = sql("SELECT files, asset, memory_bytes FROM jobs WHERE id = $1 AND caller = $2")
        .bind(id.to_bytes())
        .bind(caller.name())
        .optional(connection)
        .await?;
    let Some(row) = row else { return Ok(None) };
    let infos = codec::files_from(&codec::parse(row.get("files")?, "files")?)?;
    for file in &infos {
        if rows::blob(connection, &file.sha256).await?.is_none() {
            return Ok(None);
        }
    }
    let asset = row.get::<Option<&[u8]>>("asset")?.map(rows::bytes).transpose()?.map(AssetId::from_bytes);
    let memory_bytes = u64::try_from(row.get::<i64>("memory_bytes")?).unwrap_or(0);
    Ok(Some(Files { infos, asset, memory_bytes }))
}
