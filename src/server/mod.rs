//! The HTTP door: extract, call [`crate::jobs`], answer.
