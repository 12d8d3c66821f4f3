//! Connections: how many, which HTTP they speak, and how long they may be silent. HTTP/1.1 serves REST; HTTP/2 without TLS
//! ("prior knowledge") serves REST and gRPC; the first bytes tell which.

use super::exchanges::{Exchanges, Standing, Watched};
use axum::Router;
use axum::body::Body;
use axum::extract::Request;
use hyper::body::Incoming;
use hyper::server::conn::{http1, http2};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::graceful::GracefulConnection;
use std::fmt::Display;
use std::io;
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, watch};
use tokio::time::{Instant, MissedTickBehavior, Sleep, interval, sleep_until, timeout};
use tower::ServiceExt;

/// Limits of one connection, and of all together.
#[derive(Clone, Copy, Debug)]
pub struct ConnectionLimits {
    pub connections_max: usize,
    /// For the header of a request; also for a connection that sends none.
    pub header_time_max: Duration,
    pub header_bytes_max: usize,
    /// In which the caller takes no byte of an answer.
    pub write_pause_max: Duration,
    /// Requests at the same time on one HTTP/2 connection.
    pub streams_max: u32,
}

impl Default for ConnectionLimits {
    fn default() -> Self {
        Self {
            connections_max: 1024,
            header_time_max: Duration::from_secs(30),
            header_bytes_max: 64 * 1024,
            write_pause_max: Duration::from_secs(60),
            streams_max: 100,
        }
    }
}

/// After a failed accept, which means that descriptors ran out: others must close first.
const ACCEPT_PAUSE: Duration = Duration::from_millis(200);
/// How often an HTTP/2 peer is asked whether it is there, and how long it may take to say so.
const PING: Duration = Duration::from_secs(20);
/// For a connection that was told to close.
const CLOSE_TIME: Duration = Duration::from_secs(5);
/// How an HTTP/2 connection begins (RFC 9113, section 3.4). No request of HTTP/1 begins like it.
const HTTP2_PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

/// Serves connections of `listener` until `closed` resolves, then lets requests under way end within `last_wait`.
pub async fn serve(
    listener: TcpListener,
    router: Router,
    limits: ConnectionLimits,
    closed: impl Future<Output = ()>,
    last_wait: Duration,
) {
    let places = u32::try_from(limits.connections_max).unwrap_or(u32::MAX);
    let room = Arc::new(Semaphore::new(places as usize));
    let (closing, closing_seen) = watch::channel(false);
    let mut closed = pin!(closed);
    loop {
        // More callers than there is room for wait in the operating system's queue.
        let next = async {
            let permit = room.clone().acquire_owned().await;
            (permit, listener.accept().await)
        };
        let (permit, accepted) = tokio::select! {
            next = next => next,
            () = &mut closed => break,
        };
        let stream = match accepted {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!(%error, "a connection could not be taken");
                tokio::time::sleep(ACCEPT_PAUSE).await;
                continue;
            }
        };
        // Answers are written whole; waiting for more of them only delays.
        let _ = stream.set_nodelay(true);
        let (stream, router, closing) =
            (Patient::new(stream, limits.write_pause_max), router.clone(), closing_seen.clone());
        tokio::spawn(async move {
            let _permit = permit;
            converse(stream, router, limits, closing).await;
        });
    }
    drop(listener);
    closing.send_replace(true);
    // Every connection gives its place back when it ends.
    if timeout(last_wait, room.acquire_many(places)).await.is_err() {
        tracing::warn!("some connections were still open at the end");
    }
}

/// One connection, from its first byte to its last.
async fn converse(mut stream: Patient, router: Router, limits: ConnectionLimits, mut closing: watch::Receiver<bool>) {
    let opened = tokio::select! {
        opened = timeout(limits.header_time_max, stream.opens_http2()) => opened,
        () = closes(&mut closing) => return,
    };
    let Ok(Ok(http2)) = opened else { return };
    let exchanges = Arc::new(Exchanges::default());
    let service = hyper::service::service_fn({
        let exchanges = exchanges.clone();
        move |request: Request<Incoming>| {
            let exchange = exchanges.begin(request.version());
            let answer = router.clone().oneshot(request.map(Body::new));
            async move { answer.await.map(|response| response.map(|body| Watched::new(body, exchange))) }
        }
    });
    let io = TokioIo::new(stream);
    if http2 {
        let mut http = http2::Builder::new(TokioExecutor::new());
        http.timer(TokioTimer::new())
            .max_header_list_size(u32::try_from(limits.header_bytes_max).unwrap_or(u32::MAX))
            .max_concurrent_streams(limits.streams_max)
            .keep_alive_interval(PING)
            .keep_alive_timeout(PING);
        attend(http.serve_connection(io, service), &exchanges, limits, closing).await;
    } else {
        let mut http = http1::Builder::new();
        http.timer(TokioTimer::new())
            .header_read_timeout(limits.header_time_max)
            .max_header_size(limits.header_bytes_max);
        attend(http.serve_connection(io, service), &exchanges, limits, closing).await;
    }
}

