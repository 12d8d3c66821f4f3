#![no_main]
//! Any bytes behind the signature of a zip.

use libfuzzer_sys::fuzz_target;
use rigsmith::formats::{DecodeOptions, ExistingRigPolicy, NoSiblings, decode};

#[path = "upload.rs"]
mod upload;

fuzz_target!(|bytes: &[u8]| {
    let options = DecodeOptions { existing_rig: ExistingRigPolicy::Replace, allow_missing_textures: true, old_rig: true };
    let zip = [b"PK\x03\x04", bytes].concat();
    if let Ok(asset) = decode("upload.zip", &zip, &NoSiblings, &upload::LIMITS, &options) {
        upload::check_asset(&asset);
    }
});
