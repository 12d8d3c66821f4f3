//! Which way is up and which way a character faces, for formats that do not say.
//!
//! | in     | shape              | unit                |
//! |--------|--------------------|---------------------|
//! | `mesh` | `[V, 3]`, `[F, 3]` | upload space, any   |
//!
//! Each of the 24 ways to choose signed axes for up and front is described by a few features of evenly spread surface
//! points: how nearly left mirrors right, whether the shape would stand, where feet and head are. A multinomial logistic
//! model over the 24, with a prior for what files usually have, gives their probabilities. Its weights were fitted to
//! 295 openly licensed characters whose axes are known.
//!
//! How well it does on 49 other characters: all files with the usual axes keep them (98 % of the fitted ones do); of files
//! with z up and −y front 39 % are recognised, and the rest are taken as +y up and +z front with a confidence that says
//! so. Which of two opposite ways a character faces is mostly the prior's choice.

use super::point_tree::PointTree;
use super::surface_samples::SurfaceSamples;
use crate::mesh::Mesh;
use glam::{DMat3, DVec2, DVec3};

/// Signed unit axes of upload space, and how far they can be trusted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orientation {
    /// One of ±x, ±y, ±z.
    pub up: DVec3,
    /// One of ±x, ±y, ±z, at a right angle to `up`.
    pub front: DVec3,
    /// Probability of these axes, 0 to 1. Other axes than [`Self::DEFAULT`]'s have at least [`CONFIDENT`].
    pub confidence: f64,
}

/// Other axes than the usual ones are taken only when they are this probable.
pub const CONFIDENT: f64 = 0.8;

impl Orientation {
    /// What is assumed when nothing speaks for anything else, and what glTF prescribes.
    pub const DEFAULT: Self = Self { up: DVec3::Y, front: DVec3::Z, confidence: 0.0 };

    /// The rotation that takes `up` to +y and `front` to +z.
    pub fn rotation(&self) -> DMat3 {
        rotation_to_frame(self.up, self.front)
    }
}

/// A front that goes with `up` where none is known: +z, or as Blender has it, −y where z is up.
pub fn any_front(up: DVec3) -> DVec3 {
    if up.z.abs() > 0.5 { DVec3::NEG_Y * up.z.signum() } else { DVec3::Z }
}

/// The rotation that takes `up` to +y and `front` to +z (both of unit length, at a right angle).
pub fn rotation_to_frame(up: DVec3, front: DVec3) -> DMat3 {
    DMat3::from_cols(up.cross(front), up, front).transpose()
}

/// Guesses the axes of `mesh`.
pub fn guess_orientation(mesh: &Mesh) -> Orientation {
    let Some(cloud) = Cloud::new(mesh) else { return Orientation::DEFAULT };
    let choices = choices();
    let scores = choices.map(|(up, front)| {
        let features = cloud.features(up, front);
        features.iter().zip(WEIGHTS).map(|(feature, weight)| feature * weight).sum::<f64>() + prior(up, front)
    });
    let highest = scores.into_iter().fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = scores.iter().map(|score| (score - highest).exp()).sum();
    let probability = |index: usize| (scores[index] - highest).exp() / total;
    let best = (0..choices.len()).max_by(|&a, &b| scores[a].total_cmp(&scores[b]).then(b.cmp(&a))).unwrap_or(0);
    let usual = choices.iter().position(|&choice| choice == (DVec3::Y, DVec3::Z)).unwrap_or(0);
    let chosen = if probability(best) >= CONFIDENT { best } else { usual };
    let (up, front) = choices[chosen];
    Orientation { up, front, confidence: probability(chosen) }
}

/// How much more often files have these axes than others, as a logarithm: +y up and +z front as in glTF and most OBJ
/// files; z up and −y front as Blender and CAD programs have it.
fn prior(up: DVec3, front: DVec3) -> f64 {
    match (up, front) {
        (DVec3::Y, DVec3::Z) => 4.0,
        (DVec3::Z, DVec3::NEG_Y) => 3.0,
        (DVec3::Y | DVec3::Z, _) => 1.0,
        _ => 0.0,
    }
}

const AXES: [DVec3; 6] = [DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_X, DVec3::NEG_Y, DVec3::NEG_Z];

