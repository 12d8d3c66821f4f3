//! Left and right of a skin made alike: each vertex takes the mean of its own weights and the mirrored weights of its image.
//!
//! | in         | shape | meaning                                                               |
//! |------------|-------|-----------------------------------------------------------------------|
//! | `skeleton` | `[J]` | normalised frame                                                      |
//! | `images`   | `[V]` | place of each vertex's image, [`crate::geometry::mirror_images`]      |
//! | `twins`    | `[J]` | the joint at each joint's image, [`joint_twins`]; `None` without one  |
//!
//! Of two vertices that are each other's images both get the same weights but for rounding. A vertex keeps its own where it has
//! no image, or where it or its image follows a joint without a twin: a sword's joint has none.

use super::skin_weights::{Trim, heaviest_first, kept_count, scaled};
use super::{Influence, Skeleton, SkinWeights};
use crate::geometry::symmetry_plane::SymmetryPlane;
use crate::geometry::transfer::Blend;
use rayon::prelude::*;

/// A joint this near to another's image is its twin (normalised frame): a finger's width, since artists' sides differ by less.
const TWIN_DISTANCE: f64 = 0.02;

/// The twin of every joint; a joint in the middle is its own. Twins are mutual.
///
/// Joints at one place (a hip and the root) are told apart by their parents: a joint whose parent is the twin of the parent
/// comes before any other.
pub fn joint_twins(skeleton: &Skeleton, plane: &SymmetryPlane) -> Vec<Option<u32>> {
    let joints = &skeleton.joints;
    let mut twins: Vec<Option<u32>> = vec![None; joints.len()];
    for (index, joint) in joints.iter().enumerate() {
        if twins[index].is_some() {
            continue;
        }
        let image = plane.reflect(joint.position);
        let parent = joint.parent.map(|parent| twins[parent]);
        let is_of_twins = |other: usize| joints[other].parent.map(|parent| Some(parent as u32)) == parent;
        let free = (0..joints.len()).filter(|&other| twins[other].is_none());
        let near = free.filter_map(|other| {
            let distance = joints[other].position.distance(image);
            (distance <= TWIN_DISTANCE).then_some((!is_of_twins(other), distance, other))
        });
        let best = near.min_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        if let Some((.., other)) = best {
            twins[index] = Some(other as u32);
            twins[other] = Some(index as u32);
        }
    }
    twins
}

impl SkinWeights {
    /// The skin with both sides alike. Second: how many vertices have the mean of two sides.
    pub fn mirrored(&self, images: &[Option<Blend>], twins: &[Option<u32>], trim: Trim) -> (Self, usize) {
        let rows: Vec<(Vec<Influence>, bool)> = (self.rows.par_iter().zip(images))
            .map(|(row, image)| match image.and_then(|image| self.mean_of_sides(row, &image, twins, trim)) {
                Some(row) => (row, true),
                None => (row.clone(), false),
            })
            .collect();
        let averaged = rows.iter().filter(|(_, averaged)| *averaged).count();
        (Self { rows: rows.into_iter().map(|(row, _)| row).collect() }, averaged)
    }

    fn mean_of_sides(
        &self,
        row: &[Influence],
        image: &Blend,
        twins: &[Option<u32>],
        trim: Trim,
    ) -> Option<Vec<Influence>> {
        let twin = |joint: u32| twins.get(joint as usize).copied().flatten();
        let mut shares: Vec<(u32, f64)> = Vec::new();
        for influence in row {
            twin(influence.joint)?;
            shares.push((influence.joint, f64::from(influence.weight) / 2.0));
        }
        for &(vertex, share) in image.iter().filter(|(_, share)| *share > 0.0) {
            for influence in self.rows.get(vertex as usize)? {
                shares.push((twin(influence.joint)?, share * f64::from(influence.weight) / 2.0));
            }
        }
        let shares = heaviest_first(shares);
        let count = kept_count(&shares, trim)?;
        Some(scaled(&shares[..symmetric_count(&shares, count)]))
    }
}

