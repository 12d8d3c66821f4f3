//! Numbers that stand for places: choices that look random, yet depend on where things are and not on their order.

use glam::DVec3;

/// Places nearer than about this (in the normalised frame: 2⁻²⁰ of the longest side) share a number.
const GRAIN: f64 = 1.0 / (1 << 20) as f64;

/// A number that depends only on where a point is.
pub fn place_hash(position: DVec3) -> u64 {
    let cell = (position / GRAIN).round().as_i64vec3();
    mix(cell.x as u64 ^ mix(cell.y as u64 ^ mix(cell.z as u64)))
}

/// Mixes 64 bits so that near inputs give unrelated outputs (the finaliser of SplitMix64 [Steele et al. 2014]).
pub fn mix(value: u64) -> u64 {
    let value = value.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let value = (value ^ (value >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    value ^ (value >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_keeps_a_place_and_a_step_changes_it() {
        let place = DVec3::new(0.25, -0.5, 0.125);
        assert_eq!(place_hash(place), place_hash(place + DVec3::splat(1e-9)));
        assert_ne!(place_hash(place), place_hash(place + DVec3::X * 1e-5));
        assert_eq!(place_hash(DVec3::ZERO), place_hash(-DVec3::ZERO));
    }

    #[test]
    fn bits_of_neighbouring_numbers_are_even() {
        for bit in 0..64 {
            let ones = (0..4096u64).filter(|&n| mix(n) >> bit & 1 == 1).count();
            assert!((1850..2250).contains(&ones), "bit {bit}: {ones}");
        }
    }
}
