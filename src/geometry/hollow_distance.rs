//! How far bones are from vertices on ways that do not pass through the surface: HollowDist. Xiaoyu Pan et al.:
//! *HeterSkinNet: A Heterogeneous Network for Skin Weights Prediction*, I3D 2021, Section 3.1, Algorithm 1, Eq. 1.
//!
//! | in         | shape       | unit      |
//! |------------|-------------|-----------|
//! | `mesh`     | `[V, 3]`    | any space |
//! | `bones`    | `[B, 2, 3]` | the same  |
//!
//! Out: `[V, B]`, row-major, in the mesh's unit; finite where the straight distance fits single precision.
//!
//! Cells of a regular grid are *mesh* cells where the surface touches them, *hollow* cells elsewhere, inside and outside
//! alike. A search spreads from the cells of a bone through hollow cells and into mesh cells; from a mesh cell it goes on to other
//! mesh cells, never back into a hollow one. When it stops before every vertex is met, it starts again at the nearest
//! mesh cell that touches a hollow cell not yet met, and passes the surface there: so bones outside the body and parts that do not
//! hang together are reached. A vertex is as far as the cell before its own, plus the straight way from that cell's middle.
//!
//! All bones are searched at once, layer by layer, one bit per bone and 64 bones a word, and a layer spreads over whole lines of
//! cells: O(C · L · ⌈B/64⌉), C the cells of lines that are met, L at most the layers that a line takes to be met by all. Words in
//! parallel; same bits for any number of threads.
//! # Choices where the paper is silent
//! - Five layers in turn spread over faces, all 26 neighbours, faces, all, faces. A way of that kind is at most 4 % shorter and
//!   5 % longer than the straight one in open space; over faces alone it would be up to 73 % longer.
//! - A bone outside the grid starts in the cells nearest to it, and its distance to them is added.
//! - No distance is shorter than the straight one.
//! - Only the part of the grid about the mesh is searched, with a margin of one cell to walk around it.

use super::hollow_search::{Met, NEVER, Search};
use super::surface_voxels::Lattice;
use super::volumetric_geodesic::Segment;
use crate::mesh::Mesh;
use rayon::prelude::*;

/// Cells along the longest side unless asked otherwise (the paper's).
pub const HOLLOW_RESOLUTION: usize = 88;
/// The finest grid: every doubling costs eight times as much.
pub const HOLLOW_RESOLUTION_MAX: usize = 256;
pub(super) const WORD: usize = 64;

/// HollowDist from every vertex of `mesh` to every bone, `[V, B]`; `resolution` cells along the longest side.
///
/// `straight` are the straight distances of the same vertices and bones ([`super::volumetric_geodesic::bone_euclid`]), which are
/// made longer in place: the answer is the greater part of the memory.
pub fn hollow_distance(mesh: &Mesh, bones: &[Segment], straight: Vec<f32>, resolution: usize) -> Vec<f32> {
    let mut distances = straight;
    let lattice = Lattice::around(mesh, resolution.clamp(1, HOLLOW_RESOLUTION_MAX));
    let Some(lattice) = lattice.filter(|_| !bones.is_empty()) else { return distances };
    let field = Field::new(&lattice, mesh);
    let mut rows = field.rows(&mut distances, bones.len());
    // As many words at once as there are threads: what each has met is the greater part of the memory, beside the result.
    let words_at_once = rayon::current_num_threads().max(1);
    for (group, bones_of_group) in bones.chunks(WORD * words_at_once).enumerate() {
        let words: Vec<Searched> = bones_of_group.par_chunks(WORD).map(|word| field.searched(word)).collect();
        let first = group * WORD * words_at_once;
        let cells = rows.par_chunk_by_mut(|one, other| one.cell == other.cell);
        cells.for_each(|rows_of_cell| field.lengthen(rows_of_cell, &words, first));
    }
    distances
}

/// When up to 64 bones met the cells around the vertices.
struct Searched {
    /// How far each bone is from the cells it began in.
    offsets: Vec<f64>,
    /// `[kept, bones]`
    met: Vec<Met>,
}

/// The distances of one vertex.
struct Row<'a> {
    /// As a number in `kept`.
    cell: u32,
    vertex: u32,
    /// `[B]`
    distances: &'a mut [f32],
}

