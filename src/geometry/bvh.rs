//! A bounding volume hierarchy over the triangles of a mesh: ray hits and nearest surface points.
//! Binned surface-area heuristic [Wald 2007].
//!
//! | in     | shape              | unit                |
//! |--------|--------------------|---------------------|
//! | `mesh` | `[V, 3]`, `[F, 3]` | any space, finite   |
//!
//! Bounds are single precision rounded outward, triangles double precision, so no hit is lost to rounding of bounds.

use super::triangle::Triangle;
use crate::mesh::Mesh;
use glam::DVec3;

/// The hierarchy and a copy of the triangles in its order. Both sides of a triangle count.
pub struct Bvh {
    nodes: Vec<Node>,
    triangles: Vec<Triangle>,
    /// `[F]`: index in the mesh of each triangle here.
    index_in_mesh: Vec<u32>,
}

/// Where a ray first meets the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    pub triangle: u32,
    /// In lengths of the direction.
    pub t: f64,
}

/// A place on the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    pub triangle: u32,
    pub position: DVec3,
    /// Weights of the triangle's corners, in its order; not negative, sum 1.
    pub barycentric: [f64; 3],
    pub distance: f64,
}

/// Bounds, and either two children (`count` 0, at `first` and `first + 1`) or `count` triangles from `first`.
#[derive(Clone, Copy)]
struct Node {
    low: [f32; 3],
    high: [f32; 3],
    first: u32,
    count: u32,
}

/// Leaves hold at most this many triangles (more only where they all lie at one place).
const LEAF_MAX: usize = 4;
const BINS: usize = 12;
/// From this depth on nodes are halved by count, which bounds the depth by this plus log2 F.
const DEPTH_SAH: u32 = 30;
const STACK: usize = 64;
impl Bvh {
    pub fn new(mesh: &Mesh) -> Self {
        let mut items: Vec<Item> = (0..mesh.triangles.len()).map(|index| Item::new(mesh, index)).collect();
        let mut nodes = Vec::with_capacity(mesh.triangles.len());
        if !items.is_empty() {
            nodes.push(Node { low: [0.0; 3], high: [0.0; 3], first: 0, count: 0 });
            let mut work = vec![(0usize, 0usize, items.len(), 0u32)];
            // Each turn makes one node; a tree over F triangles has fewer than 2 F.
            while let Some((node, start, end, depth)) = work.pop() {
                let (low, high) = bounds(&items[start..end]);
                let middle = start + split(&mut items[start..end], depth);
                let (first, count) = if middle > start && middle < end {
                    let children = nodes.len();
                    nodes.extend([Node { low, high, first: 0, count: 0 }; 2]);
                    work.push((children + 1, middle, end, depth + 1));
                    work.push((children, start, middle, depth + 1));
                    (children, 0)
                } else {
                    (start, end - start)
                };
                nodes[node] = Node { low, high, first: first as u32, count: count as u32 };
            }
        }
        let triangles = items.iter().map(|item| Triangle::new(mesh.corners(item.index as usize)));
        Self { nodes, triangles: triangles.collect(), index_in_mesh: items.iter().map(|item| item.index).collect() }
    }

    /// Whether the ray meets the surface at a `t` from 0 to `t_max` (in lengths of `direction`).
    pub fn any_hit(&self, origin: DVec3, direction: DVec3, t_max: f64) -> bool {
        let mut found = false;
        self.along_ray(origin, direction, t_max, |_, _| {
            found = true;
            f64::NEG_INFINITY
        });
        found
    }

    /// The nearest place where the ray meets the surface; at equal distances the lowest triangle of the mesh.
    pub fn first_hit(&self, origin: DVec3, direction: DVec3) -> Option<Hit> {
        self.first_hit_among(origin, direction, |_| true)
    }

