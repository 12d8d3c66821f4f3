//! Distance from bones to vertices through the cells of the solid. Olivier Dionne, Martin de Lasa: *Geodesic Voxel Binding
//! for Production Character Meshes*, Symposium on Computer Animation 2013, Section 3.
//!
//! | in         | shape       | unit       |
//! |------------|-------------|------------|
//! | `vertices` | `[V, 3]`    | normalised |
//! | `bones`    | `[B, 2, 3]` | normalised |
//!
//! Out: `[V, B]`, row-major, normalised; infinite where no way leads from the bone to the vertex. A way runs through cells that are
//! inside or that the surface passes, from cell to any of the 26 around it; it begins in the cells that the bone passes, at
//! their straight distance from the bone, and ends at the vertex, from the best of the cells around it.
//! # Departures from the paper
//! - A bone with no cell of the solid on its way begins in the cells nearest to it; theirs weighs nothing.
//! - A part of the solid that no bone passes is joined to its nearest neighbours by straight bridges, so that every vertex is
//!   reached; theirs leaves such parts unweighted.
//! - Every way is as long as the shortest path over cell centres (theirs too), but never shorter than the straight line.

use super::solid_cells::SolidCells;
use super::volumetric_geodesic::{Segment, nearest_on_segment};
use super::voxel_grid::VoxelGrid;
use crate::mesh::Mesh;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The cells of a solid, and where every bone begins in them. Lengths are in cells.
pub struct VoxelBinding {
    cells: SolidCells,
    /// Straight ways between parts, by the cell that they leave from.
    bridges: BTreeMap<u32, Vec<(u32, f32)>>,
    /// In cell coordinates.
    bones: Vec<Segment>,
    begin: Vec<Begin>,
}

/// Where the ways of a bone begin.
struct Begin {
    /// From the bone to the nearest of its cells.
    offset: f64,
    /// Cells, and how much farther than `offset` they are from the bone.
    cells: Vec<(u32, f32)>,
}

/// Finds every cell that a bone passes for more than a quarter of a side.
const SAMPLES_PER_CELL: f64 = 4.0;
/// A bone longer than this (a few times the grid) is sampled more thinly; its cells are then found as the nearest.
const SAMPLES_MAX: usize = 4_096;
/// Cells that are at most so much farther from an outside bone than the nearest one begin its ways too (a cell's diagonal).
const NEAREST_BAND: f64 = 1.75;

impl VoxelBinding {
    /// `solid` is that of `mesh`.
    pub fn new(mesh: &Mesh, solid: &VoxelGrid, bones: &[Segment]) -> Self {
        let cells = SolidCells::new(mesh, solid);
        let bones: Vec<Segment> =
            bones.iter().map(|&(start, end)| (cells.to_cells(start), cells.to_cells(end))).collect();
        let begin: Vec<Begin> = bones.par_iter().map(|&bone| Begin::of(bone, &cells)).collect();
        let bridges = bridges_to_unreached_parts(&cells, &begin);
        Self { cells, bridges, bones, begin }
    }

    /// How far each vertex is from each bone, `[V, B]`.
    pub fn distances(&self, vertices: &[DVec3]) -> Vec<f32> {
        let around: Vec<(DVec3, Vec<(u32, f32)>)> = vertices
            .par_iter()
            .map(|&vertex| {
                let vertex = self.cells.to_cells(vertex);
                (vertex, self.cells.around(vertex))
            })
            .collect();
        let columns: Vec<Vec<f32>> = (0..self.bones.len())
            .into_par_iter()
            .map(|bone| {
                let through = self.ways_from(&self.begin[bone].cells);
                let way = |(vertex, around): &(DVec3, Vec<(u32, f32)>)| {
                    let best = around.iter().map(|&(cell, rest)| through[cell as usize] + rest);
                    let best = self.begin[bone].offset + f64::from(best.fold(f32::INFINITY, f32::min));
                    let straight = vertex.distance(nearest_on_segment(*vertex, self.bones[bone]));
                    (best.max(straight) / self.cells.scale) as f32
                };
                around.iter().map(way).collect()
            })
            .collect();
        (0..vertices.len()).flat_map(|vertex| columns.iter().map(move |column| column[vertex])).collect()
    }

    /// Shortest way to every occupied cell from those in `begin`, in cells. `[C]`
    ///
    /// Dijkstra's algorithm with one bucket per unit of length [Dial 1969]: no step is shorter than a bucket is wide, so all
    /// that stands in a bucket when its turn comes is final, in any order.
    fn ways_from(&self, begin: &[(u32, f32)]) -> Vec<f32> {
        let mut way = vec![f32::INFINITY; self.cells.count() as usize];
        let mut buckets: Vec<Vec<(u32, f32)>> = Vec::new();
        for &(cell, distance) in begin {
            put(&mut buckets, &mut way, cell, distance);
        }
        // Every way is shorter than twice as many units as there are cells, beside the bridges.
        let mut turn = 0;
        while turn < buckets.len() {
            for (cell, distance) in std::mem::take(&mut buckets[turn]) {
                if distance > way[cell as usize] {
                    continue;
                }
                self.cells.neighbours(cell, |other, length| put(&mut buckets, &mut way, other, distance + length));
                for &(other, length) in self.bridges.get(&cell).into_iter().flatten() {
                    put(&mut buckets, &mut way, other, distance + length);
                }
            }
            turn += 1;
        }
        way
    }
}

