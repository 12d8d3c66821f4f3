//! Compiles `proto/` into the types and traits of the gRPC door, and into the descriptors that it tells about itself.

use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=proto");
    let mut compiler = protox::Compiler::new(["proto"])?;
    compiler.include_imports(true).open_files([
        "rigsmith/v1/rigging.proto",
        "google/longrunning/operations.proto",
        "google/rpc/error_details.proto",
    ])?;
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("rigsmith.descriptors"), compiler.encode_file_descriptor_set())?;
    tonic_prost_build::configure().bytes(".rigsmith.v1").compile_fds(compiler.file_descriptor_set())?;
    Ok(())
}
