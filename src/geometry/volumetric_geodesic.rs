//! Distance from vertices to bones through the inside. RigNet [Xu et al. 2020], Section 4.3 ("volumetric geodesic
//! distance"); constants of the published code.
//!
//! | in         | shape       | unit       |
//! |------------|-------------|------------|
//! | `vertices` | `[V, 3]`    | normalised |
//! | `bones`    | `[B, 2, 3]` | normalised |
//!
//! Out: `[V, B]`, row-major, normalised. A vertex that a bone sees is as far from it as the straight line; any other is as
//! far as the seen vertex nearest along the surface, plus the way there. A bone that sees no vertex measures straight.
//! # Departures from the published code
//! - All vertices, on all faces: no vertex copies another's row, no ray is cast on a decimation.
//! - The first hit of a ray is not looked for: any hit nearer than the vertex hides it. They differ only when a ray
//!   misses every face of its own vertex by rounding.

use super::bvh::Bvh;
use super::surface_geodesic::SurfaceGeodesic;
use glam::DVec3;
use rayon::prelude::*;

/// The two ends of a bone; equal for a leaf bone.
pub type Segment = (DVec3, DVec3);

/// A hit this near to the vertex is the vertex's own surface.
const OWN_SURFACE: f64 = 1e-4;
/// A bone shorter than the root of this is a point.
const POINT_SQUARED: f64 = 1e-8;
/// The share of seen vertices that sets a bone's reach ...
const REACH_QUANTILE: f64 = 0.15;
/// ... and how much farther than their farthest the bone still sees.
const REACH_FACTOR: f64 = 1.3;

/// Volumetric geodesic distance from every vertex to every bone, `[V, B]`.
pub fn volumetric_geodesic_distance(
    vertices: &[DVec3],
    surface_distance: &SurfaceGeodesic,
    surface: &Bvh,
    bones: &[Segment],
) -> Vec<f32> {
    distance_given_visibility(vertices, surface_distance, bones, &bone_visibility(vertices, surface, bones))
}

/// The same from what each bone sees: `visible` `[V, B]`, before the limit of reach.
pub fn distance_given_visibility(
    vertices: &[DVec3],
    surface_distance: &SurfaceGeodesic,
    bones: &[Segment],
    visible: &[bool],
) -> Vec<f32> {
    let distance_to = |(index, &bone): (usize, &Segment)| {
        let euclid: Vec<f64> = vertices.iter().map(|&v| v.distance(nearest_on_segment(v, bone))).collect();
        let seen = (0..vertices.len() as u32).filter(|&v| visible[v as usize * bones.len() + index]).collect();
        distances_around(surface_distance, &euclid, &within_reach(seen, &euclid))
    };
    by_vertex(vertices.len(), &bones.par_iter().enumerate().map(distance_to).collect::<Vec<_>>())
}

/// Euclidean distance from every vertex to every bone, `[V, B]`.
pub fn bone_euclid(vertices: &[DVec3], bones: &[Segment]) -> Vec<f32> {
    /// Vertices that are measured together: the same steps for each, which processors do several at a time.
    const LANES: usize = 8;
    let mut distances = vec![0.0; vertices.len() * bones.len()];
    let blocks = distances.par_chunks_mut((LANES * bones.len()).max(1)).zip(vertices.par_chunks(LANES));
    blocks.for_each(|(rows, vertices)| {
        let [x, y, z] = [0, 1, 2].map(|axis| {
            std::array::from_fn::<f64, LANES, _>(|lane| vertices.get(lane).map_or(0.0, |vertex| vertex[axis]))
        });
        for (bone, &(start, end)) in bones.iter().enumerate() {
            // As [`nearest_on_segment`] has it.
            let along = end - start;
            let squared = along.length_squared();
            let (along, squared) = if squared < POINT_SQUARED { (DVec3::ZERO, 1.0) } else { (along, squared) };
            let of_lane: [f32; LANES] = std::array::from_fn(|lane| {
                let from_start = DVec3::new(x[lane], y[lane], z[lane]) - start;
                let nearest = start + along * (from_start.dot(along) / squared).clamp(0.0, 1.0);
                DVec3::new(x[lane], y[lane], z[lane]).distance(nearest) as f32
            });
            rows.iter_mut().skip(bone).step_by(bones.len()).zip(of_lane).for_each(|(row, of_lane)| *row = of_lane);
        }
    });
    distances
}

/// Whether each vertex can be seen from the nearest point of each bone, `[V, B]`, before the limit of reach.
pub fn bone_visibility(vertices: &[DVec3], surface: &Bvh, bones: &[Segment]) -> Vec<bool> {
    let sees = |vertex: DVec3| move |&bone: &Segment| is_visible(nearest_on_segment(vertex, bone), vertex, surface);
    vertices.par_iter().flat_map_iter(|&vertex| bones.iter().map(sees(vertex))).collect()
}

/// The point of a bone nearest to `point`; the start for a bone shorter than 1e-4.
pub fn nearest_on_segment(point: DVec3, (start, end): Segment) -> DVec3 {
    let along = end - start;
    let squared = along.length_squared();
    if squared < POINT_SQUARED {
        return start;
    }
    start + along * ((point - start).dot(along) / squared).clamp(0.0, 1.0)
}

fn is_visible(from: DVec3, to: DVec3, surface: &Bvh) -> bool {
    let length = from.distance(to);
    length <= OWN_SURFACE || !surface.any_hit(from, (to - from) / length, length - OWN_SURFACE)
}

