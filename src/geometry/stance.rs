//! How many legs a character stands on, and how it holds its arms, as far as the bare shape tells.
//!
//! | in        | shape              | unit       |
//! |-----------|--------------------|------------|
//! | `mesh`    | `[V, 3]`, `[F, 3]` | normalised |
//! | `samples` | `[S, 3]`           | normalised |
//! | `plane`   | mirror plane       | normalised |
//!
//! Legs: the mesh is cut at a few low heights; what a cut leaves on either side of the mirror plane are footprints. One a side
//! are two legs, two a side, one behind the other, are four. Arms of a biped: how much lower the far end of each side is than
//! what lies halfway. Both rules are ours. On the 44 validation rigs they call
//! 10 of 14 humanoids bipeds, 7 of 11 animals on four legs quadrupeds, the rest of both unknown; two fish on their fins pass for
//! bipeds, with half the confidence. Robes, snakes and shapes without a mirror plane are [`Category::Unknown`]. Pure; O(F).

use super::surface_samples::SurfaceSamples;
use super::symmetry_plane::SymmetryPlane;
use crate::mesh::Mesh;
use crate::mesh::adjacency::DisjointSets;
use glam::{DVec2, DVec3};
use std::collections::{BTreeMap, HashMap};

/// What stands there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Category {
    /// Two legs.
    Biped,
    /// Four legs, in two pairs one behind the other.
    Quadruped,
    /// More legs than four.
    Other,
    /// The shape does not tell.
    Unknown,
}

impl Category {
    pub const ALL: [Self; 4] = [Self::Biped, Self::Quadruped, Self::Other, Self::Unknown];

    pub fn name(self) -> &'static str {
        match self {
            Self::Biped => "biped",
            Self::Quadruped => "quadruped",
            Self::Other => "other",
            Self::Unknown => "unknown",
        }
    }
}

/// How a biped holds its arms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pose {
    /// Level, to both sides.
    T,
    /// Obliquely down.
    A,
    /// Another way: hanging, raised, each differently; or there are none.
    Other,
    /// It is no biped, or its arms cannot be told from the rest.
    Unknown,
}

impl Pose {
    pub const ALL: [Self; 4] = [Self::T, Self::A, Self::Other, Self::Unknown];

    pub fn name(self) -> &'static str {
        match self {
            Self::T => "t",
            Self::A => "a",
            Self::Other => "other",
            Self::Unknown => "unknown",
        }
    }
}

/// What was made out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stance {
    pub category: Category,
    /// 0 (unknown) to 1: the share of the cuts that agree, times the symmetry.
    pub confidence: f64,
    pub pose: Pose,
}

/// Where the mesh is cut, as shares of its height: above the soles, below the hands.
const CUTS: [f64; 6] = [0.06, 0.09, 0.12, 0.15, 0.18, 0.21];
/// So many cuts must agree.
const AGREEING_MIN: usize = 4;
/// Less symmetric than this, there is no left and right to speak of.
const SYMMETRY_MIN: f64 = 0.75;
/// A footprint that is smaller both ways is a strand or a crumb;
const FOOTPRINT_MIN: f64 = 0.01;
/// footprints nearer than this are one, as those of clothes and what is in them;
const FOOTPRINT_GAP: f64 = 0.01;
/// and more than this are no legs.
const FOOTPRINTS_MAX: usize = 32;
/// A footprint of one side may reach over the plane by this much.
const OVER_PLANE: f64 = 0.005;

