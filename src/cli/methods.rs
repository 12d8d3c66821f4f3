//! `rigsmith methods`: what runs here, with digests, licences and self-tests.

use super::EngineOptions;
use super::failure::Failure;
use rigsmith::jobs::{Availability, Engine, Rigger};
use rigsmith::pipelines::skin_choice::MeasuredL1;

pub fn run(engine: &EngineOptions) -> Result<(), Failure> {
    let methods = Engine::open(&engine.load_options(1))?.methods();
    for method in methods {
        say!("{}: {} ({})", method.name, method.title, state(&method.availability));
        say!("  {}", method.description);
        say!("  licence of the weights: {}", method.licence);
        for model in method.models {
            say!("  {:<22} self-test {:<8} sha256 {}", model.name, model.self_test, model.sha256);
        }
        say!("  skin methods, by mean L1 to the artists' weights on validation rigs (organic, box models, all):");
        for skin in method.skin_methods {
            let MeasuredL1 { organic, boxes, all } = skin.mean_l1;
            let auto = if skin.is_auto { ", auto" } else { "" };
            say!("  {:<22} {organic:.2} {boxes:.2} {all:.2} ({}{auto})", skin.name, state(&skin.availability));
        }
    }
    Ok(())
}

fn state(availability: &Availability) -> String {
    match availability {
        Availability::Available => "available".to_owned(),
        Availability::Unavailable { reason } => format!("NOT AVAILABLE: {reason}"),
    }
}
