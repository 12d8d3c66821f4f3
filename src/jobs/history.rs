//! A job's events as a watcher follows them.

use super::core::Core;
use super::event::{Event, EventKind};
use super::ids::JobId;
use super::store::StoreFailure;
use super::submission::Caller;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::SystemTime;
use tokio::sync::watch;
use tokio::time::timeout;

/// Events read at a time.
const BATCH: usize = 100;

/// What happens to one job, from some event on, to its end.
pub struct Events {
    core: Arc<Core>,
    caller: Caller,
    id: JobId,
    /// The number of the event given last.
    after: u64,
    pending: VecDeque<Event>,
    over: bool,
    news: watch::Receiver<()>,
}

impl Events {
    /// `None`: there is no such job. Without `after`, or when it lies in the future, a snapshot comes first.
    pub(super) async fn open(
        core: Arc<Core>,
        caller: Caller,
        id: JobId,
        after: Option<u64>,
    ) -> Result<Option<Self>, StoreFailure> {
        // Watched before it is looked at, so that nothing falls between.
        let news = core.watchers.subscribe(id);
        let Some(job) = core.jobs.job(&caller, id).await? else { return Ok(None) };
        let mut events =
            Self { core, caller, id, after: after.unwrap_or(0), pending: VecDeque::new(), over: false, news };
        match after.filter(|after| *after <= job.sequence) {
            Some(after) => events.over = after == job.sequence && job.state.is_final(),
            None => {
                // The end of a job that is over is told after its snapshot.
                events.after = if job.state.is_final() { job.sequence.saturating_sub(1) } else { job.sequence };
                let (sequence, at) = (events.after, SystemTime::now());
                let job = events.core.completed(job);
                events.pending.push_back(Event { sequence, at, kind: EventKind::Snapshot(Box::new(job)) });
            }
        }
        Ok(Some(events))
    }

    /// Nothing more will come.
    pub fn is_over(&self) -> bool {
        self.over && self.pending.is_empty()
    }

    /// The next event, as soon as there is one; `None` after the last one, when the job is deleted, and when the
    /// service stops.
    pub async fn next(&mut self) -> Result<Option<Event>, StoreFailure> {
        loop {
            if let Some(event) = self.pending.pop_front() {
                self.after = self.after.max(event.sequence);
                self.over |= matches!(event.kind, EventKind::Done { .. });
                return Ok(Some(event));
            }
            if self.over || self.core.is_closed() {
                return Ok(None);
            }
            self.news.mark_unchanged();
            self.pending.extend(self.core.jobs.events(self.id, self.after, BATCH).await?);
            if !self.pending.is_empty() {
                continue;
            }
            if self.core.jobs.job(&self.caller, self.id).await?.is_none() {
                self.over = true;
                return Ok(None);
            }
            // Waking early is as good as waking late: the store is asked either way.
            let _ = timeout(self.core.look_again, self.news.changed()).await;
        }
    }
}
