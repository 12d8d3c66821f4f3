-- Who is told what happens, and what became of it.

CREATE TABLE webhook_endpoints (
    id              BYTEA   NOT NULL PRIMARY KEY,
    caller          TEXT    NOT NULL,
    url             TEXT,             -- none: signs what single jobs want told
    description     TEXT    NOT NULL,
    events          TEXT    NOT NULL, -- JSON: names of what it is told
    enabled         BIGINT  NOT NULL,
    disabled_reason TEXT,             -- why the service has disabled it
    secret          BYTEA   NOT NULL,
    previous_secret BYTEA,            -- signs too until
    previous_until  BIGINT ,
    failing_since   BIGINT ,
    held_until      BIGINT,           -- nothing is sent before this time
    created_at      BIGINT  NOT NULL
);
CREATE INDEX webhook_endpoints_by_caller ON webhook_endpoints (caller);
CREATE UNIQUE INDEX webhook_endpoints_of_jobs ON webhook_endpoints (caller) WHERE url IS NULL;

-- What happened, as it was then.
CREATE TABLE webhook_messages (
    id      BYTEA   NOT NULL PRIMARY KEY,
    type    TEXT    NOT NULL,
    at      BIGINT  NOT NULL,
    subject TEXT    NOT NULL -- JSON
);
CREATE INDEX webhook_messages_by_age ON webhook_messages (at);

CREATE TABLE webhook_deliveries (
    endpoint    BYTEA   NOT NULL REFERENCES webhook_endpoints (id) ON DELETE CASCADE,
    message     BYTEA   NOT NULL REFERENCES webhook_messages (id) ON DELETE CASCADE,
    url         TEXT,             -- where one job wants it; none: where the endpoint is
    state       TEXT    NOT NULL, -- pending, delivered, failed
    due_at      BIGINT,           -- while pending
    lease_until BIGINT,           -- while it is being sent
    attempts    BIGINT  NOT NULL, -- how often it was sent; the fencing token
    tries       BIGINT  NOT NULL, -- how often since it was last asked for
    log         TEXT    NOT NULL, -- JSON: the newest attempts
    PRIMARY KEY (endpoint, message)
);
CREATE INDEX webhook_deliveries_by_message ON webhook_deliveries (message);
CREATE INDEX webhook_deliveries_due ON webhook_deliveries (endpoint, due_at) WHERE state = 'pending';
CREATE INDEX webhook_deliveries_under_way ON webhook_deliveries (endpoint, lease_until) WHERE lease_until IS NOT NULL;

ALTER TABLE jobs ADD COLUMN webhook TEXT; -- JSON: where this job wants told what becomes of it, and of what
