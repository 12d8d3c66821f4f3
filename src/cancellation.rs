//! A request to stop that long work looks at between steps, or is told of while it waits inside a library.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Shared request: one side cancels, the working side asks or is told. Clones share it.
#[derive(Clone, Default)]
pub struct Cancellation(Arc<Shared>);

#[derive(Default)]
struct Shared {
    cancelled: AtomicBool,
    actions: Mutex<Actions>,
}

#[derive(Default)]
struct Actions {
    next: u64,
    waiting: BTreeMap<u64, Box<dyn Fn() + Send>>,
}

/// The work was cancelled; nothing was produced.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the work was cancelled")]
pub struct Cancelled;

/// Forgets its action when dropped.
#[must_use = "the action is forgotten when this is dropped"]
pub struct Registration {
    shared: Arc<Shared>,
    number: u64,
}

impl Cancellation {
    /// Asks the work to stop: at its next look, and at once where an action is registered.
    pub fn cancel(&self) {
        let actions = self.0.lock();
        self.0.cancelled.store(true, Ordering::SeqCst);
        for action in actions.waiting.values() {
            action();
        }
    }

    pub fn is_cancelled(&self) -> bool {
        self.0.cancelled.load(Ordering::SeqCst)
    }

    /// `Err(Cancelled)` once cancelled, for use with `?` inside loops.
    pub fn check(&self) -> Result<(), Cancelled> {
        if self.is_cancelled() { Err(Cancelled) } else { Ok(()) }
    }

    /// Runs `action` when the work is cancelled, or now if it already is. It must be short and not cancel again.
    pub fn on_cancel(&self, action: impl Fn() + Send + 'static) -> Registration {
        let mut actions = self.0.lock();
        if self.is_cancelled() {
            action();
        }
        let number = actions.next;
        actions.next += 1;
        actions.waiting.insert(number, Box::new(action));
        drop(actions);
        Registration { shared: Arc::clone(&self.0), number }
    }
}

impl Shared {
    /// The actions are whole after every operation, so a panic of another holder leaves nothing half done.
    fn lock(&self) -> MutexGuard<'_, Actions> {
        self.actions.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Registration {
    fn drop(&mut self) {
        self.shared.lock().waiting.remove(&self.number);
    }
}

impl std::fmt::Debug for Cancellation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Cancellation").field("cancelled", &self.is_cancelled()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicUsize;

    #[test]
    fn an_action_runs_once_on_cancel_and_never_after_it_was_dropped() {
        let (calls, cancellation) = (Arc::new(AtomicUsize::new(0)), Cancellation::default());
        let count = |calls: &Arc<AtomicUsize>| {
            let calls = Arc::clone(calls);
            move || {
                calls.fetch_add(1, Ordering::SeqCst);
            }
        };
        drop(cancellation.on_cancel(count(&calls)));
        let kept = cancellation.on_cancel(count(&calls));
        cancellation.clone().cancel();
        assert_eq!(calls.load(Ordering::SeqCst), 1);
        assert_eq!(cancellation.check(), Err(Cancelled));
        drop(kept);
        let late = cancellation.on_cancel(count(&calls));
        assert_eq!(calls.load(Ordering::SeqCst), 2, "a late action runs at once");
        drop(late);
    }
}
