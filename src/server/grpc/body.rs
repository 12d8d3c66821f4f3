//! Requests as they arrive: how long they may pause, and how long they may take.

use super::super::http::receive;
use super::super::http::sink::Deadline;
use axum::body::{Body, HttpBody};
use bytes::Bytes;
use http_body::{Frame, SizeHint};
use std::pin::Pin;
use std::task::{Context, Poll};
use tokio::time::{Instant, Sleep, sleep_until};
use tonic::Status;

/// A body that fails when its sender is too slow. Time in which nobody reads does not count.
pub struct TimedBody {
    body: Body,
    deadline: Deadline,
    /// Runs while bytes are waited for.
    waiting: Option<(Instant, Pin<Box<Sleep>>)>,
}

impl TimedBody {
    pub fn new(body: Body, deadline: Deadline) -> Self {
        Self { body, deadline, waiting: None }
    }
}

impl HttpBody for TimedBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let this = &mut *self;
        if let Poll::Ready(frame) = Pin::new(&mut this.body).poll_frame(context) {
            this.waiting = None;
            return Poll::Ready(frame.map(|frame| frame.map_err(|_| receive::incomplete().into())));
        }
        let (until, sleep) = this.waiting.get_or_insert_with(|| {
            let until = this.deadline.next();
            (until, Box::pin(sleep_until(until)))
        });
        let until = *until;
        sleep.as_mut().poll(context).map(|()| Some(Err(this.deadline.passed(until).into())))
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
