//! What becomes of jobs, for those who asked for them: look, wait, watch, list, stop, forget.

use super::history::Events;
use super::ids::JobId;
use super::job::{Job, JobState};
use super::page::{NoPage, Page, read_token, token};
use super::queue::Jobs;
use super::running::Stop;
use super::store::{Change, JobFilter, StoreFailure};
use super::submission::Caller;
use std::time::Duration;
use tokio::time::{Instant, timeout_at};

/// What became of a wish to cancel or delete.
#[derive(Clone, Debug, thiserror::Error)]
pub enum Denied {
    #[error("there is no such job")]
    NotFound,
    #[error("the job is {}", .0.name())]
    State(JobState),
    #[error(transparent)]
    Unavailable(#[from] StoreFailure),
}

impl Jobs {
    pub async fn get(&self, caller: &Caller, id: JobId) -> Result<Option<Job>, StoreFailure> {
        let job = self.core().jobs.job(caller, id).await?;
        Ok(job.map(|job| self.core().completed(job)))
    }

    /// The job that the caller gave this id.
    pub async fn get_by_client_id(&self, caller: &Caller, client_id: &str) -> Result<Option<Job>, StoreFailure> {
        let job = self.core().jobs.job_by_client_id(caller, client_id).await?;
        Ok(job.map(|job| self.core().completed(job)))
    }

    /// The job as soon as it is final, or as it is after `time`.
    pub async fn wait(&self, caller: &Caller, id: JobId, time: Duration) -> Result<Option<Job>, StoreFailure> {
        let until = Instant::now() + time;
        let mut news = self.core().watchers.subscribe(id);
        loop {
            news.mark_unchanged();
            let Some(job) = self.get(caller, id).await? else { return Ok(None) };
            if job.state.is_final() || Instant::now() >= until {
                return Ok(Some(job));
            }
            let look_again = until.min(Instant::now() + self.core().look_again);
            // However the waiting ends, the job is looked at.
            let _ = timeout_at(look_again, news.changed()).await;
        }
    }

    /// The events of a job after the one numbered `after`; without it, a snapshot and what follows. `None`: there is
    /// no such job.
    pub async fn events(&self, caller: &Caller, id: JobId, after: Option<u64>) -> Result<Option<Events>, StoreFailure> {
        Events::open(self.core().clone(), caller.clone(), id, after).await
    }

    /// A page of the caller's jobs, newest first.
    pub async fn list(
        &self,
        caller: &Caller,
        filter: &JobFilter,
        page_token: Option<&str>,
        page_size: usize,
    ) -> Result<Page, NoPage> {
        let before = page_token.map(|text| read_token(text, filter)).transpose()?;
        let mut jobs = self.core().jobs.list(caller, filter, before, page_size.saturating_add(1)).await?;
        let more = jobs.len() > page_size;
        jobs.truncate(page_size);
        let next_page_token = jobs.last().filter(|_| more).map(|job| token(job.id, filter));
        let jobs = jobs.into_iter().map(|job| self.core().completed(job)).collect();
        Ok(Page { jobs, next_page_token })
    }

    /// A waiting job ends at once; a running one is asked to. Asking twice is asking once.
    pub async fn cancel(&self, caller: &Caller, id: JobId) -> Result<Job, Denied> {
        match self.core().jobs.cancel(caller, id).await? {
            Change::Done => self.core().collect_garbage().await?,
            Change::Requested => self.core().running.stop(id, Stop::Asked),
            Change::NotFound => return Err(Denied::NotFound),
            Change::State(state) => return Err(Denied::State(state)),
        }
        self.core().watchers.tell(id);
        self.get(caller, id).await?.ok_or(Denied::NotFound)
    }

    /// Forgets a job that does not run, with all files that only it needs.
    pub async fn delete(&self, caller: &Caller, id: JobId) -> Result<(), Denied> {
        match self.core().jobs.delete(caller, id).await? {
            Change::Done | Change::Requested => {}
            Change::NotFound => return Err(Denied::NotFound),
            Change::State(state) => return Err(Denied::State(state)),
        }
        self.core().watchers.tell(id);
        self.core().collect_garbage().await?;
        Ok(())
    }
}
