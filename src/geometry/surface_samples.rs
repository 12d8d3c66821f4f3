//! Points spread evenly over a surface, with normals. RigNet [Xu et al. 2020] measures surface distances between 4,000
//! such points; they are spread by sample elimination [Yuksel 2015].
//!
//! | in      | shape              | unit       |
//! |---------|--------------------|------------|
//! | `mesh`  | `[V, 3]`, `[F, 3]` | any space  |
//!
//! Out: positions and normals `[S, 3]`, S = `count` on any surface with an area.
//! # Departures from the published code
//! - Candidates are not drawn from a sequence: every triangle is halved across its longest edge until its pieces are
//!   small, and each piece holds one candidate where a hash of its [`Place`] puts it. So the samples follow the mesh when it is
//!   renumbered, moved, grown or mirrored in x, and nearly all of them when it is turned a little or changed in places. (The
//!   pieces' middles would not do: they form lattices whose patches the graph of nearest samples does not join.)
//! - Candidates on opposite sides of something thin do not crowd each other out.

use super::close_pairs::for_each_close_pair;
use super::place_hash::mix;
use crate::mesh::Mesh;
use glam::{DVec3, I64Vec3};
use std::cmp::Ordering;
use std::collections::{BinaryHeap, HashMap};

/// How many samples the surface distances use.
pub const SAMPLE_COUNT: usize = 4_000;
/// At least this many candidates per sample; about 1.4 times as many come, since pieces are halved. Yuksel's quality
/// rises little beyond that.
const CANDIDATES_PER_SAMPLE: usize = 3;
/// A piece smaller than this share of the largest holds a candidate only as often as its area says: the candidates of fine
/// triangles are not all needed and would only cost time.
const SMALL_PIECE: f64 = 0.125;
/// At most [`CROWD_MAX`] candidates are kept in a cell this wide, in radii: a bound on the work for surfaces in many layers,
/// which no sound mesh meets.
const CROWDED: f64 = 0.2;
const CROWD_MAX: u32 = 12;
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
        let frame = Frame::new(mesh, area);
        let radius = 2.0 * (area / (2.0 * 3f64.sqrt() * count as f64)).sqrt();
        let piece_area = area / (count * CANDIDATES_PER_SAMPLE) as f64;
        let mut candidates = candidates(mesh, &frame, piece_area, SMALL_PIECE * piece_area);
        if candidates.len() < count {
            candidates = self::candidates(mesh, &frame, piece_area, 0.0);
        }
        thin_out(&mut candidates, CROWDED * radius, count);
        let kept = eliminate(&candidates, radius, count);
        let (positions, normals) =
            candidates.into_iter().zip(kept).filter_map(|(candidate, kept)| kept.then_some(candidate)).unzip();
        Self { positions, normals }
    }
}

/// The vertical through the middle of a surface, and its size: they turn, mirror, move and grow with it.
struct Frame {
    /// Mean position over the surface.
    center: DVec3,
    /// Square root of the area.
    size: f64,
}

/// Height and distance from the vertical, in [`GRAIN`]s, and the sector of the angle between the horizontal offset and z,
/// left and right alike. The same for a point and its image when the surface is moved, grown or mirrored in x; almost always
/// when it is turned a little about the vertical, or a few vertices change. (Without sectors the samples of a round body would
/// lie in rings that the graph of nearest samples does not join.)
type Place = [i64; 3];

/// Places nearer than about this share of the surface's size are one: far above what a few vertices more or less shift the
/// middle by, below the spacing of samples.
const GRAIN: f64 = 1.0 / 512.0;
/// Sectors of half a turn.
const SECTORS: f64 = 16.0;
/// Lengths that differ by less are equal but for rounding.
const ROUNDING: f64 = 1e-9;

impl Frame {
    fn new(mesh: &Mesh, area: f64) -> Self {
        let moment: DVec3 = (0..mesh.triangles.len())
            .map(|face| mesh.corners(face).into_iter().sum::<DVec3>() * (mesh.area_normal(face).length() / 6.0))
            .sum();
        Self { center: moment / area, size: area.sqrt() }
    }

    fn place(&self, position: DVec3) -> Place {
        let from = (position - self.center) / self.size;
        let sector = from.x.abs().atan2(from.z) * SECTORS / std::f64::consts::PI;
        [from.y / GRAIN, from.x.hypot(from.z) / GRAIN, sector].map(|value| value.round() as i64)
    }
}

/// A corner of a piece: position and normal, both linear over the triangle.
type Corner = (DVec3, DVec3);

