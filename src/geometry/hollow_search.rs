//! The search of HollowDist: up to 64 bones at once, one bit each, layer by layer. [`super::hollow_distance`] says what it is for.
//!
//! In: a [`Field`] (the grid of one mesh). Out: when each bone met each kept cell, `[kept, bones]`.

use super::hollow_field::Field;
use super::surface_voxels::Lattice;
use super::volumetric_geodesic::Segment;
use glam::DVec3;
use std::ops::Range;

/// Bones that are searched together, one bit each.
pub(super) const WORD: usize = 64;
/// Finds every cell that a bone passes for more than a quarter of an edge.
const SAMPLES_PER_CELL: f64 = 4.0;
const SAMPLES_MAX: usize = 4_096;
/// Which layers of a round spread over all 26 neighbours.
const ROUND: [bool; 5] = [false, true, false, true, false];
/// A bone that met nothing new for so many layers has stopped: any three in a row hold one over all neighbours.
const STOPPED_AFTER: u16 = 3;
/// The longest way through a maze that is followed; beyond it distances are straight.
const LAYERS_MAX: u16 = u16::MAX - 16;
/// Not met.
pub(super) const NEVER: Met = Met { start: u16::MAX, layer: u16::MAX };

/// When a bone met a cell: after how many new starts, and in which layer of its search.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Met {
    pub start: u16,
    pub layer: u16,
}

/// The search of one word of bones.
pub(super) struct Search<'a> {
    field: &'a Field,
    bone_count: usize,
    /// Bones that have met each cell; all bits where nothing may go. `[cells]`
    met: Vec<u64>,
    /// Bones that met each cell since the last layer that spread over all neighbours. `[cells]`
    recent: Vec<u64>,
    /// Those of them that go on into hollow cells: in hollow cells all, in mesh cells those that begin or start again there. `[cells]`
    free: Vec<u64>,
    lines: Lines,
    /// Bones that met a cell in the last layer.
    moved: u64,
    /// When each bone met each kept cell. `[kept, bones]`
    pub when: Vec<Met>,
    /// Cells that hold a vertex and have not been met, per bone.
    missing: Vec<u32>,
    /// Bones still searching.
    active: u64,
    /// Layer of the last progress, per bone.
    progress: Vec<u16>,
    /// What is taken off the common layer for the layer of a bone that started again; whole rounds.
    delay: Vec<u16>,
    /// How often each bone has started again.
    starts: Vec<u16>,
    /// Bones that wait for the layer of their turn to start again: the layer, the bone and the cell.
    waiting: Vec<(u16, usize, u32)>,
}

/// The grid's lines along its last axis. A layer spreads line by line, which processors do many cells at a time.
struct Lines {
    /// Cells of a line.
    length: usize,
    /// Offsets between numbers of lines: to itself, to those that share a side with it, to those that share an edge.
    steps: [isize; 9],
    /// Lines with recent cells.
    recent: Vec<u32>,
    /// The first and the last recent cell of each line; [`NOTHING`] without any. `[lines]`
    spans: Vec<(u16, u16)>,
    /// The last layer that looked at each line; never for those at the edge of the grid. `[lines]`
    looked_at: Vec<u16>,
}

impl Lines {
    fn new(lattice: &Lattice) -> Self {
        let [width, height, length] = lattice.size;
        let is_edge =
            |line: usize| [0, width - 1].contains(&(line / height)) || [0, height - 1].contains(&(line % height));
        let far = height as isize;
        Self {
            length,
            steps: [0, -1, 1, -far, far, -far - 1, -far + 1, far - 1, far + 1],
            recent: Vec::new(),
            spans: vec![NOTHING; width * height],
            looked_at: (0..width * height).map(|line| if is_edge(line) { u16::MAX } else { 0 }).collect(),
        }
    }

    /// Notes that a line has recent cells between a first and a last one.
    fn note(&mut self, line: u32, (first, last): (u16, u16)) {
        let span = &mut self.spans[line as usize];
        if *span == NOTHING {
            self.recent.push(line);
        }
        *span = (span.0.min(first), span.1.max(last));
    }

