//! The task that keeps the time: leases, news, deadlines, memory, retention.

use super::core::Core;
use super::memory;
use super::running::{Stop, stuck};
use super::store::{Duty, Ending, LeaseState, Memory, News, StoreFailure};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};
use tokio::sync::Notify;
use tokio::sync::broadcast::{Receiver, error::RecvError};
use uuid::Uuid;

/// News of stages reach the store at most this often.
const NEWS_EVERY: Duration = Duration::from_millis(250);
/// How often jobs of this process are asked for that somebody else wants stopped, where no news come.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// How long no other worker is woken by news, in the mean.
const WAKE_REST: Duration = Duration::from_millis(200);
/// How often files without a name are looked for.
const ORPHANS_EVERY: Duration = Duration::from_secs(3600);
/// A lease is extended this many times before it would end.
const BEATS_PER_LEASE: u32 = 5;
/// Work that does not yield is given up after this time; its thread stays busy.
const PATIENCE: Duration = Duration::from_secs(10);

pub fn start(core: &Arc<Core>) {
    if let Some(handle) = core.handle() {
        handle.spawn(keep(core.clone()));
        if let Some(news) = core.jobs.news() {
            let queued = Arc::new(Notify::new());
            handle.spawn(hear(Arc::downgrade(core), news, queued.clone()));
            handle.spawn(wake_one(Arc::downgrade(core), queued));
        }
    }
}

/// What comes round.
struct Round {
    every: Duration,
    last: Instant,
}

impl Round {
    fn new(every: Duration) -> Self {
        Self { every, last: Instant::now() }
    }

    fn comes(&mut self) -> bool {
        let comes = self.last.elapsed() >= self.every;
        if comes {
            self.last = Instant::now();
        }
        comes
    }
}

async fn keep(core: Arc<Core>) {
    let tick = core.settings.sweep_every.clamp(Duration::from_millis(1), NEWS_EVERY);
    let mut beat = Round::new(core.settings.lease / BEATS_PER_LEASE);
    let (mut look, mut news) = (Round::new(LOOK_EVERY), Round::new(NEWS_EVERY));
    let (mut sweep, mut orphans) = (Round::new(core.settings.sweep_every), Round::new(ORPHANS_EVERY));
    let told = core.jobs.news().is_some();
    let mut idle_bytes = memory::resident_bytes().unwrap_or(0);
    // While work is given back, leases are kept; afterwards there is nothing to keep.
    while !core.is_closed() || core.running.count() > 0 {
        tokio::time::sleep(tick).await;
        core.running.stop_overdue(Instant::now());
        watch_memory(&core, &mut idle_bytes);
        // Leases before the sweep: a process that was stopped for long and woke finds its own jobs first.
        let kept = async {
            if beat.comes() {
                let leases = core.running.leases();
                heed(&core, &leases, core.jobs.extend(&leases).await?);
            } else if !told && look.comes() {
                let leases = core.running.leases();
                heed(&core, &leases, core.jobs.look_at(&leases).await?);
            }
            if news.comes() {
                tell_news(&core).await?;
            }
            give_up_stuck(&core).await?;
            if sweep.comes() {
                sweep_up(&core).await?;
            }
            if orphans.comes() && core.jobs.take_turn(Duty::RemoveOrphans, ORPHANS_EVERY).await? {
                core.collect_garbage().await?;
                core.remove_orphans().await?;
            }
            Ok::<_, StoreFailure>(())
        };
        if let Err(error) = kept.await {
            tracing::error!(%error, "the job store could not be kept up");
        }
    }
}

/// Passes on what other processes tell.
async fn hear(core: Weak<Core>, mut news: Receiver<News>, queued: Arc<Notify>) {
    loop {
        let heard = match news.recv().await {
            Ok(heard) => heard,
            Err(RecvError::Lagged(_)) => News::Missed,
            Err(RecvError::Closed) => return,
        };
        let Some(core) = core.upgrade() else { return };
        match heard {
            News::Job(id) => core.watchers.tell(id),
            News::Stop(id) => {
                if let Some(lease) = core.running.lease_of(id) {
                    match core.jobs.look_at(&[lease]).await {
                        Ok(states) => heed(&core, &[lease], states),
                        Err(error) => tracing::warn!(%error, "a wish to stop is heard with the next beat"),
                    }
                }
            }
            News::Queued => queued.notify_one(),
            News::Missed => {
                core.watchers.tell_all();
                core.wake.notify_waiters();
            }
        }
    }
}

/// Wakes a worker for news of waiting jobs, and then rests: every process hears of every job, and few can have it.
async fn wake_one(core: Weak<Core>, queued: Arc<Notify>) {
    loop {
        queued.notified().await;
        match core.upgrade() {
            Some(core) => core.wake.notify_one(),
            None => return,
        }
        // Not all of them at the same time.
        let uneven = u32::from(Uuid::now_v7().as_bytes()[15]);
        tokio::time::sleep(WAKE_REST / 2 + WAKE_REST * uneven / 256).await;
    }
}

fn heed(core: &Core, leases: &[super::store::Lease], states: Vec<LeaseState>) {
    for (lease, state) in leases.iter().zip(states) {
        match state {
            LeaseState::Held => {}
            LeaseState::CancelRequested => core.running.stop(lease.job, Stop::Asked),
            LeaseState::Lost => {
                tracing::warn!(job.id = %lease.job, lease.attempt, "a late attempt stops: the job is in other hands or over");
                core.running.stop(lease.job, Stop::Fenced);
            }
        }
    }
}

async fn tell_news(core: &Core) -> Result<(), StoreFailure> {
    for (lease, stage) in core.running.take_news() {
        // Fenced work is found out by its lease.
        core.jobs.advance(lease, stage).await?;
        core.watchers.tell(lease.job);
    }
    Ok(())
}

/// Work that was asked to stop long ago ends without it.
async fn give_up_stuck(core: &Core) -> Result<(), StoreFailure> {
    for (lease, stop, stage) in core.running.take_stuck(Instant::now(), PATIENCE) {
        tracing::error!(job.id = %lease.job, ?stop, "the work does not yield; its job ends without it");
        if let Some(ended) = stuck(stop, stage) {
            core.jobs.finish(lease, Ending { outcome: Err(ended), stage, timings: Vec::new() }).await?;
            core.collect_garbage().await?;
            core.watchers.tell(lease.job);
        }
    }
    Ok(())
}

/// Beyond the bound, beside what the process has when it is idle, the job that is expected to need most is stopped. One at a time: it needs a moment to give its
/// memory back.
fn watch_memory(core: &Core, idle_bytes: &mut u64) {
    let (max, Some(resident)) = (core.settings.memory_max(), memory::resident_bytes()) else { return };
    if core.running.count() == 0 {
        // What the allocator keeps between jobs is nobody's.
        *idle_bytes = resident;
    }
    let taken = resident.saturating_sub(*idle_bytes);
    if taken > max && !core.running.any_stopped() {
        core.running.stop_largest(Stop::OutOfMemory { taken, max });
    }
}

async fn sweep_up(core: &Core) -> Result<(), StoreFailure> {
    let memory = Memory { records_time: core.settings.records_time, records_max: core.settings.records_max };
    let swept = core.jobs.sweep(memory).await?;
    for id in &swept.changed {
        core.watchers.tell(*id);
    }
    core.watchers.tidy();
    if swept.requeued > 0 {
        core.wake.notify_waiters();
    }
    if swept.freed {
        core.collect_garbage().await?;
    }
    Ok(())
}
