//! An endpoint of webhooks on loopback: keeps what it is sent, and answers as it is told to.

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use hmac::{Hmac, Mac};
use serde_json::Value;
use sha2::Sha256;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::net::TcpListener;

/// What it answers to one message.
#[derive(Clone, Debug)]
pub struct Reply {
    pub status: u16,
    pub retry_after: Option<&'static str>,
    pub location: Option<&'static str>,
    pub after: Duration,
    /// A body that never ends.
    pub endless: bool,
}

impl Reply {
    pub fn with(status: u16) -> Self {
        Self { status, retry_after: None, location: None, after: Duration::ZERO, endless: false }
    }
}

/// A message as it came.
#[derive(Clone, Debug)]
pub struct Received {
    pub headers: HeaderMap,
    pub body: Bytes,
}

impl Received {
    pub fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().expect("ASCII"))
    }

    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).expect("JSON")
    }

    /// Whether one of the signatures is by `secret`.
    pub fn is_signed_by(&self, secret: &str) -> bool {
        let key = BASE64_STANDARD.decode(secret.strip_prefix("whsec_").expect("a secret")).expect("base64");
        let mut mac = Hmac::<Sha256>::new_from_slice(&key).expect("any length");
        mac.update(format!("{}.{}.", self.header("webhook-id"), self.header("webhook-timestamp")).as_bytes());
        mac.update(&self.body);
        let expected = format!("v1,{}", BASE64_STANDARD.encode(mac.finalize().into_bytes()));
        self.header("webhook-signature").split(' ').any(|signature| signature == expected)
    }
}

#[derive(Default)]
struct Seen {
    received: Mutex<Vec<Received>>,
    replies: Mutex<VecDeque<Reply>>,
}

pub struct Receiver {
    pub port: u16,
    seen: Arc<Seen>,
}

impl Receiver {
    pub async fn start() -> Self {
        let seen = Arc::new(Seen::default());
        let router = Router::new().fallback(take).with_state(seen.clone());
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let port = listener.local_addr().expect("an address").port();
        tokio::spawn(async move { axum::serve(listener, router).await });
        Self { port, seen }
    }

    pub fn url(&self) -> String {
        format!("http://hooks.test:{}/hooks", self.port)
    }

    /// What it answers to the next messages; 204 afterwards.
    pub fn answers(&self, replies: impl IntoIterator<Item = Reply>) {
        self.seen.replies.lock().expect("not poisoned").extend(replies);
    }

    pub fn received(&self) -> Vec<Received> {
        self.seen.received.lock().expect("not poisoned").clone()
    }

    /// Waits until `count` messages have come; more must not have.
    pub async fn has(&self, count: usize) -> Vec<Received> {
        for _ in 0..1000 {
            if self.received().len() >= count {
                break;
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        let received = self.received();
        assert_eq!(received.len(), count, "{:#?}", received.iter().map(Received::json).collect::<Vec<_>>());
        received
    }
}

async fn take(State(seen): State<Arc<Seen>>, headers: HeaderMap, body: Bytes) -> Response {
    seen.received.lock().expect("not poisoned").push(Received { headers, body });
    let reply = seen.replies.lock().expect("not poisoned").pop_front().unwrap_or(Reply::with(204));
    tokio::time::sleep(reply.after).await;
    let mut response = StatusCode::from_u16(reply.status).expect("a status").into_response();
    if reply.endless {
        let drops = tokio_stream::iter(std::iter::repeat_with(|| Ok::<_, Infallible>("drop")));
        *response.body_mut() = Body::from_stream(drops);
    }
    for (name, value) in [("retry-after", reply.retry_after), ("location", reply.location)] {
        if let Some(value) = value {
            response.headers_mut().insert(name, value.parse().expect("a header"));
        }
    }
    response
}
