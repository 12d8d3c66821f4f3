//! What `proto/` compiles to; see `build.rs`.

/// Every file of `proto/`, for reflection.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/rigsmith.descriptors"));

// Compiled packages find each other by their places.
pub mod rigsmith {
    #[allow(clippy::all)]
    pub mod v1 {
        tonic::include_proto!("rigsmith.v1");
    }
}
pub mod google {
    #[allow(clippy::all)]
    pub mod longrunning {
        tonic::include_proto!("google.longrunning");
    }
    #[allow(clippy::all)]
    pub mod rpc {
        tonic::include_proto!("google.rpc");
    }
}