    /// The lines that a layer can come to, each once.
    fn reached(&mut self, layer: u16, to_all: bool) -> Vec<u32> {
        let mut reached = Vec::new();
        for &line in &self.recent {
            for &step in &self.steps[..if to_all { 9 } else { 5 }] {
                let other = (line as usize).wrapping_add_signed(step);
                if self.looked_at[other] < layer {
                    self.looked_at[other] = layer;
                    reached.push(other as u32);
                }
            }
        }
        reached
    }

    /// The cells of a line that the lines around it can come to: never the first and the last, which are at the edge of the grid.
    fn window(&self, line: u32, to_all: bool) -> Range<usize> {
        let steps = self.steps[..if to_all { 9 } else { 5 }].iter();
        let spans = steps.map(|&step| self.spans[(line as usize).wrapping_add_signed(step)]);
        let (first, last) = spans.fold(NOTHING, |all, span| (all.0.min(span.0), all.1.max(span.1)));
        (usize::from(first).max(2) - 1)..(usize::from(last) + 2).min(self.length - 1)
    }

    /// The bones of the lines at `steps` from one, in a window and one cell before and behind it.
    fn around<'b>(&self, line: u32, window: &Range<usize>, bones: &'b [u64]) -> [&'b [u64]; 9] {
        self.steps.map(|step| {
            let first = (line as usize).wrapping_add_signed(step) * self.length;
            &bones[first + window.start - 1..first + window.end + 1]
        })
    }
}

/// No cells of a line.
const NOTHING: (u16, u16) = (u16::MAX, 0);

/// What a layer came to.
#[derive(Default)]
struct Came {
    /// Lines, and the first and the last cell of each.
    lines: Vec<(u32, (u16, u16))>,
    /// Cells, and the bones that met them.
    cells: Vec<(u32, u64)>,
}

/// What comes to a window of a line in one layer.
struct Coming {
    /// To the cell beside, one cell more on both sides of the window.
    beside: Vec<u64>,
    /// To the cell beside, and to the cells before and behind that one; one cell more on both sides.
    around: Vec<u64>,
    /// The bones that come to each cell.
    bones: Vec<u64>,
}

impl Coming {
    /// For windows of lines of `length` cells.
    fn new(length: usize) -> Self {
        Self { beside: vec![0; length], around: vec![0; length], bones: vec![0; length] }
    }

    /// `lines` as [`Lines::around`] gives them.
    fn gather(&mut self, lines: [&[u64]; 9], to_all: bool) -> &[u64] {
        let [own, low, high, left, right, ..] = lines;
        let length = own.len();
        if to_all {
            unite(lines, &mut self.around[..length]);
        } else {
            unite([low, high, left, right], &mut self.beside[..length]);
            self.around[..length].copy_from_slice(own);
        }
        let bones = &mut self.bones[..length - 2];
        let around = self.around[..length].windows(3).zip(&self.beside[1..]);
        for (bones, (around, beside)) in bones.iter_mut().zip(around) {
            *bones = around[0] | around[1] | around[2] | beside;
        }
        bones
    }
}

/// The bones of several lines together, cell by cell.
fn unite<const COUNT: usize>(lines: [&[u64]; COUNT], united: &mut [u64]) {
    let lines = lines.map(|line| &line[..united.len()]);
    for (at, united) in united.iter_mut().enumerate() {
        *united = lines.iter().fold(0, |bones, line| bones | line[at]);
    }
}

impl<'a> Search<'a> {
    pub fn new(field: &'a Field, bone_count: usize) -> Self {
        let cells = field.lattice.count();
        let closed = |cell| if field.lattice.is_outermost(cell) { u64::MAX } else { 0 };
        Self {
            field,
            bone_count,
            met: (0..cells).map(closed).collect(),
            recent: vec![0; cells],
            free: vec![0; cells],
            lines: Lines::new(&field.lattice),
            moved: 0,
            when: vec![NEVER; field.kept.len() * bone_count],
            missing: vec![field.holding_count; bone_count],
            active: if bone_count == WORD { u64::MAX } else { (1 << bone_count) - 1 },
            progress: vec![0; bone_count],
            delay: vec![0; bone_count],
            starts: vec![0; bone_count],
            waiting: Vec::new(),
        }
    }

