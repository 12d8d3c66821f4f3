//! The jobs that this process works on: what the store learns of them later, and how to stop them.

use super::failure::{ErrorCode, JobError};
use super::ids::JobId;
use super::job::{Job, JobState};
use super::memory;
use super::stage::Stage;
use super::store::{Claim, EndedWithout, Lease};
use crate::cancellation::Cancellation;
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Why running work was asked to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    Asked,
    TimedOut,
    /// It took this many bytes of memory, and may take so many.
    OutOfMemory {
        taken: u64,
        max: u64,
    },
    /// The service ends; the job goes back to the queue.
    Draining,
    /// The job is no longer ours.
    Fenced,
}

/// Work in progress.
pub struct Work {
    pub lease: Lease,
    pub memory_bytes: u64,
    cancellation: Cancellation,
    /// When it is asked to stop.
    deadline: Option<Instant>,
    stop: Option<(Stop, Instant)>,
    stage: Option<Stage>,
    progress: u8,
    /// The stage that the store knows.
    written: Option<Stage>,
}

/// All work in progress.
#[derive(Default)]
pub struct Running(Mutex<BTreeMap<JobId, Work>>);

impl Running {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<JobId, Work>> {
        // No code that can panic runs under the lock.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn begin(&self, claim: &Claim) {
        let time = claim.time_left.map_or(claim.job.request.timeout, |left| left.min(claim.job.request.timeout));
        let work = Work {
            lease: claim.lease,
            memory_bytes: claim.memory_bytes,
            cancellation: Cancellation::default(),
            deadline: Instant::now().checked_add(time),
            stop: None,
            stage: None,
            progress: claim.job.progress,
            written: None,
        };
        self.lock().insert(claim.lease.job, work);
    }

    pub fn cancellation(&self, lease: Lease) -> Option<Cancellation> {
        self.lock().get(&lease.job).filter(|work| work.lease == lease).map(|work| work.cancellation.clone())
    }

    /// Whether some work was asked to stop and has not yet.
    pub fn any_stopped(&self) -> bool {
        self.lock().values().any(|work| work.stop.is_some())
    }

    /// The work is over, unless the job was taken up anew meanwhile.
    pub fn end(&self, lease: Lease) {
        let mut running = self.lock();
        if running.get(&lease.job).is_some_and(|work| work.lease == lease) {
            running.remove(&lease.job);
        }
    }

    /// Why the work was asked to stop.
    pub fn stop_of(&self, lease: Lease) -> Option<Stop> {
        match self.lock().get(&lease.job).filter(|work| work.lease == lease) {
            Some(work) => work.stop.map(|(stop, _)| stop),
            None => Some(Stop::Fenced),
        }
    }

    pub fn count(&self) -> usize {
        self.lock().len()
    }

    /// Memory that all of it is expected to need.
    pub fn memory_bytes(&self) -> u64 {
        self.lock().values().map(|work| work.memory_bytes).fold(0, u64::saturating_add)
    }

    pub fn leases(&self) -> Vec<Lease> {
        self.lock().values().map(|work| work.lease).collect()
    }

    /// The right by which this process works on the job.
    pub fn lease_of(&self, id: JobId) -> Option<Lease> {
        self.lock().get(&id).map(|work| work.lease)
    }

    pub fn enter(&self, lease: Lease, stage: Stage) {
        if let Some(work) = self.lock().get_mut(&lease.job).filter(|work| work.lease == lease) {
            work.stage = Some(stage);
            work.progress = work.progress.max(stage.progress());
        }
    }

    /// Stages that the store does not know yet.
    pub fn take_news(&self) -> Vec<(Lease, Stage)> {
        let mut running = self.lock();
        let fresh = running.values_mut().filter(|work| work.stage != work.written);
        fresh
            .filter_map(|work| {
                work.written = work.stage;
                Some((work.lease, work.stage?))
            })
            .collect()
    }

    pub fn stop(&self, id: JobId, stop: Stop) {
        if let Some(work) = self.lock().get_mut(&id) {
            work.ask_to(stop);
        }
    }

    pub fn stop_all(&self, stop: Stop) {
        self.lock().values_mut().for_each(|work| work.ask_to(stop));
    }

    pub fn stop_overdue(&self, now: Instant) {
        for work in self.lock().values_mut() {
            if work.deadline.is_some_and(|deadline| deadline <= now) {
                work.ask_to(Stop::TimedOut);
            }
        }
    }

    /// Asks the work that is expected to need most to stop.
    pub fn stop_largest(&self, stop: Stop) {
        let mut running = self.lock();
        let largest = running.values_mut().filter(|work| work.stop.is_none()).max_by_key(|work| work.memory_bytes);
        if let Some(work) = largest {
            work.ask_to(stop);
        }
    }

    /// Work that was asked to stop `patience` ago and goes on all the same. Each is named once.
    pub fn take_stuck(&self, now: Instant, patience: Duration) -> Vec<(Lease, Stop, Option<Stage>)> {
        let mut stuck = Vec::new();
        for work in self.lock().values_mut() {
            if let Some((stop, asked_at)) = work.stop
                && now.saturating_duration_since(asked_at) > patience
                && matches!(stop, Stop::Asked | Stop::TimedOut | Stop::OutOfMemory { .. })
            {
                stuck.push((work.lease, stop, work.stage));
                work.stop = Some((Stop::Fenced, now));
            }
        }
        stuck
    }

    /// What this process knows of a job and the store does not yet.
    pub fn add_to(&self, job: &mut Job) {
        let running = self.lock();
        let ours = running.get(&job.id).filter(|work| work.lease.attempt == job.attempt);
        if let Some(work) = ours.filter(|_| job.state == JobState::Running) {
            job.stage = work.stage.or(job.stage);
            job.progress = job.progress.max(work.progress);
        }
    }
}

impl Work {
    fn ask_to(&mut self, stop: Stop) {
        if self.stop.is_none() {
            self.stop = Some((stop, Instant::now()));
            self.cancellation.cancel();
        }
    }
}

/// The honest end of work that gave no result: the reason it was stopped for, or its own error. `None`: none, the job
/// goes back or is not ours.
pub fn ended_without_result(stop: Option<Stop>, error: JobError) -> Option<EndedWithout> {
    let stage = error.stage;
    let failed = |made: JobError| {
        EndedWithout::Failed(match stage {
            Some(stage) => made.at(stage),
            None => made,
        })
    };
    Some(match (stop, error.code) {
        (Some(Stop::Draining | Stop::Fenced), ErrorCode::Canceled) | (Some(Stop::Fenced), _) => return None,
        (Some(Stop::Asked), ErrorCode::Canceled) => EndedWithout::Canceled,
        (Some(Stop::TimedOut), ErrorCode::Canceled) => failed(timed_out()),
        (Some(Stop::OutOfMemory { taken, max }), ErrorCode::Canceled) => failed(memory::took_too_much(taken, max)),
        (None, ErrorCode::Canceled) => {
            failed(JobError::new(ErrorCode::Internal, "the work stopped without being asked to"))
        }
        _ => EndedWithout::Failed(error),
    })
}

fn timed_out() -> JobError {
    JobError::new(ErrorCode::Timeout, "the job took longer than it may").hint("send a simpler mesh, or less detail")
}

/// The end of work that does not yield.
pub fn stuck(stop: Stop, stage: Option<Stage>) -> Option<EndedWithout> {
    let canceled = JobError::new(ErrorCode::Canceled, "");
    ended_without_result(Some(stop), stage.map_or(canceled.clone(), |stage| canceled.at(stage)))
}
