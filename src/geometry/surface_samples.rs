//! Points spread evenly over a surface, with normals. RigNet [Xu et al. 2020] measures surface distances between 4,000
//! such points; they are spread by sample elimination [Yuksel 2015].
//!
//! | in      | shape              | unit       |
//! |---------|--------------------|------------|
//! | `mesh`  | `[V, 3]`, `[F, 3]` | any space  |
//!
//! Out: positions and normals `[S, 3]`, S = `count` on any surface with an area.
//! # Departures from the published code
//! - Candidates are not random: every triangle is halved across its longest edge until its pieces are small, and the
//!   pieces' middles are the candidates. They depend on the shape alone, not on how it is numbered or where it stands.
//! - Candidates on opposite sides of something thin do not crowd each other out.

use super::close_pairs::for_each_close_pair;
use crate::mesh::Mesh;
use glam::{DVec3, I64Vec3};
use std::cmp::Ordering;
use std::collections::{BinaryHeap, HashSet};

/// How many samples the surface distances use.
pub const SAMPLE_COUNT: usize = 4_000;
/// At least this many candidates per sample; about 1.4 times as many come, since pieces are halved. Yuksel's quality
/// rises little beyond that.
const CANDIDATES_PER_SAMPLE: usize = 3;
/// Candidates of fine triangles nearer than this share of the radius are not needed: they would only cost time.
const CROWDED: f64 = 0.2;
/// Candidates whose normals have a cosine at or below this lie on opposite sides (as in the surface distance).
const OPPOSITE: f64 = -0.5;

/// Points on a surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceSamples {
    pub positions: Vec<DVec3>,
    /// Interpolated from the vertices; unit length, zero where they cancel.
    pub normals: Vec<DVec3>,
}

impl SurfaceSamples {
    /// `count` samples of `mesh`, evenly spread, ordered by place.
    pub fn new(mesh: &Mesh, count: usize) -> Self {
        let area: f64 = (0..mesh.triangles.len()).map(|face| 0.5 * mesh.area_normal(face).length()).sum();
        if !(area > 0.0 && area.is_finite()) || count == 0 {
            return Self::default();
        }
        let mut candidates = candidates(mesh, area / (count * CANDIDATES_PER_SAMPLE) as f64);
        let radius = 2.0 * (area / (2.0 * 3f64.sqrt() * count as f64)).sqrt();
        thin_out(&mut candidates, CROWDED * radius, count);
        let kept = eliminate(&candidates, radius, count);
        let (positions, normals) =
            candidates.into_iter().zip(kept).filter_map(|(candidate, kept)| kept.then_some(candidate)).unzip();
        Self { positions, normals }
    }
}

/// A corner of a piece: position and normal, both linear over the triangle.
type Corner = (DVec3, DVec3);

/// Middles of pieces of at most `piece_area`, sorted by place. Fewer than 2 area / `piece_area` + F.
fn candidates(mesh: &Mesh, piece_area: f64) -> Vec<Corner> {
    let normals = mesh.vertex_normals();
    let mut candidates = Vec::new();
    let mut work: Vec<[Corner; 3]> = Vec::new();
    for triangle in &mesh.triangles {
        let mut corners = triangle.map(|corner| (mesh.positions[corner as usize], normals[corner as usize]));
        // In order of place, so that the pieces do not depend on the order of corners.
        corners.sort_by(|a, b| order_of_place(a.0, b.0));
        work.push(corners);
        // Halving ends: each half has half the area.
        while let Some([a, b, c]) = work.pop() {
            let area = 0.5 * (b.0 - a.0).cross(c.0 - a.0).length();
            if area > piece_area {
                let (ab, bc, ca) = (a.0.distance_squared(b.0), b.0.distance_squared(c.0), c.0.distance_squared(a.0));
                let (from, to, other) = if ab >= bc && ab >= ca {
                    (a, b, c)
                } else if bc >= ca {
                    (b, c, a)
                } else {
                    (a, c, b)
                };
                let middle = ((from.0 + to.0) * 0.5, (from.1 + to.1) * 0.5);
                work.extend([[from, middle, other], [middle, to, other]]);
            } else if area > 0.0 {
                candidates.push(((a.0 + b.0 + c.0) / 3.0, (a.1 + b.1 + c.1).normalize_or_zero()));
            }
        }
    }
    candidates.sort_by(|a, b| order_of_place(a.0, b.0).then_with(|| order_of_place(a.1, b.1)));
    candidates
}

fn order_of_place(a: DVec3, b: DVec3) -> Ordering {
    a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z))
}

