//! A rig judged without knowing the right answer: what an artist would look at before using it.
//!
//! | in         | shape     | space                                       |
//! |------------|-----------|---------------------------------------------|
//! | `mesh`     | `[V, 3]`  | normalised: the longest side is 1           |
//! | `skeleton` | `[J]`     | the same                                    |
//! | `skin`     | `[V, ≤N]` | rows of the mesh's vertices                 |
//!
//! Every figure is a share from 0 to 1 or a ratio; lengths are in units of the longest side. The bounds of the verdict are
//! chosen, not fitted. On every third validation rig they call 9 good, 5 usable and 3 poor with the artist's skeleton and our
//! weights, and 7, 7 and 3 of the rigs that are all ours; bleeding weights are the most frequent reason. Pure; O(J · E log V).

use super::bleed::bleed;
use super::linear_blend_skinning::posed_positions;
use super::quality::{inside_share, mirror_error};
use super::range_of_motion::{poses, stretch, volume_change};
use super::{Skeleton, SkinWeights};
use crate::geometry::symmetry_plane::SymmetryPlane;
use crate::mesh::Mesh;
use crate::mesh::adjacency::{Neighbors, one_ring};
use glam::DVec3;

/// What is judged.
pub struct Subject<'a> {
    pub mesh: &'a Mesh,
    pub skeleton: &'a Skeleton,
    pub skin: &'a SkinWeights,
    /// Whether a point lies inside the solid.
    pub is_inside: &'a (dyn Fn(DVec3) -> bool + Sync),
    /// The mirror plane, where left and right are meant to be alike.
    pub plane: Option<&'a SymmetryPlane>,
}

/// The figures and what they come to.
#[derive(Clone, Debug, PartialEq)]
pub struct Quality {
    /// Share of joints inside the solid.
    pub joints_inside: f64,
    /// Share of the bones' length that lies outside of it.
    pub bone_outside: f64,
    /// Per joint `[J]`: share of its weight on vertices that are far away over the surface.
    pub bleed: Vec<f64>,
    /// Mean distance of mirrored joints from the nearest joint.
    pub mirror_error: Option<f64>,
    /// Mean over the edges of half the difference of both ends' weights: 0 is one rigid piece, 1 no two neighbours alike.
    pub roughness: f64,
    /// How much longer or shorter the worst hundredth of the edges becomes over the range of motion; 1: not at all.
    pub stretch: f64,
    /// The largest share of the volume that is lost or gained over the range of motion; `None` where there is no volume.
    pub volume_change: Option<f64>,
    pub verdict: Verdict,
    /// Why it is not good; empty when it is.
    pub reasons: Vec<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    Good,
    Usable,
    Poor,
}

impl Verdict {
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Usable => "usable",
            Self::Poor => "poor",
        }
    }
}

/// Points looked at along each bone.
const BONE_SAMPLES: usize = 16;
/// Judges a rig.
pub fn judge(subject: &Subject) -> Quality {
    let Subject { mesh, skeleton, skin, is_inside, plane } = subject;
    let joints = skeleton.positions();
    let ring = one_ring(mesh);
    let poses: Vec<Vec<DVec3>> = poses(skeleton.joints.len())
        .iter()
        .map(|rotations| posed_positions(&mesh.positions, skeleton, skin, rotations))
        .collect();
    let mut quality = Quality {
        joints_inside: inside_share(&joints, is_inside),
        bone_outside: bone_outside(skeleton, is_inside),
        bleed: bleed(mesh, &ring, skin, joints.len()),
        mirror_error: plane.map(|plane| mirror_error(&joints, plane)),
        roughness: roughness(&ring, skin),
        stretch: poses.iter().map(|posed| stretch(&ring, &mesh.positions, posed)).fold(1.0, f64::max),
        volume_change: volume_change(mesh, &poses),
        verdict: Verdict::Good,
        reasons: Vec::new(),
    };
    conclude(&mut quality, skeleton);
    quality
}

/// Share of the bones' length outside the solid; 0 without bones of any length.
fn bone_outside(skeleton: &Skeleton, is_inside: &(dyn Fn(DVec3) -> bool + Sync)) -> f64 {
    let (mut outside, mut total) = (0.0, 0.0);
    for bone in skeleton.bones() {
        let length = bone.start.distance(bone.end);
        let at = |sample: usize| bone.start.lerp(bone.end, (sample as f64 + 0.5) / BONE_SAMPLES as f64);
        let missed = (0..BONE_SAMPLES).filter(|&sample| !is_inside(at(sample))).count();
        outside += length * missed as f64 / BONE_SAMPLES as f64;
        total += length;
    }
    if total > 0.0 { outside / total } else { 0.0 }
}

