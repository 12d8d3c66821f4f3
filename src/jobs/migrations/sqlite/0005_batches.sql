-- Requests that were handed in together, and what became of each.

CREATE TABLE batches (
    id          BLOB    NOT NULL PRIMARY KEY,
    caller      TEXT    NOT NULL,
    jobs_max    INTEGER,           -- unfinished jobs that the caller may have
    created_at  INTEGER NOT NULL,
    canceled_at INTEGER,
    finished_at INTEGER
) STRICT;
CREATE INDEX batches_by_caller ON batches (caller, id);
CREATE INDEX batches_open ON batches (id) WHERE finished_at IS NULL;
CREATE INDEX batches_over ON batches (finished_at) WHERE finished_at IS NOT NULL;

CREATE TABLE batch_items (
    batch     BLOB    NOT NULL REFERENCES batches (id) ON DELETE CASCADE,
    position  INTEGER NOT NULL,
    custom_id TEXT    NOT NULL,
    request   TEXT    NOT NULL, -- JSON
    asset     BLOB,             -- needed as long as the item is pending
    state     TEXT    NOT NULL, -- pending, job, and how it ended: succeeded, failed, canceled
    job       BLOB,
    error     TEXT,             -- JSON: why it became no job
    PRIMARY KEY (batch, position)
) STRICT, WITHOUT ROWID;
CREATE INDEX batch_items_pending ON batch_items (batch, position) WHERE state = 'pending';
CREATE INDEX batch_items_at_work ON batch_items (job) WHERE state = 'job';
CREATE INDEX batch_items_by_asset ON batch_items (asset) WHERE state = 'pending';