/// One point in each piece of at most `piece_area`, sorted by place; in some of the pieces below `small_area`. Fewer than
/// 2 area / `piece_area` + F.
fn candidates(mesh: &Mesh, frame: &Frame, piece_area: f64, small_area: f64) -> Vec<Corner> {
    let normals = mesh.vertex_normals();
    let mut candidates = Vec::new();
    let mut work: Vec<[Corner; 3]> = Vec::new();
    let places: Vec<Place> = mesh.positions.iter().map(|&position| frame.place(position)).collect();
    for triangle in &mesh.triangles {
        // In order of place, so that the pieces do not depend on the order of corners.
        let mut order = *triangle;
        order.sort_by(|&a, &b| {
            let (a, b) = (a as usize, b as usize);
            places[a].cmp(&places[b]).then_with(|| by_axes(mesh.positions[a], mesh.positions[b]))
        });
        work.push(order.map(|corner| (mesh.positions[corner as usize], normals[corner as usize])));
        // Halving ends: each half has half the area.
        while let Some([a, b, c]) = work.pop() {
            let area = 0.5 * (b.0 - a.0).cross(c.0 - a.0).length();
            if area > piece_area {
                let (ab, bc, ca) = (a.0.distance_squared(b.0), b.0.distance_squared(c.0), c.0.distance_squared(a.0));
                // Edges that differ by rounding alone are equally long; the first of them is halved.
                let longest = ab.max(bc).max(ca) * (1.0 - ROUNDING);
                let (from, to, other) = if ab >= longest {
                    (a, b, c)
                } else if bc >= longest {
                    (b, c, a)
                } else {
                    (a, c, b)
                };
                let middle = ((from.0 + to.0) * 0.5, (from.1 + to.1) * 0.5);
                work.extend([[from, middle, other], [middle, to, other]]);
            } else if area > 0.0 {
                let [height, distance, sector] = frame.place((a.0 + b.0 + c.0) / 3.0);
                let bits = mix(height as u64 ^ mix(distance as u64 ^ mix(sector as u64)));
                if area >= small_area || share(mix(bits)) * small_area < area {
                    let [u, v, w] = scattered(bits);
                    let normal = (a.1 * u + b.1 * v + c.1 * w).normalize_or_zero();
                    candidates.push((a.0 * u + b.0 * v + c.0 * w, normal));
                }
            }
        }
    }
    let mut keyed: Vec<(Place, Corner)> =
        candidates.into_iter().map(|candidate| (frame.place(candidate.0), candidate)).collect();
    keyed.sort_by(|(place, a), (other, b)| {
        place.cmp(other).then_with(|| by_axes(a.0, b.0)).then_with(|| by_axes(a.1, b.1))
    });
    keyed.into_iter().map(|(_, candidate)| candidate).collect()
}

/// By y, z, distance from x = 0, and side last: meshes mirrored in x = 0 are walked in the same order.
fn by_axes(a: DVec3, b: DVec3) -> Ordering {
    let by_side = a.x.total_cmp(&b.x);
    a.y.total_cmp(&b.y).then(a.z.total_cmp(&b.z)).then(a.x.abs().total_cmp(&b.x.abs())).then(by_side)
}

/// The low half of 64 bits as a number from 0 to 1.
fn share(bits: u64) -> f64 {
    f64::from(bits as u32) / f64::from(u32::MAX)
}

/// Barycentric weights that are even over a triangle.
fn scattered(bits: u64) -> [f64; 3] {
    let (first, second) = (share(bits >> 32).sqrt(), share(bits));
    [1.0 - first, first * (1.0 - second), first * second]
}

