//! Skin weights as the heat that bones give off. Ilya Baran, Jovan Popović: *Automatic Rigging and Animation of 3D
//! Characters*, ACM Transactions on Graphics 26(3), 2007, Section 4 ("bone heat").
//!
//! | in         | shape    | unit                                                |
//! |------------|----------|-----------------------------------------------------|
//! | `mesh`     | V, F     | normalised frame                                    |
//! | `distance` | `[V, B]` | from bones to vertices through the solid, normalised |
//!
//! Out: weights over bones `[V, B]`, rows of sum 1 (0 where no bone has a finite distance). Each joint is kept hot along its
//! bones, heat flows over the surface, and the temperature at rest is the weight:
//!
//! ```text
//! −Δ w_j + H w_j = H p_j        H_v = c / d_v²,   p_j(v) = 1 where j is nearest to v, else 0
//! ```
//!
//! d_v is the distance of the nearest joint. Weights of a limb turn into those of the next over about its own radius, at
//! any resolution of the mesh, which no smoothing over edges does.
//! # Departures from the paper
//! - d is the way through the solid [Dionne and de Lasa 2013], so no visibility test is needed: theirs leaves vertices that no
//!   bone sees without heat of their own, and fails on parts that hold none.
//! - Joints as near as the nearest within [`TIE`] share p; theirs does so within a rounding error.
//! - Cotangents are bounded, so that needles and slivers neither insulate nor conduct without limit.

use super::bone_weights::BoneWeights;
use super::distance_falloff::nearest_of_joints;
use super::skeleton::Bone;
use crate::mesh::Mesh;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// c: how strongly bones heat. The paper's is 1.
///
/// On 76 training rigs with their own skeletons, organic / box: mean L1 .558 / .789, precision .76 / .47, recall .81 / .85. c of 1: .608 /
/// .825, 2: .572 / .806, 8: .564 / .775 with less recall. The falloff of [`super::distance_falloff`] reaches .60 / .80.
pub const HEAT: f64 = 4.0;
/// What is below this share of a row's greatest is dropped.
pub const HEAT_TRACE_SHARE: f32 = 0.05;
/// Relative difference of distances that counts as none.
const TIE: f64 = 0.01;
/// Nearer than this a vertex takes the bone's temperature at once; keeps H finite.
const DISTANCE_MIN: f64 = 1e-3;
/// Bounds of a face's share in the coupling of two vertices, half a cotangent.
const COUPLING: std::ops::RangeInclusive<f64> = 0.01..=5.0;
/// Stands for the area of vertices without faces.
const AREA_MIN: f64 = 1e-9;

/// The iteration ends when the residual has fallen to this share ...
const RESIDUAL: f64 = 1e-5;
/// ... or after so many steps: five times what the worst of the validation meshes took.
const STEPS_MAX: usize = 400;

/// Weights of every vertex over `bones` from its `distance` to each.
pub fn heat_weights(mesh: &Mesh, distance: &[f32], bones: &[Bone], heat: f64) -> BoneWeights {
    let vertex_count = mesh.positions.len();
    let mut weights = BoneWeights { bone_count: bones.len(), values: vec![0.0; vertex_count * bones.len()] };
    if bones.is_empty() {
        return weights;
    }
    let nearest: Vec<Nearest> = distance.par_chunks_exact(bones.len()).map(|row| Nearest::new(row, bones)).collect();
    let system = System::new(mesh, &nearest, heat);
    let mut sources: BTreeMap<usize, Vec<(usize, f64)>> = BTreeMap::new();
    for (vertex, nearest) in nearest.iter().enumerate() {
        for &bone in &nearest.bones {
            let share = system.heating[vertex] / nearest.bones.len() as f64;
            sources.entry(bones[bone].start_joint).or_default().push((vertex, share));
        }
    }
    let temperatures: Vec<(usize, Vec<f64>)> =
        sources.into_par_iter().map(|(joint, source)| (joint, system.solve(&source))).collect();
    let bone_of_joint = first_bones(bones);
    for (joint, temperature) in temperatures {
        for (row, warmth) in weights.values.chunks_exact_mut(bones.len()).zip(temperature) {
            row[bone_of_joint[&joint]] = warmth.clamp(0.0, 1.0) as f32;
        }
    }
    weights
}

