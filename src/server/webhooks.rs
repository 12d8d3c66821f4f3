//! Sending webhooks: what is due is taken from the store, sent by [`crate::outgoing`], and what became of it is noted. Any number
//! of processes may do so: each message is sent by one at a time.

pub mod message;

use super::App;
use crate::jobs::StoreFailure;
use crate::jobs::webhooks::{ANSWER_TIME, DueDelivery, Tried, Verdict};
use crate::outgoing::Outgoing;
use crate::telemetry::metrics::WEBHOOKS;
use metrics::counter;
use reqwest::Response;
use reqwest::header::RETRY_AFTER;
use std::time::{Duration, Instant, SystemTime};
use tokio::task::JoinSet;

/// Messages under way from this process at the same time.
const UNDER_WAY_MAX: usize = 32;
/// How often the store is looked at while nothing is under way.
const LOOK: Duration = Duration::from_millis(500);
/// When the service stops: for what is due then, and what is under way. The rest goes on at the next start or elsewhere.
const LAST_TIME: Duration = Duration::from_secs(5);

/// Sends what is due until the service closes.
pub async fn send(app: App, outgoing: Outgoing) {
    let mut closing = app.closing.subscribe();
    let mut under_way = JoinSet::new();
    loop {
        take_up(&app, &outgoing, &mut under_way).await;
        tokio::select! {
            () = tokio::time::sleep(LOOK) => {}
            Some(_) = under_way.join_next() => {}
            _ = closing.wait_for(|closing| *closing) => break,
        }
    }
    let flush = async {
        loop {
            take_up(&app, &outgoing, &mut under_way).await;
            if under_way.join_next().await.is_none() {
                return;
            }
        }
    };
    if tokio::time::timeout(LAST_TIME, flush).await.is_err() {
        tracing::warn!("some webhooks were not answered in time; they are sent again");
    }
}

/// Begins to send what is due, as far as there is room.
async fn take_up(app: &App, outgoing: &Outgoing, under_way: &mut JoinSet<()>) {
    while under_way.try_join_next().is_some() {}
    let room = UNDER_WAY_MAX.saturating_sub(under_way.len());
    if room == 0 {
        return;
    }
    match app.jobs.claim_deliveries(room).await {
        Ok(due) => {
            for due in due {
                let (app, outgoing) = (app.clone(), outgoing.clone());
                under_way.spawn(async move {
                    if let Err(error) = attempt(&app, &outgoing, &due).await {
                        tracing::error!(%error, "what became of a webhook could not be noted; it is sent again");
                    }
                });
            }
        }
        Err(error) => tracing::error!(%error, "webhooks could not be looked at"),
    }
}

/// Sends a message once, and notes what became of it.
async fn attempt(app: &App, outgoing: &Outgoing, due: &DueDelivery) -> Result<(), StoreFailure> {
    let tried = deliver(outgoing, due, SystemTime::now()).await;
    let verdict = app.jobs.note_attempt(due, &tried).await?;
    let (id, endpoint, error) = (due.message.id, due.endpoint, tried.error.as_deref().unwrap_or_default());
    match verdict {
        Some(Verdict::Delivered) => tracing::debug!(webhook.id = %id, %endpoint, "a webhook is delivered"),
        Some(verdict) => {
            tracing::info!(webhook.id = %id, %endpoint, due.attempt, verdict = verdict.name(), "a webhook was not taken: {error}");
        }
        None => tracing::debug!(webhook.id = %id, %endpoint, "a webhook is not wanted any more"),
    }
    if let Some(verdict) = verdict {
        counter!(WEBHOOKS, "outcome" => verdict.name()).increment(1);
    }
    Ok(())
}

async fn deliver(outgoing: &Outgoing, due: &DueDelivery, now: SystemTime) -> Tried {
    let body = message::body(&due.message);
    let headers = message::headers(due.message.id, now, body.as_bytes(), &due.secrets);
    let began = Instant::now();
    let answer = outgoing.post(&due.url, headers, body.into(), ANSWER_TIME).await;
    let duration = began.elapsed();
    match answer {
        Ok(answer) => {
            let status = answer.status();
            let error = match status.as_u16() {
                200..300 => None,
                300..400 => Some(format!("it answered {}, and redirects are not followed", status.as_u16())),
                other => Some(format!("it answered {other}")),
            };
            Tried { duration, status: Some(status.as_u16()), error, retry_after: retry_after(&answer, now) }
        }
        Err(error) => Tried { duration, status: None, error: Some(error.to_string()), retry_after: None },
    }
}

/// How long the answer asks to be left alone: in seconds, or until a date.
fn retry_after(answer: &Response, now: SystemTime) -> Option<Duration> {
    let text = answer.headers().get(RETRY_AFTER)?.to_str().ok()?.trim();
    match text.parse() {
        Ok(seconds) => Some(Duration::from_secs(seconds)),
        Err(_) => httpdate::parse_http_date(text).ok()?.duration_since(now).ok(),
    }
}
