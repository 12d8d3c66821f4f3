//! What is asked of weights after a method has made them: smoothing, pruning, and both sides alike.

use super::metamorphic::{character, models};
use super::program::{rigsmith, sample, stderr};
use super::shapes::{joined, tube};
use super::skin::chain;
use glam::{DMat3, DVec3};
use rigsmith::cancellation::Cancellation;
use rigsmith::mesh::Mesh;
use rigsmith::pipelines::{RigOptions, Rigged, SkinMethod, Subject, Symmetry, Watch, skin};
use rigsmith::rig::{Joint, Skeleton, SkinWeights};

fn weighed(mesh: &Mesh, skeleton: &Skeleton, options: &RigOptions) -> Rigged {
    let cancellation = Cancellation::default();
    let watch = Watch { cancellation: &cancellation, on_stage: &|_| {} };
    skin(Subject { mesh, to_upright: DMat3::IDENTITY }, skeleton, models(), options, watch).expect("weighed")
}

fn joint(name: &str, parent: Option<usize>, position: [f64; 3]) -> Joint {
    Joint { name: name.to_owned(), parent, position: position.into() }
}

fn weight(skin: &SkinWeights, vertex: usize, joint: u32) -> f32 {
    skin.rows[vertex].iter().find(|influence| influence.joint == joint).map_or(0.0, |influence| influence.weight)
}

fn spine() -> Skeleton {
    let (low, high) = character().bounding_box().expect("has vertices");
    let middle = (low + high) / 2.0;
    chain(&[0.2, 0.45, 0.7, 0.9].map(|share| DVec3::new(middle.x, low.y + share * (high.y - low.y), middle.z)))
}

/// Steps of weights along edges, squared and added up: the same change over more edges counts less.
#[test]
fn stronger_smoothing_makes_weights_smoother() {
    let steps = [0.0, 0.3, 1.0].map(|smooth| {
        let options = RigOptions { smooth, skin_method: SkinMethod::GeodesicVoxel, ..RigOptions::default() };
        let skin = weighed(character(), &spine(), &options).rig.skin;
        let step = |a: u32, b: u32| -> f32 {
            (0..4).map(|joint| (weight(&skin, a as usize, joint) - weight(&skin, b as usize, joint)).powi(2)).sum()
        };
        character().triangles.iter().map(|&[a, b, c]| step(a, b) + step(b, c) + step(c, a)).sum::<f32>()
    });
    assert!(steps[1] < 0.9 * steps[0] && steps[2] < 0.8 * steps[1], "{steps:?}");
}

/// Two posts a finger's width apart, each with bones of its own: whatever the smoothing, nothing runs over.
#[test]
fn smoothing_crosses_no_gap() {
    let post = |x: f64| tube(DVec3::new(x, 0.0, 0.0), DVec3::new(x, 1.0, 0.0), [0.1; 2], 24, 30);
    let (mesh, starts) = joined(&[post(-0.105), post(0.105)]);
    let skeleton = Skeleton {
        joints: vec![
            joint("root", None, [0.0, -0.1, 0.0]),
            joint("left", Some(0), [0.105, 0.05, 0.0]),
            joint("left_top", Some(1), [0.105, 0.5, 0.0]),
            joint("right", Some(0), [-0.105, 0.05, 0.0]),
            joint("right_top", Some(3), [-0.105, 0.5, 0.0]),
        ],
    };
    let of = |smooth| {
        let options = RigOptions {
            smooth,
            prune: 0.0,
            max_influences: 8,
            skin_method: SkinMethod::GeodesicVoxel,
            ..RigOptions::default()
        };
        weighed(&mesh, &skeleton, &options).rig.skin
    };
    let (plain, smoothed) = (of(0.0), of(1.0));
    assert_ne!(plain, smoothed);
    for joint in 0..5 {
        let greatest = |skin: &SkinWeights, vertices: std::ops::Range<usize>| {
            vertices.map(|vertex| weight(skin, vertex, joint)).fold(0.0, f32::max)
        };
        for vertices in [starts[0]..starts[1], starts[1]..mesh.positions.len()] {
            let (before, after) = (greatest(&plain, vertices.clone()), greatest(&smoothed, vertices));
            assert!(before > 0.0 || after == 0.0, "joint {joint} reached a post that it had no part in: {after}");
        }
    }
}

