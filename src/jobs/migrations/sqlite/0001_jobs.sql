-- Jobs, the files that they read and write, and who may have them. Times are milliseconds since 1970; ids are the 16
-- bytes of a UUIDv7; digests are the 32 bytes of a SHA-256.

-- Files that are in use, and where each is.
CREATE TABLE blobs (
    sha256     BLOB    NOT NULL PRIMARY KEY,
    bytes      INTEGER NOT NULL,
    location   TEXT    NOT NULL UNIQUE,
    created_at INTEGER NOT NULL
) STRICT;

-- Uploads that outlive one request. An upload that came with its job lives as long as a job needs it; one that was sent
-- as an asset (`explicit`) lives until it expires. `identity` is the digest of the files and of what their names decide.
CREATE TABLE assets (
    id           BLOB    NOT NULL PRIMARY KEY,
    caller       TEXT    NOT NULL,
    identity     BLOB    NOT NULL,
    files        TEXT    NOT NULL, -- JSON: name, bytes and sha256 of each, the main file first
    memory_bytes INTEGER NOT NULL, -- what rigging it is expected to need
    explicit     INTEGER NOT NULL,
    created_at   INTEGER NOT NULL,
    used_at      INTEGER NOT NULL,
    expires_at   INTEGER NOT NULL,
    UNIQUE (caller, identity)
) STRICT;
CREATE INDEX assets_expiring ON assets (expires_at);
CREATE INDEX assets_by_use ON assets (used_at);

CREATE TABLE asset_blobs (
    asset  BLOB NOT NULL REFERENCES assets (id) ON DELETE CASCADE,
    sha256 BLOB NOT NULL REFERENCES blobs (sha256),
    PRIMARY KEY (asset, sha256)
) STRICT, WITHOUT ROWID;
CREATE INDEX asset_blobs_by_blob ON asset_blobs (sha256);

CREATE TABLE jobs (
    id               BLOB    NOT NULL PRIMARY KEY,
    caller           TEXT    NOT NULL,
    client_id        TEXT,
    -- what was asked
    options          TEXT    NOT NULL, -- JSON
    labels           TEXT    NOT NULL, -- JSON
    files            TEXT    NOT NULL, -- JSON, as in assets
    skeleton         BLOB,             -- digest of the skeleton that came along
    asset            BLOB,
    priority         INTEGER NOT NULL,
    timeout_ms       INTEGER NOT NULL,
    retention_ms     INTEGER NOT NULL,
    deadline_at      INTEGER,
    memory_bytes     INTEGER NOT NULL,
    -- where it stands
    state            TEXT    NOT NULL,
    stage            TEXT,
    progress         INTEGER NOT NULL DEFAULT 0,
    cancel_requested INTEGER NOT NULL DEFAULT 0,
    sequence         INTEGER NOT NULL DEFAULT 0, -- number of the last event
    -- who works on it
    attempt          INTEGER NOT NULL DEFAULT 0, -- the fencing token
    losses           INTEGER NOT NULL DEFAULT 0, -- workers lost over it
    worker           TEXT,
    lease_until      INTEGER,
    -- when
    created_at       INTEGER NOT NULL,
    queued_at        INTEGER NOT NULL,
    started_at       INTEGER,
    finished_at      INTEGER,
    expires_at       INTEGER,
    queue_ms         INTEGER,
    -- how it ended
    timings          TEXT, -- JSON: microseconds per stage
    result           TEXT, -- JSON
    error            TEXT  -- JSON
) STRICT;
CREATE UNIQUE INDEX jobs_by_client_id ON jobs (caller, client_id) WHERE client_id IS NOT NULL;
CREATE INDEX jobs_by_asset ON jobs (asset) WHERE asset IS NOT NULL;
CREATE INDEX jobs_by_caller ON jobs (caller, id);
CREATE INDEX jobs_waiting ON jobs (priority, id) WHERE state = 'queued';
CREATE INDEX jobs_running ON jobs (lease_until) WHERE state = 'running';
CREATE INDEX jobs_expiring ON jobs (expires_at) WHERE state = 'succeeded';
CREATE INDEX jobs_over ON jobs (finished_at) WHERE finished_at IS NOT NULL;

CREATE TABLE job_labels (
    job   BLOB NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    name  TEXT NOT NULL,
    value TEXT NOT NULL,
    PRIMARY KEY (job, name)
) STRICT, WITHOUT ROWID;
CREATE INDEX job_labels_by_value ON job_labels (name, value, job);

-- Blobs that a job reads or has made: in use while it waits, runs, or its result is kept.
CREATE TABLE job_blobs (
    job    BLOB NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    sha256 BLOB NOT NULL,
    PRIMARY KEY (job, sha256)
) STRICT, WITHOUT ROWID;
CREATE INDEX job_blobs_by_blob ON job_blobs (sha256);

CREATE TABLE events (
    job      BLOB    NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    sequence INTEGER NOT NULL,
    at       INTEGER NOT NULL,
    body     TEXT    NOT NULL, -- JSON
    PRIMARY KEY (job, sequence)
) STRICT, WITHOUT ROWID;

-- When each caller was served last, as a running number.
CREATE TABLE callers (
    name   TEXT    NOT NULL PRIMARY KEY,
    served INTEGER NOT NULL
) STRICT;
