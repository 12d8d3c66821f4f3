//! The numbers that an operator sets.

use super::memory;
use super::store::LEASE;
use std::time::Duration;

/// Numbers that an operator sets.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Jobs that run at the same time. None: other processes do the work.
    pub workers: usize,
    /// Jobs that may wait.
    pub queue_max: usize,
    /// Running work is asked to stop after this time, or sooner when the caller says so.
    pub job_time_max: Duration,
    /// Results and assets are kept this long.
    pub keep_time: Duration,
    /// Final jobs are remembered this long,
    pub records_time: Duration,
    /// and up to this number of jobs.
    pub records_max: usize,
    /// How often deadlines and retention are looked at.
    pub sweep_every: Duration,
    /// Memory that all running jobs together may take. `None`: [`Settings::memory_max`] decides.
    pub memory_bytes_max: Option<u64>,
    /// A worker is taken for lost when it was not heard of for this long.
    pub lease: Duration,
}

/// Memory that one job may take, unless the operator says otherwise.
const JOB_MEMORY_BYTES: u64 = 2 << 30;

/// How often each of many processes looks at deadlines and retention.
const SHARED_SWEEP: Duration = Duration::from_secs(2);

impl Default for Settings {
    fn default() -> Self {
        Self {
            workers: 1,
            queue_max: 100,
            job_time_max: Duration::from_secs(300),
            keep_time: Duration::from_secs(24 * 3600),
            records_time: Duration::from_secs(30 * 24 * 3600),
            records_max: 10_000,
            sweep_every: Duration::from_millis(500),
            memory_bytes_max: None,
            lease: LEASE,
        }
    }
}

impl Settings {
    /// For jobs that many processes share: each sweeps less often, and records go by their age alone, since counting
    /// them takes its time.
    pub fn shared(self) -> Self {
        Self { sweep_every: SHARED_SWEEP, records_max: usize::MAX, ..self }
    }

    /// Memory that all running jobs together may take: 2 GiB per worker, and no more than three quarters of what the
    /// machine or container has.
    pub fn memory_max(&self) -> u64 {
        let wanted = JOB_MEMORY_BYTES.saturating_mul(self.workers.max(1) as u64);
        // Where nothing runs, this machine's memory says nothing about the jobs.
        let share = if self.workers == 0 { None } else { memory::machine_share() };
        self.memory_bytes_max.unwrap_or_else(|| share.unwrap_or(u64::MAX).min(wanted))
    }
}