fn roughness(ring: &Neighbors, skin: &SkinWeights) -> f64 {
    let (mut total, mut edges) = (0.0, 0usize);
    for (vertex, row) in skin.rows.iter().enumerate().take(ring.vertex_count()) {
        for &next in ring.row(vertex).iter().filter(|&&next| next as usize > vertex) {
            let Some(other) = skin.rows.get(next as usize) else { continue };
            let weight_of = |row: &[super::Influence], joint| {
                row.iter().find(|part| part.joint == joint).map_or(0.0, |part| f64::from(part.weight))
            };
            let shared: f64 = row.iter().map(|part| f64::from(part.weight).min(weight_of(other, part.joint))).sum();
            total += (1.0 - shared).clamp(0.0, 1.0);
            edges += 1;
        }
    }
    if edges > 0 { total / edges as f64 } else { 0.0 }
}

/// Bounds of one figure: from `usable` on it is not good, from `poor` on it is poor.
struct Bounds {
    usable: f64,
    poor: f64,
}

impl Bounds {
    fn verdict(&self, value: f64) -> Verdict {
        if value >= self.poor {
            Verdict::Poor
        } else if value >= self.usable {
            Verdict::Usable
        } else {
            Verdict::Good
        }
    }
}

const JOINTS_OUTSIDE: Bounds = Bounds { usable: 0.3, poor: 0.6 };
const BONE_OUTSIDE: Bounds = Bounds { usable: 0.25, poor: 0.5 };
const BLEED: Bounds = Bounds { usable: 0.1, poor: 0.3 };
const MIRROR: Bounds = Bounds { usable: 0.02, poor: 0.08 };
const STRETCH: Bounds = Bounds { usable: 3.0, poor: 8.0 };
const VOLUME: Bounds = Bounds { usable: 0.3, poor: 0.6 };