    /// [`Self::first_hit`] with those triangles of the mesh alone that `counts` lets count.
    pub fn first_hit_among(&self, origin: DVec3, direction: DVec3, counts: impl Fn(u32) -> bool) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        self.along_ray(origin, direction, f64::INFINITY, |triangle, t| {
            if best.is_none_or(|hit| (t, triangle) < (hit.t, hit.triangle)) && counts(triangle) {
                best = Some(Hit { triangle, t });
            }
            best.map_or(f64::INFINITY, |hit| hit.t)
        });
        best
    }

    /// Calls `on_hit(triangle, t)` for hits with 0 ≤ t ≤ limit; it returns the new limit.
    fn along_ray(&self, origin: DVec3, direction: DVec3, t_max: f64, mut on_hit: impl FnMut(u32, f64) -> f64) {
        let inverse = direction.recip();
        let mut limit = t_max;
        let mut stack = [(0u32, 0.0f64); STACK];
        let mut depth = 0;
        if let Some(root) = self.nodes.first() {
            stack[0] = (0, root.entry(origin, inverse));
            depth = 1;
        }
        while depth > 0 {
            depth -= 1;
            let (index, entry) = stack[depth];
            if entry > limit {
                continue;
            }
            let node = &self.nodes[index as usize];
            let first = node.first as usize;
            if node.count > 0 {
                for at in first..first + node.count as usize {
                    if let Some(t) = self.triangles[at].ray(origin, direction)
                        && t <= limit
                    {
                        limit = on_hit(self.index_in_mesh[at], t);
                    }
                }
                continue;
            }
            let left = (first as u32, self.nodes[first].entry(origin, inverse));
            let right = (first as u32 + 1, self.nodes[first + 1].entry(origin, inverse));
            let (near, far) = if left.1 <= right.1 { (left, right) } else { (right, left) };
            for child in [far, near] {
                if child.1 <= limit {
                    stack[depth] = child;
                    depth += 1;
                }
            }
        }
    }

    /// The surface point nearest to `point`; `None` without triangles.
    pub fn nearest_point(&self, point: DVec3) -> Option<SurfacePoint> {
        self.nearest_point_where(point, f64::INFINITY, |_| true)
    }

    /// The nearest surface point within `distance_max` on a triangle (index in the mesh) that `accept`s; at equal
    /// distances the lowest triangle.
    pub fn nearest_point_where(
        &self,
        point: DVec3,
        distance_max: f64,
        mut accept: impl FnMut(u32) -> bool,
    ) -> Option<SurfacePoint> {
        let mut best: Option<(f64, u32, DVec3, [f64; 3])> = None;
        let mut limit = distance_max * distance_max;
        let mut stack = [(0u32, 0.0f64); STACK];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let (index, squared) = stack[depth];
            if squared > limit {
                continue;
            }
            let node = &self.nodes[index as usize];
            let first = node.first as usize;
            if node.count > 0 {
                for at in first..first + node.count as usize {
                    let (position, barycentric) = self.triangles[at].nearest(point);
                    let squared = position.distance_squared(point);
                    let triangle = self.index_in_mesh[at];
                    let better = best.is_none_or(|(d, t, ..)| (squared, triangle) < (d, t));
                    if squared <= limit && better && accept(triangle) {
                        best = Some((squared, triangle, position, barycentric));
                        limit = squared;
                    }
                }
                continue;
            }
            let left = (first as u32, self.nodes[first].distance_squared(point));
            let right = (first as u32 + 1, self.nodes[first + 1].distance_squared(point));
            let (near, far) = if left.1 <= right.1 { (left, right) } else { (right, left) };
            for child in [far, near] {
                if child.1 <= limit {
                    stack[depth] = child;
                    depth += 1;
                }
            }
        }
        best.map(|(squared, triangle, position, barycentric)| SurfacePoint {
            triangle,
            position,
            barycentric,
            distance: squared.sqrt(),
        })
    }
}

/// A triangle while the tree is built.
struct Item {
    low: DVec3,
    high: DVec3,
    index: u32,
}

impl Item {
    fn new(mesh: &Mesh, index: usize) -> Self {
        let [a, b, c] = mesh.corners(index);
        Self { low: a.min(b).min(c), high: a.max(b).max(c), index: index as u32 }
    }

    fn centre(&self) -> DVec3 {
        self.low * 0.5 + self.high * 0.5
    }
}

fn bounds(items: &[Item]) -> ([f32; 3], [f32; 3]) {
    let low = items.iter().fold(DVec3::INFINITY, |low, item| low.min(item.low));
    let high = items.iter().fold(DVec3::NEG_INFINITY, |high, item| high.max(item.high));
    (low.to_array().map(|value| (value as f32).next_down()), high.to_array().map(|value| (value as f32).next_up()))
}

/// Partitions `items` at the cheapest of the bins' borders; returns the size of the first part, 0 for a leaf.
fn split(items: &mut [Item], depth: u32) -> usize {
    let count = items.len();
    if count <= LEAF_MAX {
        return 0;
    }
    let low = items.iter().fold(DVec3::INFINITY, |low, item| low.min(item.centre()));
    let high = items.iter().fold(DVec3::NEG_INFINITY, |high, item| high.max(item.centre()));
    let axis = (high - low).max_position();
    let extent = (high - low)[axis];
    if !(extent > 0.0 && extent.is_finite()) || depth >= DEPTH_SAH {
        items.sort_unstable_by(|a, b| a.centre()[axis].total_cmp(&b.centre()[axis]).then(a.index.cmp(&b.index)));
        return count / 2;
    }
    let bin = |item: &Item| ((((item.centre()[axis] - low[axis]) / extent) * BINS as f64) as usize).min(BINS - 1);
    let mut boxes = [(DVec3::INFINITY, DVec3::NEG_INFINITY, 0usize); BINS];
    for item in items.iter() {
        let (low, high, inside) = &mut boxes[bin(item)];
        (*low, *high, *inside) = (low.min(item.low), high.max(item.high), *inside + 1);
    }
    let cost_after = |boxes: &mut dyn Iterator<Item = (DVec3, DVec3, usize)>| {
        let mut all = (DVec3::INFINITY, DVec3::NEG_INFINITY, 0usize);
        let mut costs = [0.0; BINS];
        for (cost, (low, high, inside)) in costs.iter_mut().zip(boxes) {
            all = (all.0.min(low), all.1.max(high), all.2 + inside);
            let size = (all.1 - all.0).max(DVec3::ZERO);
            *cost = all.2 as f64 * (size.x * size.y + size.y * size.z + size.z * size.x);
        }
        costs
    };
    let from_left = cost_after(&mut boxes.iter().copied());
    let from_right = cost_after(&mut boxes.iter().rev().copied());
    let cost = |border: usize| from_left[border - 1] + from_right[BINS - 1 - border];
    let border = (1..BINS).min_by(|&a, &b| cost(a).total_cmp(&cost(b))).unwrap_or(BINS / 2);
    // Order-preserving, so the tree does not depend on how a partition swaps.
    items.sort_by_key(|item| bin(item) >= border);
    items.partition_point(|item| bin(item) < border)
}

