//! Where uploads and artifacts are kept.
