//! The pipeline as the workers drive it: stages in order, and the end of work that is no longer wanted.

use super::metamorphic::{character, models};
use glam::{DMat3, DVec3};
use rigsmith::cancellation::Cancellation;
use rigsmith::mesh::Mesh;
use rigsmith::pipelines::{LevelOfDetail, RigError, RigOptions, Stage, Subject, Symmetry, Watch, rig};
use std::sync::Mutex;

fn run(mesh: &Mesh, options: &RigOptions, cancel_at: Option<Stage>) -> (Result<usize, RigError>, Vec<Stage>) {
    let (cancellation, entered) = (Cancellation::default(), Mutex::new(Vec::new()));
    let on_stage = |stage| {
        entered.lock().expect("no panic while locked").push(stage);
        if Some(stage) == cancel_at {
            cancellation.cancel();
        }
    };
    let watch = Watch { cancellation: &cancellation, on_stage: &on_stage };
    let subject = Subject { mesh, to_upright: DMat3::IDENTITY };
    let result = rig(subject, models(), options, watch).map(|rigged| rigged.rig.skeleton.joints.len());
    (result, entered.into_inner().expect("no panic while locked"))
}

#[test]
fn stages_are_entered_in_their_order() {
    let (result, entered) = run(character(), &RigOptions::default(), None);
    assert!(result.is_ok_and(|joints| (2..=100).contains(&joints)));
    assert_eq!(entered, Stage::ALL);
}

#[test]
fn work_cancelled_in_any_stage_but_the_last_ends_there() {
    for stage in [Stage::Normalize, Stage::Geometry, Stage::Joints, Stage::Connect, Stage::Skin] {
        let (result, entered) = run(character(), &RigOptions::default(), Some(stage));
        assert!(matches!(result, Err(RigError::Cancelled(_))), "{}: {result:?}", stage.name());
        assert!(entered.last().is_some_and(|last| *last <= Stage::ALL[stage as usize + 1]), "{entered:?}");
    }
}

#[test]
fn symmetry_on_makes_every_joint_a_mirror_image_of_one() {
    let cancellation = Cancellation::default();
    let watch = Watch { cancellation: &cancellation, on_stage: &|_| {} };
    let options = RigOptions { symmetry: Symmetry::On, ..RigOptions::default() };
    let subject = Subject { mesh: character(), to_upright: DMat3::IDENTITY };
    let rigged = rig(subject, models(), &options, watch).expect("rigs");
    let (normal, point) = rigged.facts.symmetry_plane.expect("a plane was used");
    let (low, high) = character().bounding_box().expect("has vertices");
    let reach = 1e-6 * (high - low).max_element();
    let joints = rigged.rig.skeleton.positions();
    for joint in &joints {
        let image = *joint - normal * (2.0 * normal.dot(*joint - point));
        assert!(joints.iter().any(|other| other.distance(image) < reach), "{joint} has no image");
    }
}

#[test]
fn another_seed_asks_the_networks_about_other_neighbours() {
    let positions = |seed| {
        let cancellation = Cancellation::default();
        let watch = Watch { cancellation: &cancellation, on_stage: &|_| {} };
        let options = RigOptions { seed, ..RigOptions::default() };
        let subject = Subject { mesh: character(), to_upright: DMat3::IDENTITY };
        rig(subject, models(), &options, watch).expect("rigs").rig.skeleton.positions()
    };
    assert_eq!(positions(1), positions(1));
    assert_ne!(positions(0), positions(1));
}

#[test]
fn a_larger_bandwidth_does_not_give_more_joints() {
    let with = |h| RigOptions { level_of_detail: LevelOfDetail::Bandwidth(h), ..RigOptions::default() };
    let fine = run(character(), &with(0.03), None).0.expect("rigs");
    let coarse = run(character(), &with(0.12), None).0.expect("rigs");
    assert!(coarse <= fine, "{coarse} joints at 0.12, {fine} at 0.03");
}

#[test]
fn meshes_at_the_edge_of_what_can_be_rigged_end_in_a_rig_or_a_refusal() {
    let triangle = Mesh { positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y], triangles: vec![[0, 1, 2]] };
    let tetrahedron = Mesh {
        positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
        triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
    };
    let point = Mesh { positions: vec![DVec3::ONE; 3], triangles: vec![[0, 1, 2]] };
    let sliver = Mesh { positions: vec![DVec3::ZERO, DVec3::X, DVec3::X * 2.0], triangles: vec![[0, 1, 2]] };
    for (name, mesh) in [("triangle", triangle), ("tetrahedron", tetrahedron), ("point", point), ("sliver", sliver)] {
        match run(&mesh, &RigOptions::default(), None).0 {
            Ok(joints) => assert!((2..=100).contains(&joints), "{name}: {joints} joints"),
            Err(error) => {
                let honest = matches!(error, RigError::NoExtent | RigError::NoJointsFound { .. });
                assert!(honest, "{name}: {error}");
            }
        }
    }
}