impl Begin {
    /// The occupied cells that a bone passes; where there are none, those nearest to it.
    fn of(bone: Segment, cells: &SolidCells) -> Self {
        let (start, end) = bone;
        let distance = |cell: u32| {
            let centre = cells.centre(cell);
            centre.distance(nearest_on_segment(centre, bone))
        };
        let steps = ((start.distance(end) * SAMPLES_PER_CELL).ceil().max(1.0) as usize).min(SAMPLES_MAX);
        let samples = (0..=steps).map(|step| start.lerp(end, step as f64 / steps as f64));
        let mut passed: Vec<u32> = samples.filter_map(|sample| cells.number_at(sample.floor())).collect();
        passed.sort_unstable();
        passed.dedup();
        if passed.is_empty() {
            let nearest = (0..cells.count()).map(distance).fold(f64::INFINITY, f64::min);
            passed = (0..cells.count()).filter(|&cell| distance(cell) <= nearest + NEAREST_BAND).collect();
        }
        let offset = passed.iter().map(|&cell| distance(cell)).fold(f64::INFINITY, f64::min);
        Self { offset, cells: passed.into_iter().map(|cell| (cell, (distance(cell) - offset) as f32)).collect() }
    }
}

/// Straight ways, in both directions, that join every part without a bone to the others: a minimum spanning tree of
/// parts [Kruskal 1956], where all parts with a bone are one to begin with.
fn bridges_to_unreached_parts(cells: &SolidCells, begin: &[Begin]) -> BTreeMap<u32, Vec<(u32, f32)>> {
    let (part, count) = cells.parts();
    let mut joined: Vec<usize> = (0..count).collect();
    let mut anchor = None;
    for &(cell, _) in begin.iter().flat_map(|begin| &begin.cells) {
        let reached = part[cell as usize] as usize;
        joined[reached] = *anchor.get_or_insert(reached);
    }
    let mut bridges: BTreeMap<u32, Vec<(u32, f32)>> = BTreeMap::new();
    if (0..count).all(|part| Some(joined[part]) == anchor) {
        return bridges;
    }
    let mut gaps: Vec<(f32, u32, u32)> = cells.gaps(&part).into_values().collect();
    gaps.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    for (length, one, other) in gaps {
        let (a, b) = (joined[part[one as usize] as usize], joined[part[other as usize] as usize]);
        if a != b {
            joined.iter_mut().filter(|group| **group == b).for_each(|group| *group = a);
            bridges.entry(one).or_default().push((other, length));
            bridges.entry(other).or_default().push((one, length));
        }
    }
    bridges
}

