//! Requests under way on one connection. A caller of HTTP/2 can leave one answer untaken while the connection itself moves;
//! a connection without requests takes a place that others could have. Both are seen here.

use axum::body::{Body, HttpBody};
use axum::http::Version;
use bytes::Bytes;
use http_body::{Frame, SizeHint};
use std::collections::HashMap;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::time::Instant;

/// The exchanges of one connection.
#[derive(Debug)]
pub struct Exchanges(Mutex<State>);

#[derive(Debug)]
struct State {
    begun: u64,
    open: usize,
    /// Since when none is open.
    idle_since: Instant,
    /// Answers of which a part was handed on and the next not asked for yet, and since when.
    waiting: HashMap<u64, Instant>,
}

/// How a connection stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    Busy,
    /// For so long no request is under way.
    Idle(Duration),
    /// For so long the caller has taken nothing of an answer.
    Waiting(Duration),
}

impl Default for Exchanges {
    fn default() -> Self {
        let state = State { begun: 0, open: 0, idle_since: Instant::now(), waiting: HashMap::new() };
        Self(Mutex::new(state))
    }
}

impl Exchanges {
    pub fn begin(self: &Arc<Self>, version: Version) -> Exchange {
        let mut state = self.state();
        state.begun += 1;
        state.open += 1;
        Exchange { of: self.clone(), number: state.begun, multiplexed: version == Version::HTTP_2 }
    }

    pub fn standing(&self, now: Instant) -> Standing {
        let state = self.state();
        if state.open == 0 {
            return Standing::Idle(now.saturating_duration_since(state.idle_since));
        }
        let longest = state.waiting.values().min();
        longest.map_or(Standing::Busy, |since| Standing::Waiting(now.saturating_duration_since(*since)))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// One request, until its answer is written or given up.
#[derive(Debug)]
pub struct Exchange {
    of: Arc<Exchanges>,
    number: u64,
    /// Others share the connection, so that its own writes tell nothing of this one.
    multiplexed: bool,
}

impl Exchange {
    fn asked_for_more(&self) {
        if self.multiplexed {
            self.of.state().waiting.remove(&self.number);
        }
    }

    fn gave(&self) {
        if self.multiplexed {
            self.of.state().waiting.insert(self.number, Instant::now());
        }
    }
}

impl Drop for Exchange {
    fn drop(&mut self) {
        let mut state = self.of.state();
        state.waiting.remove(&self.number);
        state.open -= 1;
        state.idle_since = Instant::now();
    }
}

/// The body of an answer, watched while it is taken.
pub struct Watched {
    body: Body,
    exchange: Exchange,
}

impl Watched {
    pub fn new(body: Body, exchange: Exchange) -> Self {
        Self { body, exchange }
    }
}

impl HttpBody for Watched {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        self.exchange.asked_for_more();
        let frame = ready!(Pin::new(&mut self.body).poll_frame(context));
        if frame.is_some() {
            self.exchange.gave();
        }
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use http_body_util::BodyExt;

    #[tokio::test]
    async fn an_answer_that_is_not_taken_and_a_connection_without_requests_are_seen() {
        let exchanges = Arc::new(Exchanges::default());
        let soon = || Instant::now() + Duration::from_secs(9);
        assert!(matches!(exchanges.standing(soon()), Standing::Idle(time) if time >= Duration::from_secs(8)));
        let mut answer = Watched::new(Body::from("bytes"), exchanges.begin(Version::HTTP_2));
        assert_eq!(exchanges.standing(soon()), Standing::Busy, "it is being made");
        let frame = answer.frame().await;
        assert!(frame.is_some());
        assert!(matches!(exchanges.standing(soon()), Standing::Waiting(time) if time >= Duration::from_secs(8)));
        assert!(answer.frame().await.is_none(), "asked for more");
        assert_eq!(exchanges.standing(soon()), Standing::Busy);
        drop(answer);
        assert!(matches!(exchanges.standing(soon()), Standing::Idle(_)));
    }
}