/// Looks at an upright mesh of some height.
pub fn stance(mesh: &Mesh, samples: &SurfaceSamples, plane: &SymmetryPlane) -> Stance {
    let unknown = Stance { category: Category::Unknown, confidence: 0.0, pose: Pose::Unknown };
    let Some((low, high)) = mesh.bounding_box() else { return unknown };
    let size = high - low;
    if plane.score < SYMMETRY_MIN || size.y <= 0.0 {
        return unknown;
    }
    let seen = CUTS.map(|share| legs(&footprints(mesh, plane, low.y + share * size.y)));
    let votes = |category| seen.iter().filter(|&&seen| seen == Some(category)).count();
    let best = [Category::Biped, Category::Quadruped, Category::Other].into_iter().max_by_key(|&kind| votes(kind));
    let Some(category) = best.filter(|&kind| votes(kind) >= AGREEING_MIN) else { return unknown };
    let mut confidence = votes(category) as f64 / CUTS.len() as f64 * plane.score;
    if category == Category::Biped && size.z > size.y {
        confidence *= 0.5; // a bird, or a fish on its fins
    }
    let pose = if category == Category::Biped { arms(samples, plane, low.y, size.y) } else { Pose::Unknown };
    Stance { category, confidence, pose }
}

/// A piece of a cut: its box, sideways (from the mirror plane) and forward.
#[derive(Clone, Copy, Debug)]
struct Footprint {
    low: DVec2,
    high: DVec2,
}

