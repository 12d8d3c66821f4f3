//! A picture of a rig, for people: from the front, from its left side, and in a pose, as one PNG.
//!
//! Each panel shows the shaded mesh in the colours of its skin weights (one colour per joint, blended as the weights
//! are) and the skeleton over it: bones as narrow kites from parent to child, joints as dots, the root as a ring. The
//! pose is [`pose::telling_pose`], applied by linear blend skinning, so that wrong weights show.
//!
//! | in         | shape        | space                                            |
//! |------------|--------------|--------------------------------------------------|
//! | `mesh`     | `[V]`, `[F]` | any; the picture is fitted to it                 |
//! | `rig`      | `[J]`, `[V]` | the mesh's                                       |
//!
//! Orthographic, software-rasterised with a depth buffer. Pure and the same on every machine up to the rounding of the
//! platform's square roots and sines.

mod canvas;
mod pose;

use crate::formats::{Axes, Axis};
use crate::mesh::Mesh;
use crate::rig::Rig;
use crate::rig::forward_kinematics::joint_transforms;
use crate::rig::linear_blend_skinning::posed_positions;
use canvas::{Canvas, Corner};
use glam::{DMat3, DQuat, DVec2, DVec3, Vec3};
use std::collections::HashMap;

/// How a preview is drawn.
#[derive(Clone, Copy, Debug)]
pub struct PreviewOptions {
    /// Which way the character stands and looks.
    pub axes: Axes,
    /// Size of the picture; its three panels share the width as their figures need it.
    pub width: u32,
    pub height: u32,
}

impl Default for PreviewOptions {
    fn default() -> Self {
        Self { axes: Axes { up: Axis::PosY, front: Axis::PosZ }, width: 1200, height: 600 }
    }
}

/// Every pixel is the mean of this many squared.
const SUPERSAMPLING: u32 = 3;
/// Free space on each side of a figure, as a share of the picture's height.
const MARGIN: f64 = 0.05;
/// Turn of the posed view about the vertical, and its tilt, in degrees: a three-quarter view from slightly above.
const POSED_YAW: f64 = -30.0;
const POSED_PITCH: f64 = 12.0;
/// Faces meeting at more than this angle keep their edge when shaded.
const CREASE_DEGREES: f64 = 50.0;

/// Linear light, not sRGB.
const BACKGROUND: Vec3 = Vec3::new(0.90, 0.91, 0.93);
const BONE: Vec3 = Vec3::new(0.98, 0.98, 0.98);
const OUTLINE: Vec3 = Vec3::new(0.015, 0.018, 0.025);
const ROOT: Vec3 = Vec3::new(0.95, 0.22, 0.02);

/// Draws `rig` over `mesh` and returns a PNG.
///
/// A vertex without a row of weights is drawn grey and at rest, so that a preview of a broken rig shows the break.
pub fn preview_png(mesh: &Mesh, rig: &Rig, options: &PreviewOptions) -> Vec<u8> {
    let frame = character_frame(options.axes);
    let joints: Vec<DVec3> = rig.skeleton.joints.iter().map(|joint| joint.position).collect();
    let rest = Figure::new(&mesh.positions, &joints, frame);
    let posed = posed(mesh, rig, frame, &pose::telling_pose(&rest.joints, &rig.skeleton));
    let colours = weight_colours(rig, mesh.positions.len());

    // Rows: what points right, up and to the viewer. The side view is taken from the character's left: it looks left.
    let side = DMat3::from_cols(DVec3::NEG_Z, DVec3::Y, DVec3::X).transpose();
    let quarter = DMat3::from_rotation_x(POSED_PITCH.to_radians()) * DMat3::from_rotation_y(POSED_YAW.to_radians());
    let views = [(&rest, DMat3::IDENTITY), (&rest, side), (&posed, quarter)];
    let figures = views.map(|(figure, view)| Figure::new(&figure.positions, &figure.joints, view));
    let (scale, widths) = layout(&figures, options);
    let panels: Vec<Canvas> = figures
        .iter()
        .zip(widths)
        .map(|(figure, width)| draw_panel(figure, mesh, rig, &colours, scale, (width, options.height)))
        .collect();
    canvas::png(&panels)
}

