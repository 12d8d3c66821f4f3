-- Results that serve again, and requests that may arrive twice.

ALTER TABLE jobs ADD COLUMN cached INTEGER NOT NULL DEFAULT 0;
-- Digest of everything that decides the result. Jobs of version 1 have none and serve nobody else.
ALTER TABLE jobs ADD COLUMN cache_key BLOB;
-- Digest of the request, for telling a repetition from another request.
ALTER TABLE jobs ADD COLUMN fingerprint BLOB;
CREATE INDEX jobs_by_cache_key ON jobs (cache_key, finished_at) WHERE state = 'succeeded' AND cache_key IS NOT NULL;

CREATE TABLE idempotency (
    caller      TEXT    NOT NULL,
    key         TEXT    NOT NULL,
    fingerprint BLOB    NOT NULL,
    job         BLOB REFERENCES jobs (id) ON DELETE CASCADE, -- the job that the request made,
    answer      BLOB,                                        -- or the answer that it got
    expires_at  INTEGER NOT NULL,
    PRIMARY KEY (caller, key)
) STRICT;
CREATE INDEX idempotency_expiring ON idempotency (expires_at);