/// A bone of each joint that has any; weights belong to the joint, whichever of its bones carries them.
fn first_bones(bones: &[Bone]) -> BTreeMap<usize, usize> {
    bones.iter().enumerate().rev().map(|(index, bone)| (bone.start_joint, index)).collect()
}

/// The bones nearest to a vertex, one per joint, and how far they are; no bones where none is at a finite distance.
struct Nearest {
    distance: f64,
    bones: Vec<usize>,
}

impl Nearest {
    fn new(distance: &[f32], bones: &[Bone]) -> Self {
        let of_joints: Vec<usize> = nearest_of_joints(distance, bones).into_iter().flatten().collect();
        let least = of_joints.iter().map(|&bone| f64::from(distance[bone])).fold(f64::INFINITY, f64::min);
        let is_near = |bone: &usize| f64::from(distance[*bone]) <= least * (1.0 + TIE);
        Self { distance: least, bones: of_joints.into_iter().filter(is_near).collect() }
    }
}

/// `(C + A H) w = A H p`: C the cotangent couplings, A the vertices' areas. Symmetric and positive definite.
struct System {
    /// Per vertex its neighbours, each with the coupling.
    couplings: Vec<Vec<(u32, f64)>>,
    /// A H. `[V]`
    heating: Vec<f64>,
    diagonal: Vec<f64>,
}

impl System {
    fn new(mesh: &Mesh, nearest: &[Nearest], heat: f64) -> Self {
        let mut area = vec![AREA_MIN; mesh.positions.len()];
        let mut couplings: Vec<BTreeMap<u32, f64>> = vec![BTreeMap::new(); mesh.positions.len()];
        for (triangle, &corners) in mesh.triangles.iter().enumerate() {
            let places = mesh.corners(triangle);
            for turn in 0..3 {
                let [a, b, opposite] = [turn, (turn + 1) % 3, (turn + 2) % 3];
                let (u, v) = (places[a] - places[opposite], places[b] - places[opposite]);
                let twice_area = u.cross(v).length();
                let half_cotangent = 0.5 * u.dot(v) / twice_area.max(f64::MIN_POSITIVE);
                let coupling = half_cotangent.clamp(*COUPLING.start(), *COUPLING.end());
                *couplings[corners[a] as usize].entry(corners[b]).or_default() += coupling;
                *couplings[corners[b] as usize].entry(corners[a]).or_default() += coupling;
                area[corners[a] as usize] += twice_area / 6.0;
            }
        }
        let rate = |nearest: &Nearest| {
            if nearest.bones.is_empty() { 0.0 } else { heat / nearest.distance.max(DISTANCE_MIN).powi(2) }
        };
        let heating: Vec<f64> = area.iter().zip(nearest).map(|(area, nearest)| area * rate(nearest)).collect();
        let couplings: Vec<Vec<(u32, f64)>> = couplings.into_iter().map(|row| row.into_iter().collect()).collect();
        // A vertex that nothing heats and that has no neighbours stays at zero; one on the diagonal keeps it solvable.
        let own = |(row, heating): (&Vec<(u32, f64)>, &f64)| heating + row.iter().map(|(_, c)| c).sum::<f64>();
        let diagonal = couplings.iter().zip(&heating).map(own).map(|own| if own > 0.0 { own } else { 1.0 }).collect();
        Self { couplings, heating, diagonal }
    }

    fn times(&self, warmth: &[f64]) -> Vec<f64> {
        let row = |vertex: usize| {
            let flow: f64 = self.couplings[vertex].iter().map(|&(other, c)| c * warmth[other as usize]).sum();
            self.diagonal[vertex] * warmth[vertex] - flow
        };
        (0..warmth.len()).map(row).collect()
    }

