//! Uploads in parts.

use super::admission::{UploadToKeep, keep_files};
use super::{Columns, Connection, Engine, Lock, SqlStore, int, rows, sql};
use crate::jobs::clock::Timestamp;
use crate::jobs::ids::{AssetId, UploadId};
use crate::jobs::resumable::{NewResumable, NotAdded, Resumable, ResumableState};
use crate::jobs::store::resumable::ResumableStore;
use crate::jobs::store::{BlobPlace, StoreFailure};
use crate::jobs::submission::Caller;
use crate::storage::NewBlob;
use async_trait::async_trait;
use sqlx::AssertSqlSafe;
use std::time::{Duration, SystemTime};

#[async_trait]
impl<E: Engine> ResumableStore for SqlStore<E> {
    async fn begin_resumable(&self, new: &NewResumable, keep: Duration) -> Result<Option<Resumable>, StoreFailure> {
        let mut writing = self.0.write().await?;
        let now = self.0.now();
        let begun = begin(&mut *writing, new, now, now.after(keep)).await?;
        self.0.commit(writing).await?;
        Ok(begun)
    }

    async fn resumable(&self, caller: &Caller, id: UploadId) -> Result<Option<Resumable>, StoreFailure> {
        find(&mut *self.0.read().await?, caller, id, self.0.now()).await
    }

    async fn add_parts(
        &self,
        caller: &Caller,
        id: UploadId,
        offset: u64,
        parts: &[NewBlob],
        keep: Duration,
    ) -> Result<Result<Vec<String>, NotAdded>, StoreFailure> {
        let mut writing = self.0.write().await?;
        writing.lock(Lock::Naming).await?;
        let now = self.0.now();
        if let Err(not_added) = take(&mut *writing, caller, id, offset, now).await? {
            return Ok(Err(not_added));
        }
        let kept = add(&mut *writing, id, offset, parts, now, now.after(keep)).await?;
        self.0.commit(writing).await?;
        Ok(Ok(kept))
    }

    async fn resumable_parts(&self, id: UploadId, offset: u64) -> Result<Vec<BlobPlace>, StoreFailure> {
        let rows = sql("SELECT b.location AS location, b.bytes AS bytes FROM upload_parts p \
             JOIN blobs b ON b.sha256 = p.sha256 WHERE p.upload = $1 AND p.position < $2 ORDER BY p.position")
        .bind(id.to_bytes())
        .bind(int(offset))
        .all(&mut *self.0.read().await?)
        .await?;
        rows.iter().map(rows::place).collect()
    }

    async fn complete_resumable(
        &self,
        caller: &Caller,
        id: UploadId,
        offset: u64,
        files: &[NewBlob],
        memory_bytes: u64,
        retention: Duration,
    ) -> Result<Result<Vec<String>, NotAdded>, StoreFailure> {
        let mut writing = self.0.write().await?;
        writing.lock(Lock::Naming).await?;
        let now = self.0.now();
        if let Err(not_added) = take(&mut *writing, caller, id, offset, now).await? {
            return Ok(Err(not_added));
        }
        let until = now.after(retention);
        let whole = UploadToKeep { files, memory_bytes, explicit: true };
        let put = keep_files(&mut *writing, caller, whole, now, until).await?;
        close(&mut *writing, id, put.asset.id, until).await?;
        self.0.commit(writing).await?;
        Ok(Ok(put.kept))
    }

    async fn delete_resumable(&self, caller: &Caller, id: UploadId) -> Result<bool, StoreFailure> {
        let mut writing = self.0.write().await?;
        let deleted = sql("DELETE FROM uploads WHERE id = $1 AND caller = $2")
            .bind(id.to_bytes())
            .bind(caller.name())
            .execute(&mut *writing)
            .await?;
        self.0.commit(writing).await?;
        Ok(deleted > 0)
    }
}

const UPLOAD: &str = "SELECT id, file_name, metadata, length, received, is_open, asset, created_at, expires_at \
     FROM uploads WHERE id = $1 AND caller = $2";

async fn begin(
    connection: &mut impl Connection,
    new: &NewResumable,
    now: Timestamp,
    expires_at: Timestamp,
) -> Result<Option<Resumable>, StoreFailure> {
    connection.lock(Lock::Name { kind: "uploads", caller: new.caller.name(), name: "" }).await?;
    let open: i64 = sql("SELECT count(*) AS open FROM uploads WHERE caller = $1 AND is_open = 1 AND expires_at > $2")
        .bind(new.caller.name())
        .bind(now.0)
        .one(connection)
        .await?
        .get("open")?;
    if open >= int(new.open_max as u64) {
        return Ok(None);
    }
    let id = UploadId::new();
    sql("INSERT INTO uploads (id, caller, file_name, metadata, length, received, is_open, created_at, expires_at) \
         VALUES ($1, $2, $3, $4, $5, 0, 1, $6, $7)")
    .bind(id.to_bytes())
    .bind(new.caller.name())
    .bind(new.file_name.as_str())
    .bind(new.metadata.as_deref())
    .bind(int(new.length))
    .bind(now.0)
    .bind(expires_at.0)
    .execute(connection)
    .await?;
    find(connection, &new.caller, id, now).await
}

