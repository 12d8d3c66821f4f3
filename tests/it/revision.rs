//! The revision of the corridor stands in the key of kept results. These figures of a rig stand beside it: when they move,
//! results have changed, and results that were kept before must not be given again.

use super::metamorphic::character;
use super::skin::{chain, weighed};
use rigsmith::pipelines::{REVISION, SkinMethod};

/// The revision that the figures are of.
const OF: u32 = 5;
/// Share of all weight that each joint of a chain up the middle has, by skin method.
const SHARES: [(SkinMethod, [f64; 4]); 2] = [
    (SkinMethod::GeodesicVoxel, [0.2705, 0.4228, 0.2256, 0.0811]),
    (SkinMethod::GeodesicHeat, [0.2444, 0.4666, 0.2095, 0.0795]),
];
/// More than the rounding of another processor, less than any change worth the name.
const TOLERANCE: f64 = 5e-4;

#[test]
fn results_move_only_with_the_revision() {
    let (low, high) = character().bounding_box().expect("has vertices");
    let places = [0.2, 0.45, 0.7, 0.9].map(|share| {
        let mut place = low.lerp(high, 0.5);
        place.y = low.y + share * (high.y - low.y);
        place
    });
    for (method, expected) in SHARES {
        let rigged = weighed(character(), &chain(&places), method);
        let mut shares = [0.0; 4];
        for influence in rigged.rig.skin.rows.iter().flatten() {
            shares[influence.joint as usize] += f64::from(influence.weight) / rigged.rig.skin.rows.len() as f64;
        }
        let same = shares.iter().zip(expected).all(|(share, expected)| (share - expected).abs() < TOLERANCE);
        assert!(
            same && OF == REVISION,
            "{} gives {shares:.4?}; revision {REVISION}, figures of {OF}. If that is meant, raise pipelines::REVISION \
             and write revision and figures here",
            method.name()
        );
    }
}
