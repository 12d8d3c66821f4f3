//! How far bones are from vertices on ways that do not pass through the surface: HollowDist. Xiaoyu Pan et al.:
//! *HeterSkinNet: A Heterogeneous Network for Skin Weights Prediction*, I3D 2021, Section 3.1, Algorithm 1, Eq. 1.
//!
//! | in         | shape       | unit      |
//! |------------|-------------|-----------|
//! | `mesh`     | `[V, 3]`    | any space |
//! | `bones`    | `[B, 2, 3]` | the same  |
//!
//! Out: one row `[B]` per vertex, in the mesh's unit; finite where the straight distance fits single precision. Rows
//! are given to a reducer one by one, so that a large mesh needs no table `[V, B]`: see [`HollowDistance::map`].
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
//!
//! Kept are 4 bytes for each bone and each vertex, or for each bone and each cell that holds a vertex or is beside one, whichever are
//! fewer: of a million vertices at 128³ the cells, of a working mesh at 88³ the vertices (its cells are 9,000 to 34,000, measured on
//! 44 validation characters).
//! # Choices where the paper is silent
//! - Five layers in turn spread over faces, all 26 neighbours, faces, all, faces. A way of that kind is at most 4 % shorter and
//!   5 % longer than the straight one in open space; over faces alone it would be up to 73 % longer.
//! - A bone outside the grid starts in the cells nearest to it, and its distance to them is added.
//! - No distance is shorter than the straight one.
//! - Only the part of the grid about the mesh is searched, with a margin of one cell to walk around it.

use super::hollow_field::Field;
use super::hollow_search::WORD;
use super::hollow_ways::Ways;
use super::surface_voxels::Lattice;
use super::volumetric_geodesic::{Segment, bone_euclid};
use crate::mesh::Mesh;
use glam::DVec3;
use rayon::prelude::*;

/// Cells along the longest side unless asked otherwise (the paper's).
pub const HOLLOW_RESOLUTION: usize = 88;
/// The finest grid: every doubling costs eight times as much.
pub const HOLLOW_RESOLUTION_MAX: usize = 256;
/// Vertices whose rows are made at once: many, because those of one cell share most of the work; few, because their rows may be all
/// that is held of the table of distances.
const BLOCK: usize = 64;

/// HollowDist between the vertices of a mesh and bones.
pub struct HollowDistance<'a> {
    mesh: &'a Mesh,
    bones: &'a [Segment],
    /// The vertices, those of one cell side by side. `[V]`
    order: Vec<u32>,
    kept: Kept,
}

/// What is kept of the search.
enum Kept {
    /// Nothing: every distance is straight. There are no bones, or the mesh has no extent.
    Nothing,
    /// The distances, vertices in order. `[V, B]`
    Distances(Vec<f32>),
    /// What distances are made of.
    Ways(Box<Field>, Ways),
}

/// How far one vertex is from every bone, in the mesh's unit.
#[derive(Clone, Copy, Debug)]
pub struct VertexDistances<'a> {
    pub vertex: usize,
    /// HollowDist, never shorter than the straight distance. `[B]`
    pub hollow: &'a [f32],
    /// In a straight line, as [`bone_euclid`] has it. `[B]`
    pub straight: &'a [f32],
}

impl<'a> HollowDistance<'a> {
    /// Searches from all `bones`; `resolution` cells along the longest side, at most [`HOLLOW_RESOLUTION_MAX`].
    pub fn new(mesh: &'a Mesh, bones: &'a [Segment], resolution: usize) -> Self {
        Self::keeping(mesh, bones, resolution, |field| mesh.positions.len() < field.near_count)
    }

    /// `by_vertex`: whether distances are kept, not ways.
    fn keeping(mesh: &'a Mesh, bones: &'a [Segment], resolution: usize, by_vertex: impl Fn(&Field) -> bool) -> Self {
        let order = (0..mesh.positions.len() as u32).collect();
        let mut made = Self { mesh, bones, order, kept: Kept::Nothing };
        let lattice = Lattice::around(mesh, resolution.clamp(1, HOLLOW_RESOLUTION_MAX));
        let Some(lattice) = lattice.filter(|_| !bones.is_empty()) else { return made };
        let field = Field::new(lattice, mesh);
        made.order.sort_unstable_by_key(|&vertex| (field.cell_of_vertex[vertex as usize], vertex));
        made.kept = if by_vertex(&field) {
            Kept::Distances(made.measured(&field))
        } else {
            let ways = Ways::new(&field, bones, 0);
            Kept::Ways(Box::new(field), ways)
        };
        made
    }

    /// The distances of all vertices, in order, with the ways of as many words at once as there are threads. `[V, B]`
    fn measured(&self, field: &Field) -> Vec<f32> {
        let bone_count = self.bones.len();
        let mut distances = bone_euclid(&self.places(&self.order), self.bones);
        let group = WORD * rayon::current_num_threads().max(1);
        for (bones, first) in self.bones.chunks(group).zip((0..).step_by(group)) {
            let ways = Ways::new(field, bones, first);
            let blocks = distances.par_chunks_mut(BLOCK * bone_count).zip(self.order.par_chunks(BLOCK));
            blocks.for_each(|(rows, block)| ways.lengthen(field, block, &self.places(block), rows, bone_count));
        }
        distances
    }