async fn find(
    connection: &mut impl Connection,
    caller: &Caller,
    id: UploadId,
    now: Timestamp,
) -> Result<Option<Resumable>, StoreFailure> {
    let row = sql(UPLOAD).bind(id.to_bytes()).bind(caller.name()).optional(connection).await?;
    row.map(|row| read(&row, now)).transpose()
}

fn read(row: &impl Columns, now: Timestamp) -> Result<Resumable, StoreFailure> {
    let number = |column| Ok::<_, StoreFailure>(u64::try_from(row.get::<i64>(column)?).unwrap_or(0));
    let expires_at = Timestamp(row.get("expires_at")?);
    let asset = row.get::<Option<&[u8]>>("asset")?.map(rows::bytes).transpose()?.map(AssetId::from_bytes);
    let is_open = row.get::<i64>("is_open")? != 0 && expires_at > now;
    let state = match asset {
        Some(asset) => ResumableState::Complete(asset),
        None if is_open => ResumableState::Open,
        None => ResumableState::Expired,
    };
    Ok(Resumable {
        id: UploadId::from_bytes(rows::bytes(row.get("id")?)?),
        file_name: row.get("file_name")?,
        metadata: row.get("metadata")?,
        length: number("length")?,
        received: number("received")?,
        state,
        created_at: SystemTime::from(Timestamp(row.get("created_at")?)),
        expires_at: SystemTime::from(expires_at),
    })
}

/// Takes an open upload whose end is `offset`, until the transaction ends.
async fn take<C: Connection>(
    connection: &mut C,
    caller: &Caller,
    id: UploadId,
    offset: u64,
    now: Timestamp,
) -> Result<Result<(), NotAdded>, StoreFailure> {
    let query = format!("{UPLOAD}{}", C::FOR_UPDATE);
    let row = sql(AssertSqlSafe(query)).bind(id.to_bytes()).bind(caller.name()).optional(connection).await?;
    Ok(match row.map(|row| read(&row, now)).transpose()? {
        None | Some(Resumable { state: ResumableState::Expired, .. }) => Err(NotAdded::Gone),
        Some(upload) if upload.state == ResumableState::Open && upload.received == offset => Ok(()),
        Some(_) => Err(NotAdded::Elsewhere),
    })
}

async fn add(
    connection: &mut impl Connection,
    id: UploadId,
    offset: u64,
    parts: &[NewBlob],
    now: Timestamp,
    expires_at: Timestamp,
) -> Result<Vec<String>, StoreFailure> {
    let kept = rows::name_blobs(connection, parts, now).await?;
    let mut position = offset;
    for part in parts {
        sql("INSERT INTO upload_parts (upload, position, sha256) VALUES ($1, $2, $3)")
            .bind(id.to_bytes())
            .bind(int(position))
            .bind(part.sha256)
            .execute(connection)
            .await?;
        position += part.bytes;
    }
    sql("UPDATE uploads SET received = $1, expires_at = $2 WHERE id = $3")
        .bind(int(position))
        .bind(expires_at.0)
        .bind(id.to_bytes())
        .execute(connection)
        .await?;
    Ok(kept)
}

/// All of it is here, as an asset.
async fn close(
    connection: &mut impl Connection,
    id: UploadId,
    asset: AssetId,
    expires_at: Timestamp,
) -> Result<(), StoreFailure> {
    sql("UPDATE uploads SET received = length, is_open = 0, asset = $1, expires_at = $2 WHERE id = $3")
        .bind(asset.to_bytes())
        .bind(expires_at.0)
        .bind(id.to_bytes())
        .execute(connection)
        .await?;
    sql("DELETE FROM upload_parts WHERE upload = $1").bind(id.to_bytes()).execute(connection).await?;
    Ok(())
}

/// Uploads that nobody went on with lose their parts. Gives their number.
pub async fn expire(connection: &mut impl Connection, now: Timestamp) -> Result<u64, StoreFailure> {
    let expired = sql("UPDATE uploads SET is_open = 0 WHERE is_open = 1 AND expires_at <= $1")
        .bind(now.0)
        .execute(connection)
        .await?;
    if expired > 0 {
        sql("DELETE FROM upload_parts WHERE EXISTS (SELECT 1 FROM uploads u \
             WHERE u.id = upload_parts.upload AND u.is_open = 0)")
        .execute(connection)
        .await?;
    }
    Ok(expired)
}
