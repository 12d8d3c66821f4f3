//! `rigsmith openapi`: the description of the REST interface, for those who make clients of it.

use super::failure::Failure;
use rigsmith::server::http::openapi::document;

/// Prints what a service gives at `/v1/openapi.json`.
pub fn run() -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(&document());
    say!("{}", text.map_err(|error| Failure::internal(error.to_string(), ""))?);
    Ok(())
}
