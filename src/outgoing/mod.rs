//! Requests that the service makes itself, to places that its callers name: the one way out, and the guard before it.
//!
//! A name is resolved once; every address that it has must be public ([`addresses`]); the connection goes to those very
//! addresses, so that an answer that changes afterwards changes nothing. Addresses written as numbers are held to the same.
//! Redirects are not followed. Only `https` is spoken. Hosts that the operator names are excepted from all of that but the
//! redirects.

mod addresses;

pub use addresses::is_public;

use bytes::Bytes;
use reqwest::dns::{Addrs, Name, Resolve, Resolving};
use reqwest::header::HeaderMap;
use reqwest::redirect::Policy;
use reqwest::{Client, Method, Response, Url};
use rustls::crypto::ring;
use std::error::Error;
use std::future::Future;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

const CONNECT_TIME_MAX: Duration = Duration::from_secs(10);
const URL_BYTES_MAX: usize = 2048;

/// How names become addresses.
pub trait Names: Send + Sync + 'static {
    fn resolve(&self, name: &str) -> Pin<Box<dyn Future<Output = io::Result<Vec<IpAddr>>> + Send>>;
}

/// As the operating system does it.
pub struct SystemNames;

impl Names for SystemNames {
    fn resolve(&self, name: &str) -> Pin<Box<dyn Future<Output = io::Result<Vec<IpAddr>>> + Send>> {
        let name = name.to_owned();
        Box::pin(async move {
            let found = tokio::net::lookup_host((name.as_str(), 0)).await?;
            Ok(found.map(|address| address.ip()).collect())
        })
    }
}

/// Why a request was not made, or not answered.
#[derive(Debug, thiserror::Error)]
pub enum OutgoingError {
    #[error("{0}")]
    Url(String),
    #[error("{0} does not lead to the public internet")]
    Inside(String),
    #[error("it answered with a redirect to {0}, and redirects are not followed")]
    Redirect(String),
    #[error("it answered {0}")]
    Status(u16),
    #[error("it gave no answer within {} s", .0.as_secs())]
    Late(Duration),
    #[error("it could not be reached: {0}")]
    Unreachable(String),
}

/// The way out. Clones share it.
#[derive(Clone)]
pub struct Outgoing {
    client: Client,
    guard: Arc<Guard>,
}

struct Guard {
    names: Arc<dyn Names>,
    /// Hosts that the operator trusts, in lower case.
    trusted: Vec<String>,
}

impl Outgoing {
    /// `trusted` are hosts, as names or numbers, that may be anywhere and speak `http`.
    pub fn new(names: Arc<dyn Names>, trusted: &[String]) -> Result<Self, OutgoingError> {
        // Only the first of a process is installed; all are the same.
        let _ = ring::default_provider().install_default();
        let trusted = trusted.iter().map(|host| host.trim_matches(['[', ']']).to_ascii_lowercase()).collect();
        let guard = Arc::new(Guard { names, trusted });
        let client = Client::builder()
            .user_agent(concat!("rigsmith/", env!("CARGO_PKG_VERSION")))
            // Every request asks anew where its host is.
            .pool_max_idle_per_host(0)
            .no_proxy()
            .redirect(Policy::none())
            .connect_timeout(CONNECT_TIME_MAX)
            .dns_resolver(Guarded(guard.clone()))
            .build()
            .map_err(|error| OutgoingError::Unreachable(error.to_string()))?;
        Ok(Self { client, guard })
    }

    /// The answer of a place, when it is a good one. Its body is not read yet.
    pub async fn get(&self, url: &str) -> Result<Response, OutgoingError> {
        let url = self.guard.checked(url)?;
        let response = self.client.request(Method::GET, url).send().await.map_err(|error| cause(&error))?;
        let status = response.status();
        if status.is_redirection() {
            let to = response.headers().get("location").and_then(|to| to.to_str().ok()).unwrap_or("nowhere");
            return Err(OutgoingError::Redirect(to.chars().take(200).collect()));
        }
        if !status.is_success() {
            return Err(OutgoingError::Status(status.as_u16()));
        }
        Ok(response)
    }

    /// Whether a place may be told anything, as far as its URL says. What its name leads to is looked at when it is told.
    pub fn check(&self, url: &str) -> Result<(), OutgoingError> {
        self.guard.checked(url).map(|_| ())
    }

    /// Tells a place something. Gives the head of its answer, whatever it says, if it comes within `time`; the body, which
    /// may never end, is not read.
    pub async fn post(
        &self,
        url: &str,
        headers: HeaderMap,
        body: Bytes,
        time: Duration,
    ) -> Result<Response, OutgoingError> {
        let url = self.guard.checked(url)?;
        let request = self.client.request(Method::POST, url).headers(headers).body(body).timeout(time);
        request.send().await.map_err(|error| if error.is_timeout() { OutgoingError::Late(time) } else { cause(&error) })
    }
}

