//! All integration tests, linked once. One module per claim-bearing area.

mod architecture;
mod batch;
mod bucket;
mod doors;
mod examples;
mod formats_decode;
mod formats_gltf;
mod golden;
mod golden_geometry;
mod golden_nets;
mod golden_rig;
mod http;
mod jobs;
mod jobs_store;
mod metamorphic;
mod operation;
mod pipeline;
mod program;
mod reskin;
mod revision;
#[path = "../stand_ins/s3.rs"]
mod s3;
mod served_rigs;
mod shapes;
mod skin;
mod skin_choice;
mod skin_options;
