//! The search of HollowDist: up to 64 bones at once, one bit each, layer by layer. [`super::hollow_distance`] says what it is for.
//!
//! In: a [`Field`] (the grid of one mesh). Out: when each bone met each kept cell, `[kept, bones]`.

use super::hollow_distance::{Field, WORD};
use super::volumetric_geodesic::Segment;
use glam::DVec3;

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
    field: &'a Field<'a>,
    bone_count: usize,
    /// Bones that have met each cell; all bits where nothing may go. `[cells]`
    met: Vec<u64>,
    /// Bones about to meet each cell. `[cells]`
    coming: Vec<u64>,
    /// When each bone met each kept cell. `[kept, bones]`
    pub when: Vec<Met>,
    /// Cells met in the last layer, and which bones met them there.
    front: Vec<Front>,
    /// Cells met since the last layer that spread over all neighbours, for those that come after it.
    recent: Vec<Front>,
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

#[derive(Clone, Copy)]
struct Front {
    cell: u32,
    bones: u64,
    /// Whether the way goes on into hollow cells.
    free: bool,
}

impl<'a> Search<'a> {
    pub fn new(field: &'a Field<'a>, bone_count: usize) -> Self {
        let cells = field.lattice.count();
        let closed = |cell| if field.lattice.is_outermost(cell) { u64::MAX } else { 0 };
        Self {
            field,
            bone_count,
            met: (0..cells).map(closed).collect(),
            coming: vec![0; cells],
            when: vec![NEVER; field.kept.len() * bone_count],
            front: Vec::new(),
            recent: Vec::new(),
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
        let lattice = self.field.lattice;
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
            self.meet(cell, 1 << bone, 0, true);
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
            let all = ROUND[(layer as usize - 1) % ROUND.len()];
            let sources = if all { std::mem::take(&mut self.recent) } else { std::mem::take(&mut self.front) };
            self.front.clear();
            let touched = self.spread(&sources, all);
            for cell in touched {
                let bones = std::mem::take(&mut self.coming[cell as usize]) & !self.met[cell as usize];
                self.meet(cell, bones, layer, !self.field.is_mesh[cell as usize]);
            }
            self.resume(layer);
            self.retire(layer);
        }
    }

    /// Marks the neighbours that the bones of `sources` come to; returns them, each once.
    fn spread(&mut self, sources: &[Front], all: bool) -> Vec<u32> {
        let steps = if all { &self.field.steps[..] } else { &self.field.steps[..6] };
        let mut touched = Vec::new();
        for source in sources {
            let bones = source.bones & self.active;
            if bones == 0 {
                continue;
            }
            for &step in steps {
                let cell = (source.cell as usize).wrapping_add_signed(step);
                if bones & !self.met[cell] != 0 && (source.free || self.field.is_mesh[cell]) {
                    if self.coming[cell] == 0 {
                        touched.push(cell as u32);
                    }
                    self.coming[cell] |= bones;
                }
            }
        }
        touched
    }

    /// Notes that bones are in a cell from this layer on.
    fn meet(&mut self, cell: u32, bones: u64, layer: u16, free: bool) {
        if bones == 0 {
            return;
        }
        self.met[cell as usize] |= bones;
        self.front.push(Front { cell, bones, free });
        self.recent.push(Front { cell, bones, free });
        let number = self.field.number[cell as usize];
        let mut rest = bones;
        while rest != 0 {
            let bone = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            self.progress[bone] = layer;
            if number != u32::MAX {
                let met = Met { start: self.starts[bone], layer: layer - self.delay[bone] };
                self.when[number as usize * self.bone_count + bone] = met;
                self.missing[bone] -= u32::from(self.field.holds_vertex[number as usize]);
            }
        }
    }

    /// Takes bones out that have met every vertex, and has those start again that have stopped.
    fn retire(&mut self, layer: u16) {
        let mut rest = self.active;
        while rest != 0 {
            let bone = rest.trailing_zeros() as usize;
            rest &= rest - 1;
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
            let passing = Front { cell, bones: 1 << bone, free: true };
            self.front.push(passing);
            self.recent.push(passing);
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
