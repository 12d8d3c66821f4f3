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

use super::volumetric_geodesic::{Segment, nearest_on_segment};
use super::voxel_grid::{RESOLUTION, VoxelGrid, surface_cells};
use crate::mesh::Mesh;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The cells of a solid, and where every bone begins in them. Lengths are in cells.
pub struct VoxelBinding {
    origin: DVec3,
    /// Cells per unit of the normalised frame.
    scale: f64,
    /// Number among the occupied cells, or [`EMPTY`]. `[88³]`
    number: Vec<u32>,
    /// Places of the occupied cells, ascending.
    cells: Vec<[u8; 3]>,
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

const EMPTY: u32 = u32::MAX;
const CELLS: usize = RESOLUTION * RESOLUTION * RESOLUTION;
/// Two samples per cell find every cell that a bone passes for more than half a side.
const SAMPLES_PER_CELL: f64 = 4.0;
/// A bone longer than this (a few times the grid) is sampled more thinly; its cells are then found as the nearest.
const SAMPLES_MAX: usize = 4_096;
/// Cells that are at most so much farther from an outside bone than the nearest one begin its ways too (a cell's diagonal).
const NEAREST_BAND: f64 = 1.75;

impl VoxelBinding {
    /// `solid` is that of `mesh`.
    pub fn new(mesh: &Mesh, solid: &VoxelGrid, bones: &[Segment]) -> Self {
        let scale = RESOLUTION as f64 / solid.side;
        let to_cells = |point: DVec3| (point - solid.origin) * scale;
        let positions = mesh.positions.iter().map(|&position| to_cells(position)).collect();
        let surface = surface_cells(&Mesh { positions, triangles: mesh.triangles.clone() });
        let mut number = vec![EMPTY; CELLS];
        let mut cells = Vec::new();
        for (index, number) in number.iter_mut().enumerate().filter(|&(index, _)| surface[index] || solid.inside[index])
        {
            *number = cells.len() as u32;
            cells.push(place_of(index));
        }
        let bones: Vec<Segment> = bones.iter().map(|&(start, end)| (to_cells(start), to_cells(end))).collect();
        let mut binding =
            Self { origin: solid.origin, scale, number, cells, bridges: BTreeMap::new(), bones, begin: Vec::new() };
        binding.begin = binding.bones.par_iter().map(|&bone| binding.begin_of(bone)).collect();
        binding.bridges = binding.bridges_to_unreached_parts();
        binding
    }

    /// How far each vertex is from each bone, `[V, B]`.
    pub fn distances(&self, vertices: &[DVec3]) -> Vec<f32> {
        let around: Vec<(DVec3, Vec<(u32, f32)>)> = vertices
            .par_iter()
            .map(|&vertex| {
                let vertex = (vertex - self.origin) * self.scale;
                (vertex, self.cells_around(vertex))
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
                    (best.max(straight) / self.scale) as f32
                };
                around.iter().map(way).collect()
            })
            .collect();
        (0..vertices.len()).flat_map(|vertex| columns.iter().map(move |column| column[vertex])).collect()
    }

    fn centre(&self, cell: u32) -> DVec3 {
        centre(self.cells[cell as usize])
    }

    /// The occupied cells that a bone passes; where there are none, those nearest to it.
    fn begin_of(&self, bone: Segment) -> Begin {
        let (start, end) = bone;
        let distance = |cell: u32| {
            let centre = self.centre(cell);
            centre.distance(nearest_on_segment(centre, bone))
        };
        let steps = ((start.distance(end) * SAMPLES_PER_CELL).ceil().max(1.0) as usize).min(SAMPLES_MAX);
        let samples = (0..=steps).map(|step| start.lerp(end, step as f64 / steps as f64));
        let mut passed: Vec<u32> = samples.filter_map(|sample| self.number_at(sample.floor())).collect();
        passed.sort_unstable();
        passed.dedup();
        if passed.is_empty() {
            let nearest = (0..self.cells.len() as u32).map(distance).fold(f64::INFINITY, f64::min);
            passed = (0..self.cells.len() as u32).filter(|&cell| distance(cell) <= nearest + NEAREST_BAND).collect();
        }
        let offset = passed.iter().map(|&cell| distance(cell)).fold(f64::INFINITY, f64::min);
        Begin { offset, cells: passed.into_iter().map(|cell| (cell, (distance(cell) - offset) as f32)).collect() }
    }

