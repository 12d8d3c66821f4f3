-- Uploads that arrive in parts. The last part makes an asset of one and is not written down itself; what is left of it then, as of
-- one that expired, is a record for whoever asks.

CREATE TABLE uploads (
    id         BYTEA   NOT NULL PRIMARY KEY,
    caller     TEXT    NOT NULL,
    file_name  TEXT    NOT NULL,
    metadata   TEXT,             -- as the caller said it
    length     BIGINT  NOT NULL, -- bytes of the whole
    received   BIGINT  NOT NULL, -- bytes that are here
    is_open    BIGINT  NOT NULL, -- more may come
    asset      BYTEA,           -- what became of it
    created_at BIGINT  NOT NULL,
    expires_at BIGINT  NOT NULL
);
CREATE INDEX uploads_open ON uploads (expires_at) WHERE is_open = 1;
CREATE INDEX uploads_open_by_caller ON uploads (caller) WHERE is_open = 1;
CREATE INDEX uploads_expiring ON uploads (expires_at);

CREATE TABLE upload_parts (
    upload   BYTEA   NOT NULL REFERENCES uploads (id) ON DELETE CASCADE,
    position BIGINT  NOT NULL, -- of its first byte
    sha256   BYTEA   NOT NULL REFERENCES blobs (sha256),
    PRIMARY KEY (upload, position)
);
CREATE INDEX upload_parts_by_blob ON upload_parts (sha256);
