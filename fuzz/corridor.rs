//! The modules that decoding needs, from the sources of `rigsmith` itself.

#[path = "../src/cancellation.rs"]
pub mod cancellation;
#[path = "../src/formats/mod.rs"]
pub mod formats;
#[path = "../src/geometry/mod.rs"]
pub mod geometry;
#[path = "../src/mesh/mod.rs"]
pub mod mesh;
#[path = "../src/rig/mod.rs"]
pub mod rig;
