-- Requests that were handed in together, and what became of each.

CREATE TABLE batches (
    id          BYTEA   NOT NULL PRIMARY KEY,
    caller      TEXT    NOT NULL,
    jobs_max    BIGINT,           -- unfinished jobs that the caller may have
    created_at  BIGINT NOT NULL,
    canceled_at BIGINT,
    finished_at BIGINT
);
CREATE INDEX batches_by_caller ON batches (caller, id);
CREATE INDEX batches_open ON batches (id) WHERE finished_at IS NULL;
CREATE INDEX batches_over ON batches (finished_at) WHERE finished_at IS NOT NULL;

CREATE TABLE batch_items (
    batch     BYTEA   NOT NULL REFERENCES batches (id) ON DELETE CASCADE,
    position  BIGINT NOT NULL,
    custom_id TEXT    NOT NULL,
    request   TEXT    NOT NULL, -- JSON
    asset     BYTEA,            -- needed as long as the item is pending
    state     TEXT    NOT NULL, -- pending, job, and how it ended: succeeded, failed, canceled
    job       BYTEA,
    error     TEXT,             -- JSON: why it became no job
    PRIMARY KEY (batch, position)
);
CREATE INDEX batch_items_pending ON batch_items (batch, position) WHERE state = 'pending';
CREATE INDEX batch_items_at_work ON batch_items (job) WHERE state = 'job';
CREATE INDEX batch_items_by_asset ON batch_items (asset) WHERE state = 'pending';
