//! Whether a limb ends in a hand, and where its fingers are, by the branches of its surface.
//!
//! | in       | shape        | unit                                            |
//! |----------|--------------|-------------------------------------------------|
//! | `joints` | `[L, 3]`     | normalised, y up; the limb's, its start first   |
//! | `found`  | `[R]`        | branches of the limb's surface                  |
//!
//! Fingers are branches that begin side by side, three to six of them, of comparable length, at the far end of the limb, with
//! nothing beyond them, where the skeleton has an end too. The rule is ours. Of 33 training characters that have fingers (every
//! third) it knows the hands of 27; of 66 others one gets fingers that its artist did not give it.

use super::hands::FEET_HEIGHT;
use crate::geometry::surface_branches::{Branch, SurfaceBranches};
use crate::geometry::symmetry_plane::SymmetryPlane;
use glam::DVec3;
use std::ops::RangeInclusive;

/// Fingers of one hand.
const COUNT: RangeInclusive<usize> = 3..=6;
/// Lengths of fingers, in longest sides; the upper bound is for their median.
const LENGTH_MIN: f64 = 0.018;
const LENGTH_MAX: f64 = 0.13;
/// Fingers begin within so many lengths of one of them, along the surface and in space,
const LEVELS_APART: f64 = 2.0;
const BASES_APART: f64 = 2.2;
/// and none is longer or shorter than that one by this factor.
const LENGTHS_APART: f64 = 4.0;
/// A finger that begins so many lengths before the others is a thumb.
const THUMB_BEHIND: f64 = 0.3;
/// What lies so many lengths beyond the knuckles is fingers or something held.
const BEYOND_KNUCKLES: f64 = 0.4;

/// How sure it must be that the end of a limb is a hand. Lengths are in those of the median finger.
#[derive(Clone, Copy, Debug)]
pub struct HandRule {
    /// From where the limb begins to the knuckles, along its surface and straight.
    surface_min: f64,
    reach_min: f64,
    /// From the knuckles to the skeleton's nearest joint.
    joint_max: f64,
    /// Share of what lies beyond the knuckles that is fingers.
    share_min: f64,
    /// The longest finger in lengths of the shortest but one: that is the thumb.
    evenness_max: f64,
    /// Length of the mean of the directions of all fingers but thumbs: 1 where they are parallel, little where they are rags of a sleeve.
    parallel_min: f64,
    /// Cosine between where they point and the way from where the limb begins to the knuckles.
    along_min: f64,
}

impl HandRule {
    /// What an artist would call a hand at once.
    pub const SURE: Self = Self {
        surface_min: 1.5,
        reach_min: 3.2,
        joint_max: 2.0,
        share_min: 0.6,
        evenness_max: 2.5,
        parallel_min: 0.7,
        along_min: 0.72,
    };
    /// For those who know that there are hands.
    pub const LIKELY: Self = Self {
        surface_min: 1.0,
        reach_min: 2.0,
        joint_max: 2.5,
        share_min: 0.4,
        evenness_max: 4.0,
        parallel_min: 0.5,
        along_min: 0.3,
    };
}

/// A straight finger.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finger {
    /// Where it leaves the palm, and its end.
    pub base: DVec3,
    pub tip: DVec3,
    pub is_thumb: bool,
    /// Too thick for its length to bend in two places.
    pub is_stubby: bool,
}

/// Where the joints of a finger lie on the way from its base (0) to its tip (1): medians of the artists' joints on training rigs
/// (quartiles ±.05; ±.1 inside the palm). Artists give stubby fingers a joint less.
const FINGER_JOINTS: &[f64] = &[-0.1, 0.3, 0.65];
const STUBBY_FINGER_JOINTS: &[f64] = &[-0.1, 0.33];
const THUMB_JOINTS: &[f64] = &[-0.5, -0.05, 0.4];
const STUBBY_THUMB_JOINTS: &[f64] = &[-0.4, 0.3];
/// From this length by diameter on a thumb, or the median of the other fingers, is not stubby.
const FINGER_SLENDERNESS: f64 = 2.6;
const THUMB_SLENDERNESS: f64 = 1.8;

impl Finger {
    /// Its joints, from the knuckle on, for a hand with this wrist. Behind its base a thumb bends halfway toward the wrist: straight
    /// on it would leave the palm.
    pub fn joints(&self, wrist: DVec3) -> impl Iterator<Item = DVec3> + use<> {
        let (base, along) = (self.base, self.tip - self.base);
        let halfway = (wrist - base).normalize_or_zero() - along.normalize_or_zero();
        let back = if self.is_thumb { halfway.normalize_or_zero() * along.length() } else { -along };
        let places = match (self.is_thumb, self.is_stubby) {
            (false, false) => FINGER_JOINTS,
            (false, true) => STUBBY_FINGER_JOINTS,
            (true, false) => THUMB_JOINTS,
            (true, true) => STUBBY_THUMB_JOINTS,
        };
        places.iter().map(move |&place| base + if place < 0.0 { back * -place } else { along * place })
    }
}

