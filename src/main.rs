//! The `rigsmith` program.

mod cli;

fn main() -> std::process::ExitCode {
    // ONNX Runtime's published builds report usage over the network unless this is set before the library is loaded.
    // SAFETY: no other thread runs yet, so nobody reads the environment while it changes.
    unsafe { std::env::set_var("ORT_DISABLE_TELEMETRY", "1") };
    // Fails only when another provider was installed before, and there is none.
    let _ = rustls::crypto::ring::default_provider().install_default();
    cli::run()
}