/// The grid of one mesh, and where its vertices are in it.
pub(super) struct Field<'a> {
    pub lattice: &'a Lattice,
    mesh: &'a Mesh,
    pub is_mesh: Vec<bool>,
    /// Offsets between indices of neighbours: the first six share a face.
    pub steps: [isize; 26],
    /// The cell of each vertex, as a number in `kept`. `[V]`
    cell_of_vertex: Vec<u32>,
    /// Cells whose layers are kept: mesh cells, and the neighbours of cells that hold a vertex. Ascending.
    pub kept: Vec<u32>,
    /// Number in `kept`, or `u32::MAX`. `[cells]`
    pub number: Vec<u32>,
    /// Whether a kept cell holds a vertex.
    pub holds_vertex: Vec<bool>,
    pub holding_count: u32,
}

impl<'a> Field<'a> {
    fn new(lattice: &'a Lattice, mesh: &'a Mesh) -> Self {
        let is_mesh = lattice.surface(mesh);
        let mut wanted = is_mesh.clone();
        let steps = steps(lattice);
        let cell_of = |&position| lattice.holding(lattice.to_cells(position)) as u32;
        let mut cell_of_vertex: Vec<u32> = mesh.positions.iter().map(cell_of).collect();
        for &cell in &cell_of_vertex {
            wanted[cell as usize] = true;
            steps.iter().for_each(|&step| wanted[(cell as usize).wrapping_add_signed(step)] = true);
        }
        let kept: Vec<u32> = (0..wanted.len()).filter(|&cell| wanted[cell]).map(|cell| cell as u32).collect();
        let mut number = vec![u32::MAX; wanted.len()];
        kept.iter().enumerate().for_each(|(at, &cell)| number[cell as usize] = at as u32);
        let mut holds_vertex = vec![false; kept.len()];
        for cell in &mut cell_of_vertex {
            *cell = number[*cell as usize];
            holds_vertex[*cell as usize] = true;
        }
        let holding_count = holds_vertex.iter().filter(|holds| **holds).count() as u32;
        Self { lattice, mesh, is_mesh, steps, cell_of_vertex, kept, number, holds_vertex, holding_count }
    }

    /// The rows of `distances`, those of one cell side by side.
    fn rows<'d>(&self, distances: &'d mut [f32], bone_count: usize) -> Vec<Row<'d>> {
        let rows = distances.chunks_exact_mut(bone_count).zip(&self.cell_of_vertex).zip(0..);
        let mut rows: Vec<Row> = rows.map(|((distances, &cell), vertex)| Row { cell, vertex, distances }).collect();
        rows.sort_unstable_by_key(|row| (row.cell, row.vertex));
        rows
    }

    /// Searches from up to 64 bones.
    fn searched(&self, bones: &[Segment]) -> Searched {
        let mut search = Search::new(self, bones.len());
        let to_cells = |&(start, end): &Segment| (self.lattice.to_cells(start), self.lattice.to_cells(end));
        let offsets = bones.iter().map(to_cells).enumerate().map(|(at, bone)| search.begin(at, bone)).collect();
        search.run();
        Searched { offsets, met: search.when }
    }

    /// Makes the straight distances of the vertices of one cell to the bones of `words`, of which `first` is the first, as long as
    /// the ways that were found.
    fn lengthen(&self, rows: &mut [Row], words: &[Searched], first: usize) {
        let Some(own) = rows.first().map(|row| row.cell as usize) else { return };
        let cell = self.kept[own] as usize;
        let neighbours = self.steps.map(|step| cell.wrapping_add_signed(step));
        let centres = neighbours.map(|neighbour| self.lattice.centre(neighbour));
        let numbers = neighbours.map(|neighbour| self.number[neighbour] as usize);
        for (word, first) in words.iter().zip((first..).step_by(WORD)) {
            let count = word.offsets.len();
            let here = &word.met[own * count..][..count];
            // By how many layers each bone met a neighbour before this cell (small numbers, which single precision holds).
            let mut before = [[f32::INFINITY; WORD]; 26];
            for (before, number) in before.iter_mut().zip(numbers) {
                let there = &word.met[number * count..][..count];
                for ((before, here), there) in before.iter_mut().zip(here).zip(there) {
                    if there.start <= here.start && there.layer < here.layer {
                        *before = -f32::from(here.layer - there.layer);
                    }
                }
            }
            // Nothing is farther than straight in the cells where a bone begins, and in those that it never met.
            let mut own_ways = [f64::NEG_INFINITY; WORD];
            for ((way, here), offset) in own_ways.iter_mut().zip(here).zip(&word.offsets) {
                if here.layer != 0 && *here != NEVER {
                    *way = offset + f64::from(here.layer);
                }
            }
            for row in rows.iter_mut() {
                let place = self.lattice.to_cells(self.mesh.positions[row.vertex as usize]);
                let mut last_steps = [f32::INFINITY; WORD];
                let last_steps = &mut last_steps[..count];
                for (before, centre) in before.iter().zip(centres) {
                    let step = place.distance(centre) as f32;
                    for (least, before) in last_steps.iter_mut().zip(before) {
                        let way = before + step;
                        *least = if way < *least { way } else { *least };
                    }
                }
                let distances = &mut row.distances[first..][..count];
                for ((distance, way), step) in distances.iter_mut().zip(own_ways).zip(last_steps) {
                    let way = ((way + f64::from(*step)) * self.lattice.cell) as f32;
                    *distance = if way > *distance { way } else { *distance };
                }
            }
        }
    }
}