/// Keeps the first [`CROWD_MAX`] candidates of each cell of `width` and side of the surface, if `count` remain.
fn thin_out(candidates: &mut Vec<Corner>, width: f64, count: usize) {
    let mut taken: HashMap<(I64Vec3, usize, bool), u32> = HashMap::with_capacity(candidates.len());
    let place = |&(position, normal): &Corner| {
        let axis = normal.abs().max_position();
        ((position / width).floor().as_i64vec3(), axis, normal[axis] < 0.0)
    };
    let within: Vec<bool> = candidates
        .iter()
        .map(|candidate| {
            let taken = taken.entry(place(candidate)).or_default();
            *taken += 1;
            *taken <= CROWD_MAX
        })
        .collect();
    if within.iter().filter(|&&within| within).count() >= count {
        let mut within = within.into_iter();
        candidates.retain(|_| within.next().unwrap_or(false));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::bvh::Bvh;
    use crate::mesh::test_shapes::{degenerate, joined, sphere, torus, tube};

    /// Twice the largest radius at which `count` discs can lie apart on the surface.
    fn widest_spacing(mesh: &Mesh, count: usize) -> f64 {
        let area: f64 = (0..mesh.triangles.len()).map(|face| 0.5 * mesh.area_normal(face).length()).sum();
        2.0 * (area / (2.0 * 3f64.sqrt() * count as f64)).sqrt()
    }

    #[test]
    fn samples_lie_on_the_surface_far_apart_and_leave_no_hole() {
        for mesh in [sphere(DVec3::ZERO, 0.5, 40), torus(0.4, 0.1, 30), tube(DVec3::ZERO, 0.1, 1.0, 16, 3)] {
            let samples = SurfaceSamples::new(&mesh, 1_000);
            assert_eq!(samples.positions.len(), 1_000);
            let spacing = widest_spacing(&mesh, 1_000);
            let surface = Bvh::new(&mesh);
            let tree = crate::geometry::point_tree::PointTree::new(&samples.positions);
            let mut nearest = Vec::new();
            for (sample, &position) in (0u32..).zip(&samples.positions) {
                assert!(surface.nearest_point(position).unwrap().distance < 1e-9);
                tree.nearest_others(sample, position, 1, &mut nearest);
                assert!(nearest[0].0.sqrt() > 0.5 * spacing, "{} of {spacing}", nearest[0].0.sqrt());
            }
            for face in 0..mesh.triangles.len() {
                let middle = mesh.corners(face).into_iter().sum::<DVec3>() / 3.0;
                assert!(tree.nearest(middle).unwrap().1.sqrt() < 1.2 * spacing);
            }
        }
    }

    #[test]
    fn renumbering_vertices_and_faces_changes_no_sample() {
        let mesh = torus(0.4, 0.15, 40);
        let count = mesh.positions.len() as u32;
        let renumbered = Mesh {
            positions: (0..count).map(|vertex| mesh.positions[(vertex * 7 % count) as usize]).collect(),
            triangles: mesh
                .triangles
                .iter()
                .rev()
                .map(|&[a, b, c]| {
                    let new = |old: u32| (0..count).find(|vertex| vertex * 7 % count == old).unwrap();
                    [new(b), new(c), new(a)]
                })
                .collect(),
        };
        assert_ne!(count % 7, 0);
        let (first, second) = (SurfaceSamples::new(&mesh, 500), SurfaceSamples::new(&renumbered, 500));
        assert_eq!(first.positions, second.positions);
        assert!(first.normals.iter().zip(&second.normals).all(|(a, b)| a.distance(*b) < 1e-12));
    }

    #[test]
    fn samples_go_along_when_the_mesh_is_turned_a_little_mirrored_moved_or_grown() {
        // Nothing about it is symmetric.
        let mesh = joined(&[torus(0.4, 0.15, 40), sphere(DVec3::new(0.3, 0.4, -0.2), 0.2, 30)]);
        let samples = SurfaceSamples::new(&mesh, 1_000);
        let turn = glam::DMat3::from_rotation_y(5e-4);
        let mirror = glam::DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
        for (name, map, scale) in [("turned", turn, 1.0), ("mirrored", mirror, 1.0), ("grown", turn, 3.0)] {
            let moved = Mesh {
                positions: mesh.positions.iter().map(|&p| scale * (map * p) + DVec3::new(0.1, 2.0, -0.3)).collect(),
                triangles: mesh.triangles.clone(),
            };
            let found = SurfaceSamples::new(&moved, 1_000);
            let tree = crate::geometry::point_tree::PointTree::new(&found.positions);
            let there = |&p: &DVec3| tree.nearest(scale * (map * p) + DVec3::new(0.1, 2.0, -0.3)).unwrap().1 < 1e-12;
            let kept = samples.positions.iter().filter(|p| there(p)).count();
            assert!(kept >= 950, "{name}: {kept} of 1000 samples went along");
        }
    }

    #[test]
    fn fine_detail_gets_no_more_samples_than_its_area() {
        let (plain, fine) = (sphere(DVec3::ZERO, 0.5, 24), sphere(DVec3::X * 2.0, 0.05, 120));
        let samples = SurfaceSamples::new(&joined(&[plain, fine]), 2_000);
        let on_fine = samples.positions.iter().filter(|position| position.x > 1.5).count();
        assert!((10..40).contains(&on_fine), "{on_fine} of 2000, 20 by area");
    }

    #[test]
    fn degenerate_shapes_have_samples_or_none() {
        for mesh in degenerate() {
            let samples = SurfaceSamples::new(&mesh, 100);
            assert_eq!(samples.positions.len(), samples.normals.len());
            assert!(samples.positions.iter().all(|position| position.is_finite()));
        }
    }
}