    /// The temperature at rest where `source` heats: conjugate gradients [Hestenes and Stiefel 1952], preconditioned by the
    /// diagonal.
    fn solve(&self, source: &[(usize, f64)]) -> Vec<f64> {
        let mut warmth = vec![0.0; self.diagonal.len()];
        let mut residual = vec![0.0; self.diagonal.len()];
        source.iter().for_each(|&(vertex, share)| residual[vertex] += share);
        let scaled =
            |residual: &[f64]| -> Vec<f64> { residual.iter().zip(&self.diagonal).map(|(r, d)| r / d).collect() };
        let mut step = scaled(&residual);
        let mut measure = dot(&residual, &step);
        let enough = measure * RESIDUAL * RESIDUAL;
        for _ in 0..STEPS_MAX {
            if measure <= enough {
                break;
            }
            let image = self.times(&step);
            let length = measure / dot(&step, &image);
            for vertex in 0..warmth.len() {
                warmth[vertex] += length * step[vertex];
                residual[vertex] -= length * image[vertex];
            }
            let ahead = scaled(&residual);
            let next = dot(&residual, &ahead);
            let keep = next / measure;
            step.iter_mut().zip(ahead).for_each(|(step, ahead)| *step = ahead + keep * *step);
            measure = next;
        }
        warmth
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::volumetric_geodesic::bone_euclid;
    use crate::mesh::test_shapes::{degenerate, joined, sphere, tube};
    use glam::DVec3;

    fn bone(joint: usize, start: DVec3, end: DVec3) -> Bone {
        Bone { start, end, start_joint: joint, end_joint: joint + 1 }
    }

    /// Two bones of an arm along y.
    fn arm() -> Vec<Bone> {
        let place = |k: f64| DVec3::Y * k * 0.5;
        vec![bone(0, place(0.0), place(1.0)), bone(1, place(1.0), place(2.0))]
    }

    fn weights(mesh: &Mesh, bones: &[Bone]) -> BoneWeights {
        let segments: Vec<_> = bones.iter().map(|bone| (bone.start, bone.end)).collect();
        heat_weights(mesh, &bone_euclid(&mesh.positions, &segments), bones, 1.0)
    }

    /// On a long tube the equation is `−w'' + w c / r² = …`: weights cross at one half and fall by e over a radius.
    #[test]
    fn an_arm_blends_over_its_radius_at_any_resolution() {
        for (around, along) in [(12, 40), (24, 120)] {
            let mesh = tube(DVec3::ZERO, 0.1, 1.0, around, along);
            let skin = weights(&mesh, &arm());
            for (vertex, place) in mesh.positions.iter().enumerate() {
                let beyond = (place.y - 0.5) / 0.1;
                let expected = if beyond < 0.0 { 0.5 * beyond.exp() } else { 1.0 - 0.5 * (-beyond).exp() };
                let found = f64::from(skin.row(vertex)[1]);
                assert!((found - expected).abs() < 0.06, "{found} at {beyond}, expected {expected}");
            }
        }
    }

    #[test]
    fn rows_sum_to_one_on_parts_that_do_not_touch() {
        let mesh = joined(&[tube(DVec3::ZERO, 0.1, 1.0, 16, 20), sphere(DVec3::X, 0.2, 12)]);
        let skin = weights(&mesh, &arm());
        for vertex in 0..mesh.positions.len() {
            assert!((skin.row(vertex).iter().sum::<f32>() - 1.0).abs() < 1e-3);
        }
    }

    #[test]
    fn a_vertex_that_no_bone_reaches_takes_its_neighbours_warmth() {
        let mesh = tube(DVec3::ZERO, 0.1, 1.0, 16, 20);
        let mut distance = vec![0.1; mesh.positions.len()];
        distance[40] = f32::INFINITY;
        let skin = heat_weights(&mesh, &distance, &arm()[..1], 1.0);
        assert!((skin.row(40)[0] - 1.0).abs() < 1e-3);
        let nowhere = heat_weights(&mesh, &vec![f32::INFINITY; mesh.positions.len()], &arm()[..1], 1.0);
        assert!(nowhere.values.iter().all(|weight| *weight == 0.0));
    }

    #[test]
    fn degenerate_shapes_and_no_bones_are_survived() {
        for mesh in degenerate() {
            assert!(weights(&mesh, &arm()).values.iter().all(|weight| weight.is_finite()));
            assert!(weights(&mesh, &[]).values.is_empty());
        }
    }

    #[test]
    fn one_thread_and_two_give_the_same_bits() {
        let mesh = tube(DVec3::ZERO, 0.1, 1.0, 16, 40);
        let with = |threads| {
            rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| weights(&mesh, &arm()))
        };
        assert_eq!(with(1), with(2));
    }
}
