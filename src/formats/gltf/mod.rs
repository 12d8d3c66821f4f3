//! glTF 2.0, as JSON with buffers or as GLB.

use super::{Asset, DecodeError, DecodeOptions, Limits, Siblings};

/// An uploaded document with its buffers, kept whole so that it can be given back with a skin.
#[derive(Debug)]
pub struct Document {}

/// Reads a `.gltf` or `.glb` file.
pub fn decode(
    _file_name: &str,
    _bytes: &[u8],
    _siblings: &dyn Siblings,
    _limits: &Limits,
    _options: &DecodeOptions,
) -> Result<Asset, DecodeError> {
    Err(DecodeError::UnsupportedFormat { seen: "a glTF file".into() })
}