    /// Puts a bone into its cells; returns how far it is from them, in cells.
    pub fn begin(&mut self, bone: usize, segment: Segment) -> f64 {
        let lattice = &self.field.lattice;
        let low = DVec3::ONE;
        let high = DVec3::from(lattice.size.map(|size| size as f64 - 1.0));
        let (start, end) = segment;
        let steps = ((start.distance(end) * SAMPLES_PER_CELL).ceil().max(1.0) as usize).min(SAMPLES_MAX);
        let samples: Vec<(DVec3, f64)> = (0..=steps)
            .map(|step| start.lerp(end, step as f64 / steps as f64))
            .map(|sample| (sample.clamp(low, high), sample.distance(sample.clamp(low, high))))
            .collect();
        let offset = samples.iter().map(|sample| sample.1).fold(f64::INFINITY, f64::min);
        let near = samples.iter().filter(|sample| sample.1 <= offset);
        let mut cells: Vec<u32> = near.map(|&(place, _)| lattice.holding(place) as u32).collect();
        cells.sort_unstable();
        cells.dedup();
        for cell in cells {
            self.meet(cell, 1 << bone, 0);
            self.set_free(cell, bone);
        }
        offset
    }

    /// Spreads until every bone has met all cells that hold a vertex.
    pub fn run(&mut self) {
        let mut layer = 0;
        self.retire(layer);
        // Every bone meets a new cell at least once in three layers or starts again, and starts again once per hollow region.
        while self.active != 0 && layer < LAYERS_MAX {
            layer += 1;
            let spreads_to_all = ROUND[(layer as usize - 1) % ROUND.len()];
            let came = self.spread(layer, spreads_to_all);
            if spreads_to_all {
                self.forget_recent();
            }
            came.lines.into_iter().for_each(|(line, span)| self.lines.note(line, span));
            for (cell, bones) in came.cells {
                self.meet(cell, bones, layer);
            }
            self.resume(layer);
            self.retire(layer);
        }
    }

    /// The cells that the bones come to in a layer, over all neighbours or over faces, and which bones come to each. Of the recent
    /// cells, those before the last layer have spread over their faces already, so they may do so again.
    fn spread(&mut self, layer: u16, to_all: bool) -> Came {
        let (length, active) = (self.lines.length, self.active);
        let (mut from_all, mut from_free) = (Coming::new(length), Coming::new(length));
        let mut new = vec![0; length];
        let mut came = Came::default();
        for line in self.lines.reached(layer, to_all) {
            let window = self.lines.window(line, to_all);
            let first = line as usize * length;
            let cells = first + window.start..first + window.end;
            let is_mesh = &self.field.is_mesh[cells.clone()];
            let new = &mut new[..cells.len()];
            new.copy_from_slice(from_free.gather(self.lines.around(line, &window, &self.free), to_all));
            if is_mesh.contains(&true) {
                let from_all = from_all.gather(self.lines.around(line, &window, &self.recent), to_all);
                for ((new, from_all), is_mesh) in new.iter_mut().zip(from_all).zip(is_mesh) {
                    *new = if *is_mesh { *from_all } else { *new };
                }
            }
            let mut any = 0;
            for (new, met) in new.iter_mut().zip(&mut self.met[cells.clone()]) {
                *new &= active & !*met;
                *met |= *new;
                any |= *new;
            }
            if any != 0 {
                let before = came.cells.len();
                let with_new = (cells.start as u32..).zip(&*new).filter(|(_, bones)| **bones != 0);
                came.cells.extend(with_new.map(|(cell, bones)| (cell, *bones)));
                let place = |(cell, _): &(u32, u64)| (*cell as usize - first) as u16;
                let new = &came.cells[before..];
                came.lines.push((line, (new.first().map_or(0, place), new.last().map_or(0, place))));
            }
        }
        came
    }

