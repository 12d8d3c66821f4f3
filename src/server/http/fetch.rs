//! Meshes that a request names by their address elsewhere.

use super::App;
use super::error::{ApiError, Code};
use super::media;
use super::sink::Sink;
use crate::jobs::Received;
use crate::outgoing::Outgoing;
use crate::server::uploads::{self, empty};
use serde_json::{Map, Value};
use sha2::{Digest, Sha256};

/// What is to be fetched.
#[derive(Debug)]
pub struct Wanted {
    url: String,
    /// What the file must be.
    sha256: Option<[u8; 32]>,
}

impl Wanted {
    pub fn new(url: String, sha256: Option<&str>) -> Result<Self, ApiError> {
        let sha256 = sha256.map(|text| {
            digest(text).ok_or_else(|| ApiError::field("asset.sha256", "is not a SHA-256 as 64 hexadecimal digits"))
        });
        Ok(Self { url, sha256: sha256.transpose()? })
    }

    /// From `{"url": …, "sha256": …}`.
    pub fn of_json(given: &Map<String, Value>) -> Result<Self, ApiError> {
        if let Some(name) = given.keys().find(|name| !["url", "sha256"].contains(&name.as_str())) {
            return Err(ApiError::unknown_field(&format!("asset.{name}"), "url, sha256"));
        }
        let text = |name: &str| match given.get(name) {
            None | Some(Value::Null) => Ok(None),
            Some(Value::String(text)) => Ok(Some(text.as_str())),
            Some(_) => Err(ApiError::field(&format!("asset.{name}"), "is not a text")),
        };
        let url = text("url")?.ok_or_else(|| ApiError::field("asset.url", "is missing"))?;
        Self::new(url.to_owned(), text("sha256")?)
    }

    /// Fetches the mesh, within the limits of an upload.
    pub async fn fetch(&self, app: &App) -> Result<Received, ApiError> {
        let Some(outgoing) = &app.outgoing else {
            return Err(ApiError::field("asset.url", "this service fetches nothing")
                .hint("download the file and POST it to /v1/assets; the operator allows fetching by --outgoing"));
        };
        let _permit = uploads::permit(app)?;
        self.receive(outgoing, app).await
    }

    async fn receive(&self, outgoing: &Outgoing, app: &App) -> Result<Received, ApiError> {
        let mut sink = Sink::open(app)?;
        let late = |error: ApiError| failed(&error);
        let answer = sink.deadline.in_time(outgoing.get(&self.url)).await.map_err(late)?;
        let mut answer = answer.map_err(|error| failed(&error))?;
        if let Some(bytes) = answer.content_length().filter(|bytes| *bytes > sink.bytes_max()) {
            return Err(ApiError::too_large(sink.bytes_max(), Some(bytes)));
        }
        let declared = answer.headers().get("content-type").and_then(|value| value.to_str().ok());
        let name = name(answer.url().path(), declared.unwrap_or_default());
        sink.begin(&name).await?;
        let mut digest = Sha256::new();
        loop {
            let chunk = sink.deadline.in_time(answer.chunk()).await.map_err(late)?;
            let Some(chunk) = chunk.map_err(|_| failed(&"the answer broke off"))? else { break };
            digest.update(&chunk);
            sink.push(chunk).await?;
            sink.refuse_foreign(&name)?;
        }
        sink.flush().await?;
        if sink.file_bytes() == 0 {
            return Err(empty(&name));
        }
        let is: [u8; 32] = digest.finalize().into();
        if self.sha256.is_some_and(|should| should != is) {
            return Err(failed(&format!("the file has the SHA-256 {}", super::views::hex(&is))));
        }
        sink.finish(&name).await
    }
}

fn failed(why: &dyn std::fmt::Display) -> ApiError {
    ApiError::new(Code::FetchFailed, format!("asset.url could not be fetched: {why}"))
        .hint("download the file and POST it to /v1/assets")
}

/// The name at the end of the path, when it tells a format; else one for the declared media type.
fn name(path: &str, declared: &str) -> String {
    let last = path.rsplit('/').next().unwrap_or_default();
    let named = media::relative_name(last).ok().filter(|name| media::is_mesh_name(name));
    let essence = declared.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    named.or_else(|| media::name_for(&essence).ok()).unwrap_or_else(|| "upload".to_owned())
}

fn digest(hex: &str) -> Option<[u8; 32]> {
    let mut bytes = [0; 32];
    if hex.len() != 64 || !hex.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return None;
    }
    for (byte, digits) in bytes.iter_mut().zip(hex.as_bytes().chunks(2)) {
        *byte = u8::from_str_radix(std::str::from_utf8(digits).ok()?, 16).ok()?;
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fetched_file_is_named_by_its_path_or_else_by_its_type() {
        for (path, declared, expected) in [
            ("/a/Hero.GLB", "text/plain", "Hero.GLB"),
            ("/download", "model/obj; charset=utf-8", "upload.obj"),
            ("/download", "text/html", "upload"),
            ("/", "", "upload"),
            ("/hero.png", "application/octet-stream", "upload"),
        ] {
            assert_eq!(name(path, declared), expected, "{path} {declared}");
        }
    }
}
