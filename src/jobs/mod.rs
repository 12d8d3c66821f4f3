//! Requests for rigs: the queue, the workers, and the work itself. Knows nothing of geometry.
