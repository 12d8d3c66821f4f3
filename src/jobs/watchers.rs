//! Who waits for news of a job, within this process.

use super::ids::JobId;
use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;

/// Wakes those who watch a job. Only a hint: the news themselves are in the store.
#[derive(Default)]
pub struct Watchers(Mutex<HashMap<JobId, watch::Sender<()>>>);

impl Watchers {
    fn lock(&self) -> MutexGuard<'_, HashMap<JobId, watch::Sender<()>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn subscribe(&self, id: JobId) -> watch::Receiver<()> {
        self.lock().entry(id).or_insert_with(|| watch::Sender::new(())).subscribe()
    }

    pub fn tell(&self, id: JobId) {
        let mut watched = self.lock();
        if let Some(watchers) = watched.get(&id) {
            if watchers.receiver_count() == 0 {
                watched.remove(&id);
            } else {
                watchers.send_replace(());
            }
        }
    }

    /// Wakes all who watch any job.
    pub fn tell_all(&self) {
        self.lock().values().for_each(|watchers| watchers.send_replace(()));
    }

    /// Forgets jobs that nobody watches any more.
    pub fn tidy(&self) {
        self.lock().retain(|_, watchers| watchers.receiver_count() > 0);
    }
}