/// Pixels per unit, the same in all panels so that they can be compared, and the width of each panel.
fn layout(figures: &[Figure; 3], options: &PreviewOptions) -> (f64, [u32; 3]) {
    let margin = MARGIN * f64::from(options.height);
    let sizes = figures.each_ref().map(|figure| {
        let (low, high) = figure.bounds();
        (high - low).max(DVec3::splat(f64::MIN_POSITIVE.sqrt()))
    });
    let total_width: f64 = sizes.iter().map(|size| size.x).sum();
    let largest_height = sizes.iter().map(|size| size.y).fold(0.0, f64::max);
    let free_width = (f64::from(options.width) - 6.0 * margin).max(1.0);
    let free_height = (f64::from(options.height) - 2.0 * margin).max(1.0);
    let scale = (free_width / total_width).min(free_height / largest_height);

    let spare = (free_width - scale * total_width).max(0.0) / 3.0;
    let ends = [1, 2, 3].map(|count| {
        let figures_width: f64 = sizes[..count].iter().map(|size| scale * size.x + 2.0 * margin + spare).sum();
        (figures_width.round() as u32).min(options.width)
    });
    (scale, [ends[0], ends[1] - ends[0], options.width - ends[1]])
}

/// A mesh's vertices and joints in one space of the picture: x to the right, y up, z towards the viewer.
struct Figure {
    positions: Vec<DVec3>,
    joints: Vec<DVec3>,
}

impl Figure {
    fn new(positions: &[DVec3], joints: &[DVec3], view: DMat3) -> Figure {
        let through = |points: &[DVec3]| points.iter().map(|&point| view * point).collect();
        Figure { positions: through(positions), joints: through(joints) }
    }

    /// Lower and upper corner of everything that is drawn.
    fn bounds(&self) -> (DVec3, DVec3) {
        let everything = self.positions.iter().chain(&self.joints);
        let (low, high) = everything
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &point| (low.min(point), high.max(point)));
        if low.is_finite() && high.is_finite() { (low, high) } else { (DVec3::ZERO, DVec3::ONE) }
    }
}

/// The figure with its joints turned by `rotations` (in the character's own axes) and its vertices carried along.
fn posed(mesh: &Mesh, rig: &Rig, frame: DMat3, rotations: &[DQuat]) -> Figure {
    let to_frame = DQuat::from_mat3(&frame);
    let rotations: Vec<DQuat> = rotations.iter().map(|&turn| to_frame.inverse() * turn * to_frame).collect();
    let mut positions = posed_positions(&mesh.positions, &rig.skeleton, &rig.skin, &rotations);
    // A rig without a row for every vertex is drawn with the rest at rest.
    positions.extend(mesh.positions.iter().skip(positions.len()));
    let joints: Vec<DVec3> =
        joint_transforms(&rig.skeleton, &rotations).iter().map(|transform| transform.translation).collect();
    Figure::new(&positions, &joints, frame)
}

/// The rotation from upload space to the character's own axes: x to its left, y up, z to its front.
fn character_frame(axes: Axes) -> DMat3 {
    let (up, front) = (direction(axes.up), direction(axes.front));
    DMat3::from_cols(up.cross(front), up, front).transpose()
}

fn direction(axis: Axis) -> DVec3 {
    match axis {
        Axis::PosX => DVec3::X,
        Axis::NegX => DVec3::NEG_X,
        Axis::PosY => DVec3::Y,
        Axis::NegY => DVec3::NEG_Y,
        Axis::PosZ => DVec3::Z,
        Axis::NegZ => DVec3::NEG_Z,
    }
}

/// Each vertex in the mean of its joints' colours, by weight. `[V, 3]`
fn weight_colours(rig: &Rig, vertex_count: usize) -> Vec<Vec3> {
    let palette: Vec<Vec3> = (0..rig.skeleton.joints.len()).map(joint_colour).collect();
    let grey = Vec3::splat(0.35);
    let mut colours: Vec<Vec3> = rig
        .skin
        .rows
        .iter()
        .take(vertex_count)
        .map(|row| {
            let (sum, weight) = row.iter().fold((Vec3::ZERO, 0.0), |(sum, total), influence| {
                match palette.get(influence.joint as usize) {
                    Some(&colour) => (sum + colour * influence.weight, total + influence.weight),
                    None => (sum, total),
                }
            });
            if weight > 0.0 { sum / weight } else { grey }
        })
        .collect();
    colours.resize(vertex_count, grey);
    colours
}

