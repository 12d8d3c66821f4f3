//! One triangle: where a ray meets it [Möller and Trumbore 1997] and its nearest point, by its Voronoi regions
//! [Ericson 2005, Section 5.1.5]. Any space; degenerate triangles are met by no ray and have a nearest point.

use glam::DVec3;

#[derive(Clone, Copy)]
pub struct Triangle {
    corner: DVec3,
    edge_1: DVec3,
    edge_2: DVec3,
}

/// Rays meet an edge from either side: a ray through an edge shared by two triangles never slips between them.
const EDGE_SLACK: f64 = 1e-9;

impl Triangle {
    pub fn new([a, b, c]: [DVec3; 3]) -> Self {
        Self { corner: a, edge_1: b - a, edge_2: c - a }
    }

    /// Where a ray meets the triangle, from either side, at `t` ≥ 0 lengths of the direction.
    pub fn ray(&self, origin: DVec3, direction: DVec3) -> Option<f64> {
        let across = direction.cross(self.edge_2);
        let determinant = self.edge_1.dot(across);
        if determinant == 0.0 {
            return None;
        }
        let inverse = determinant.recip();
        let from_corner = origin - self.corner;
        let u = from_corner.dot(across) * inverse;
        if !(-EDGE_SLACK..=1.0 + EDGE_SLACK).contains(&u) {
            return None;
        }
        let turned = from_corner.cross(self.edge_1);
        let v = direction.dot(turned) * inverse;
        if !(v >= -EDGE_SLACK && u + v <= 1.0 + EDGE_SLACK) {
            return None;
        }
        let t = self.edge_2.dot(turned) * inverse;
        (t >= 0.0).then_some(t)
    }

    /// Nearest point and its barycentric weights (corner, end of edge 1, end of edge 2).
    pub fn nearest(&self, point: DVec3) -> (DVec3, [f64; 3]) {
        let (ab, ac, ap) = (self.edge_1, self.edge_2, point - self.corner);
        let (d1, d2) = (ab.dot(ap), ac.dot(ap));
        let at = |v: f64, w: f64| (self.corner + ab * v + ac * w, [(1.0 - v - w).max(0.0), v, w]);
        if d1 <= 0.0 && d2 <= 0.0 {
            return at(0.0, 0.0);
        }
        let bp = ap - ab;
        let (d3, d4) = (ab.dot(bp), ac.dot(bp));
        if d3 >= 0.0 && d4 <= d3 {
            return at(1.0, 0.0);
        }
        let vc = d1 * d4 - d3 * d2;
        if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
            return at(d1 / (d1 - d3), 0.0);
        }
        let cp = ap - ac;
        let (d5, d6) = (ab.dot(cp), ac.dot(cp));
        if d6 >= 0.0 && d5 <= d6 {
            return at(0.0, 1.0);
        }
        let vb = d5 * d2 - d1 * d6;
        if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
            return at(0.0, d2 / (d2 - d6));
        }
        let va = d3 * d6 - d5 * d4;
        if va <= 0.0 && d4 >= d3 && d5 >= d6 {
            let w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
            return at(1.0 - w, w);
        }
        let all = va + vb + vc;
        if all > 0.0 { at(vb / all, vc / all) } else { at(0.0, 0.0) }
    }
}