    /// What `reduce` makes of the distances of each vertex, `[V]`. Vertices come in no order, several at once; each thread holds the
    /// distances of 64 of them.
    pub fn map<T: Default + Send>(&self, reduce: impl Fn(VertexDistances) -> T + Sync) -> Vec<T> {
        let mut answers: Vec<T> = self.order.iter().map(|_| T::default()).collect();
        let blocks = answers.par_chunks_mut(BLOCK).zip(self.order.par_chunks(BLOCK)).enumerate();
        blocks.for_each(|(block, (answers, vertices))| self.reduce_block(block * BLOCK, vertices, answers, &reduce));
        // Each to the place of its vertex.
        let mut order = self.order.clone();
        for at in 0..order.len() {
            while order[at] as usize != at {
                let vertex = order[at] as usize;
                answers.swap(at, vertex);
                order.swap(at, vertex);
            }
        }
        answers
    }

    /// `vertices` stand in order from `begin` on.
    fn reduce_block<T>(
        &self,
        begin: usize,
        vertices: &[u32],
        answers: &mut [T],
        reduce: impl Fn(VertexDistances) -> T,
    ) {
        let bone_count = self.bones.len();
        let places = self.places(vertices);
        let straight = bone_euclid(&places, self.bones);
        let made;
        let hollow = match &self.kept {
            Kept::Nothing => &straight,
            Kept::Distances(distances) => &distances[begin * bone_count..][..straight.len()],
            Kept::Ways(field, ways) => {
                let mut rows = straight.clone();
                ways.lengthen(field, vertices, &places, &mut rows, bone_count);
                made = rows;
                &made
            }
        };
        for (at, (&vertex, answer)) in vertices.iter().zip(answers).enumerate() {
            let [hollow, straight] = [hollow, &straight].map(|rows| &rows[at * bone_count..][..bone_count]);
            *answer = reduce(VertexDistances { vertex: vertex as usize, hollow, straight });
        }
    }

    fn places(&self, vertices: &[u32]) -> Vec<DVec3> {
        vertices.iter().map(|&vertex| self.mesh.positions[vertex as usize]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::volumetric_geodesic::nearest_on_segment;
    use crate::mesh::test_shapes::{degenerate, joined, sphere, tube};
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
        HollowDistance::new(mesh, bones, resolution).map(|vertex| vertex.hollow.to_vec()).concat()
    }

    /// With distances kept and with ways kept.
    fn agrees(mesh: &Mesh, bones: &[Segment], resolution: usize) -> Result<(), TestCaseError> {
        let [found, by_cell] = [true, false].map(|by_vertex| {
            let kept = HollowDistance::keeping(mesh, bones, resolution, |_| by_vertex);
            kept.map(|vertex| vertex.hollow.to_vec()).concat()
        });
        prop_assert_eq!(&found, &by_cell);
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
        #![proptest_config(ProptestConfig::with_cases(500))]

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
            let counted = HollowDistance::new(&mesh, &[], HOLLOW_RESOLUTION).map(|vertex| vertex.hollow.len() + 1);
            assert_eq!(counted, vec![1; mesh.positions.len()]);
        }
    }

    #[test]
    fn every_vertex_is_given_its_own_rows() {
        let mesh = joined(&[sphere(DVec3::ZERO, 0.5, 24), tube(DVec3::X, 0.1, 1.0, 20, 20)]);
        let bones = [(DVec3::ZERO, DVec3::X), (DVec3::Y, DVec3::Y)];
        let hollow = HollowDistance::new(&mesh, &bones, 32);
        assert!(matches!(hollow.kept, Kept::Distances(_)), "fewer vertices than cells");
        let dense = sphere(DVec3::ZERO, 0.5, 128);
        assert!(matches!(HollowDistance::new(&dense, &bones, 16).kept, Kept::Ways(..)), "fewer cells than vertices");
        let rows = hollow.map(|row| (row.vertex, row.straight.to_vec()));
        let (vertices, straight): (Vec<usize>, Vec<Vec<f32>>) = rows.into_iter().unzip();
        assert_eq!(vertices, (0..mesh.positions.len()).collect::<Vec<_>>());
        assert_eq!(straight.concat(), bone_euclid(&mesh.positions, &bones));
    }

    #[test]
    fn one_thread_and_two_give_the_same_bits() {
        let mesh = joined(&[sphere(DVec3::ZERO, 0.5, 24), tube(DVec3::X, 0.1, 1.0, 20, 20)]);
        let bones: Vec<Segment> =
            (0..100).map(|at| (DVec3::X * f64::from(at) * 0.01, DVec3::Y * f64::from(at % 7) * 0.1)).collect();
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| [8, 32].map(|resolution| measured(&mesh, &bones, resolution)))
        };
        assert_eq!(with(1), with(2));
    }
}
