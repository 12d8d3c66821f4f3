//! From polygons with separate indices per corner to triangles over split vertices.
//!
//! Corners that share mesh row, normal, texture coordinate and colour become one split vertex. Splits are ordered by mesh
//! row, then by first use, so the output keeps the file's vertex order and is the same each time.

use super::polygon::triangulate;
use super::scene::{Scene, SceneNode, ScenePrimitive};
use super::soundness::check_counts;
use super::{DecodeError, Finding, Limits, Severity};
use glam::{DVec3, Vec3};
use std::collections::HashMap;

/// "This corner has none", in place of an attribute index.
pub(super) const NONE: u32 = u32::MAX;

/// One corner of a polygon: a row of the mesh, and rows of the [`Attributes`] or [`NONE`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Corner {
    pub(super) mesh_row: u32,
    pub(super) normal: u32,
    pub(super) texture_coordinate: u32,
    pub(super) color: u32,
}

/// What corners refer to; in the conventions of [`ScenePrimitive`], but not checked yet.
#[derive(Clone, Debug, Default)]
pub(super) struct Attributes {
    pub(super) normals: Vec<Vec3>,
    pub(super) texture_coordinates: Vec<[f32; 2]>,
    pub(super) colors: Vec<[f32; 4]>,
}

/// Collects polygons; makes the mesh's triangles and the scene's nodes.
pub(super) struct SceneBuilder<'a> {
    limits: &'a Limits,
    node_names: Vec<String>,
    primitives: Vec<Primitive>,
    primitive_of: HashMap<(usize, Option<usize>), usize>,
    triangles: Vec<[u32; 3]>,
    line_or_point_polygons: usize,
    repaired_normals: usize,
    dropped_normals: usize,
    repaired_values: usize,
}

struct Primitive {
    node: usize,
    material: Option<usize>,
    split_of: HashMap<Corner, u32>,
    corners: Vec<Corner>,
    triangles: Vec<[u32; 3]>,
}

impl<'a> SceneBuilder<'a> {
    pub(super) fn new(limits: &'a Limits) -> Self {
        Self {
            limits,
            node_names: Vec::new(),
            primitives: Vec::new(),
            primitive_of: HashMap::new(),
            triangles: Vec::new(),
            line_or_point_polygons: 0,
            repaired_normals: 0,
            dropped_normals: 0,
            repaired_values: 0,
        }
    }

    /// Starts a node and returns its index for [`Self::add_polygon`].
    pub(super) fn add_node(&mut self, name: String) -> Result<usize, DecodeError> {
        let (found, limit) = (self.node_names.len() as u64 + 1, self.limits.nodes_max as u64);
        if found > limit {
            return Err(DecodeError::TooMany { what: "nodes", found, limit });
        }
        self.node_names.push(name);
        Ok(self.node_names.len() - 1)
    }

    /// Adds one polygon. Its mesh rows must be rows of `positions`; the decoder has checked them.
    pub(super) fn add_polygon(
        &mut self,
        node: usize,
        material: Option<usize>,
        corners: &[Corner],
        positions: &[DVec3],
    ) -> Result<(), DecodeError> {
        if corners.len() < 3 {
            self.line_or_point_polygons += 1;
            return Ok(());
        }
        check_counts(0, (self.triangles.len() + corners.len() - 2) as u64, self.limits)?;
        let points: Vec<DVec3> = corners.iter().map(|corner| positions[corner.mesh_row as usize]).collect();
        let primitive = self.primitive(node, material);
        let splits: Vec<u32> = corners.iter().map(|&corner| self.primitives[primitive].split(corner)).collect();
        for triangle in triangulate(&points) {
            self.triangles.push(triangle.map(|corner| corners[corner].mesh_row));
            self.primitives[primitive].triangles.push(triangle.map(|corner| splits[corner]));
        }
        Ok(())
    }

    fn primitive(&mut self, node: usize, material: Option<usize>) -> usize {
        *self.primitive_of.entry((node, material)).or_insert_with(|| {
            let (split_of, corners, triangles) = Default::default();
            self.primitives.push(Primitive { node, material, split_of, corners, triangles });
            self.primitives.len() - 1
        })
    }

    /// The mesh's triangles in file order, the nodes that have any, and what was noticed. Materials and images are the
    /// caller's to add.
    pub(super) fn finish(
        mut self,
        attributes: &Attributes,
        positions: &[DVec3],
    ) -> (Vec<[u32; 3]>, Scene, Vec<Finding>) {
        let mut nodes: Vec<SceneNode> = std::mem::take(&mut self.node_names)
            .into_iter()
            .map(|name| SceneNode { name, primitives: Vec::new() })
            .collect();
        for primitive in std::mem::take(&mut self.primitives) {
            let node = primitive.node;
            nodes[node].primitives.push(self.finish_primitive(primitive, attributes, positions));
        }
        nodes.retain(|node| !node.primitives.is_empty());
        let findings = self.findings();
        (self.triangles, Scene { nodes, ..Scene::default() }, findings)
    }

