//! Connections to PostgreSQL by TLS, as the URL of the database says.

use super::engines::postgres_url;
use rigsmith::jobs::store::LEASE;
use rigsmith::jobs::store::postgres::PostgresStore;
use sqlx::{Connection, PgConnection};

/// The certificate by which the server of the tests is known: it stands for 127.0.0.1 alone.
fn root() -> String {
    std::env::var("TEST_POSTGRES_ROOT").expect("tests/postgres.py names the certificate of its server")
}

/// Why the store does not open, if so.
async fn refusal(url: &str) -> Option<String> {
    PostgresStore::open(url, LEASE).await.err().map(|error| error.to_string())
}

#[tokio::test]
async fn a_connection_is_encrypted_and_its_server_is_who_it_should_be() {
    let url = postgres_url().await;
    let store = PostgresStore::open(&format!("{url}?sslmode=verify-full&sslrootcert={}", root()), LEASE).await;
    let _open = store.expect("opens");
    let mut other = PgConnection::connect(&url).await.expect("connects");
    let encrypted: Vec<bool> = sqlx::query_scalar(
        "SELECT ssl FROM pg_stat_ssl JOIN pg_stat_activity USING (pid) \
         WHERE datname = current_database() AND application_name = 'rigsmith'",
    )
    .fetch_all(&mut other)
    .await
    .expect("answers");
    assert!(encrypted.len() >= 2 && encrypted.iter().all(|encrypted| *encrypted), "{encrypted:?}");
}

#[tokio::test]
async fn a_server_that_cannot_show_who_it_is_is_refused_where_that_is_asked() {
    let url = postgres_url().await;
    assert_eq!(refusal(&format!("{url}?sslmode=require")).await, None, "encrypted, to whomever it is");
    assert_eq!(refusal(&format!("{url}?sslmode=disable")).await, None);
    let unknown = refusal(&format!("{url}?sslmode=verify-full")).await.expect("nobody known vouches for it");
    assert!(unknown.contains("certificate"), "{unknown}");
    let named = url.replace("127.0.0.1", "localhost");
    assert_eq!(refusal(&format!("{named}?sslmode=verify-ca&sslrootcert={}", root())).await, None);
    let another = refusal(&format!("{named}?sslmode=verify-full&sslrootcert={}", root())).await;
    let another = another.expect("it is for another name");
    assert!(another.contains("certificate"), "{another}");
}
