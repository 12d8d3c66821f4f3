//! All jobs of this process and the order in which they run: plain data, changed under one lock and never waited in.

use super::failure::{ErrorCode, JobError};
use super::job::{Job, JobId, JobRequest, JobResult, JobState};
use super::perform::Timing;
use super::stage::Stage;
use crate::cancellation::Cancellation;
use crate::storage::Bundle;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};
use tokio::sync::watch;

/// Why running work was asked to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    Asked,
    TimedOut,
    Draining,
}

/// A job and what belongs to it.
struct Record {
    job: Job,
    /// Kept until the job is final.
    upload: Option<Arc<Bundle>>,
    artifacts: Option<Arc<Bundle>>,
    cancellation: Cancellation,
    stop: Option<Stop>,
    queued_at: Instant,
    /// When running work is asked to stop.
    deadline: Option<Instant>,
    /// Rises with every change that a watcher may want to see.
    revision: watch::Sender<u64>,
}

impl Record {
    fn changed(&self) {
        self.revision.send_modify(|revision| *revision += 1);
    }

    fn end(&mut self, state: JobState, error: Option<JobError>) {
        self.job.state = state;
        self.job.error = error;
        self.job.finished_at = Some(SystemTime::now());
        self.upload = None;
        self.deadline = None;
        self.changed();
    }

    fn expire(&mut self) {
        self.job.state = JobState::Expired;
        self.artifacts = None;
        self.changed();
    }
}

/// Work for a worker.
pub struct Task {
    pub id: JobId,
    pub request: Arc<JobRequest>,
    pub upload: Arc<Bundle>,
    pub cancellation: Cancellation,
}

/// How work ended.
pub struct Ending {
    pub outcome: Result<(JobResult, Bundle), JobError>,
    pub stage: Option<Stage>,
    pub timings: Vec<Timing>,
    pub run_time: Duration,
}

/// What became of a wish to cancel or delete.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Denied {
    NotFound,
    /// The job is in this state.
    State(JobState),
}

#[derive(Default)]
pub struct Ledger {
    records: BTreeMap<JobId, Record>,
    queue: VecDeque<JobId>,
    pub draining: bool,
    /// Workers leave at their next look.
    pub closed: bool,
    /// Mean run time of the latest jobs, for telling callers when to come back.
    mean_run: Option<Duration>,
}

/// Weight of the newest job in the mean run time.
const MEAN_WEIGHT: f64 = 0.2;

impl Ledger {
    pub fn waiting(&self) -> usize {
        self.queue.len()
    }

    pub fn running(&self) -> usize {
        self.records.values().filter(|record| record.job.state == JobState::Running).count()
    }

    /// About how long until a place in the queue is free.
    pub fn turn(&self, workers: usize) -> Duration {
        self.mean_run.unwrap_or(Duration::from_secs(2)) / workers.max(1) as u32
    }

    pub fn add(&mut self, request: JobRequest, upload: Bundle) -> JobId {
        let id = JobId::new();
        let job = Job {
            id,
            state: JobState::Queued,
            stage: None,
            progress: 0,
            queue_position: None,
            cancel_requested: false,
            attempt: 1,
            created_at: SystemTime::now(),
            started_at: None,
            finished_at: None,
            expires_at: None,
            request: Arc::new(request),
            queue_time: None,
            timings: Vec::new(),
            result: None,
            error: None,
        };
        let record = Record {
            job,
            upload: Some(Arc::new(upload)),
            artifacts: None,
            cancellation: Cancellation::default(),
            stop: None,
            queued_at: Instant::now(),
            deadline: None,
            revision: watch::Sender::new(0),
        };
        self.records.insert(id, record);
        self.queue.push_back(id);
        id
    }

    /// The next job for a worker, now running.
    pub fn take(&mut self, job_time_max: Duration) -> Option<Task> {
        // A job leaves the queue when it is cancelled, so the first one is always fit to run; the loop is bounded by
        // the queue all the same.
        while let Some(id) = self.queue.pop_front() {
            let Some(record) = self.records.get_mut(&id) else { continue };
            let Some(upload) = record.upload.clone() else { continue };
            record.job.state = JobState::Running;
            record.job.started_at = Some(SystemTime::now());
            record.job.queue_time = Some(record.queued_at.elapsed());
            record.deadline = Instant::now().checked_add(job_time_max);
            record.changed();
            let (request, cancellation) = (record.job.request.clone(), record.cancellation.clone());
            self.note_positions();
            return Some(Task { id, request, upload, cancellation });
        }
        None
    }

    pub fn enter(&mut self, id: JobId, stage: Stage) {
        if let Some(record) = self.records.get_mut(&id) {
            record.job.stage = Some(stage);
            record.job.progress = record.job.progress.max(stage.progress());
            record.changed();
        }
    }

    pub fn finish(&mut self, id: JobId, ending: Ending, keep_time: Duration) {
        let mean = self.mean_run.unwrap_or(ending.run_time);
        self.mean_run = Some(mean.mul_f64(1.0 - MEAN_WEIGHT) + ending.run_time.mul_f64(MEAN_WEIGHT));
        let Some(record) = self.records.get_mut(&id) else { return };
        record.job.timings = ending.timings;
        match ending.outcome {
            Ok((result, artifacts)) => {
                record.job.result = Some(Arc::new(result));
                record.artifacts = Some(Arc::new(artifacts));
                record.job.progress = 100;
                record.job.expires_at = SystemTime::now().checked_add(keep_time);
                record.end(JobState::Succeeded, None);
            }
            Err(error) => {
                let error = match error.stage.or(ending.stage) {
                    Some(stage) => error.at(stage),
                    None => error,
                };
                let (state, error) = ended_without_result(record.stop, error);
                record.end(state, error);
            }
        }
    }

