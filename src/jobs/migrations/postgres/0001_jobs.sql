-- Jobs, the files that they read and write, and who may have them: the tables of the SQLite engine, in one step. Times are
-- milliseconds since 1970; ids are the 16 bytes of a UUIDv7; digests are the 32 bytes of a SHA-256.

-- Files that are in use, and where each is.
CREATE TABLE blobs (
    sha256     BYTEA  NOT NULL PRIMARY KEY,
    bytes      BIGINT NOT NULL,
    location   TEXT   NOT NULL UNIQUE,
    created_at BIGINT NOT NULL
);

-- Uploads that outlive one request. An upload that came with its job lives as long as a job needs it; one that was sent
-- as an asset (`explicit`) lives until it expires. `identity` is the digest of the files and of what their names decide.
CREATE TABLE assets (
    id           BYTEA  NOT NULL PRIMARY KEY,
    caller       TEXT   NOT NULL,
    identity     BYTEA  NOT NULL,
    files        TEXT   NOT NULL, -- JSON: name, bytes and sha256 of each, the main file first
    memory_bytes BIGINT NOT NULL, -- what rigging it is expected to need
    explicit     BIGINT NOT NULL,
    created_at   BIGINT NOT NULL,
    used_at      BIGINT NOT NULL,
    expires_at   BIGINT NOT NULL,
    UNIQUE (caller, identity)
);
CREATE INDEX assets_expiring ON assets (expires_at);
CREATE INDEX assets_by_use ON assets (used_at);

CREATE TABLE asset_blobs (
    asset  BYTEA NOT NULL REFERENCES assets (id) ON DELETE CASCADE,
    sha256 BYTEA NOT NULL REFERENCES blobs (sha256),
    PRIMARY KEY (asset, sha256)
);
CREATE INDEX asset_blobs_by_blob ON asset_blobs (sha256);

CREATE TABLE jobs (
    id               BYTEA  NOT NULL PRIMARY KEY,
    caller           TEXT   NOT NULL,
    client_id        TEXT,
    -- what was asked
    options          TEXT   NOT NULL, -- JSON
    labels           TEXT   NOT NULL, -- JSON
    files            TEXT   NOT NULL, -- JSON, as in assets
    skeleton         BYTEA,             -- digest of the skeleton that came along
    asset            BYTEA,
    priority         BIGINT NOT NULL,
    timeout_ms       BIGINT NOT NULL,
    retention_ms     BIGINT NOT NULL,
    deadline_at      BIGINT,
    memory_bytes     BIGINT NOT NULL,
    -- where it stands
    state            TEXT   NOT NULL,
    stage            TEXT,
    progress         BIGINT NOT NULL DEFAULT 0,
    cancel_requested BIGINT NOT NULL DEFAULT 0,
    sequence         BIGINT NOT NULL DEFAULT 0, -- number of the last event
    -- who works on it
    attempt          BIGINT NOT NULL DEFAULT 0, -- the fencing token
    losses           BIGINT NOT NULL DEFAULT 0, -- workers lost over it
    worker           TEXT,
    lease_until      BIGINT,
    -- when
    created_at       BIGINT NOT NULL,
    queued_at        BIGINT NOT NULL,
    started_at       BIGINT,
    finished_at      BIGINT,
    expires_at       BIGINT,
    queue_ms         BIGINT,
    -- how it ended
    timings          TEXT, -- JSON: microseconds per stage
    result           TEXT, -- JSON
    error            TEXT, -- JSON
    -- what it is compared by
    cached           BIGINT NOT NULL DEFAULT 0,
    cache_key        BYTEA, -- digest of everything that decides the result
    fingerprint      BYTEA  -- digest of the request, for telling a repetition from another request
);
CREATE UNIQUE INDEX jobs_by_client_id ON jobs (caller, client_id) WHERE client_id IS NOT NULL;
CREATE INDEX jobs_by_asset ON jobs (asset) WHERE asset IS NOT NULL;
CREATE INDEX jobs_by_caller ON jobs (caller, id);
CREATE INDEX jobs_waiting ON jobs (priority, id) WHERE state = 'queued';
CREATE INDEX jobs_running ON jobs (lease_until) WHERE state = 'running';
CREATE INDEX jobs_running_by_caller ON jobs (caller) WHERE state = 'running';
CREATE INDEX jobs_by_deadline ON jobs (deadline_at) WHERE state = 'queued';
CREATE INDEX jobs_expiring ON jobs (expires_at) WHERE state = 'succeeded';
CREATE INDEX jobs_by_cache_key ON jobs (cache_key, finished_at) WHERE state = 'succeeded';
CREATE INDEX jobs_over ON jobs (finished_at) WHERE finished_at IS NOT NULL;

CREATE TABLE job_labels (
    job   BYTEA NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    name  TEXT  NOT NULL,
    value TEXT  NOT NULL,
    PRIMARY KEY (job, name)
);
CREATE INDEX job_labels_by_value ON job_labels (name, value, job);

-- Blobs that a job reads or has made: in use while it waits, runs, or its result is kept.
CREATE TABLE job_blobs (
    job    BYTEA NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    sha256 BYTEA NOT NULL,
    PRIMARY KEY (job, sha256)
);
CREATE INDEX job_blobs_by_blob ON job_blobs (sha256);

CREATE TABLE events (
    job      BYTEA  NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    sequence BIGINT NOT NULL,
    at       BIGINT NOT NULL,
    body     TEXT   NOT NULL, -- JSON
    PRIMARY KEY (job, sequence)
);

-- When each caller was served last, as a running number.
CREATE SEQUENCE turns;
CREATE TABLE callers (
    name   TEXT   NOT NULL PRIMARY KEY,
    served BIGINT NOT NULL
);

-- Requests that may arrive twice.
CREATE TABLE idempotency (
    caller      TEXT   NOT NULL,
    key         TEXT   NOT NULL,
    fingerprint BYTEA  NOT NULL,
    job         BYTEA  REFERENCES jobs (id) ON DELETE CASCADE, -- the job that the request made,
    answer      BYTEA,                                        -- or the answer that it got
    expires_at  BIGINT NOT NULL,
    PRIMARY KEY (caller, key)
);
CREATE INDEX idempotency_expiring ON idempotency (expires_at);
CREATE INDEX idempotency_by_job ON idempotency (job) WHERE job IS NOT NULL;

-- What one process does for all, and when it is due again.
CREATE TABLE duties (
    name   TEXT   NOT NULL PRIMARY KEY,
    due_at BIGINT NOT NULL
);