/// Shortens the way to a cell and puts it into its bucket, if `distance` is shorter than what is known.
fn put(buckets: &mut Vec<Vec<(u32, f32)>>, way: &mut [f32], cell: u32, distance: f32) {
    if distance < way[cell as usize] {
        way[cell as usize] = distance;
        let bucket = distance as usize;
        if buckets.len() <= bucket {
            buckets.resize(bucket + 1, Vec::new());
        }
        buckets[bucket].push((cell, distance));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::voxel_grid::RESOLUTION;
    use crate::mesh::test_shapes::{degenerate, joined, sphere, tube};
    use proptest::prelude::*;

    fn distances(mesh: &Mesh, bones: &[Segment]) -> Vec<f32> {
        VoxelBinding::new(mesh, &VoxelGrid::solid(mesh), bones).distances(&mesh.positions)
    }

    /// A grid path is at most this much longer than the straight one, beside half a cell at either end.
    const STRETCH: f32 = 1.13;

    #[test]
    fn inside_a_ball_the_way_is_straight_within_the_grid() {
        let mesh = sphere(DVec3::ZERO, 0.5, 24);
        let cell = 1.0 / RESOLUTION as f32;
        for distance in distances(&mesh, &[(DVec3::ZERO, DVec3::ZERO)]) {
            assert!(distance >= 0.5 - 1e-6 && distance <= 0.5 * STRETCH + 2.0 * cell, "{distance}");
        }
    }

    /// Two legs that meet at a hip: from one foot to the other the way goes up and down.
    #[test]
    fn the_way_between_two_feet_leads_through_the_hip() {
        let legs = [tube(DVec3::X * 0.1, 0.06, 0.8, 24, 30), tube(DVec3::X * -0.1, 0.06, 0.8, 24, 30)];
        let mesh = joined(&[legs[0].clone(), legs[1].clone(), sphere(DVec3::Y * 0.85, 0.2, 24)]);
        let shin = (DVec3::new(0.1, 0.05, 0.0), DVec3::new(0.1, 0.3, 0.0));
        let distance = distances(&mesh, &[shin]);
        let own = legs[0].positions.iter().position(|position| position.y < 1e-9).unwrap();
        let other = own + legs[0].positions.len();
        assert!(distance[own] < 0.1, "{}", distance[own]);
        assert!(distance[other] > 0.9, "{}", distance[other]);
    }

    #[test]
    fn a_bone_outside_begins_at_the_nearest_cells() {
        let mesh = sphere(DVec3::ZERO, 0.5, 24);
        let bone = (DVec3::X * 0.8, DVec3::X * 1.2);
        let distance = distances(&mesh, &[bone]);
        let at = |place: DVec3| mesh.positions.iter().position(|p| p.distance(place) < 1e-6).unwrap();
        assert!((distance[at(DVec3::X * 0.5)] - 0.3).abs() < 0.05);
        assert!(distance[at(DVec3::X * -0.5)] >= 1.3 - 1e-6);
        let far = distances(&mesh, &[(DVec3::X * 1e7, DVec3::X * 1e7)]);
        assert!(far.iter().all(|distance| distance.is_finite()));
    }

    #[test]
    fn parts_without_a_bone_are_reached_over_the_narrowest_gap() {
        let (body, hat, feather) =
            (sphere(DVec3::ZERO, 0.2, 24), sphere(DVec3::Y * 0.4, 0.1, 24), sphere(DVec3::Y * 0.65, 0.1, 24));
        let body_vertices = body.positions.len();
        let mesh = joined(&[body, hat.clone(), feather]);
        let distance = distances(&mesh, &[(DVec3::ZERO, DVec3::ZERO), (DVec3::X * 0.05, DVec3::X * 0.1)]);
        assert!(distance.iter().all(|distance| distance.is_finite()));
        let (top, below) = (distance[2 * (body_vertices + hat.positions.len())], distance[2 * body_vertices]);
        assert!(top > below, "{top} {below}");
        // Two parts that both hold a bone need no bridge.
        let two = joined(&[sphere(DVec3::ZERO, 0.2, 24), hat]);
        let distance = distances(&two, &[(DVec3::ZERO, DVec3::ZERO), (DVec3::Y * 0.4, DVec3::Y * 0.4)]);
        assert!(distance[0].is_finite() && distance[1].is_infinite());
    }

    #[test]
    fn degenerate_shapes_and_no_bones_are_survived() {
        for mesh in degenerate() {
            let bones = [(DVec3::ZERO, DVec3::X), (DVec3::Y, DVec3::Y)];
            assert_eq!(distances(&mesh, &bones).len(), 2 * mesh.positions.len());
            assert!(distances(&mesh, &[]).is_empty());
        }
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

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]

        /// Against a plain relaxation that sweeps over all cells until nothing changes.
        #[test]
        fn ways_are_the_shortest_over_cells(centres in prop::collection::vec(prop::array::uniform3(-0.5..0.5f64), 1..4), bone in prop::array::uniform6(-0.6..0.6f64)) {
            let balls: Vec<Mesh> = centres.into_iter().map(|centre| sphere(DVec3::from(centre), 0.05, 8)).collect();
            let mesh = joined(&balls);
            let bone = (DVec3::new(bone[0], bone[1], bone[2]), DVec3::new(bone[3], bone[4], bone[5]));
            let binding = VoxelBinding::new(&mesh, &VoxelGrid::solid(&mesh), &[bone]);
            let ways = binding.ways_from(&binding.begin[0].cells);
            let mut plain = vec![f32::INFINITY; binding.cells.count() as usize];
            binding.begin[0].cells.iter().for_each(|&(cell, distance)| plain[cell as usize] = distance);
            loop {
                let before = plain.clone();
                for cell in 0..binding.cells.count() {
                    let here = plain[cell as usize];
                    let mut best: Vec<(u32, f32)> = Vec::new();
                    binding.cells.neighbours(cell, |other, length| best.push((other, here + length)));
                    best.extend(binding.bridges.get(&cell).into_iter().flatten().map(|&(to, length)| (to, here + length)));
                    for (other, distance) in best {
                        plain[other as usize] = plain[other as usize].min(distance);
                    }
                }
                if before == plain { break; }
            }
            prop_assert!(ways.iter().all(|way| way.is_finite()));
            prop_assert!(ways.iter().zip(&plain).all(|(a, b)| (a - b).abs() < 1e-3));
        }

        #[test]
        fn no_way_is_shorter_than_the_straight_line(bone in prop::array::uniform6(-0.6..0.6f64)) {
            let mesh = joined(&[sphere(DVec3::ZERO, 0.3, 16), tube(DVec3::ZERO, 0.1, 0.8, 16, 16)]);
            let bone = (DVec3::new(bone[0], bone[1], bone[2]), DVec3::new(bone[3], bone[4], bone[5]));
            for (vertex, distance) in mesh.positions.iter().zip(distances(&mesh, &[bone])) {
                prop_assert!(f64::from(distance) >= vertex.distance(nearest_on_segment(*vertex, bone)) - 1e-5);
            }
        }
    }
}