/// `count`, or fewer where that would part equals: of left and right with one weight both stay or both go. Where all are equal,
/// order decides.
fn symmetric_count(shares: &[(u32, f64)], count: usize) -> usize {
    let (Some(last), Some(next)) = (shares.get(count - 1), shares.get(count)) else { return count };
    if last.1 != next.1 {
        return count;
    }
    match shares.iter().position(|share| share.1 == last.1) {
        Some(first) if first > 0 => first,
        _ => count,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::Joint;

    const PLANE: SymmetryPlane = SymmetryPlane::CANONICAL;

    fn skeleton(joints: &[(Option<usize>, [f64; 3])]) -> Skeleton {
        let joint = |(index, &(parent, position)): (usize, &(Option<usize>, [f64; 3]))| Joint {
            name: format!("joint {index}"),
            parent,
            position: position.into(),
        };
        Skeleton { joints: joints.iter().enumerate().map(joint).collect() }
    }

    fn row(influences: &[(u32, f32)]) -> Vec<Influence> {
        influences.iter().map(|&(joint, weight)| Influence { joint, weight }).collect()
    }

    const AT: fn(u32) -> Option<Blend> = |vertex| Some([(vertex, 1.0), (vertex, 0.0), (vertex, 0.0)]);

    #[test]
    fn twins_are_found_by_place_and_at_one_place_by_parent() {
        let skeleton = skeleton(&[
            (None, [0.0, 0.5, 0.0]),
            (Some(0), [0.0, 0.5, 0.0]),  // hips, where the root is
            (Some(1), [0.2, 0.4, 0.01]), // a leg, with a twist joint at its place
            (Some(2), [0.2, 0.4, 0.01]),
            (Some(1), [-0.201, 0.4, 0.0]),
            (Some(4), [-0.201, 0.4, 0.0]),
            (Some(1), [-0.4, 0.9, 0.0]), // a sword
        ]);
        let twins = joint_twins(&skeleton, &PLANE);
        assert_eq!(twins, [Some(0), Some(1), Some(4), Some(5), Some(2), Some(3), None]);
    }

    #[test]
    fn both_sides_get_the_mean_and_the_middle_its_own() {
        let skin = SkinWeights {
            rows: vec![row(&[(1, 0.8), (0, 0.2)]), row(&[(2, 0.5), (0, 0.5)]), row(&[(1, 0.75), (2, 0.25)])],
        };
        let (skin, averaged) = skin.mirrored(&[AT(1), AT(0), AT(2)], &[Some(0), Some(2), Some(1)], Trim::USUAL);
        assert_eq!(averaged, 3);
        let expected = [[(1, 0.65), (0, 0.35)], [(2, 0.65), (0, 0.35)], [(1, 0.5), (2, 0.5)]];
        for (row, expected) in skin.rows.iter().zip(expected) {
            for (influence, (joint, weight)) in row.iter().zip(expected) {
                assert!(influence.joint == joint && (influence.weight - weight).abs() < 1e-6, "{row:?}");
            }
        }
    }

    #[test]
    fn what_has_no_image_or_no_twin_keeps_its_weights() {
        let rows = vec![row(&[(1, 1.0)]), row(&[(3, 1.0)]), row(&[(2, 1.0)])];
        let skin = SkinWeights { rows: rows.clone() };
        let twins = [Some(0), Some(2), Some(1), None];
        let (same, averaged) = skin.mirrored(&[None, AT(0), AT(1)], &twins, Trim::USUAL);
        assert_eq!((same.rows, averaged), (rows, 0));
    }

    #[test]
    fn a_limit_of_influences_parts_no_pair() {
        let skin = SkinWeights { rows: vec![row(&[(0, 0.5), (1, 0.3), (2, 0.2)])] };
        let trim = Trim { max_influences: 2, ..Trim::USUAL };
        let twins = [Some(0), Some(2), Some(1)];
        assert_eq!(skin.mirrored(&[AT(0)], &twins, trim).0.rows[0], row(&[(0, 1.0)]));
        let pair = SkinWeights { rows: vec![row(&[(1, 0.5), (2, 0.5)])] };
        let one = Trim { max_influences: 1, ..trim };
        assert_eq!(pair.mirrored(&[AT(0)], &twins, one).0.rows[0], row(&[(1, 1.0)]), "one must stay");
    }

    #[test]
    fn a_skeleton_with_nothing_on_the_other_side_has_no_twins() {
        let skeleton = skeleton(&[(None, [0.3, 0.5, 0.0])]);
        assert_eq!(joint_twins(&skeleton, &PLANE), [None]);
        assert!(joint_twins(&Skeleton::default(), &PLANE).is_empty());
    }
}