impl Node {
    /// Where the ray enters the box, at least 0; infinite when it misses.
    fn entry(&self, origin: DVec3, inverse: DVec3) -> f64 {
        let (mut near, mut far) = (0.0f64, f64::INFINITY);
        for axis in 0..3 {
            let at_low = (f64::from(self.low[axis]) - origin[axis]) * inverse[axis];
            let at_high = (f64::from(self.high[axis]) - origin[axis]) * inverse[axis];
            // min and max ignore NaN (0 · ∞: the ray runs inside a wall of the box).
            near = near.max(at_low.min(at_high));
            far = far.min(at_low.max(at_high));
        }
        if near <= far { near } else { f64::INFINITY }
    }

    fn distance_squared(&self, point: DVec3) -> f64 {
        (0..3).fold(0.0, |sum, axis| {
            let outside =
                (f64::from(self.low[axis]) - point[axis]).max(point[axis] - f64::from(self.high[axis])).max(0.0);
            sum + outside * outside
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::{degenerate, sphere, torus};
    use proptest::prelude::*;

    fn brute_first(mesh: &Mesh, origin: DVec3, direction: DVec3) -> Option<f64> {
        let hits =
            (0..mesh.triangles.len()).filter_map(|face| Triangle::new(mesh.corners(face)).ray(origin, direction));
        hits.min_by(f64::total_cmp)
    }

    proptest! {
        #[test]
        fn rays_and_nearest_points_agree_with_all_triangles(
            from in prop::array::uniform3(-1.0..1.0f64), to in prop::array::uniform3(-1.0..1.0f64), ring in any::<bool>(),
        ) {
            let mesh = if ring { torus(0.5, 0.2, 24) } else { sphere(DVec3::ZERO, 0.6, 24) };
            let surface = Bvh::new(&mesh);
            let (from, direction) = (DVec3::from(from), DVec3::from(to) - DVec3::from(from));
            let first = brute_first(&mesh, from, direction);
            prop_assert_eq!(surface.first_hit(from, direction).map(|hit| hit.t), first);
            for limit in [0.1, 0.5, 1.0, 5.0] {
                prop_assert_eq!(surface.any_hit(from, direction, limit), first.is_some_and(|t| t <= limit));
            }
            let nearest = surface.nearest_point(from).unwrap();
            let all = (0..mesh.triangles.len()).map(|face| Triangle::new(mesh.corners(face)).nearest(from).0.distance(from));
            prop_assert!((nearest.distance - all.fold(f64::INFINITY, f64::min)).abs() < 1e-15);
            let corners = mesh.corners(nearest.triangle as usize);
            let blended: DVec3 = corners.iter().zip(nearest.barycentric).map(|(&corner, weight)| corner * weight).sum();
            prop_assert!(blended.distance(nearest.position) < 1e-12);
            prop_assert!((nearest.barycentric.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn rays_through_shared_edges_and_corners_are_stopped() {
        let mesh = sphere(DVec3::ZERO, 0.5, 16);
        let surface = Bvh::new(&mesh);
        for &[a, b, c] in &mesh.triangles {
            let [a, b, c] = [a, b, c].map(|corner| mesh.positions[corner as usize]);
            for target in [a, (a + b) * 0.5, (b + c) * 0.5, (c + a) * 0.5] {
                assert!(surface.any_hit(DVec3::new(0.01, 0.02, 0.03), target - DVec3::new(0.01, 0.02, 0.03), 1.1));
            }
        }
    }

    #[test]
    fn degenerate_meshes_are_searched_without_harm() {
        for mesh in degenerate() {
            let surface = Bvh::new(&mesh);
            for origin in [DVec3::ZERO, DVec3::splat(0.2), DVec3::splat(1e200)] {
                surface.first_hit(origin, DVec3::X);
                surface.any_hit(origin, DVec3::ZERO, 1.0);
                let nearest = surface.nearest_point(origin);
                assert!(nearest.is_none() || !mesh.triangles.is_empty());
            }
        }
        let one_place = Mesh { positions: vec![DVec3::ZERO; 3], triangles: vec![[0, 1, 2]; 10_000] };
        assert!(Bvh::new(&one_place).nearest_point(DVec3::X).is_some());
    }
}