/// Drives a connection to its end: its own, that of the service, or that of our patience.
async fn attend<C>(connection: C, exchanges: &Exchanges, limits: ConnectionLimits, mut closing: watch::Receiver<bool>)
where
    C: GracefulConnection,
    C::Error: Display,
{
    let mut connection = pin!(connection);
    let shortest = limits.header_time_max.min(limits.write_pause_max) / 4;
    let mut look = interval(shortest.clamp(Duration::from_millis(10), Duration::from_secs(5)));
    look.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut told_to_close = false;
    loop {
        let close = tokio::select! {
            ended = connection.as_mut() => {
                // Broken connections are everyday life and not ours to mend.
                if let Err(error) = ended {
                    tracing::debug!(%error, "a connection ended");
                }
                return;
            }
            () = closes(&mut closing), if !told_to_close => true,
            _ = look.tick() => match exchanges.standing(Instant::now()) {
                Standing::Waiting(time) if time >= limits.write_pause_max => return,
                Standing::Idle(time) if time >= limits.header_time_max + CLOSE_TIME => return,
                Standing::Idle(time) => time >= limits.header_time_max,
                Standing::Waiting(_) | Standing::Busy => false,
            },
        };
        if close && !told_to_close {
            told_to_close = true;
            connection.as_mut().graceful_shutdown();
        }
    }
}

/// Resolves when the service closes.
async fn closes(closing: &mut watch::Receiver<bool>) {
    // An error says that nobody serves any more, which means the same.
    _ = closing.wait_for(|closing| *closing).await;
}

/// A stream that remembers what was read to find out what it is, and whose writes fail when the other side takes
/// nothing for too long.
struct Patient {
    stream: TcpStream,
    /// Read, and not yet given.
    head: Vec<u8>,
    pause_max: Duration,
    /// Runs while a write waits.
    waiting: Option<Pin<Box<Sleep>>>,
}

impl Patient {
    fn new(stream: TcpStream, pause_max: Duration) -> Self {
        Self { stream, head: Vec::new(), pause_max, waiting: None }
    }

    /// Whether the other side begins to speak HTTP/2.
    async fn opens_http2(&mut self) -> io::Result<bool> {
        loop {
            let read = self.stream.read_buf(&mut self.head).await?;
            if self.head.starts_with(HTTP2_PREFACE) {
                return Ok(true);
            }
            if read == 0 || !HTTP2_PREFACE.starts_with(&self.head) {
                return Ok(false);
            }
        }
    }

    /// `written`, or an error once writes have waited for too long.
    fn patience<T>(&mut self, context: &mut Context, written: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if written.is_ready() {
            self.waiting = None;
            return written;
        }
        let until = Instant::now() + self.pause_max;
        let waiting = self.waiting.get_or_insert_with(|| Box::pin(sleep_until(until)));
        ready!(waiting.as_mut().poll(context));
        Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
    }
}

impl AsyncRead for Patient {
    fn poll_read(mut self: Pin<&mut Self>, context: &mut Context, buffer: &mut ReadBuf) -> Poll<io::Result<()>> {
        if self.head.is_empty() {
            return Pin::new(&mut self.stream).poll_read(context, buffer);
        }
        let given = self.head.len().min(buffer.remaining());
        buffer.put_slice(&self.head[..given]);
        self.head.drain(..given);
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Patient {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.patience(context, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context,
        slices: &[io::IoSlice],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, slices);
        self.patience(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context) -> Poll<io::Result<()>> {
        let flushed = Pin::new(&mut self.stream).poll_flush(context);
        self.patience(context, flushed)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}
