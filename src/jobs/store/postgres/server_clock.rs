//! The database server's time, without asking for it every time.

use crate::jobs::clock::{Clock, SteadyClock, Timestamp};
use crate::jobs::store::StoreFailure;
use sqlx::postgres::PgPool;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

/// How often the difference is measured anew.
const EVERY: Duration = Duration::from_secs(60);

/// This machine's steady clock and its difference from the server's, measured once a minute. Two machines differ by the
/// time of a round trip and what their clocks drift in a minute: little beside a lease.
pub struct ServerClock {
    steady: SteadyClock,
    /// Milliseconds that the server is ahead.
    ahead: AtomicI64,
}

impl Clock for ServerClock {
    fn now(&self) -> Timestamp {
        Timestamp(self.steady.now().0.saturating_add(self.ahead.load(Ordering::Relaxed)))
    }
}

impl ServerClock {
    /// Measures, and goes on measuring until the clock is dropped or the pool closed.
    pub async fn start(pool: &PgPool) -> Result<Arc<Self>, StoreFailure> {
        let clock = Arc::new(Self { steady: SteadyClock::default(), ahead: AtomicI64::new(0) });
        clock.measure(pool).await?;
        tokio::spawn(keep_measuring(Arc::downgrade(&clock), pool.clone()));
        Ok(clock)
    }

    async fn measure(&self, pool: &PgPool) -> Result<(), StoreFailure> {
        let mut connection = pool.acquire().await?;
        let asked = self.steady.now().0;
        let server: i64 = sqlx::query_scalar("SELECT CAST(1000 * extract(epoch FROM clock_timestamp()) AS BIGINT)")
            .fetch_one(&mut *connection)
            .await?;
        let answered = self.steady.now().0;
        self.ahead.store(server - (asked + (answered - asked) / 2), Ordering::Relaxed);
        Ok(())
    }
}

async fn keep_measuring(clock: Weak<ServerClock>, pool: PgPool) {
    loop {
        tokio::time::sleep(EVERY).await;
        let Some(clock) = clock.upgrade() else { return };
        if pool.is_closed() {
            return;
        }
        if let Err(error) = clock.measure(&pool).await {
            tracing::warn!(%error, "the database's time could not be asked; the last difference holds");
        }
    }
}
