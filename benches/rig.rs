//! Rig assembly by stage, on made-up evidence of the sizes that working meshes have.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use glam::DVec3;
use rigsmith::cancellation::Cancellation;
use rigsmith::geometry::symmetry_plane::SymmetryPlane;
use rigsmith::mesh::adjacency::Neighbors;
use rigsmith::rig::Skeleton;
use rigsmith::rig::bone_features::{NEAREST_BONES, bone_features};
use rigsmith::rig::bone_weights::{BoneWeights, PRUNE_SHARE};
use rigsmith::rig::detect_joints::{Evidence, Fineness, detect_joints};
use rigsmith::rig::joint_clustering::{MeanShift, mean_shift};
use rigsmith::rig::skeleton::Bone;
use rigsmith::rig::skin_weights::Trim;
use rigsmith::rig::spanning_tree::{BoneCosts, Tree, symmetric_spanning_tree};
use rigsmith::rig::symmetrize::Side;
use std::hint::black_box;

const PLANE: SymmetryPlane = SymmetryPlane { normal: DVec3::X, offset: 0.0, score: 1.0 };

/// A number in [0, 1) from an index, without pattern (SplitMix64).
fn noise(index: usize) -> f64 {
    let mut z = (index as u64).wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

fn noise_point(index: usize) -> DVec3 {
    DVec3::new(noise(3 * index) - 0.5, noise(3 * index + 1), 0.4 * noise(3 * index + 2))
}

/// Vertices of a body, each drawn most of the way to one of 25 joints, as a trained network does.
fn evidence(vertex_count: usize) -> (Vec<DVec3>, Vec<DVec3>, Vec<f64>) {
    let joints: Vec<DVec3> = (0..25).map(|joint| noise_point(joint + 900_000)).collect();
    let nearest = |p: DVec3| *joints.iter().min_by(|a, b| a.distance(p).total_cmp(&b.distance(p))).expect("joints");
    let vertices: Vec<DVec3> = (0..vertex_count).map(noise_point).collect();
    let displaced =
        vertices.iter().enumerate().map(|(k, &v)| v.lerp(nearest(v), 0.75) + 0.02 * (noise_point(k + 700_000) - 0.4));
    let displaced = displaced.collect();
    (vertices, displaced, (0..vertex_count).map(|k| 0.05 + noise(k + 500_000)).collect())
}

fn clustering(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("joints");
    group.sample_size(10);
    for vertex_count in [1_000, 2_500, 5_000] {
        let (vertices, displaced, attention) = evidence(vertex_count);

        group.bench_function(BenchmarkId::new("mean_shift", vertex_count), |bench| {
            let rule = MeanShift::ours(0.05);
            bench.iter(|| mean_shift(black_box(&displaced), &attention, Some(&PLANE), &rule, &Cancellation::default()));
        });
        let evidence = Evidence { vertices: &vertices, displaced: &displaced, attention: &attention };
        group.bench_function(BenchmarkId::new("detect_joints", vertex_count), |bench| {
            let detail = Fineness::Detail(0.5);
            bench.iter(|| detect_joints(black_box(&evidence), None, Some(&PLANE), detail, &Cancellation::default()));
        });
    }
    group.finish();
}

fn connecting(criterion: &mut Criterion) {
    let sides = [[Side::Negative; 40].as_slice(), &[Side::Middle; 20], &[Side::Positive; 40]].concat();
    let positions: Vec<DVec3> = (0..100).map(noise_point).collect();
    let costs = BoneCosts::from_matrix(100, &(0..10_000).map(noise).collect::<Vec<_>>());
    criterion.bench_function("connect/symmetric_spanning_tree/100", |bench| {
        bench.iter(|| symmetric_spanning_tree(black_box(&costs), &positions, &sides, 50));
    });
}

/// A chain of joints whose bones number `bone_count`.
fn chain(bone_count: usize) -> Vec<Bone> {
    let parents: Vec<Option<usize>> = (0..bone_count).map(|joint| joint.checked_sub(1)).collect();
    let tree = Tree { root: 0, keys: vec![0.0; bone_count], parents };
    Skeleton::from_tree(&(0..bone_count).map(noise_point).collect::<Vec<_>>(), &tree).0.bones()
}

fn skin(criterion: &mut Criterion) {
    let (vertex_count, original_count) = (5_000, 150_000);
    let bones = chain(60);
    let distance: Vec<f32> = (0..vertex_count * bones.len()).map(|k| noise(k) as f32).collect();
    let logits: Vec<f32> = (0..vertex_count * NEAREST_BONES).map(|k| 4.0 * noise(k) as f32).collect();
    let near =
        |v: usize| (1..4).flat_map(move |step| [(v + step) % vertex_count, (v + vertex_count - step) % vertex_count]);
    let rows: Vec<Vec<u32>> = (0..vertex_count).map(|v| near(v).map(|v| v as u32).collect()).collect();
    let one_ring = Neighbors::from_rows(&rows);
    let assemble = || {
        let features = bone_features(&distance, &bones);
        let weights = BoneWeights::from_logits(&logits, &features, bones.len());
        let weights = weights.one_ring_mean(&one_ring).pruned(PRUNE_SHARE);
        rigsmith::rig::SkinWeights::from_bones(&weights, &bones, &features.nearest, Trim::USUAL).0
    };
    criterion.bench_function("skin/assembly/5000x60", |bench| bench.iter(|| black_box(assemble())));
    let skin = assemble();
    let blends: Vec<[(u32, f64); 3]> = (0..original_count)
        .map(|k| std::array::from_fn(|corner| (((k + corner * 7) % vertex_count) as u32, [0.5, 0.3, 0.2][corner])))
        .collect();
    criterion.bench_function("transfer/weights/150000", |bench| {
        bench.iter(|| skin.transferred(black_box(&blends), Trim::USUAL))
    });
}

criterion_group!(benches, clustering, connecting, skin);
criterion_main!(benches);
