//! Distance from vertices to bones through the inside. RigNet [Xu et al. 2020], Section 4.3 ("volumetric geodesic distance").

use super::bvh::Bvh;
use super::surface_geodesic::SurfaceGeodesic;
use glam::DVec3;
use rayon::prelude::*;

/// The two ends of a bone; equal for a leaf bone.
pub type Segment = (DVec3, DVec3);

/// Euclidean distance from every vertex to every bone, `[V, B]` row-major.
pub fn bone_euclid(vertices: &[DVec3], bones: &[Segment]) -> Vec<f32> {
    vertices
        .iter()
        .flat_map(|&v| bones.iter().map(move |&bone| v.distance(nearest_on_segment(v, bone)) as f32))
        .collect()
}

/// The point of a bone nearest to `point`; the start for a bone shorter than 1e-4.
pub fn nearest_on_segment(point: DVec3, (start, end): Segment) -> DVec3 {
    let along = end - start;
    let squared = along.length_squared();
    if squared < 1e-8 {
        return start;
    }
    start + along * ((point - start).dot(along) / squared).clamp(0.0, 1.0)
}

/// Volumetric geodesic distance from every vertex to every bone, `[V, B]` row-major, normalised units.
pub fn volumetric_geodesic_distance(
    vertices: &[DVec3],
    surface_distance: &SurfaceGeodesic,
    surface: &Bvh,
    bones: &[Segment],
) -> Vec<f32> {
    let columns: Vec<Vec<f32>> =
        bones.par_iter().map(|&bone| distances_to_bone(vertices, surface_distance, surface, bone)).collect();
    (0..vertices.len()).flat_map(|vertex| columns.iter().map(move |column| column[vertex])).collect()
}

fn distances_to_bone(vertices: &[DVec3], surface_distance: &SurfaceGeodesic, surface: &Bvh, bone: Segment) -> Vec<f32> {
    let euclid: Vec<f64> = vertices.iter().map(|&v| v.distance(nearest_on_segment(v, bone))).collect();
    let sees: Vec<u32> = (0..vertices.len())
        .filter(|&v| is_visible(nearest_on_segment(vertices[v], bone), vertices[v], surface))
        .map(|v| v as u32)
        .collect();
    if sees.is_empty() {
        return euclid.into_iter().map(|distance| distance as f32).collect();
    }
    let nearest = surface_distance.nearest_sources(&sees);
    nearest.iter().map(|&(source, distance)| (distance + euclid[source as usize]) as f32).collect()
}

fn is_visible(from: DVec3, to: DVec3, surface: &Bvh) -> bool {
    let length = from.distance(to);
    length <= 1e-4 || !surface.any_hit(from, (to - from) / length, length - 1e-4)
}
