//! `rigsmith methods`: what runs here, with digests, licences and self-tests.

use super::EngineOptions;
use super::failure::Failure;
use rigsmith::jobs::{Availability, Engine, Rigger};

pub fn run(engine: &EngineOptions) -> Result<(), Failure> {
    let methods = Engine::open(&engine.load_options(1))?.methods();
    for method in methods {
        let state = match &method.availability {
            Availability::Available => "available".to_owned(),
            Availability::Unavailable { reason } => format!("NOT AVAILABLE: {reason}"),
        };
        println!("{}: {} ({state})", method.name, method.title);
        println!("  {}", method.description);
        println!("  licence of the weights: {}", method.licence);
        for model in method.models {
            println!("  {:<22} self-test {:<8} sha256 {}", model.name, model.self_test, model.sha256);
        }
    }
    Ok(())
}