#[test]
fn pruning_leaves_no_weight_below_its_share_and_no_vertex_empty() {
    let of = |prune| {
        let options = RigOptions { prune, smooth: 1.0, max_influences: 8, ..RigOptions::default() };
        weighed(character(), &spine(), &options).rig.skin
    };
    let least = |skin: &SkinWeights| skin.rows.iter().flatten().map(|influence| influence.weight).fold(1.0, f32::min);
    let (little, much) = (of(0.001), of(0.2));
    assert!(least(&little) < 0.05 && least(&much) >= 0.2, "{} {}", least(&little), least(&much));
    assert!(much.rows.iter().all(|row| !row.is_empty()));
}

/// A trunk with two arms, its own mirror image vertex for vertex.
fn symmetric_figure() -> (Mesh, Skeleton, Vec<u32>) {
    let arm =
        |side: f64| tube(DVec3::new(0.1 * side, 0.8, 0.0), DVec3::new(0.5 * side, 0.75, 0.02), [0.05, 0.04], 16, 24);
    let left = arm(1.0);
    let right = Mesh {
        positions: left.positions.iter().map(|place| place * DVec3::new(-1.0, 1.0, 1.0)).collect(),
        triangles: left.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect(),
    };
    let trunk = tube(DVec3::ZERO, DVec3::Y, [0.16, 0.14], 24, 30);
    let (mesh, _) = joined(&[trunk, left, right]);
    let skeleton = Skeleton {
        joints: vec![
            joint("hips", None, [0.0, 0.1, 0.0]),
            joint("chest", Some(0), [0.0, 0.6, 0.0]),
            joint("head", Some(1), [0.0, 0.9, 0.0]),
            joint("arm_l", Some(1), [0.12, 0.8, 0.0]),
            joint("hand_l", Some(3), [0.35, 0.77, 0.01]),
            joint("arm_r", Some(1), [-0.12, 0.8, 0.0]),
            joint("hand_r", Some(5), [-0.35, 0.77, 0.01]),
        ],
    };
    (mesh, skeleton, vec![0, 1, 2, 5, 6, 3, 4])
}

/// The greatest difference between a weight and that of the twin joint at the twin vertex.
fn asymmetry(mesh: &Mesh, skin: &SkinWeights, twins: &[u32]) -> f32 {
    let mirror = |place: DVec3| place * DVec3::new(-1.0, 1.0, 1.0);
    let mut greatest: f32 = 0.0;
    for (vertex, &place) in mesh.positions.iter().enumerate() {
        let twin = mesh.positions.iter().position(|other| other.distance(mirror(place)) < 1e-9).expect("a twin");
        for (joint, &twin_joint) in (0..).zip(twins) {
            greatest = greatest.max((weight(skin, vertex, joint) - weight(skin, twin, twin_joint)).abs());
        }
    }
    greatest
}

#[test]
fn mirrored_weights_are_equal_on_both_sides() {
    let (mesh, skeleton, twins) = symmetric_figure();
    for skin_method in SkinMethod::ALL {
        let of = |mirror_weights| {
            let options = RigOptions { skin_method, mirror_weights, ..RigOptions::default() };
            weighed(&mesh, &skeleton, &options)
        };
        for wish in [Symmetry::Auto, Symmetry::On] {
            let rigged = of(wish);
            assert_eq!(rigged.facts.vertices_mirrored, Some(mesh.positions.len()));
            let most = asymmetry(&mesh, &rigged.rig.skin, &twins);
            assert!(most <= 1e-6, "{}: {most}", skin_method.name());
        }
        let plain = of(Symmetry::Off);
        assert_eq!(plain.facts.vertices_mirrored, None);
        assert!(asymmetry(&mesh, &plain.rig.skin, &twins) > 1e-6, "{} needs no mirroring", skin_method.name());
    }
}

#[test]
fn a_skeleton_on_one_side_is_not_mirrored_and_the_program_says_so() {
    let folder = tempfile::tempdir().expect("folder");
    let file =
        r#"{"format": "rigsmith.rig/1", "joints": [{"name": "hand", "parent": null, "position": [0.45, 0.6, 0]}]}"#;
    std::fs::write(folder.path().join("one.rig.json"), file).expect("writes");
    let input = sample();
    let arguments = ["skin", input.to_str().expect("path"), "--skeleton", "one.rig.json", "-o", "out.glb"];
    let output = rigsmith(folder.path(), &[&arguments[..], &["--mirror-weights", "on"]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stderr(&output).contains("no left and right that match"), "{}", stderr(&output));
}