impl Footprint {
    fn joined(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    fn is_beside(&self, other: &Self) -> bool {
        let gap = DVec2::splat(FOOTPRINT_GAP);
        (self.low - gap).cmple(other.high).all() && (other.low - gap).cmple(self.high).all()
    }

    fn middle(&self) -> DVec2 {
        (self.low + self.high) * 0.5
    }
}

/// What a cut at `height` leaves of the mesh; empty when it falls into too many pieces.
fn footprints(mesh: &Mesh, plane: &SymmetryPlane, height: f64) -> Vec<Footprint> {
    let forward = plane.normal.cross(DVec3::Y);
    let place = |vertex: u32| mesh.positions[vertex as usize];
    let is_below = |vertex: u32| place(vertex).y < height;
    let cut: Vec<[u32; 3]> = mesh
        .triangles
        .iter()
        .copied()
        .filter(|corners| corners.iter().any(|&v| is_below(v)) && !corners.iter().all(|&v| is_below(v)))
        .collect();
    let mut pieces = DisjointSets::new(cut.len());
    let mut first_at: HashMap<(u32, u32), u32> = HashMap::new();
    let mut boxes: Vec<Option<Footprint>> = vec![None; cut.len()];
    for (index, &[a, b, c]) in cut.iter().enumerate() {
        for (from, to) in [(a, b), (b, c), (c, a)].into_iter().filter(|&(from, to)| is_below(from) != is_below(to)) {
            let neighbor = *first_at.entry((from.min(to), from.max(to))).or_insert(index as u32);
            pieces.join(neighbor, index as u32);
            let (start, end) = (place(from), place(to));
            let point = start.lerp(end, (height - start.y) / (end.y - start.y));
            let at = DVec2::new(plane.signed_distance(point), point.dot(forward));
            let here = Footprint { low: at, high: at };
            boxes[index] = Some(boxes[index].map_or(here, |known| known.joined(here)));
        }
    }
    let mut of_piece: BTreeMap<u32, Footprint> = BTreeMap::new();
    for (index, found) in boxes.into_iter().enumerate() {
        let Some(found) = found else { continue };
        of_piece.entry(pieces.find(index as u32)).and_modify(|known| *known = known.joined(found)).or_insert(found);
    }
    let mut prints: Vec<Footprint> =
        of_piece.into_values().filter(|print| (print.high - print.low).max_element() > FOOTPRINT_MIN).collect();
    if prints.len() > FOOTPRINTS_MAX {
        return Vec::new();
    }
    // Each round joins two: at most as many rounds as footprints.
    while let Some((one, other)) = beside(&prints) {
        let gone = prints.remove(other);
        prints[one] = prints[one].joined(gone);
    }
    prints
}

fn beside(prints: &[Footprint]) -> Option<(usize, usize)> {
    let pairs = (0..prints.len()).flat_map(|one| (one + 1..prints.len()).map(move |other| (one, other)));
    pairs.into_iter().find(|&(one, other)| prints[one].is_beside(&prints[other]))
}

/// What stands on these; `None`: it cannot be told.
fn legs(prints: &[Footprint]) -> Option<Category> {
    let left: Vec<&Footprint> = prints.iter().filter(|print| print.low.x > -OVER_PLANE).collect();
    let right: Vec<&Footprint> = prints.iter().filter(|print| print.high.x < OVER_PLANE).collect();
    if left.len() != right.len() || left.len() + right.len() != prints.len() {
        return None;
    }
    match &left[..] {
        [] => None,
        [_] => Some(Category::Biped),
        [one, other] => {
            let apart = (one.middle() - other.middle()).abs();
            // Side by side, these are a leg and a hand.
            (apart.y > apart.x).then_some(Category::Quadruped)
        }
        _ => Some(Category::Other),
    }
}

/// Arms are looked for above this share of the height.
const ARMS_ABOVE: f64 = 0.35;
/// A side that reaches less far than this share of the height has its arms hanging, or none.
const REACH_MIN: f64 = 0.25;
/// The far end of an arm, and what lies halfway, as shares of the side's reach.
const FAR: [f64; 2] = [0.8, 1.0];
const HALFWAY: [f64; 2] = [0.5, 0.7];
/// An arm is no thicker than this share of the reach (standard deviation of heights): wider is a cape, a wing or a head.
const THICKNESS_MAX: f64 = 0.22;
const SAMPLES_MIN: usize = 4;
/// Degrees below level up to which arms make a T, and up to which an A.
const T_DEGREES: f64 = 20.0;
const A_DEGREES: f64 = 70.0;
/// Left and right differ by less than this.
const EVEN_DEGREES: f64 = 20.0;

fn arms(samples: &SurfaceSamples, plane: &SymmetryPlane, ground: f64, height: f64) -> Pose {
    let upper = || samples.positions.iter().filter(|point| point.y - ground > ARMS_ABOVE * height);
    let mut angles = [0.0; 2];
    for (angle, side) in angles.iter_mut().zip([1.0, -1.0]) {
        let out = |point: &DVec3| side * plane.signed_distance(*point);
        let reach = upper().map(out).fold(0.0, f64::max);
        if reach < REACH_MIN * height {
            return Pose::Other;
        }
        let part = |[from, to]: [f64; 2]| {
            let points = upper().map(|point| DVec2::new(out(point), point.y));
            compact(points.filter(|point| (from * reach..=to * reach).contains(&point.x)).collect(), reach)
        };
        let (Some(far), Some(halfway)) = (part(FAR), part(HALFWAY)) else { return Pose::Unknown };
        *angle = (halfway.y - far.y).atan2(far.x - halfway.x).to_degrees();
    }
    let [left, right] = angles;
    let mean = 0.5 * (left + right);
    if (left - right).abs() > EVEN_DEGREES || !(-T_DEGREES..=A_DEGREES).contains(&mean) {
        Pose::Other
    } else if mean <= T_DEGREES {
        Pose::T
    } else {
        Pose::A
    }
}

/// The mean of points that may be a piece of an arm.
fn compact(points: Vec<DVec2>, reach: f64) -> Option<DVec2> {
    if points.len() < SAMPLES_MIN {
        return None;
    }
    let count = points.len() as f64;
    let mean = points.iter().sum::<DVec2>() / count;
    let variance = points.iter().map(|point| (point.y - mean.y).powi(2)).sum::<f64>() / count;
    (variance.sqrt() <= THICKNESS_MAX * reach).then_some(mean)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::bvh::Bvh;
    use crate::geometry::symmetry_plane::detect_symmetry_plane;
    use crate::mesh::test_shapes::{degenerate, joined, sphere, tube};
    use glam::{DMat3, DQuat};

    fn seen(mesh: &Mesh) -> Stance {
        let samples = SurfaceSamples::new(mesh, 2_000);
        stance(mesh, &samples, &detect_symmetry_plane(&samples, &Bvh::new(mesh)))
    }

    fn turned(mut mesh: Mesh, rotation: DQuat, origin: DVec3) -> Mesh {
        mesh.positions.iter_mut().for_each(|place| *place = rotation * *place + origin);
        mesh
    }

    /// A figure of height 1 whose arms hang `degrees` below level.
    fn figure(degrees: f64) -> Mesh {
        let leg = |x: f64| tube(DVec3::new(x, 0.0, 0.0), 0.05, 0.5, 16, 12);
        let arm = |side: f64| {
            let down = DQuat::from_rotation_z(-side * (90.0 + degrees).to_radians());
            turned(tube(DVec3::ZERO, 0.04, 0.35, 12, 10), down, DVec3::new(0.12 * side, 0.78, 0.0))
        };
        let trunk = tube(DVec3::new(0.0, 0.45, 0.0), 0.12, 0.38, 20, 10);
        let head = sphere(DVec3::new(0.0, 0.91, 0.03), 0.09, 16);
        joined(&[leg(0.08), leg(-0.08), arm(1.0), arm(-1.0), trunk, head])
    }

    #[test]
    fn the_angle_of_both_arms_makes_the_pose_of_a_biped() {
        for (degrees, pose) in [
            (0.0, Pose::T),
            (-10.0, Pose::T),
            (45.0, Pose::A),
            (60.0, Pose::A),
            (85.0, Pose::Other),
            (-50.0, Pose::Other),
        ] {
            let found = seen(&figure(degrees));
            assert_eq!((found.category, found.pose), (Category::Biped, pose), "{degrees}: {found:?}");
            assert!(found.confidence > 0.9, "{found:?}");
        }
    }

    #[test]
    fn a_figure_that_stands_askew_is_the_same_figure() {
        let mut mesh = figure(45.0);
        let turn = DMat3::from_rotation_y(0.5);
        mesh.positions.iter_mut().for_each(|place| *place = turn * *place + DVec3::new(0.1, 0.0, 0.2));
        let found = seen(&mesh);
        assert_eq!((found.category, found.pose), (Category::Biped, Pose::A), "{found:?}");
    }

    #[test]
    fn legs_behind_each_other_are_four_and_more_pairs_are_other() {
        let standing_on = |pairs: &[f64]| {
            let legs = pairs.iter().flat_map(|&z| [(0.1, z), (-0.1, z)]);
            let mut parts: Vec<Mesh> = legs.map(|(x, z)| tube(DVec3::new(x, 0.0, z), 0.04, 0.4, 12, 10)).collect();
            let back = DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2);
            parts.push(turned(tube(DVec3::ZERO, 0.15, 1.0, 20, 16), back, DVec3::new(0.0, 0.5, -0.5)));
            parts.push(sphere(DVec3::new(0.0, 0.6, 0.55), 0.12, 16));
            seen(&joined(&parts))
        };
        let dog = standing_on(&[-0.4, 0.4]);
        assert_eq!((dog.category, dog.pose), (Category::Quadruped, Pose::Unknown), "{dog:?}");
        assert_eq!(standing_on(&[-0.4, 0.0, 0.4]).category, Category::Other);
    }

    #[test]
    fn what_has_no_legs_or_no_mirror_plane_is_unknown_and_so_sure() {
        let robe = tube(DVec3::ZERO, 0.2, 1.0, 24, 20);
        let lopsided = joined(&[figure(0.0), sphere(DVec3::new(0.6, 0.3, 0.5), 0.3, 24)]);
        for mesh in [robe, lopsided].iter().chain(&degenerate()) {
            let found = seen(mesh);
            assert_eq!((found.category, found.confidence, found.pose), (Category::Unknown, 0.0, Pose::Unknown));
        }
    }
}