/// Keeps the first candidate of each cell of `width` and side of the surface, if `count` remain. Bounds how many
/// neighbours a candidate can have, however fine the triangles are.
fn thin_out(candidates: &mut Vec<Corner>, width: f64, count: usize) {
    let mut taken: HashSet<(I64Vec3, usize, bool)> = HashSet::with_capacity(candidates.len());
    let place = |&(position, normal): &Corner| {
        let axis = normal.abs().max_position();
        ((position / width).floor().as_i64vec3(), axis, normal[axis] < 0.0)
    };
    let first: Vec<bool> = candidates.iter().map(|candidate| taken.insert(place(candidate))).collect();
    if taken.len() >= count {
        let mut first = first.into_iter();
        candidates.retain(|_| first.next().unwrap_or(false));
    }
}

/// Who crowds whom, and how much: neighbours of candidate c are `neighbors[offsets[c]..offsets[c + 1]]`.
struct Crowding {
    offsets: Vec<u32>,
    neighbors: Vec<(u32, f32)>,
}

impl Crowding {
    fn new(candidates: &[Corner], radius: f64) -> Self {
        let positions: Vec<DVec3> = candidates.iter().map(|candidate| candidate.0).collect();
        let mut pairs: Vec<(u32, u32, f32)> = Vec::with_capacity(candidates.len() * 12);
        let mut offsets = vec![0u32; candidates.len() + 1];
        for_each_close_pair(&positions, radius, |a, b, squared| {
            if candidates[a as usize].1.dot(candidates[b as usize].1) > OPPOSITE {
                pairs.push((a, b, crowding(squared.sqrt() / radius) as f32));
                offsets[a as usize + 1] += 1;
                offsets[b as usize + 1] += 1;
            }
        });
        for candidate in 1..offsets.len() {
            offsets[candidate] += offsets[candidate - 1];
        }
        let mut next = offsets.clone();
        let mut neighbors = vec![(0, 0.0); 2 * pairs.len()];
        for (a, b, weight) in pairs {
            for (own, other) in [(a, b), (b, a)] {
                neighbors[next[own as usize] as usize] = (other, weight);
                next[own as usize] += 1;
            }
        }
        Self { offsets, neighbors }
    }

    fn around(&self, candidate: usize) -> &[(u32, f32)] {
        &self.neighbors[self.offsets[candidate] as usize..self.offsets[candidate + 1] as usize]
    }
}

/// Removes the most crowded candidate again and again until `count` remain; whether each is kept.
fn eliminate(candidates: &[Corner], radius: f64, count: usize) -> Vec<bool> {
    let crowding = Crowding::new(candidates, radius);
    let weight = |candidate| crowding.around(candidate).iter().map(|&(_, weight)| f64::from(weight)).sum();
    let mut crowded: Vec<f64> = (0..candidates.len()).map(weight).collect();
    let mut queue: BinaryHeap<Crowded> =
        crowded.iter().zip(0..).map(|(&weight, candidate)| Crowded { weight, candidate }).collect();
    let mut kept = vec![true; candidates.len()];
    let mut remaining = candidates.len();
    // Weights only fall, so an entry that is out of date comes up early and goes back with its present weight. Each
    // removal dates the entries of its neighbours once.
    while remaining > count {
        let Some(Crowded { weight, candidate }) = queue.pop() else { break };
        let present = crowded[candidate as usize];
        if weight > present {
            queue.push(Crowded { weight: present, candidate });
            continue;
        }
        kept[candidate as usize] = false;
        remaining -= 1;
        for &(other, share) in crowding.around(candidate as usize) {
            // Exactly zero rather than rounding below it.
            crowded[other as usize] = (crowded[other as usize] - f64::from(share)).max(0.0);
        }
    }
    kept
}

/// Yuksel's weight, (1 − d / 2 r_max)^8, for a distance in units of 2 r_max.
fn crowding(distance: f64) -> f64 {
    let near = (1.0 - distance).max(0.0);
    let squared = near * near;
    let fourth = squared * squared;
    fourth * fourth
}

/// A candidate in a queue that gives the most crowded first; equally crowded: the first in order of place.
#[derive(PartialEq)]
struct Crowded {
    weight: f64,
    candidate: u32,
}

impl Eq for Crowded {}

impl Ord for Crowded {
    fn cmp(&self, other: &Self) -> Ordering {
        self.weight.total_cmp(&other.weight).then_with(|| other.candidate.cmp(&self.candidate))
    }
}

impl PartialOrd for Crowded {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