/// Every pair of signed axes at a right angle: (up, front).
fn choices() -> [(DVec3, DVec3); 24] {
    std::array::from_fn(|index| {
        let up = index / 4;
        let others = [(up + 1) % 3, (up + 2) % 3];
        (AXES[up], AXES[others[index % 2] + 3 * (index / 2 % 2)])
    })
}

/// Weights of [`Cloud::features`], fitted by maximum likelihood with a small ridge.
const WEIGHTS: [f64; 10] = [-5.9, 1.561, 8.663, 0.737, -2.957, -3.785, 2.126, 2.938, 0.661, 9.436];

/// Points and faces that are enough to describe a shape.
const POINTS: usize = 1_500;
const FACES_MAX: usize = 20_000;

/// Evenly spread points of the surface in a box whose longest side is 1, centred.
struct Cloud {
    points: Vec<DVec3>,
    /// Sides of the box; the longest is 1.
    size: DVec3,
    /// Per axis: mean distance of mirrored points from the nearest point.
    mirror_error: [f64; 3],
}

impl Cloud {
    /// `None` for a mesh without a surface.
    fn new(mesh: &Mesh) -> Option<Self> {
        let (low, high) = mesh.bounding_box()?;
        let scale = (high - low).max_element().recip();
        if !(scale.is_finite() && scale > 0.0) {
            return None;
        }
        let middle = low * 0.5 + high * 0.5;
        let positions = mesh.positions.iter().map(|&position| (position - middle) * scale).collect();
        let step = mesh.triangles.len().div_ceil(FACES_MAX).max(1);
        let triangles = mesh.triangles.iter().copied().step_by(step).collect();
        let points = SurfaceSamples::new(&Mesh { positions, triangles }, POINTS).positions;
        if points.is_empty() {
            return None;
        }
        let tree = PointTree::new(&points);
        let mirror_error = [0, 1, 2].map(|axis| {
            let distance = |point: &DVec3| {
                let mut mirrored = *point;
                mirrored[axis] = -mirrored[axis];
                tree.nearest(mirrored).map_or(0.0, |(_, squared)| squared.sqrt())
            };
            points.iter().map(distance).sum::<f64>() / points.len() as f64
        });
        Some(Self { points, size: (high - low) * scale, mirror_error })
    }

    /// What speaks for or against a choice of axes: asymmetry of left and right against other axes; whether the middle
    /// is above the support; share of the box that bottom and top rest on; height; depth; toes before heels; head before
    /// body; body before the middle of the box; height of the body's middle.
    fn features(&self, up: DVec3, front: DVec3) -> [f64; 10] {
        let side = up.cross(front);
        let [height, depth, width] = [up, front, side].map(|axis| self.size.dot(axis.abs()));
        // Height of a point as a share, 0 at the bottom.
        let share = |point: DVec3| point.dot(up) / height.max(1e-9) + 0.5;
        let between =
            |low: f64, high: f64| self.points.iter().copied().filter(move |&p| (low..=high).contains(&share(p)));
        let forward = |low: f64, high: f64| {
            let (sum, count) = between(low, high).fold((0.0, 0.0), |(sum, count), p| (sum + p.dot(front), count + 1.0));
            if count > 0.0 { sum / count / depth.max(1e-9) } else { 0.0 }
        };
        let flat = |point: DVec3| DVec2::new(point.dot(side), point.dot(front));
        let hull = |low: f64, high: f64| convex_hull(between(low, high).map(flat).collect());
        let (bottom, top) = (hull(0.0, 0.04), hull(0.96, 1.0));
        let count = self.points.len() as f64;
        let centre = flat(self.points.iter().sum::<DVec3>() / count);
        let base = (width * depth).max(1e-9);
        let mean_error = self.mirror_error.iter().sum::<f64>() / 3.0;
        [
            DVec3::from(self.mirror_error).dot(side.abs()) / mean_error.max(1e-9),
            f64::from(u8::from(encloses(&bottom, centre))),
            hull_area(&bottom) / base,
            hull_area(&top) / base,
            height,
            depth,
            forward(0.0, 0.05) - forward(0.08, 0.25),
            forward(0.8, 1.0) - forward(0.0, 1.0),
            forward(0.0, 1.0),
            self.points.iter().map(|&point| share(point)).sum::<f64>() / count,
        ]
    }
}