/// A hand with fingers.
#[derive(Clone, Debug, PartialEq)]
pub struct HandShape {
    pub fingers: Vec<Finger>,
    /// The middle of the bases of all fingers but thumbs.
    pub knuckles: DVec3,
    /// Median length of the fingers.
    pub length: f64,
}

impl HandShape {
    /// The hand at the end of a limb, if the limb has one. `found` may be branches of the limb's end alone.
    pub fn of(joints: &[DVec3], found: &SurfaceBranches, rule: &HandRule) -> Option<Self> {
        let start = *joints.first()?;
        let branches = side_by_side(&found.branches)?;
        let length = median(branches.iter().map(|branch| branch.length()));
        let level = median(branches.iter().map(|branch| branch.level));
        let is_thumb = |branch: &Branch| level - branch.level > THUMB_BEHIND * length;
        let but_thumbs = || branches.iter().filter(|branch| !is_thumb(branch));
        let knuckles = but_thumbs().map(|branch| branch.base).sum::<DVec3>() / but_thumbs().count().max(1) as f64;

        let beyond = found.distances.iter().filter(|&&distance| distance > level + BEYOND_KNUCKLES * length).count();
        let in_fingers = branches.iter().flat_map(|branch| &branch.distances);
        let beyond_in_fingers = in_fingers.filter(|&&distance| distance > level + BEYOND_KNUCKLES * length).count();
        let joint = joints.iter().map(|joint| joint.distance(knuckles)).fold(f64::INFINITY, f64::min);
        let mut lengths: Vec<f64> = branches.iter().map(|branch| branch.length()).collect();
        lengths.sort_by(f64::total_cmp);
        let directions = but_thumbs().map(|branch| (branch.tip - branch.base).normalize_or_zero()).sum::<DVec3>();
        let parallel = directions.length() / but_thumbs().count().max(1) as f64;
        let is_hand = length <= LENGTH_MAX
            && branches.iter().all(|branch| branch.tip.y > FEET_HEIGHT)
            && level >= rule.surface_min * length
            && knuckles.distance(start) >= rule.reach_min * length
            && joint <= rule.joint_max * length
            && beyond_in_fingers as f64 >= rule.share_min * beyond as f64
            && lengths[lengths.len() - 1] <= rule.evenness_max * lengths[1]
            && parallel >= rule.parallel_min
            && directions.normalize_or_zero().dot((knuckles - start).normalize_or_zero()) >= rule.along_min;
        let slenderness = |branch: &Branch| branch.length() / branch.thickness;
        // All fingers of a hand have as many joints.
        let is_slender = median(but_thumbs().map(|branch| slenderness(branch))) >= FINGER_SLENDERNESS;
        let finger = |branch: &&Branch| {
            let is_thumb = is_thumb(branch);
            let is_stubby = if is_thumb { slenderness(branch) < THUMB_SLENDERNESS } else { !is_slender };
            Finger { base: branch.base, tip: branch.tip, is_thumb, is_stubby }
        };
        is_hand.then(|| Self { fingers: branches.iter().map(finger).collect(), knuckles, length })
    }

    /// Its mirror image.
    pub fn mirrored(&self, plane: &SymmetryPlane) -> Self {
        let image =
            |finger: &Finger| Finger { base: plane.reflect(finger.base), tip: plane.reflect(finger.tip), ..*finger };
        Self {
            fingers: self.fingers.iter().map(image).collect(),
            knuckles: plane.reflect(self.knuckles),
            length: self.length,
        }
    }

    /// Where the fingers point to, without a unit.
    pub fn forward(&self) -> DVec3 {
        self.fingers.iter().filter(|finger| !finger.is_thumb).map(|finger| finger.tip - finger.base).sum()
    }

    /// Whether its fingers, the thumb left out, are stubby.
    pub fn is_stubby(&self) -> bool {
        self.fingers.iter().any(|finger| !finger.is_thumb && finger.is_stubby)
    }
}

/// The most branches that may be fingers of one hand; the first of equally many.
fn side_by_side(branches: &[Branch]) -> Option<Vec<&Branch>> {
    let slender = |branch: &&Branch| branch.length() >= LENGTH_MIN.max(branch.thickness);
    let branches: Vec<&Branch> = branches.iter().filter(slender).collect();
    let beside = |one: &Branch| -> Vec<&Branch> {
        let length = one.length();
        let is_beside = |other: &&Branch| {
            (other.level - one.level).abs() <= LEVELS_APART * length
                && other.base.distance(one.base) <= BASES_APART * length
                && (length / LENGTHS_APART..=length * LENGTHS_APART).contains(&other.length())
        };
        branches.iter().copied().filter(is_beside).collect()
    };
    let groups = branches.iter().map(|branch| beside(branch));
    let most = groups.reduce(|best, group| if group.len() > best.len() { group } else { best })?;
    COUNT.contains(&most.len()).then_some(most)
}