/// A colour for joint `index`: the golden angle apart from its neighbours in hue, with three alternating tones, so that
/// joints next to each other in the skeleton differ.
fn joint_colour(index: usize) -> Vec3 {
    const GOLDEN_TURN: f64 = 0.381_966;
    let turn = (index as f64 * GOLDEN_TURN).fract();
    let (saturation, value) = [(0.62, 0.80), (0.50, 0.95), (0.72, 0.62)][index % 3];
    let channel = |offset: f64| {
        let distance = ((turn + offset).fract() * 6.0 - 3.0).abs() - 1.0;
        let srgb = value * (1.0 - saturation + saturation * distance.clamp(0.0, 1.0));
        (srgb as f32).powf(2.2)
    };
    Vec3::new(channel(1.0), channel(2.0 / 3.0), channel(1.0 / 3.0))
}

fn draw_panel(
    figure: &Figure,
    mesh: &Mesh,
    rig: &Rig,
    colours: &[Vec3],
    scale: f64,
    (width, height): (u32, u32),
) -> Canvas {
    let mut canvas = Canvas::new(width, height, SUPERSAMPLING, BACKGROUND);
    let (low, high) = figure.bounds();
    let middle = (low + high) / 2.0;
    let centre = DVec2::new(f64::from(width), f64::from(height)) / 2.0;
    let on_panel = |point: DVec3| {
        let offset = (point - middle) * scale;
        DVec3::new(centre.x + offset.x, centre.y - offset.y, offset.z)
    };

    let normals = corner_normals(&figure.positions, &mesh.triangles);
    for (triangle, normals) in mesh.triangles.iter().zip(&normals) {
        let corners = [0, 1, 2].map(|corner| {
            let vertex = triangle[corner] as usize;
            let light = brightness(normals[corner]);
            Corner { place: on_panel(figure.positions[vertex]), colour: colours[vertex] * light }
        });
        canvas.triangle(&corners);
    }
    let joints: Vec<DVec3> = figure.joints.iter().map(|&joint| on_panel(joint)).collect();
    draw_skeleton(&mut canvas, &joints, rig);
    canvas
}

/// Light on a surface seen with this normal: a key light from above left, the sky, and a little from everywhere. Both
/// sides of a surface are lit alike, since uploads are not always turned outwards.
fn brightness(normal: DVec3) -> f32 {
    let towards_viewer = if normal.z < 0.0 { -normal } else { normal };
    let key = towards_viewer.dot(DVec3::new(-0.45, 0.55, 0.70)).max(0.0);
    let sky = 0.5 + 0.5 * towards_viewer.y;
    let rim = 1.0 - 0.35 * (1.0 - towards_viewer.z).powi(3);
    ((0.16 + 0.70 * key + 0.26 * sky) * rim) as f32
}

/// A normal per corner of each triangle: the mean around the corner's position (across seams, where vertices are split),
/// or the triangle's own where that mean is past the crease. `[F, 3]`
fn corner_normals(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<[DVec3; 3]> {
    let key = |vertex: u32| positions[vertex as usize].to_array().map(f64::to_bits);
    let area_normal = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|vertex| positions[vertex as usize]);
        (b - a).cross(c - a)
    };
    let mut sums: HashMap<[u64; 3], DVec3> = HashMap::with_capacity(positions.len());
    for triangle in triangles {
        for &vertex in triangle {
            *sums.entry(key(vertex)).or_default() += area_normal(triangle);
        }
    }
    let crease = CREASE_DEGREES.to_radians().cos();
    triangles
        .iter()
        .map(|triangle| {
            let own = area_normal(triangle).normalize_or_zero();
            triangle.map(|vertex| {
                let mean = sums.get(&key(vertex)).copied().unwrap_or_default().normalize_or_zero();
                if mean.dot(own) > crease { mean } else { own }
            })
        })
        .collect()
}