/// From a cell's index to its neighbours': over faces first.
fn steps(lattice: &Lattice) -> [isize; 26] {
    let strides = [lattice.size[1] * lattice.size[2], lattice.size[2], 1].map(|stride| stride as isize);
    let mut all: Vec<[isize; 3]> = (0..27).map(|code| [code / 9 - 1, code / 3 % 3 - 1, code % 3 - 1]).collect();
    all.retain(|offset| *offset != [0; 3]);
    all.sort_by_key(|offset| offset.iter().map(|at| at.abs()).sum::<isize>() > 1);
    std::array::from_fn(|at| all[at].iter().zip(strides).map(|(at, stride)| at * stride).sum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::volumetric_geodesic::{bone_euclid, nearest_on_segment};
    use crate::mesh::test_shapes::{degenerate, joined, sphere, tube};
    use glam::DVec3;
    use proptest::prelude::*;

    /// One bone at a time, every layer over all cells of the grid, nothing shared with the search above but the grid.
    fn plain(mesh: &Mesh, (start, end): Segment, resolution: usize) -> Vec<f64> {
        let lattice = Lattice::around(mesh, resolution).unwrap();
        let (start, end) = (lattice.to_cells(start), lattice.to_cells(end));
        let is_mesh = lattice.surface(mesh);
        let cells: Vec<usize> = (0..lattice.count()).filter(|&cell| !lattice.is_outermost(cell)).collect();
        let neighbours = |cell: usize, all: bool| -> Vec<usize> {
            let [x, y, z] = lattice.place(cell);
            let offsets = (0..27).map(|code| [code / 9, code / 3 % 3, code % 3]);
            let wanted = offsets.filter(|offset| match offset.iter().filter(|at| **at != 1).count() {
                0 => false,
                1 => true,
                _ => all,
            });
            wanted.map(|[i, j, k]| lattice.index([x + i - 1, y + j - 1, z + k - 1])).collect()
        };
        // (new starts, layer) of each cell, and whether its way goes on into hollow cells.
        let mut met: Vec<Option<(u32, u32, bool)>> = vec![None; lattice.count()];
        let (low, high) = (DVec3::ONE, DVec3::from(lattice.size.map(|size| size as f64 - 1.0)));
        let steps = (start.distance(end) * 4.0).ceil().max(1.0) as usize;
        let samples: Vec<DVec3> = (0..=steps).map(|step| start.lerp(end, step as f64 / steps as f64)).collect();
        let beyond = |sample: DVec3| sample.distance(sample.clamp(low, high));
        let offset = samples.iter().map(|&sample| beyond(sample)).fold(f64::INFINITY, f64::min);
        for &sample in samples.iter().filter(|sample| beyond(**sample) <= offset) {
            met[lattice.holding(sample.clamp(low, high))] = Some((0, 0, true));
        }
        let places: Vec<DVec3> = mesh.positions.iter().map(|&position| lattice.to_cells(position)).collect();
        let (mut starts, mut layer, mut idle) = (0, 0, 0);
        while places.iter().any(|&place| met[lattice.holding(place)].is_none()) {
            layer += 1;
            let all = [2, 4].contains(&((layer - 1) % 5 + 1));
            let comes = |cell: usize| {
                let from = neighbours(cell, all).into_iter().filter_map(|other| met[other]);
                from.into_iter().any(|(.., free)| free || is_mesh[cell])
            };
            let new: Vec<usize> = cells.iter().copied().filter(|&cell| met[cell].is_none() && comes(cell)).collect();
            idle = if new.is_empty() { idle + 1 } else { 0 };
            for cell in new {
                met[cell] = Some((starts, layer, !is_mesh[cell]));
            }
            if idle == 5 {
                let touches = |cell: usize| {
                    neighbours(cell, true)
                        .into_iter()
                        .any(|other| !lattice.is_outermost(other) && !is_mesh[other] && met[other].is_none())
                };
                let exits = cells.iter().filter(|&&cell| is_mesh[cell] && met[cell].is_some() && touches(cell));
                let (at, cell) = exits.map(|&cell| (met[cell].unwrap().1, cell)).min().unwrap();
                met[cell] = met[cell].map(|(start, layer, _)| (start, layer, true));
                (starts, layer, idle) = (starts + 1, at, 0);
            }
        }
        let way = |place: DVec3| {
            let straight = place.distance(nearest_on_segment(place, (start, end)));
            let cell = lattice.holding(place);
            let (own_start, own_layer, _) = met[cell].unwrap();
            if own_layer == 0 {
                return straight;
            }
            let before = neighbours(cell, true).into_iter().filter_map(|other| {
                let (start, layer, _) = met[other]?;
                let is_before = start <= own_start && layer < own_layer;
                is_before.then(|| f64::from(layer) + place.distance(lattice.centre(other)))
            });
            (offset + before.fold(f64::INFINITY, f64::min)).max(straight)
        };
        places.into_iter().map(|place| way(place) * lattice.cell).collect()
    }

    fn measured(mesh: &Mesh, bones: &[Segment], resolution: usize) -> Vec<f32> {
        hollow_distance(mesh, bones, bone_euclid(&mesh.positions, bones), resolution)
    }

    fn agrees(mesh: &Mesh, bones: &[Segment], resolution: usize) -> Result<(), TestCaseError> {
        let found = measured(mesh, bones, resolution);
        for (bone, &segment) in bones.iter().enumerate() {
            for (vertex, expected) in plain(mesh, segment, resolution).into_iter().enumerate() {
                let found = f64::from(found[vertex * bones.len() + bone]);
                prop_assert!((found - expected).abs() < 1e-5, "bone {bone}, vertex {vertex}: {found}, not {expected}");
            }
        }
        Ok(())
    }

    fn bone(ends: [f64; 6]) -> Segment {
        (DVec3::from_slice(&ends[..3]), DVec3::from_slice(&ends[3..]))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        /// Parts that overlap, touch or stand apart; bones inside, across and outside of them.
        #[test]
        fn closed_parts_are_measured_as_one_bone_at_a_time(
            balls in prop::collection::vec((prop::array::uniform3(-0.5..0.5f64), 0.08..0.35f64), 1..5),
            bones in prop::collection::vec(prop::array::uniform6(-0.8..0.8f64), 1..6),
            resolution in 5..14usize,
        ) {
            let parts: Vec<Mesh> = balls.iter().map(|&(centre, radius)| sphere(DVec3::from(centre), radius, 8)).collect();
            let bones: Vec<Segment> = bones.into_iter().map(bone).collect();
            agrees(&joined(&parts), &bones, resolution)?;
        }

        /// Triangles without any order.
        #[test]
        fn loose_triangles_are_measured_as_one_bone_at_a_time(
            corners in prop::collection::vec(prop::array::uniform3(-0.5..0.5f64), 3..24),
            bones in prop::collection::vec(prop::array::uniform6(-1.0..1.0f64), 1..4),
            resolution in 3..11usize,
        ) {
            let positions: Vec<DVec3> = corners.into_iter().map(DVec3::from).collect();
            let triangles = (0..positions.len() as u32 / 3).map(|at| [3 * at, 3 * at + 1, 3 * at + 2]).collect();
            let bones: Vec<Segment> = bones.into_iter().map(bone).collect();
            agrees(&Mesh { positions, triangles }, &bones, resolution)?;
        }
    }

    #[test]
    fn bones_beyond_one_word_are_measured_alike() {
        let mesh = joined(&[sphere(DVec3::ZERO, 0.4, 12), tube(DVec3::X * 0.8, 0.1, 0.5, 8, 6)]);
        let ends = |at: u32| {
            let (s, c) = f64::from(at).sin_cos();
            bone([s * 0.7, c * 0.3, 0.1, s * 0.2, c * 0.5, s * c])
        };
        let bones: Vec<Segment> = (0..70).map(ends).collect();
        agrees(&mesh, &bones, 9).unwrap();
    }

    /// The way from one foot to the other leads through the hip, not through the air.
    #[test]
    fn the_way_between_two_feet_leads_through_the_hip() {
        let legs = [tube(DVec3::X * 0.1, 0.06, 0.8, 24, 30), tube(DVec3::X * -0.1, 0.06, 0.8, 24, 30)];
        let soles = [DVec3::X * 0.1, DVec3::X * -0.1].map(|centre| sphere(centre, 0.06, 24));
        let mesh = joined(&[
            legs[0].clone(),
            legs[1].clone(),
            sphere(DVec3::Y * 0.85, 0.2, 24),
            soles[0].clone(),
            soles[1].clone(),
        ]);
        let shin = (DVec3::new(0.1, 0.05, 0.0), DVec3::new(0.1, 0.3, 0.0));
        let distance = measured(&mesh, &[shin], HOLLOW_RESOLUTION);
        let knee = legs[0].positions.iter().position(|place| (place.y - 0.4).abs() < 0.03).unwrap();
        let other = knee + legs[0].positions.len();
        assert!(distance[knee] < 0.15, "{}", distance[knee]);
        assert!(distance[other] > 0.4, "{}", distance[other]);
    }

    #[test]
    fn a_bone_beside_the_body_and_a_part_that_floats_are_reached() {
        let (body, ball) = (sphere(DVec3::ZERO, 0.3, 24), sphere(DVec3::X * 0.6, 0.1, 16));
        let mesh = joined(&[body.clone(), ball]);
        let beside = (DVec3::new(0.0, 0.4, 0.0), DVec3::new(0.1, 0.4, 0.0));
        let far = (DVec3::Y * 50.0, DVec3::Y * 51.0);
        let bones = [(DVec3::ZERO, DVec3::X * 0.1), beside, far];
        let distance = measured(&mesh, &bones, HOLLOW_RESOLUTION);
        let straight = bone_euclid(&mesh.positions, &bones);
        for (own, straight) in distance.iter().zip(&straight) {
            assert!(own.is_finite() && own >= straight && *own < straight + 1.2, "{own} {straight}");
        }
        // From the middle of the body to the near side of the ball: through the skin, then through the air.
        let near = mesh.positions.iter().position(|place| place.distance(DVec3::X * 0.5) < 1e-6).unwrap();
        assert!((distance[3 * near] - 0.4).abs() < 0.06, "{}", distance[3 * near]);
    }

    #[test]
    fn degenerate_shapes_and_no_bones_are_survived() {
        for mesh in degenerate() {
            let bones = [(DVec3::ZERO, DVec3::X), (DVec3::Y, DVec3::Y)];
            let distance = measured(&mesh, &bones, HOLLOW_RESOLUTION);
            assert_eq!(distance.len(), 2 * mesh.positions.len());
            let straight = bone_euclid(&mesh.positions, &bones);
            assert!(distance.iter().zip(&straight).all(|(own, straight)| own.is_finite() || straight.is_infinite()));
            assert!(measured(&mesh, &[], HOLLOW_RESOLUTION).is_empty());
        }
    }

    #[test]
    fn one_thread_and_two_give_the_same_bits() {
        let mesh = joined(&[sphere(DVec3::ZERO, 0.5, 24), tube(DVec3::X, 0.1, 1.0, 20, 20)]);
        let bones: Vec<Segment> =
            (0..100).map(|at| (DVec3::X * f64::from(at) * 0.01, DVec3::Y * f64::from(at % 7) * 0.1)).collect();
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| measured(&mesh, &bones, 32))
        };
        assert_eq!(with(1), with(2));
    }
}