/// What went wrong, as far as it helps whoever named the place.
fn cause(error: &reqwest::Error) -> OutgoingError {
    let mut source: Option<&(dyn Error + 'static)> = Some(error);
    let mut innermost = String::new();
    while let Some(error) = source {
        if let Some(Inside(name)) = error.downcast_ref::<Inside>() {
            return OutgoingError::Inside(name.clone());
        }
        innermost = error.to_string();
        source = error.source();
    }
    OutgoingError::Unreachable(innermost)
}

/// A name with an address that is not public.
#[derive(Debug, thiserror::Error)]
#[error("{0} does not lead to the public internet")]
struct Inside(String);

impl Guard {
    fn trusts(&self, host: &str) -> bool {
        self.trusted.iter().any(|trusted| *trusted == host.to_ascii_lowercase())
    }

    /// A URL that may be asked. Names are looked at again when they are resolved.
    fn checked(&self, text: &str) -> Result<Url, OutgoingError> {
        let refused = |why: &str| OutgoingError::Url(why.to_owned());
        if text.len() > URL_BYTES_MAX {
            return Err(refused(&format!("the URL has more than {URL_BYTES_MAX} bytes")));
        }
        let url = Url::parse(text).map_err(|error| refused(&format!("that is no URL: {error}")))?;
        let host = url.host_str().ok_or_else(|| refused("the URL names no host"))?;
        let host = host.trim_matches(['[', ']']).to_owned();
        let trusted = self.trusts(&host);
        if url.scheme() != "https" && !(trusted && url.scheme() == "http") {
            return Err(refused("only https is spoken"));
        }
        if !url.username().is_empty() || url.password().is_some() {
            return Err(refused("the URL holds a name or password"));
        }
        match host.parse::<IpAddr>() {
            Ok(address) if !trusted && !is_public(address) => Err(OutgoingError::Inside(host)),
            _ => Ok(url),
        }
    }

    /// The addresses of a name, all of which may be asked.
    async fn addresses(&self, name: &str) -> Result<Vec<IpAddr>, Box<dyn Error + Send + Sync>> {
        let found = self.names.resolve(name).await?;
        if !self.trusts(name) && !found.iter().all(|address| is_public(*address)) {
            return Err(Box::new(Inside(name.to_owned())));
        }
        Ok(found)
    }
}

/// The guard as the client's resolver: it connects to nothing else than what this gives.
struct Guarded(Arc<Guard>);

impl Resolve for Guarded {
    fn resolve(&self, name: Name) -> Resolving {
        let guard = self.0.clone();
        Box::pin(async move {
            let addresses = guard.addresses(name.as_str()).await?;
            let addresses: Addrs = Box::new(addresses.into_iter().map(|address| SocketAddr::new(address, 0)));
            Ok(addresses)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Answers in turn; the last one stays.
    struct Changing(Vec<Vec<&'static str>>, AtomicUsize);

    impl Names for Changing {
        fn resolve(&self, _: &str) -> Pin<Box<dyn Future<Output = io::Result<Vec<IpAddr>>> + Send>> {
            let turn = self.1.fetch_add(1, Ordering::SeqCst).min(self.0.len() - 1);
            let answer = self.0[turn].iter().map(|address| address.parse().expect("an address")).collect();
            Box::pin(async move { Ok(answer) })
        }
    }

    fn guard(answers: Vec<Vec<&'static str>>, trusted: &[&str]) -> Guard {
        let trusted = trusted.iter().map(|&host| host.to_owned()).collect();
        Guard { names: Arc::new(Changing(answers, AtomicUsize::new(0))), trusted }
    }

    #[tokio::test]
    async fn what_is_checked_is_what_is_given_and_one_address_inside_spoils_the_name() {
        let guard = guard(vec![vec!["1.1.1.1", "2606:4700:4700::1111"], vec!["1.1.1.1", "127.0.0.1"], vec![]], &[]);
        let first = guard.addresses("changing.example").await.expect("public");
        assert_eq!(first, ["1.1.1.1", "2606:4700:4700::1111"].map(|text| text.parse::<IpAddr>().expect("an address")));
        let second = guard.addresses("changing.example").await.expect_err("it leads inside now");
        assert!(second.downcast_ref::<Inside>().is_some());
        assert_eq!(guard.addresses("changing.example").await.expect("nothing to connect to"), Vec::<IpAddr>::new());
    }

    #[test]
    fn urls_are_held_to_the_rules_however_they_are_written() {
        let guard = guard(vec![vec![]], &["files.lan", "127.0.0.1"]);
        for refused in [
            "",
            "nonsense",
            "ftp://example.com/a",
            "file:///etc/passwd",
            "http://example.com/a",
            "https://",
            "https://user:secret@example.com/a",
            "https://user@example.com/a",
            "https://127.0.0.2/",
            "https://127.1.1/",
            "https://2130706434/",
            "https://0x7f000002/",
            "https://0177.0.0.2/",
            "https://[::1]/",
            "https://[::ffff:7f00:2]/",
            "https://[::ffff:10.0.0.1]/",
            "https://169.254.169.254/latest/meta-data",
            "https://[fd00:ec2::254]/",
            "https://10.0.0.1/",
            "https://0/",
            "gopher://files.lan/",
        ] {
            assert!(guard.checked(refused).is_err(), "{refused}");
        }
        for fine in [
            "https://example.com/a.glb",
            "https://1.1.1.1:8443/a",
            "http://files.lan/a",
            "http://127.0.0.1:9/a",
            "http://FILES.lan/a",
        ] {
            assert!(guard.checked(fine).is_ok(), "{fine}");
        }
    }
}