/// Bones far to near, then joints, then the root, on top of the mesh: a skeleton is inside and would not be seen.
fn draw_skeleton(canvas: &mut Canvas, joints: &[DVec3], rig: &Rig) {
    let mut bones: Vec<(DVec3, DVec3)> = rig
        .skeleton
        .joints
        .iter()
        .zip(joints)
        .filter_map(|(joint, &child)| Some((*joints.get(joint.parent?)?, child)))
        .collect();
    bones.sort_by(|a, b| (a.0.z + a.1.z).total_cmp(&(b.0.z + b.1.z)));
    for (parent, child) in bones {
        canvas.kite(parent.truncate(), child.truncate(), BONE, OUTLINE);
    }
    for joint in joints {
        canvas.dot(joint.truncate(), 2.6, OUTLINE);
        canvas.dot(joint.truncate(), 1.5, BONE);
    }
    for (joint, place) in rig.skeleton.joints.iter().zip(joints) {
        if joint.parent.is_none() {
            canvas.dot(place.truncate(), 6.0, OUTLINE);
            canvas.dot(place.truncate(), 5.0, ROOT);
            canvas.dot(place.truncate(), 2.0, BONE);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::{Influence, Joint, Skeleton, SkinWeights};

    fn tetrahedron_on_two_joints() -> (Mesh, Rig) {
        let positions = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let triangles = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let joint = |name: &str, parent, position| Joint { name: name.to_owned(), parent, position };
        let joints = vec![joint("root", None, DVec3::ZERO), joint("tip", Some(0), DVec3::Y)];
        let row = |joint| vec![Influence { joint, weight: 1.0 }];
        let rows = vec![row(0), row(0), row(1), row(0)];
        (Mesh { positions, triangles }, Rig { skeleton: Skeleton { joints }, skin: SkinWeights { rows } })
    }

    fn pixels(bytes: &[u8]) -> (u32, u32, Vec<u8>) {
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().expect("a PNG");
        let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
        let info = reader.next_frame(&mut pixels).expect("a frame");
        (info.width, info.height, pixels)
    }

    #[test]
    fn a_preview_is_a_png_of_the_asked_size_with_something_on_it() {
        let (mesh, rig) = tetrahedron_on_two_joints();
        let options = PreviewOptions { width: 300, height: 150, ..PreviewOptions::default() };
        let (width, height, pixels) = pixels(&preview_png(&mesh, &rig, &options));
        assert_eq!((width, height), (300, 150));
        let background = &pixels[..3];
        let drawn = pixels.chunks_exact(3).filter(|pixel| *pixel != background).count();
        assert!(drawn > 300 * 150 / 20, "{drawn} pixels differ from the background");
    }

    #[test]
    fn joints_next_to_each_other_have_different_colours() {
        for index in 0..99 {
            let distance = joint_colour(index).distance(joint_colour(index + 1));
            assert!(distance > 0.2, "joints {index} and {}: {distance}", index + 1);
        }
    }

    #[test]
    fn turning_the_character_and_its_axes_leaves_the_picture_as_it_was() {
        let (mesh, rig) = tetrahedron_on_two_joints();
        let options = PreviewOptions { width: 240, height: 120, ..PreviewOptions::default() };
        // y up and z front becomes z up and -y front.
        let turn = |point: DVec3| DVec3::new(point.x, -point.z, point.y);
        let mut turned = (mesh.clone(), rig.clone());
        turned.0.positions.iter_mut().for_each(|position| *position = turn(*position));
        turned.1.skeleton.joints.iter_mut().for_each(|joint| joint.position = turn(joint.position));
        let axes = Axes { up: Axis::PosZ, front: Axis::NegY };
        let picture = preview_png(&mesh, &rig, &options);
        assert_eq!(picture, preview_png(&turned.0, &turned.1, &PreviewOptions { axes, ..options }));
    }

    #[test]
    fn a_rig_with_gaps_and_no_mesh_at_all_are_still_drawn() {
        let (mesh, mut rig) = tetrahedron_on_two_joints();
        rig.skin.rows.truncate(2);
        assert!(!preview_png(&mesh, &rig, &PreviewOptions::default()).is_empty());
        assert!(!preview_png(&Mesh::default(), &Rig::default(), &PreviewOptions::default()).is_empty());
    }
}