    /// The number of the cell at a whole-numbered place, if it is occupied.
    fn number_at(&self, place: DVec3) -> Option<u32> {
        let inside = place.cmpge(DVec3::ZERO).all() && place.cmplt(DVec3::splat(RESOLUTION as f64)).all();
        let [x, y, z] = place.to_array().map(|at| at as usize);
        inside.then(|| self.number[(x * RESOLUTION + y) * RESOLUTION + z]).filter(|&number| number != EMPTY)
    }

    /// The occupied cells at and around a point, each with its distance to it; where there are none, the nearest cell.
    fn cells_around(&self, point: DVec3) -> Vec<(u32, f32)> {
        let last = DVec3::splat(RESOLUTION as f64 - 1.0);
        let here = point.floor().clamp(DVec3::ZERO, last);
        let offsets = OFFSETS.iter().copied().chain([[0, 0, 0]]);
        let near = offsets.filter_map(|offset| self.number_at(here + DVec3::from(offset.map(f64::from))));
        let mut cells: Vec<(u32, f32)> = near.map(|cell| (cell, self.centre(cell).distance(point) as f32)).collect();
        if cells.is_empty() {
            let all = (0..self.cells.len() as u32).map(|cell| (cell, self.centre(cell).distance(point) as f32));
            cells.extend(all.min_by(|a, b| a.1.total_cmp(&b.1)));
        }
        cells
    }

