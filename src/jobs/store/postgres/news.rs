//! News between processes, by `NOTIFY` on one channel.
//!
//! They are sent a moment after the commit that they tell of, several at once and on a connection of their own: a
//! notification within the transaction would make all commits of the database wait for each other. What is lost when
//! a process ends in between is made up for by everybody's looking again now and then.

use crate::jobs::ids::JobId;
use crate::jobs::store::{News, StoreFailure};
use sqlx::postgres::{PgConnectOptions, PgListener, PgPool, PgPoolOptions};
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::sync::{broadcast, mpsc};
use tokio::task::JoinHandle;

const CHANNEL: &str = "rigsmith";
/// How long news are gathered before they are sent.
const GATHER_TIME: Duration = Duration::from_millis(20);
/// News that wait to be sent; more are dropped.
const WAITING_MAX: usize = 10_000;
/// News that a slow hearer may be behind.
const BEHIND_MAX: usize = 4096;
/// News in one notification, which has room for 8,000 bytes.
const TOGETHER: usize = 200;
/// How long to wait before the server is tried again.
const AGAIN: Duration = Duration::from_secs(1);

/// Both ends of the channel.
pub struct Wire {
    to_send: mpsc::Sender<News>,
    heard: broadcast::Sender<News>,
    pool: PgPool,
    tasks: [JoinHandle<()>; 2],
}

impl Drop for Wire {
    fn drop(&mut self) {
        self.tasks.iter().for_each(JoinHandle::abort);
    }
}

impl Wire {
    /// Listens, and makes ready to send.
    pub async fn start(options: PgConnectOptions) -> Result<Self, StoreFailure> {
        // Lost news cost nothing, so nobody waits until they are on the disk.
        let options = options.options([("synchronous_commit", "off")]);
        let pool = PgPoolOptions::new().max_connections(2).max_lifetime(None).idle_timeout(None);
        let pool = pool.connect_with(options).await?;
        let listener = listen(&pool).await?;
        let (to_send, sending) = mpsc::channel(WAITING_MAX);
        let heard = broadcast::Sender::new(BEHIND_MAX);
        let tasks =
            [tokio::spawn(send(pool.clone(), sending)), tokio::spawn(hear(pool.clone(), listener, heard.clone()))];
        Ok(Self { to_send, heard, pool, tasks })
    }

    pub fn tell(&self, news: News) {
        // News that find no room are lost, as they may be.
        let _ = self.to_send.try_send(news);
    }

    pub fn hear(&self) -> broadcast::Receiver<News> {
        self.heard.subscribe()
    }

    pub async fn close(&self) {
        // What was told last is sent first.
        tokio::time::sleep(2 * GATHER_TIME).await;
        self.tasks.iter().for_each(JoinHandle::abort);
        self.pool.close().await;
    }
}

async fn listen(pool: &PgPool) -> Result<PgListener, sqlx::Error> {
    let mut listener = PgListener::connect_with(pool).await?;
    listener.ignore_pool_close_event(true);
    listener.listen(CHANNEL).await?;
    Ok(listener)
}

async fn hear(pool: PgPool, listener: PgListener, heard: broadcast::Sender<News>) {
    let mut listener = Some(listener);
    loop {
        let Some(listening) = &mut listener else {
            tokio::time::sleep(AGAIN).await;
            listener = listen(&pool).await.ok();
            if listener.is_some() {
                // Nobody hears: nobody minds.
                let _ = heard.send(News::Missed);
            }
            continue;
        };
        match listening.try_recv().await {
            Ok(Some(notification)) => {
                for news in read(notification.payload()) {
                    let _ = heard.send(news);
                }
            }
            Ok(None) => {
                let _ = heard.send(News::Missed);
            }
            Err(error) => {
                tracing::warn!(%error, "news of other processes do not arrive; looking again now and then");
                listener = None;
            }
        }
    }
}

async fn send(pool: PgPool, mut sending: mpsc::Receiver<News>) {
    let mut gathered = Vec::with_capacity(TOGETHER);
    while sending.recv_many(&mut gathered, 1).await > 0 {
        tokio::time::sleep(GATHER_TIME).await;
        while let Ok(news) = sending.try_recv() {
            gathered.push(news);
        }
        let words: BTreeSet<String> = gathered.drain(..).filter_map(word).collect();
        let words: Vec<String> = words.into_iter().collect();
        for together in words.chunks(TOGETHER) {
            let told = sqlx::query("SELECT pg_notify($1, $2)").bind(CHANNEL).bind(together.join(" ")).execute(&pool);
            if let Err(error) = told.await {
                tracing::warn!(%error, "news could not be sent");
            }
        }
    }
}

/// News as a word of a notification.
fn word(news: News) -> Option<String> {
    match news {
        News::Job(id) => Some(id.to_string()),
        News::Stop(id) => Some(format!("-{id}")),
        News::Queued => Some("+".to_owned()),
        News::Missed => None,
    }
}

/// The news of a notification. Words of another version are passed over.
fn read(text: &str) -> impl Iterator<Item = News> + '_ {
    text.split(' ').filter_map(|word| match word.strip_prefix('-') {
        Some(id) => id.parse::<JobId>().ok().map(News::Stop),
        None if word == "+" => Some(News::Queued),
        None => word.parse::<JobId>().ok().map(News::Job),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn news_are_read_as_they_were_told() {
        let news = [News::Job(JobId::new()), News::Stop(JobId::new()), News::Queued];
        let text: Vec<String> = news.into_iter().filter_map(word).collect();
        assert_eq!(read(&text.join(" ")).collect::<Vec<_>>(), news);
        assert_eq!(read("? rig_ -rig_1 ").count(), 0);
        assert!(TOGETHER * (text.iter().map(String::len).max().unwrap_or(0) + 1) < 8000);
    }
}
