-- Uploads that arrive in parts. The last part makes an asset of one and is not written down itself; what is left of it then, as of
-- one that expired, is a record for whoever asks.

CREATE TABLE uploads (
    id         BLOB    NOT NULL PRIMARY KEY,
    caller     TEXT    NOT NULL,
    file_name  TEXT    NOT NULL,
    metadata   TEXT,             -- as the caller said it
    length     INTEGER NOT NULL, -- bytes of the whole
    received   INTEGER NOT NULL, -- bytes that are here
    is_open    INTEGER NOT NULL, -- more may come
    asset      BLOB,            -- what became of it
    created_at INTEGER NOT NULL,
    expires_at INTEGER NOT NULL
) STRICT;
CREATE INDEX uploads_open ON uploads (expires_at) WHERE is_open = 1;
CREATE INDEX uploads_open_by_caller ON uploads (caller) WHERE is_open = 1;
CREATE INDEX uploads_expiring ON uploads (expires_at);

CREATE TABLE upload_parts (
    upload   BLOB    NOT NULL REFERENCES uploads (id) ON DELETE CASCADE,
    position INTEGER NOT NULL, -- of its first byte
    sha256   BLOB    NOT NULL REFERENCES blobs (sha256),
    PRIMARY KEY (upload, position)
) STRICT, WITHOUT ROWID;
CREATE INDEX upload_parts_by_blob ON upload_parts (sha256);