/// The middle value, or the mean of both; 0 of none.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    match (values.get(values.len() / 2), values.len() % 2) {
        (Some(&middle), 1) => middle,
        (Some(&upper), _) => 0.5 * (values[values.len() / 2 - 1] + upper),
        (None, _) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A branch along x at height .5, with a distance of 1 per unit of x.
    fn branch(x: f64, z: f64, length: f64) -> Branch {
        let (base, tip) = (DVec3::new(x, 0.5, z), DVec3::new(x + length, 0.5, z));
        let distances = (0..10).map(|k| x + length * f64::from(k) / 9.0).collect();
        Branch { distances, level: x, base, tip, thickness: 0.02 }
    }

    fn limb(branches: Vec<Branch>) -> SurfaceBranches {
        let arm = (0..40).map(|k| 0.01 * f64::from(k));
        let distances = arm.chain(branches.iter().flat_map(|branch| branch.distances.clone())).collect();
        SurfaceBranches { distances, branches }
    }

    fn hand() -> Vec<Branch> {
        vec![branch(0.4, -0.03, 0.06), branch(0.4, 0.0, 0.07), branch(0.4, 0.03, 0.06), branch(0.36, 0.06, 0.04)]
    }

    const ARM: [DVec3; 3] = [DVec3::new(0.1, 0.5, 0.0), DVec3::new(0.25, 0.5, 0.0), DVec3::new(0.39, 0.5, 0.0)];

    #[test]
    fn branches_side_by_side_are_fingers_and_the_one_behind_is_the_thumb() {
        let found = HandShape::of(&ARM, &limb(hand()), &HandRule::SURE).expect("a hand");
        assert_eq!(found.fingers.iter().map(|finger| finger.is_thumb).collect::<Vec<_>>(), [false, false, false, true]);
        assert!(found.knuckles.distance(DVec3::new(0.4, 0.5, 0.0)) < 1e-9 && (found.length - 0.06).abs() < 1e-9);
        let joints: Vec<Vec<f64>> = found
            .fingers
            .iter()
            .map(|finger| finger.joints(finger.base - DVec3::X).map(|joint| joint.x - finger.base.x).collect())
            .collect();
        let near = |found: &[f64], expected: &[f64]| {
            assert_eq!(found.len(), expected.len());
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}, not {expected:?}");
        };
        near(&joints[0], &[-0.006, 0.018, 0.039]);
        near(&joints[3], &[-0.02, -0.002, 0.016]);
        let thumb = found.fingers[3];
        let bent = thumb.joints(thumb.base - DVec3::Z).next().expect("a joint") - thumb.base;
        assert!(bent.distance(DVec3::new(-1.0, 0.0, -1.0).normalize() * 0.02) < 1e-9, "{bent}");
    }

    #[test]
    fn mittens_toes_and_things_held_are_no_hands() {
        let sure = |branches: Vec<Branch>| HandShape::of(&ARM, &limb(branches), &HandRule::SURE);
        assert!(sure(hand()).is_some());
        assert_eq!(sure(hand().split_off(2)), None, "two are a mitten");
        assert_eq!(sure((0..7).map(|k| branch(0.4, 0.02 * f64::from(k), 0.06)).collect()), None, "seven are a brush");
        assert_eq!(sure([hand(), vec![branch(0.41, 0.01, 0.2)]].concat()), None, "a sword");
        let low = |mut branch: Branch| {
            branch.tip.y = 0.05;
            branch
        };
        assert_eq!(sure(hand().into_iter().map(low).collect()), None, "toes");
        let mut holding = limb(hand());
        holding.distances.extend([0.9; 60]);
        assert_eq!(
            HandShape::of(&ARM, &holding, &HandRule::SURE),
            None,
            "most of what is beyond the knuckles is something else"
        );
        assert_eq!(HandShape::of(&ARM[..1], &limb(hand()), &HandRule::SURE), None, "the skeleton ends far from it");
        assert_eq!(HandShape::of(&[], &limb(hand()), &HandRule::SURE), None);
        assert_eq!(HandShape::of(&ARM, &SurfaceBranches::default(), &HandRule::LIKELY), None);
    }

    #[test]
    fn a_mirrored_hand_is_the_hand_of_the_mirrored_limb() {
        let plane = SymmetryPlane::CANONICAL;
        let found = HandShape::of(&ARM, &limb(hand()), &HandRule::SURE).expect("a hand");
        let mut images = limb(hand());
        for branch in &mut images.branches {
            (branch.base, branch.tip) = (plane.reflect(branch.base), plane.reflect(branch.tip));
        }
        let image = HandShape::of(&ARM.map(|joint| plane.reflect(joint)), &images, &HandRule::SURE).expect("a hand");
        assert_eq!(found.mirrored(&plane), image);
        assert_eq!(image.mirrored(&plane), found);
    }
}
