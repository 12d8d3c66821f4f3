#![no_main]
//! Any bytes, read as STL.

use libfuzzer_sys::fuzz_target;
use rigsmith::formats::Format;

#[path = "upload.rs"]
mod upload;

fuzz_target!(|bytes: &[u8]| upload::check(Format::Stl, bytes));
