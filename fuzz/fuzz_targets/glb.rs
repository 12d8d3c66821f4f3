#![no_main]
//! Any bytes, read as GLB.

use libfuzzer_sys::fuzz_target;
use rigsmith::formats::Format;

#[path = "upload.rs"]
mod upload;

fuzz_target!(|bytes: &[u8]| upload::check(Format::Glb, bytes));