    fn forget_recent(&mut self) {
        for line in self.lines.recent.drain(..) {
            self.lines.spans[line as usize] = NOTHING;
            let cells = line as usize * self.lines.length..(line as usize + 1) * self.lines.length;
            self.recent[cells.clone()].fill(0);
            self.free[cells].fill(0);
        }
    }

    /// Lets a bone go on from a cell to all others.
    fn set_free(&mut self, cell: u32, bone: usize) {
        self.free[cell as usize] |= 1 << bone;
        let length = self.lines.length as u32;
        let place = (cell % length) as u16;
        self.lines.note(cell / length, (place, place));
    }

    /// Notes that bones are in a cell of a noted line from this layer on.
    fn meet(&mut self, cell: u32, bones: u64, layer: u16) {
        self.met[cell as usize] |= bones;
        self.recent[cell as usize] |= bones;
        self.free[cell as usize] |= if self.field.is_mesh[cell as usize] { 0 } else { bones };
        self.moved |= bones;
        let number = self.field.number[cell as usize];
        if number == u32::MAX {
            return;
        }
        let holds_vertex = u32::from(self.field.holds_vertex[number as usize]);
        let when = &mut self.when[number as usize * self.bone_count..][..self.bone_count];
        for bone in bits(bones) {
            when[bone] = Met { start: self.starts[bone], layer: layer - self.delay[bone] };
            self.missing[bone] -= holds_vertex;
        }
    }

    /// Takes bones out that have met every vertex, and has those start again that have stopped.
    fn retire(&mut self, layer: u16) {
        for bone in bits(std::mem::take(&mut self.moved)) {
            self.progress[bone] = layer;
        }
        for bone in bits(self.active) {
            if self.missing[bone] == 0 {
                self.active &= !(1 << bone);
            } else if layer - self.progress[bone] >= STOPPED_AFTER && !self.waiting.iter().any(|wait| wait.1 == bone) {
                match self.way_out(bone) {
                    Some((own_layer, cell)) => {
                        let round = ROUND.len() as u16;
                        let turn = layer + 1 + (round + own_layer % round - (layer + 1) % round) % round;
                        self.waiting.push((turn, bone, cell));
                    }
                    None => self.active &= !(1 << bone),
                }
            }
        }
    }

    /// Lets the bones whose turn it is pass the surface where they wait.
    fn resume(&mut self, layer: u16) {
        let due: Vec<(u16, usize, u32)> = self.waiting.iter().copied().filter(|wait| wait.0 == layer).collect();
        self.waiting.retain(|wait| wait.0 != layer);
        for (_, bone, cell) in due {
            let number = self.field.number[cell as usize] as usize;
            self.delay[bone] = layer - self.when[number * self.bone_count + bone].layer;
            self.starts[bone] += 1;
            self.progress[bone] = layer;
            self.set_free(cell, bone);
        }
    }

    /// The mesh cell that a bone met first among those that touch a hollow cell which it has not met: its layer, and the cell.
    fn way_out(&self, bone: usize) -> Option<(u16, u32)> {
        let opens = |cell: u32| {
            let around = self.field.steps.iter().map(|&step| (cell as usize).wrapping_add_signed(step));
            around.into_iter().any(|other| !self.field.is_mesh[other] && self.met[other] & (1 << bone) == 0)
        };
        let kept = self.field.kept.iter().zip(self.when.iter().skip(bone).step_by(self.bone_count));
        let mesh = kept.filter(|&(&cell, &met)| met != NEVER && self.field.is_mesh[cell as usize]);
        let mut best: Option<(u16, u32)> = None;
        for (&cell, met) in mesh {
            let candidate = (met.layer, cell);
            if best.is_none_or(|best| candidate < best) && opens(candidate.1) {
                best = Some(candidate);
            }
        }
        best
    }
}

/// The numbers of the bits of a word.
fn bits(word: u64) -> impl Iterator<Item = usize> {
    let mut rest = word;
    std::iter::from_fn(move || {
        let bit = (rest != 0).then(|| rest.trailing_zeros() as usize)?;
        rest &= rest - 1;
        Some(bit)
    })
}