fn conclude(quality: &mut Quality, skeleton: &Skeleton) {
    let worst = quality.bleed.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
    let (bleeding, bleed) = worst.unwrap_or((0, 0.0));
    let name = skeleton.joints.get(bleeding).map_or("", |joint| joint.name.as_str());
    let percent = |share: f64| format!("{:.0} %", share * 100.0);
    let outside = 1.0 - quality.joints_inside;
    let mirror = quality.mirror_error.unwrap_or(0.0);
    let volume = quality.volume_change.unwrap_or(0.0);
    let found = [
        (JOINTS_OUTSIDE.verdict(outside), format!("{} of the joints lie outside the mesh", percent(outside))),
        (
            BONE_OUTSIDE.verdict(quality.bone_outside),
            format!("{} of the bones' length lies outside the mesh", percent(quality.bone_outside)),
        ),
        (BLEED.verdict(bleed), format!("{} of the weight of {name} lies far from it over the surface", percent(bleed))),
        (MIRROR.verdict(mirror), format!("joints are {} of the height from their mirror images", percent(mirror))),
        (
            STRETCH.verdict(quality.stretch),
            format!("one edge in a hundred changes its length {:.1}-fold in motion", quality.stretch),
        ),
        (VOLUME.verdict(volume), format!("the volume changes by {} in motion", percent(volume))),
    ];
    quality.verdict = found.iter().map(|(verdict, _)| *verdict).max().unwrap_or(Verdict::Good);
    let reasons = found.into_iter().filter(|(verdict, _)| *verdict > Verdict::Good);
    quality.reasons = reasons.map(|(_, reason)| reason).collect();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::{Influence, Joint};

    const RADIUS: f64 = 0.05;

    /// Tubes from y = 0 to 1 of 8 × 41 vertices, one at each x, with ends closed.
    fn tubes(places: &[f64]) -> Mesh {
        let (around, along) = (8u32, 41u32);
        let mut mesh = Mesh::default();
        for &x in places {
            let first = mesh.positions.len() as u32;
            for ring in 0..along {
                for step in 0..around {
                    let angle = std::f64::consts::TAU * f64::from(step) / f64::from(around);
                    let y = f64::from(ring) / f64::from(along - 1);
                    mesh.positions.push(DVec3::new(x + RADIUS * angle.sin(), y, RADIUS * angle.cos()));
                }
            }
            let at = |ring: u32, step: u32| first + ring * around + step % around;
            for ring in 0..along - 1 {
                for step in 0..around {
                    mesh.triangles.push([at(ring, step), at(ring, step + 1), at(ring + 1, step + 1)]);
                    mesh.triangles.push([at(ring, step), at(ring + 1, step + 1), at(ring + 1, step)]);
                }
            }
            for step in 1..around - 1 {
                mesh.triangles.push([at(0, 0), at(0, step + 1), at(0, step)]);
                mesh.triangles.push([at(along - 1, 0), at(along - 1, step), at(along - 1, step + 1)]);
            }
        }
        mesh
    }

    /// Joints up the first tube at these heights, each the child of the one below.
    fn chain(heights: &[f64]) -> Skeleton {
        let joint = |(index, &height): (usize, &f64)| Joint {
            name: format!("joint_{index}"),
            parent: index.checked_sub(1),
            position: DVec3::new(0.0, height, 0.0),
        };
        Skeleton { joints: heights.iter().enumerate().map(joint).collect() }
    }

    fn rows(mesh: &Mesh, weights: impl Fn(DVec3) -> Vec<(u32, f32)>) -> SkinWeights {
        let row = |&place: &DVec3| {
            let mut row: Vec<Influence> =
                weights(place).into_iter().map(|(joint, weight)| Influence { joint, weight }).collect();
            row.retain(|part| part.weight > 0.0);
            row.sort_by(|a, b| b.weight.total_cmp(&a.weight).then(a.joint.cmp(&b.joint)));
            row
        };
        SkinWeights { rows: mesh.positions.iter().map(row).collect() }
    }

    fn in_tube(point: DVec3) -> bool {
        point.x.hypot(point.z) < RADIUS && (0.0..=1.0).contains(&point.y)
    }

    fn judged(mesh: &Mesh, skeleton: &Skeleton, skin: &SkinWeights) -> Quality {
        judge(&Subject { mesh, skeleton, skin, is_inside: &in_tube, plane: None })
    }

    /// A smooth change from joint 0 to joint 1 about y = 0.5.
    fn blend(place: DVec3) -> Vec<(u32, f32)> {
        let upper = ((place.y - 0.35) / 0.3).clamp(0.0, 1.0) as f32;
        vec![(0, 1.0 - upper), (1, upper)]
    }

    #[test]
    fn a_tube_that_bends_in_the_middle_is_good() {
        let mesh = tubes(&[0.0]);
        let quality = judged(&mesh, &chain(&[0.1, 0.5, 0.9]), &rows(&mesh, blend));
        assert_eq!((quality.joints_inside, quality.bone_outside), (1.0, 0.0));
        assert!(quality.bleed.iter().all(|&share| share < 0.02), "{:?}", quality.bleed);
        assert!((1.0..2.0).contains(&quality.stretch), "{}", quality.stretch);
        assert!(quality.volume_change.is_some_and(|change| change < 0.15), "{:?}", quality.volume_change);
        assert_eq!((quality.verdict, &quality.reasons[..]), (Verdict::Good, &[][..]));
    }

    #[test]
    fn a_rig_that_moves_everything_as_one_changes_nothing() {
        let mesh = tubes(&[0.0]);
        let quality = judged(&mesh, &chain(&[0.5, 0.9]), &rows(&mesh, |_| vec![(1, 1.0)]));
        assert!((quality.stretch - 1.0).abs() < 1e-9 && quality.roughness == 0.0);
        assert!(quality.volume_change.is_some_and(|change| change < 1e-9));
    }

    #[test]
    fn bones_outside_are_measured_by_their_length() {
        let mesh = tubes(&[0.0]);
        let mut skeleton = chain(&[0.25, 0.75]);
        skeleton.joints.push(Joint { name: "far".into(), parent: Some(1), position: DVec3::new(0.5, 0.75, 0.0) });
        let quality = judged(&mesh, &skeleton, &rows(&mesh, blend));
        assert!((quality.joints_inside - 2.0 / 3.0).abs() < 1e-12);
        assert!((quality.bone_outside - 0.45).abs() < 0.03, "{}", quality.bone_outside);
        assert_eq!(quality.verdict, Verdict::Usable, "{:?}", quality.reasons);
    }

    #[test]
    fn weight_on_the_other_leg_is_bleeding_and_named() {
        let mesh = tubes(&[0.0, 0.3]);
        let skin = rows(&mesh, |place| if place.x > 0.15 { vec![(0, 0.6), (1, 0.4)] } else { blend(place) });
        let quality = judged(&mesh, &chain(&[0.1, 0.5]), &skin);
        assert!(quality.bleed[1] > 0.3 && quality.bleed[0] < 1e-9, "{:?}", quality.bleed);
        assert_eq!(quality.verdict, Verdict::Poor);
        assert!(quality.reasons.iter().any(|reason| reason.contains("joint_1")), "{:?}", quality.reasons);
    }

    #[test]
    fn a_hard_cut_stretches_more_than_a_blend_and_a_scatter_tears() {
        let mesh = tubes(&[0.0]);
        let skeleton = chain(&[0.1, 0.5, 0.9]);
        let of = |weights: &dyn Fn(DVec3) -> Vec<(u32, f32)>| judged(&mesh, &skeleton, &rows(&mesh, weights));
        let soft = of(&blend);
        let hard = of(&|place: DVec3| vec![(u32::from(place.y > 0.5), 1.0)]);
        let scattered = of(&|place: DVec3| vec![(u32::from((place.y * 40.0).round() as i64 % 2 == 0), 1.0)]);
        assert!(soft.stretch < hard.stretch && hard.stretch < scattered.stretch);
        assert!(soft.roughness < scattered.roughness && scattered.roughness > 0.4);
        assert_eq!(scattered.verdict, Verdict::Poor, "{:?}", scattered.reasons);
    }

    #[test]
    fn nothing_to_judge_is_judged_without_a_panic() {
        let quality = judged(&Mesh::default(), &Skeleton::default(), &SkinWeights::default());
        assert_eq!((quality.stretch, quality.volume_change, quality.bleed.len()), (1.0, None, 0));
    }
}