    fn finish_primitive(
        &mut self,
        primitive: Primitive,
        attributes: &Attributes,
        positions: &[DVec3],
    ) -> ScenePrimitive {
        let (corners, triangles) = primitive.in_mesh_order();
        let has_normals = corners.iter().filter(|corner| corner.normal != NONE).count();
        let normals = (has_normals > 0 && has_normals == corners.len())
            .then(|| self.normals(&corners, &triangles, attributes, positions));
        if has_normals > 0 && normals.is_none() {
            self.dropped_normals += 1;
        }
        let repaired = &mut self.repaired_values;
        let mut finite = |value: f32| {
            *repaired += usize::from(!value.is_finite());
            if value.is_finite() { value } else { 0.0 }
        };
        let texture_coordinates = corners.iter().any(|corner| corner.texture_coordinate != NONE).then(|| {
            let of = |corner: &Corner| attributes.texture_coordinates.get(corner.texture_coordinate as usize);
            corners.iter().map(|corner| of(corner).copied().unwrap_or_default().map(&mut finite)).collect()
        });
        let colors = corners.iter().any(|corner| corner.color != NONE).then(|| {
            let of = |corner: &Corner| attributes.colors.get(corner.color as usize).copied().unwrap_or([1.0; 4]);
            corners.iter().map(|corner| of(corner).map(|value| finite(value).clamp(0.0, 1.0))).collect()
        });
        let mesh_rows = corners.iter().map(|corner| corner.mesh_row).collect();
        ScenePrimitive { material: primitive.material, mesh_rows, normals, texture_coordinates, colors, triangles }
    }

    /// Unit normals `[W, 3]`; one that is zero or not finite becomes the mean of its triangles' normals by area.
    fn normals(
        &mut self,
        corners: &[Corner],
        triangles: &[[u32; 3]],
        attributes: &Attributes,
        positions: &[DVec3],
    ) -> Vec<[f32; 3]> {
        let given = |corner: &Corner| {
            let normal = attributes.normals.get(corner.normal as usize).copied().unwrap_or_default();
            normal.as_dvec3().try_normalize().filter(|normal| normal.is_finite())
        };
        let mut normals: Vec<Option<DVec3>> = corners.iter().map(given).collect();
        if normals.iter().any(Option::is_none) {
            let mut sums = vec![DVec3::ZERO; corners.len()];
            for triangle in triangles {
                let [a, b, c] = triangle.map(|split| positions[corners[split as usize].mesh_row as usize]);
                for split in triangle {
                    sums[*split as usize] += (b - a).cross(c - a);
                }
            }
            for (normal, sum) in normals.iter_mut().zip(sums).filter(|(normal, _)| normal.is_none()) {
                *normal = Some(sum.try_normalize().filter(|normal| normal.is_finite()).unwrap_or(DVec3::Y));
                self.repaired_normals += 1;
            }
        }
        normals.into_iter().map(|normal| normal.unwrap_or(DVec3::Y).as_vec3().to_array()).collect()
    }

    fn findings(&self) -> Vec<Finding> {
        let counted = [
            ("faces_without_area", self.line_or_point_polygons, "lines or points among the faces were left out"),
            ("repaired_normals", self.repaired_normals, "normals of no length were replaced by those of their faces"),
            (
                "dropped_normals",
                self.dropped_normals,
                "primitives have normals at some corners only; theirs were left out",
            ),
            ("repaired_values", self.repaired_values, "texture coordinates or colours were not numbers and became 0"),
        ];
        let found = counted.into_iter().filter(|(_, count, _)| *count > 0);
        found
            .map(|(code, count, message)| Finding {
                code,
                parts: Vec::new(),
                severity: Severity::Info,
                message: format!("{count} {message}"),
                hint: String::new(),
            })
            .collect()
    }
}

impl Primitive {
    fn split(&mut self, corner: Corner) -> u32 {
        *self.split_of.entry(corner).or_insert_with(|| {
            self.corners.push(corner);
            self.corners.len() as u32 - 1
        })
    }

    /// Corners by mesh row, then by first use; triangles over them.
    fn in_mesh_order(&self) -> (Vec<Corner>, Vec<[u32; 3]>) {
        let mut order: Vec<u32> = (0..self.corners.len() as u32).collect();
        order.sort_by_key(|&split| self.corners[split as usize].mesh_row);
        let mut place = vec![0; order.len()];
        for (new, &old) in order.iter().enumerate() {
            place[old as usize] = new as u32;
        }
        let corners = order.iter().map(|&split| self.corners[split as usize]).collect();
        let triangles = self.triangles.iter().map(|triangle| triangle.map(|split| place[split as usize])).collect();
        (corners, triangles)
    }
}