    /// Shortest way to every occupied cell from those in `begin`, in cells. `[C]`
    ///
    /// Dijkstra's algorithm with one bucket per unit of length [Dial 1969]: no step is shorter than a bucket is wide, so all
    /// that stands in a bucket when its turn comes is final, in any order.
    fn ways_from(&self, begin: &[(u32, f32)]) -> Vec<f32> {
        let mut way = vec![f32::INFINITY; self.cells.len()];
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
                self.neighbours(cell, |other, length| put(&mut buckets, &mut way, other, distance + length));
                for &(other, length) in self.bridges.get(&cell).into_iter().flatten() {
                    put(&mut buckets, &mut way, other, distance + length);
                }
            }
            turn += 1;
        }
        way
    }

    /// Calls `visit` with the occupied cells around `cell` and how far their centres are.
    fn neighbours(&self, cell: u32, mut visit: impl FnMut(u32, f32)) {
        let place = self.cells[cell as usize].map(i32::from);
        for (offset, length) in OFFSETS.iter().zip(OFFSET_LENGTHS) {
            let at: [i32; 3] = std::array::from_fn(|axis| place[axis] + i32::from(offset[axis]));
            if at.iter().all(|&at| (0..RESOLUTION as i32).contains(&at)) {
                let other = self.number[index_of(at.map(|at| at as usize))];
                if other != EMPTY {
                    visit(other, length);
                }
            }
        }
    }

    /// Which connected part each occupied cell belongs to, and how many there are.
    fn parts(&self) -> (Vec<u32>, usize) {
        let mut part = vec![EMPTY; self.cells.len()];
        let mut count = 0;
        let mut work = Vec::new();
        for first in 0..self.cells.len() as u32 {
            if part[first as usize] != EMPTY {
                continue;
            }
            part[first as usize] = count;
            work.push(first);
            // Each cell enters the list once.
            while let Some(cell) = work.pop() {
                self.neighbours(cell, |other, _| {
                    if part[other as usize] == EMPTY {
                        part[other as usize] = count;
                        work.push(other);
                    }
                });
            }
            count += 1;
        }
        (part, count as usize)
    }

    /// Straight ways, in both directions, that join every part without a bone to the others: a minimum spanning tree of
    /// parts [Kruskal 1956], where all parts with a bone are one to begin with.
    fn bridges_to_unreached_parts(&self) -> BTreeMap<u32, Vec<(u32, f32)>> {
        let (part, count) = self.parts();
        let mut joined: Vec<usize> = (0..count).collect();
        let mut anchor = None;
        for &(cell, _) in self.begin.iter().flat_map(|begin| &begin.cells) {
            let reached = part[cell as usize] as usize;
            joined[reached] = *anchor.get_or_insert(reached);
        }
        let mut bridges: BTreeMap<u32, Vec<(u32, f32)>> = BTreeMap::new();
        if (0..count).all(|part| Some(joined[part]) == anchor) {
            return bridges;
        }
        let mut gaps: Vec<(f32, u32, u32)> = self.gaps(&part).into_values().collect();
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

    /// The narrowest gap between each pair of parts that face each other: length and the two cells. Found by growing all
    /// parts into the empty cells at once, each empty cell keeping the occupied cell that it was reached from.
    fn gaps(&self, part: &[u32]) -> BTreeMap<(u32, u32), (f32, u32, u32)> {
        let mut source = self.number.clone();
        let mut front: Vec<usize> = (0..CELLS).filter(|&index| source[index] != EMPTY).collect();
        let mut gaps: BTreeMap<(u32, u32), (f32, u32, u32)> = BTreeMap::new();
        // Each cell of the grid stands in one front.
        while !front.is_empty() {
            let mut next = Vec::new();
            for index in front {
                let own = source[index];
                for step in faces_of(index) {
                    if source[step] == EMPTY {
                        source[step] = own;
                        next.push(step);
                        continue;
                    }
                    let (one, other) = (own.min(source[step]), own.max(source[step]));
                    let (a, b) = (part[one as usize], part[other as usize]);
                    if a != b {
                        let length = self.centre(one).distance(self.centre(other)) as f32;
                        let known = gaps.entry((a.min(b), a.max(b))).or_insert((length, one, other));
                        if (length, one, other) < *known {
                            *known = (length, one, other);
                        }
                    }
                }
            }
            front = next;
        }
        gaps
    }
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

/// The 26 cells around one.
const OFFSETS: [[i8; 3]; 26] = offsets();
const OFFSET_LENGTHS: [f32; 26] = offset_lengths();

const fn offsets() -> [[i8; 3]; 26] {
    let mut all = [[0; 3]; 26];
    let (mut index, mut code) = (0, 0);
    while code < 27 {
        if code != 13 {
            all[index] = [code / 9 - 1, code / 3 % 3 - 1, code % 3 - 1];
            index += 1;
        }
        code += 1;
    }
    all
}

const fn offset_lengths() -> [f32; 26] {
    let mut lengths = [0.0; 26];
    let mut index = 0;
    while index < 26 {
        let [x, y, z] = OFFSETS[index];
        lengths[index] = [0.0, 1.0, std::f32::consts::SQRT_2, 1.732_050_8][(x * x + y * y + z * z) as usize];
        index += 1;
    }
    lengths
}

fn index_of([x, y, z]: [usize; 3]) -> usize {
    (x * RESOLUTION + y) * RESOLUTION + z
}

fn place_of(index: usize) -> [u8; 3] {
    [index / (RESOLUTION * RESOLUTION), index / RESOLUTION % RESOLUTION, index % RESOLUTION].map(|at| at as u8)
}

fn centre(place: [u8; 3]) -> DVec3 {
    DVec3::from(place.map(f64::from)) + 0.5
}

/// The up to six cells that share a face with a cell of the grid.
fn faces_of(index: usize) -> impl Iterator<Item = usize> {
    let place = place_of(index).map(usize::from);
    (0..3).flat_map(move |axis| {
        let moved = |at: usize| {
            let mut place = place;
            place[axis] = at;
            index_of(place)
        };
        let below = place[axis].checked_sub(1).map(moved);
        let above = Some(place[axis] + 1).filter(|&at| at < RESOLUTION).map(moved);
        below.into_iter().chain(above)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
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
            let mut plain = vec![f32::INFINITY; binding.cells.len()];
            binding.begin[0].cells.iter().for_each(|&(cell, distance)| plain[cell as usize] = distance);
            loop {
                let before = plain.clone();
                for cell in 0..binding.cells.len() as u32 {
                    let here = plain[cell as usize];
                    let mut best: Vec<(u32, f32)> = Vec::new();
                    binding.neighbours(cell, |other, length| best.push((other, here + length)));
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
