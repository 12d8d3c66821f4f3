-- What one process does for all, and when it is due again.
CREATE TABLE duties (
    name   TEXT    NOT NULL PRIMARY KEY,
    due_at INTEGER NOT NULL
) STRICT;