    /// A waiting job ends at once; a running one is asked to. Asking twice is asking once.
    pub fn cancel(&mut self, id: JobId) -> Result<(), Denied> {
        let record = self.records.get_mut(&id).ok_or(Denied::NotFound)?;
        match record.job.state {
            JobState::Queued => {
                record.end(JobState::Canceled, None);
                self.queue.retain(|queued| *queued != id);
                self.note_positions();
            }
            JobState::Running => {
                record.stop.get_or_insert(Stop::Asked);
                record.job.cancel_requested = true;
                record.cancellation.cancel();
                record.changed();
            }
            JobState::Canceled => {}
            state @ (JobState::Succeeded | JobState::Failed | JobState::Expired) => return Err(Denied::State(state)),
        }
        Ok(())
    }

    /// Forgets a job that is not running, with all its files.
    pub fn delete(&mut self, id: JobId) -> Result<(), Denied> {
        match self.records.get(&id).map(|record| record.job.state) {
            None => return Err(Denied::NotFound),
            Some(JobState::Running) => return Err(Denied::State(JobState::Running)),
            Some(JobState::Queued) => self.cancel(id)?,
            Some(_) => {}
        }
        self.records.remove(&id);
        Ok(())
    }

    pub fn snapshot(&self, id: JobId) -> Option<Job> {
        let mut job = self.records.get(&id)?.job.clone();
        if job.state == JobState::Queued {
            job.queue_position = self.queue.iter().position(|queued| *queued == id).map(|index| index + 1);
        }
        Some(job)
    }

    /// Newest first, older than `before`.
    pub fn list(&self, before: Option<JobId>, state: Option<JobState>, count: usize) -> Vec<Job> {
        self.records
            .iter()
            .rev()
            .filter(|(id, _)| before.is_none_or(|before| **id < before))
            .filter(|(_, record)| state.is_none_or(|state| record.job.state == state))
            .take(count)
            .filter_map(|(id, _)| self.snapshot(*id))
            .collect()
    }

    /// Forgets every job, with all files.
    pub fn clear(&mut self) {
        self.drain();
        self.records.clear();
    }

    pub fn artifacts(&self, id: JobId) -> Option<Arc<Bundle>> {
        self.records.get(&id)?.artifacts.clone()
    }

    pub fn watch(&self, id: JobId) -> Option<watch::Receiver<u64>> {
        Some(self.records.get(&id)?.revision.subscribe())
    }

    /// No new work: what waits fails, since nothing outlives the process yet.
    pub fn drain(&mut self) {
        self.draining = true;
        for id in std::mem::take(&mut self.queue) {
            if let Some(record) = self.records.get_mut(&id) {
                record.end(JobState::Failed, Some(stopped()));
            }
        }
    }

    pub fn stop_running(&mut self, stop: Stop, overdue_at: Option<Instant>) {
        for record in self.records.values_mut().filter(|record| record.job.state == JobState::Running) {
            let overdue = overdue_at.is_none_or(|now| record.deadline.is_some_and(|deadline| deadline <= now));
            if overdue && record.stop.is_none() {
                record.stop = Some(stop);
                record.cancellation.cancel();
            }
        }
    }

    /// Expires results kept long enough, and forgets the oldest final jobs beyond `records_max`.
    pub fn sweep(&mut self, now: SystemTime, records_max: usize) {
        for record in self.records.values_mut().filter(|record| record.job.state == JobState::Succeeded) {
            if record.job.expires_at.is_some_and(|expires_at| expires_at <= now) {
                record.expire();
            }
        }
        let excess = self.records.len().saturating_sub(records_max);
        let oldest = self.records.iter().filter(|(_, record)| record.job.state.is_final()).map(|(id, _)| *id);
        for id in oldest.take(excess).collect::<Vec<_>>() {
            self.records.remove(&id);
        }
    }

    /// Expires the results kept longest. `false`: there are none.
    pub fn expire_oldest(&mut self) -> bool {
        let oldest = self
            .records
            .values_mut()
            .filter(|record| record.job.state == JobState::Succeeded)
            .min_by_key(|record| record.job.finished_at);
        oldest.map(Record::expire).is_some()
    }

    fn note_positions(&self) {
        for id in &self.queue {
            if let Some(record) = self.records.get(id) {
                record.changed();
            }
        }
    }
}

fn stopped() -> JobError {
    JobError::new(
        ErrorCode::Draining,
        "the service stopped before the job was done, and keeps no jobs across a restart",
    )
    .hint("send the request again")
}

/// The honest end of work that gave no result: the reason it was stopped for, or its own error.
fn ended_without_result(stop: Option<Stop>, error: JobError) -> (JobState, Option<JobError>) {
    let with_stage = |made: JobError| match error.stage {
        Some(stage) => made.at(stage),
        None => made,
    };
    match (stop, error.code) {
        (Some(Stop::Asked), ErrorCode::Canceled) => (JobState::Canceled, None),
        (Some(Stop::TimedOut), ErrorCode::Canceled) => {
            let timeout = JobError::new(ErrorCode::Timeout, "the job took longer than the service allows")
                .hint("send a simpler mesh, or less detail");
            (JobState::Failed, Some(with_stage(timeout)))
        }
        (Some(Stop::Draining), ErrorCode::Canceled) => (JobState::Failed, Some(with_stage(stopped()))),
        (None, ErrorCode::Canceled) => {
            let internal = JobError::new(ErrorCode::Internal, "the work stopped without being asked to");
            (JobState::Failed, Some(with_stage(internal)))
        }
        _ => (JobState::Failed, Some(error)),
    }
}
