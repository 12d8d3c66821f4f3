//! The ways that HollowDist found: when bones met the cells around the vertices, and how long that makes distances.
//! [`super::hollow_distance`] says what it is for.

use super::hollow_field::Field;
use super::hollow_search::{Met, NEVER, Search, WORD};
use super::volumetric_geodesic::Segment;
use glam::DVec3;
use rayon::prelude::*;

/// When up to 64 bones met the cells that hold vertices and those around them.
struct Searched {
    /// How far each bone is from the cells it began in.
    offsets: Vec<f64>,
    /// `[near, bones]`: the first of the kept cells.
    met: Vec<Met>,
}

impl Searched {
    fn new(field: &Field, bones: &[Segment]) -> Self {
        let mut search = Search::new(field, bones.len());
        let to_cells = |&(start, end): &Segment| (field.lattice.to_cells(start), field.lattice.to_cells(end));
        let offsets = bones.iter().map(to_cells).enumerate().map(|(at, bone)| search.begin(at, bone)).collect();
        search.run();
        let mut met = search.when;
        met.truncate(field.near_count * bones.len());
        met.shrink_to_fit();
        Self { offsets, met }
    }
}

/// The ways from some of the bones, 64 a word.
pub(super) struct Ways {
    /// Which bone is the first of them.
    first: usize,
    words: Vec<Searched>,
}

impl Ways {
    /// From `bones`, of which `first` is the first.
    pub fn new(field: &Field, bones: &[Segment], first: usize) -> Self {
        Self { first, words: bones.par_chunks(WORD).map(|word| Searched::new(field, word)).collect() }
    }

    /// Makes distances of `vertices` at `places` as long as the ways are. `rows` `[vertices, B]` are straight at first; vertices of one
    /// cell share most of the work where they stand side by side.
    pub fn lengthen(&self, field: &Field, vertices: &[u32], places: &[DVec3], rows: &mut [f32], bone_count: usize) {
        let cell = |vertex: &u32| field.cell_of_vertex[*vertex as usize];
        let mut begin = 0;
        for of_cell in vertices.chunk_by(|one, other| cell(one) == cell(other)) {
            let end = begin + of_cell.len();
            let rows = &mut rows[begin * bone_count..end * bone_count];
            self.lengthen_in_cell(field, cell(&of_cell[0]), &places[begin..end], rows, bone_count);
            begin = end;
        }
    }

    /// The same of vertices in one cell, a number in `kept`.
    fn lengthen_in_cell(&self, field: &Field, own: u32, places: &[DVec3], rows: &mut [f32], bone_count: usize) {
        let (lattice, own) = (&field.lattice, own as usize);
        let cell = field.kept[own] as usize;
        let neighbours = field.steps.map(|step| cell.wrapping_add_signed(step));
        let centres = neighbours.map(|neighbour| lattice.centre(neighbour));
        let numbers = neighbours.map(|neighbour| field.number[neighbour] as usize);
        for (word, first) in self.words.iter().zip((self.first..).step_by(WORD)) {
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
            for (place, row) in places.iter().zip(rows.chunks_exact_mut(bone_count)) {
                let place = lattice.to_cells(*place);
                let mut last_steps = [f32::INFINITY; WORD];
                let last_steps = &mut last_steps[..count];
                for (before, centre) in before.iter().zip(centres) {
                    let step = place.distance(centre) as f32;
                    for (least, before) in last_steps.iter_mut().zip(before) {
                        let way = before + step;
                        *least = if way < *least { way } else { *least };
                    }
                }
                let row = &mut row[first..][..count];
                for ((distance, way), step) in row.iter_mut().zip(own_ways).zip(last_steps) {
                    let way = ((way + f64::from(*step)) * lattice.cell) as f32;
                    *distance = if way > *distance { way } else { *distance };
                }
            }
        }
    }
}