/// Corners of the convex hull, counter-clockwise [Andrew 1979].
fn convex_hull(mut points: Vec<DVec2>) -> Vec<DVec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let mut hull: Vec<DVec2> = Vec::new();
    for reversed in [false, true] {
        let start = hull.len();
        for index in 0..points.len() {
            let point = points[if reversed { points.len() - 1 - index } else { index }];
            while let [.., a, b] = hull[start..]
                && (b - a).perp_dot(point - b) <= 0.0
            {
                hull.pop();
            }
            hull.push(point);
        }
        hull.pop(); // the other chain begins with it
    }
    hull
}

fn hull_area(hull: &[DVec2]) -> f64 {
    let next = hull.iter().cycle().skip(1);
    0.5 * hull.iter().zip(next).map(|(a, b)| a.perp_dot(*b)).sum::<f64>()
}

fn encloses(hull: &[DVec2], point: DVec2) -> bool {
    let next = hull.iter().cycle().skip(1);
    hull.len() > 2 && hull.iter().zip(next).all(|(&a, &b)| (b - a).perp_dot(point - a) >= 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::{degenerate, joined, sphere, tube};

    /// A standing figure, +y up, facing +z: legs with toes forward, body, arms out, head.
    fn figure() -> Mesh {
        let limb = |x: f64| tube(DVec3::new(x, 0.05, 0.0), 0.06, 0.42, 16, 8);
        let foot = |x: f64| {
            let mut foot = sphere(DVec3::ZERO, 0.06, 16);
            foot.positions.iter_mut().for_each(|p| *p = DVec3::new(p.x + x, 0.5 * p.y + 0.03, 2.0 * p.z + 0.06));
            foot
        };
        let mut arms = tube(DVec3::Y * -0.45, 0.045, 0.9, 12, 12);
        arms.positions.iter_mut().for_each(|p| *p = DVec3::new(p.y, p.x + 0.75, -p.z));
        let mut chest = tube(DVec3::Y * 0.45, 0.13, 0.38, 20, 8);
        chest.positions.iter_mut().for_each(|p| p.z *= 0.6);
        let head = sphere(DVec3::new(0.0, 0.91, 0.02), 0.09, 16);
        joined(&[limb(0.15), limb(-0.15), foot(0.15), foot(-0.15), arms, chest, head])
    }

    #[test]
    fn a_standing_figure_is_found_in_the_two_usual_frames() {
        for (up, front) in [(DVec3::Y, DVec3::Z), (DVec3::Z, DVec3::NEG_Y)] {
            let to_upload = rotation_to_frame(up, front).transpose();
            let mut mesh = figure();
            mesh.positions.iter_mut().for_each(|position| *position = to_upload * *position * 170.0);
            let guess = guess_orientation(&mesh);
            assert_eq!((guess.up, guess.front), (up, front), "{guess:?}");
            assert!(guess.confidence > CONFIDENT);
        }
    }

    #[test]
    fn a_shape_without_a_way_up_keeps_the_usual_axes_and_says_so() {
        let guess = guess_orientation(&sphere(DVec3::ZERO, 1.0, 30));
        assert_eq!((guess.up, guess.front), (DVec3::Y, DVec3::Z));
        assert!(guess.confidence < CONFIDENT, "{guess:?}");
        for mesh in degenerate() {
            assert!((0.0..=1.0).contains(&guess_orientation(&mesh).confidence));
        }
    }

    #[test]
    fn every_choice_is_a_right_handed_frame_and_comes_once() {
        let choices = choices();
        for (index, &(up, front)) in choices.iter().enumerate() {
            assert_eq!(up.dot(front), 0.0);
            let rotation = rotation_to_frame(up, front);
            assert_eq!((rotation * up, rotation * front, rotation.determinant()), (DVec3::Y, DVec3::Z, 1.0));
            assert!(!choices[..index].contains(&(up, front)));
        }
    }

    #[test]
    fn the_hull_of_a_square_with_points_inside_is_the_square() {
        let points = [(0.0, 0.0), (1.0, 0.0), (0.5, 0.5), (1.0, 1.0), (0.0, 1.0), (0.5, 0.0)].map(DVec2::from).to_vec();
        let hull = convex_hull(points);
        assert_eq!((hull.len(), hull_area(&hull)), (4, 1.0));
        assert!(encloses(&hull, DVec2::new(0.3, 0.6)) && !encloses(&hull, DVec2::new(1.1, 0.5)));
        assert!(!encloses(&convex_hull(vec![DVec2::ZERO; 5]), DVec2::ZERO));
    }
}
