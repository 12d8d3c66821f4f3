//! The header fields of tus 1.0 (<https://tus.io/protocols/resumable-upload>), read and written.

use super::error::{ApiError, Code};
use super::media;
use super::negotiate::text_header;
use crate::jobs::{Resumable, ResumableState};
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use ring::digest;

pub const VERSION: &str = "1.0.0";
pub const EXTENSIONS: &str = "creation,creation-with-upload,checksum,expiration,termination";
/// The media type of a body that goes on with an upload.
pub const OFFSET_BODY: &str = "application/offset+octet-stream";

pub const TUS_RESUMABLE: HeaderName = HeaderName::from_static("tus-resumable");
pub const TUS_VERSION: HeaderName = HeaderName::from_static("tus-version");
pub const TUS_EXTENSION: HeaderName = HeaderName::from_static("tus-extension");
pub const TUS_MAX_SIZE: HeaderName = HeaderName::from_static("tus-max-size");
pub const TUS_CHECKSUM_ALGORITHM: HeaderName = HeaderName::from_static("tus-checksum-algorithm");
pub const UPLOAD_LENGTH: HeaderName = HeaderName::from_static("upload-length");
pub const UPLOAD_DEFER_LENGTH: HeaderName = HeaderName::from_static("upload-defer-length");
pub const UPLOAD_OFFSET: HeaderName = HeaderName::from_static("upload-offset");
pub const X_HTTP_METHOD_OVERRIDE: HeaderName = HeaderName::from_static("x-http-method-override");
const UPLOAD_METADATA: HeaderName = HeaderName::from_static("upload-metadata");
const UPLOAD_CHECKSUM: HeaderName = HeaderName::from_static("upload-checksum");
const UPLOAD_EXPIRES: HeaderName = HeaderName::from_static("upload-expires");
/// Ours: what a complete upload has become.
const ASSET_ID: HeaderName = HeaderName::from_static("asset-id");

const METADATA_BYTES_MAX: usize = 4096;
/// What checksums may be made by. The protocol asks for SHA-1.
static ALGORITHMS: [(&str, &digest::Algorithm); 3] =
    [("sha1", &digest::SHA1_FOR_LEGACY_USE_ONLY), ("sha256", &digest::SHA256), ("sha512", &digest::SHA512)];

/// The names of [`ALGORITHMS`], as a list.
pub fn algorithms() -> String {
    ALGORITHMS.map(|(name, _)| name).join(",")
}

/// A number of bytes that must be said.
pub fn bytes(headers: &HeaderMap, name: &HeaderName) -> Result<u64, ApiError> {
    let text = text_header(headers, name)?.ok_or_else(|| ApiError::field(name.as_str(), "is missing"))?;
    let digits = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let bytes = text.parse().ok().filter(|_| digits);
    bytes.ok_or_else(|| ApiError::field(name.as_str(), format!("{text:.40?} is not a number of bytes")))
}

/// Whether the body is said to go on with an upload.
pub fn has_offset_body(headers: &HeaderMap) -> bool {
    headers.get(header::CONTENT_TYPE).is_some_and(|value| value.as_bytes().eq_ignore_ascii_case(OFFSET_BODY.as_bytes()))
}

/// What is said of a file before it comes.
#[derive(Debug, PartialEq, Eq)]
pub struct Metadata {
    pub raw: Option<String>,
    /// `filename` or `name`; else one that fits `filetype` or `type`.
    pub file_name: String,
}

impl Metadata {
    /// Reads pairs of a key and a value in base64, separated by commas. Keys that mean nothing here are the caller's own.
    pub fn of(headers: &HeaderMap) -> Result<Self, ApiError> {
        let field = UPLOAD_METADATA;
        let wrong = |detail: String| ApiError::field(field.as_str(), detail);
        let raw = text_header(headers, &field)?;
        if raw.is_some_and(|raw| raw.len() > METADATA_BYTES_MAX) {
            return Err(wrong(format!("is longer than {METADATA_BYTES_MAX} bytes")));
        }
        let mut pairs: Vec<(&str, String)> = Vec::new();
        for pair in raw.unwrap_or_default().split(',').map(str::trim).filter(|pair| !pair.is_empty()) {
            let (key, value) = pair.split_once(' ').unwrap_or((pair, ""));
            if pairs.iter().any(|(known, _)| *known == key) {
                return Err(wrong(format!("{key:.40?} is there twice")));
            }
            let value = BASE64_STANDARD.decode(value.trim()).ok().and_then(|value| String::from_utf8(value).ok());
            pairs.push((key, value.ok_or_else(|| wrong(format!("the value of {key:.40?} is not text in base64")))?));
        }
        let said = |keys: [&str; 2]| {
            let found = pairs.iter().find(|(key, value)| keys.contains(key) && !value.is_empty());
            found.map(|(_, value)| value.as_str())
        };
        let file_name = match (said(["filename", "name"]), said(["filetype", "type"])) {
            (Some(name), _) => media::relative_name(name).map_err(wrong)?,
            (None, Some(media_type)) => media::name_for(media_type)?,
            (None, None) => media::name_for("application/octet-stream")?,
        };
        Ok(Self { raw: raw.map(str::to_owned), file_name })
    }
}

/// What the bytes of one request must come to.
pub struct Checksum {
    context: digest::Context,
    name: &'static str,
    expected: Vec<u8>,
}

