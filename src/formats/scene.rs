//! What OBJ, PLY, STL and FBX files hold besides their geometry, in glTF's conventions, ready to be written as GLB.
//!
//! Positions are not repeated here: each primitive vertex names the row of [`Asset::mesh`](super::Asset) that it copies.
//! That row index is the kept map from split vertices back to file vertices: skin weights are computed per row and
//! copied to every split, so seams never open.

use glam::{DMat4, DQuat, DVec3};

/// The parts of a file that its format calls objects, groups or meshes, and their looks.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// In file order; flat: all transforms are already in the positions.
    pub nodes: Vec<SceneNode>,
    pub materials: Vec<Material>,
    pub images: Vec<Image>,
    /// The skeleton that the file came with, where it is kept.
    pub skeleton: Option<SceneSkeleton>,
}

/// A node graph with joints, as the file has it: every node but those that only carry a mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneSkeleton {
    /// Parents before children, children in file order.
    pub nodes: Vec<SkeletonNode>,
    /// Index in `nodes` of each joint of the skin.
    pub joints: Vec<usize>,
    /// `[J]`: place in `joints` of each joint of the [`Skeleton`](crate::rig::Skeleton) that comes with it.
    pub places: Vec<Option<u32>>,
}

/// One node of a skeleton.
#[derive(Clone, Debug, PartialEq)]
pub struct SkeletonNode {
    pub name: String,
    pub parent: Option<usize>,
    /// Relative to the parent, in upload space's unit, as are the rotation and the scale.
    pub translation: DVec3,
    /// A unit quaternion.
    pub rotation: DQuat,
    pub scale: DVec3,
}

impl SkeletonNode {
    /// The transform to the parent's space.
    pub fn local(&self) -> DMat4 {
        DMat4::from_scale_rotation_translation(self.scale, self.rotation, self.translation)
    }
}

/// A transform of translation, rotation and scale comes back from its parts within this.
const SHEAR: f64 = 1e-4;
/// What is wrong with a transform that has no such parts.
pub(super) const SHEARED: &str = "its transform is not made of a translation, a rotation and a scale";

/// Scale, rotation and translation of a transform that is made of them.
pub(super) fn parts_of(local: &DMat4) -> Option<(DVec3, DQuat, DVec3)> {
    let (scale, rotation, translation) = local.to_scale_rotation_translation();
    let again = DMat4::from_scale_rotation_translation(scale, rotation, translation);
    let largest = local.to_cols_array().into_iter().map(f64::abs).fold(1.0, f64::max);
    (again.is_finite() && again.abs_diff_eq(*local, SHEAR * largest)).then_some((scale, rotation, translation))
}

/// One named mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneNode {
    pub name: String,
    /// One per material, in the order in which the file first uses them. None is empty.
    pub primitives: Vec<ScenePrimitive>,
}

/// Triangles of one material, over vertices that are split where normals, texture coordinates or colours differ.
///
/// W is the number of split vertices; every present attribute has W rows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ScenePrimitive {
    /// Index into [`Scene::materials`].
    pub material: Option<usize>,
    /// `[W]`, row of [`Asset::mesh`](super::Asset)'s positions that each split vertex copies.
    pub mesh_rows: Vec<u32>,
    /// `[W, 3]`, unit length, upload space.
    pub normals: Option<Vec<[f32; 3]>>,
    /// `[W, 2]`, glTF's convention: the origin is the image's upper left corner.
    pub texture_coordinates: Option<Vec<[f32; 2]>>,
    /// `[W, 4]`, linear RGBA, 0 to 1.
    pub colors: Option<Vec<[f32; 4]>>,
    /// `[F, 3]`, indices below W.
    pub triangles: Vec<[u32; 3]>,
}

/// A metallic-roughness material.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    pub name: String,
    /// Linear RGBA, 0 to 1.
    pub base_color: [f32; 4],
    /// Indices into [`Scene::images`], as all textures here.
    pub base_color_texture: Option<usize>,
    pub normal_texture: Option<usize>,
    pub metallic: f32,
    pub roughness: f32,
    /// Linear RGB, 0 to 1.
    pub emissive: [f32; 3],
    pub emissive_texture: Option<usize>,
    pub alpha: Alpha,
    pub double_sided: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Alpha {
    Opaque,
    Blend,
}

impl Material {
    pub fn is_textured(&self) -> bool {
        [self.base_color_texture, self.normal_texture, self.emissive_texture].iter().any(Option::is_some)
    }

    pub fn without_textures(&self) -> Self {
        Self { base_color_texture: None, normal_texture: None, emissive_texture: None, ..self.clone() }
    }
}

impl Default for Material {
    /// A plain, matt, non-metallic white, seen from both sides: OBJ and FBX know no culling.
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: [1.0; 4],
            base_color_texture: None,
            normal_texture: None,
            metallic: 0.0,
            roughness: 1.0,
            emissive: [0.0; 3],
            emissive_texture: None,
            alpha: Alpha::Opaque,
            double_sided: true,
        }
    }
}

/// A texture file as it was sent; never decoded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// File name without its folder.
    pub name: String,
    pub media_type: ImageType,
    pub bytes: Vec<u8>,
}

/// The image formats that glTF can hold without an extension, told by their first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageType {
    Png,
    Jpeg,
}

impl ImageType {
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Png => "image/png",
            Self::Jpeg => "image/jpeg",
        }
    }

    /// The type of an image file, `None` when glTF cannot hold it.
    pub fn of(bytes: &[u8]) -> Option<Self> {
        if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
            Some(Self::Png)
        } else if bytes.starts_with(&[0xff, 0xd8, 0xff]) {
            Some(Self::Jpeg)
        } else {
            None
        }
    }
}

/// The sRGB transfer function [IEC 61966-2-1], from a stored colour value to linear light.
pub(super) fn linear_from_srgb(value: f32) -> f32 {
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}
