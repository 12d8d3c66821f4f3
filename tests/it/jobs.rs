//! Jobs across restarts, lost workers, full memory and kills.

#[path = "jobs/bench.rs"]
mod bench;
#[path = "jobs/faults.rs"]
mod faults;
#[path = "jobs/kills.rs"]
mod kills;
#[path = "jobs/lives.rs"]
mod lives;
#[path = "jobs/nodes.rs"]
mod nodes;