impl Checksum {
    pub fn of(headers: &HeaderMap) -> Result<Option<Self>, ApiError> {
        let Some(text) = text_header(headers, &UPLOAD_CHECKSUM)? else { return Ok(None) };
        let wrong = |detail: String| ApiError::field(UPLOAD_CHECKSUM.as_str(), detail);
        let (asked, value) = text.split_once(' ').unwrap_or((text, ""));
        let found = ALGORITHMS.iter().find(|(name, _)| *name == asked);
        let (name, algorithm) = found.ok_or_else(|| wrong(format!("{asked:.40?} is none of {}", algorithms())))?;
        let expected = BASE64_STANDARD.decode(value.trim()).ok();
        let expected = expected.filter(|value| value.len() == algorithm.output_len());
        let expected = expected.ok_or_else(|| wrong(format!("is no {name} in base64")))?;
        Ok(Some(Self { context: digest::Context::new(algorithm), name, expected }))
    }

    pub fn update(&mut self, bytes: &[u8]) {
        self.context.update(bytes);
    }

    pub fn verify(self) -> Result<(), ApiError> {
        let found = self.context.finish();
        if found.as_ref() == self.expected.as_slice() {
            return Ok(());
        }
        let found = BASE64_STANDARD.encode(found);
        Err(ApiError::new(Code::ChecksumMismatch, format!("the {} of what came is {found}", self.name))
            .hint("send the same bytes again from the same offset"))
    }
}

/// How an upload stands.
pub fn standing(fields: &mut HeaderMap, upload: &Resumable) {
    let mut tell = |name: HeaderName, value: String| {
        if let Ok(value) = HeaderValue::from_str(&value) {
            fields.insert(name, value);
        }
    };
    tell(UPLOAD_OFFSET, upload.received.to_string());
    match upload.state {
        ResumableState::Open => tell(UPLOAD_EXPIRES, httpdate::fmt_http_date(upload.expires_at)),
        ResumableState::Complete(asset) => tell(ASSET_ID, asset.to_string()),
        ResumableState::Expired => {}
    }
}

/// The rest of what is asked for before an upload goes on.
pub fn description(fields: &mut HeaderMap, upload: &Resumable) {
    fields.insert(UPLOAD_LENGTH, upload.length.into());
    fields.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    if let Some(Ok(raw)) = upload.metadata.as_deref().map(HeaderValue::from_str) {
        fields.insert(UPLOAD_METADATA, raw);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(name: HeaderName, value: &str) -> HeaderMap {
        HeaderMap::from_iter([(name, HeaderValue::from_str(value).expect("a value"))])
    }

    #[test]
    fn metadata_names_the_file_by_itself_or_by_its_type() {
        for (raw, name) in [
            ("filename aGVyby5nbGI=", "hero.glb"),
            ("relativePath bnVsbA==,name aGVyby5nbGI=,type bW9kZWwvb2Jq", "hero.glb"),
            ("filetype bW9kZWwvb2Jq", "upload.obj"),
            ("is_confidential, filename ", "upload"),
            ("", "upload"),
        ] {
            let read = Metadata::of(&headers(UPLOAD_METADATA, raw)).expect("reads");
            assert_eq!((read.file_name.as_str(), read.raw.as_deref()), (name, Some(raw)));
        }
        assert_eq!(Metadata::of(&HeaderMap::new()).expect("reads").raw, None);
        let long = format!("filename {}", "a".repeat(METADATA_BYTES_MAX));
        for raw in ["filename ?", "filename /w==", "filename Li4vYQ==", "a YQ==,a YQ==", &long, "type aW1hZ2UvcG5n"] {
            assert!(Metadata::of(&headers(UPLOAD_METADATA, raw)).is_err(), "{raw}");
        }
    }

    #[test]
    fn numbers_of_bytes_are_digits_alone() {
        for (text, bytes_said) in
            [("0", Some(0)), ("52", Some(52)), ("+5", None), ("", None), ("5 ", None), ("x", None)]
        {
            assert_eq!(bytes(&headers(UPLOAD_OFFSET, text), &UPLOAD_OFFSET).ok(), bytes_said, "{text:?}");
        }
        assert!(bytes(&HeaderMap::new(), &UPLOAD_OFFSET).is_err());
    }

    #[test]
    fn a_checksum_is_that_of_all_bytes() {
        // SHA-1 and SHA-256 of "abc", FIPS 180.
        for value in ["sha1 qZk+NkcGgWq6PiVxeFDCbJzQ2J0=", "sha256 ungWv48Bz+pBQUDeXa4iI7ADYaOWF3qctBD/YfIAFa0="] {
            let mut checksum = Checksum::of(&headers(UPLOAD_CHECKSUM, value)).expect("reads").expect("is there");
            checksum.update(b"a");
            checksum.update(b"bc");
            assert!(checksum.verify().is_ok(), "{value}");
            let mut checksum = Checksum::of(&headers(UPLOAD_CHECKSUM, value)).expect("reads").expect("is there");
            checksum.update(b"abd");
            assert_eq!(checksum.verify().expect_err("another").code, Code::ChecksumMismatch);
        }
        for value in ["md5 kAFQmDzST7DWlj99KOF/cg==", "sha1", "sha1 YWJj", "sha1 ?"] {
            assert!(Checksum::of(&headers(UPLOAD_CHECKSUM, value)).is_err(), "{value}");
        }
    }
}