/// The seen vertices that lie within [`REACH_FACTOR`] times the [`REACH_QUANTILE`] of all seen distances.
fn within_reach(mut seen: Vec<u32>, euclid: &[f64]) -> Vec<u32> {
    let mut distances: Vec<f64> = seen.iter().map(|&v| euclid[v as usize]).collect();
    if let Some(typical) = quantile(&mut distances, REACH_QUANTILE) {
        seen.retain(|&v| euclid[v as usize] <= REACH_FACTOR * typical);
    }
    seen
}

/// Straight for seen vertices, along the surface for the rest. `[V]`
fn distances_around(surface_distance: &SurfaceGeodesic, euclid: &[f64], seen: &[u32]) -> Vec<f32> {
    let mut distances: Vec<f32> = if seen.is_empty() {
        euclid.iter().map(|&distance| distance as f32).collect()
    } else {
        let nearest = surface_distance.nearest_sources(seen).into_iter();
        nearest.map(|nearest| (nearest.distance + euclid[nearest.source as usize]) as f32).collect()
    };
    for &vertex in seen {
        distances[vertex as usize] = euclid[vertex as usize] as f32;
    }
    distances
}

/// The quantile of `values` by linear interpolation between the two nearest; `None` without values.
fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    let at = share * values.len().checked_sub(1)? as f64;
    let (_, &mut low, above) = values.select_nth_unstable_by(at as usize, f64::total_cmp);
    let high = above.iter().copied().min_by(f64::total_cmp).unwrap_or(low);
    Some(low + (high - low) * at.fract())
}

/// Columns `[B, V]` to rows `[V, B]`.
fn by_vertex(vertex_count: usize, columns: &[Vec<f32>]) -> Vec<f32> {
    let mut rows = Vec::with_capacity(vertex_count * columns.len());
    for vertex in 0..vertex_count {
        rows.extend(columns.iter().map(|column| column[vertex]));
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::surface_samples::{SAMPLE_COUNT, SurfaceSamples};
    use crate::mesh::Mesh;
    use crate::mesh::test_shapes::{joined, sphere, tube};

    fn distances(mesh: &Mesh, bones: &[Segment]) -> Vec<f32> {
        let samples = SurfaceSamples::new(mesh, SAMPLE_COUNT);
        let geodesic = SurfaceGeodesic::new(&samples, &mesh.positions);
        volumetric_geodesic_distance(&mesh.positions, &geodesic, &Bvh::new(mesh), bones)
    }

    #[test]
    fn a_bone_along_the_middle_of_a_tube_is_its_radius_away() {
        let mesh = tube(DVec3::ZERO, 0.1, 1.0, 30, 40);
        for distance in distances(&mesh, &[(DVec3::ZERO, DVec3::Y)]) {
            assert!((distance - 0.1).abs() < 1e-6, "{distance}");
        }
    }

    /// Two legs side by side: the bone of one reaches the other only through their shared surface, here not at all.
    #[test]
    fn a_bone_in_one_leg_is_far_from_the_other() {
        let (left, right) = (tube(DVec3::X * 0.06, 0.05, 1.0, 24, 30), tube(DVec3::X * -0.06, 0.05, 1.0, 24, 30));
        let vertices = left.positions.len();
        let mesh = joined(&[left, right]);
        let distance = distances(&mesh, &[(DVec3::X * 0.06, DVec3::new(0.06, 1.0, 0.0))]);
        assert!(distance[..vertices].iter().all(|&distance| distance < 0.06));
        // Open ends let the bone see a few vertices of the other leg's rim; none of them is within its reach.
        assert!(distance[vertices..].iter().all(|&distance| distance > 0.06));
    }

    #[test]
    fn bones_that_see_nothing_or_are_points_measure_straight() {
        let mesh = joined(&[sphere(DVec3::ZERO, 0.5, 24), sphere(DVec3::ZERO, 0.1, 24)]);
        let bones = [(DVec3::ZERO, DVec3::ZERO), (DVec3::X * 0.01, DVec3::X * 0.02)];
        let straight = bone_euclid(&mesh.positions, &bones);
        let around = distances(&mesh, &bones);
        assert!(around.iter().zip(&straight).all(|(around, straight)| around.is_finite() && around >= straight));
        let outer = mesh.positions.iter().position(|position| position.length() > 0.4).unwrap();
        assert!((straight[outer * 2] - 0.5).abs() < 1e-6);
        assert!(around[outer * 2] > 8.0, "the inner shell hides the outer one");
        let blind = distance_given_visibility(
            &mesh.positions,
            &SurfaceGeodesic::new(&SurfaceSamples::default(), &mesh.positions),
            &bones,
            &vec![false; straight.len()],
        );
        assert_eq!(blind, straight);
    }

    #[test]
    fn quantiles_interpolate() {
        assert_eq!(quantile(&mut [], 0.15), None);
        assert_eq!(quantile(&mut [7.0], 0.15), Some(7.0));
        assert_eq!(quantile(&mut [4.0, 1.0, 3.0, 2.0, 5.0], 0.15), Some(1.6));
    }

    #[test]
    fn one_thread_and_two_give_the_same_bits() {
        let mesh = joined(&[sphere(DVec3::ZERO, 0.5, 24), tube(DVec3::X, 0.1, 1.0, 20, 20)]);
        let bones = [(DVec3::ZERO, DVec3::X), (DVec3::X, DVec3::new(1.0, 1.0, 0.0)), (DVec3::Y, DVec3::Y)];
        let with = |threads| {
            rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| distances(&mesh, &bones))
        };
        assert_eq!(with(1), with(2));
    }
}
