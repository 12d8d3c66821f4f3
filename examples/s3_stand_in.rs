//! A stand-in for S3-compatible storage as a process of its own, for the reliability scripts; see
//! `tests/stand_ins/s3.rs`.
//!
//!     cargo run --release --example s3_stand_in 127.0.0.1:9000

#[path = "../tests/stand_ins/s3.rs"]
mod s3;

use std::error::Error;
use tokio::net::TcpListener;

fn main() -> Result<(), Box<dyn Error>> {
    let address = std::env::args().nth(1).unwrap_or_else(|| "127.0.0.1:9000".to_owned());
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
    runtime.block_on(async {
        let listener = TcpListener::bind(&address).await?;
        println!("listens on http://{} for the key {}", listener.local_addr()?, s3::KEY_ID);
        Ok(s3::serve(listener).await?)
    })
}
