//! One benchmark per geometry stage, on a figure of balls and tubes at about 1,000, 2,500 and 5,000 vertices with 40 bones.
//!
//! `cargo bench --bench geometry`. Wall time; set `RAYON_NUM_THREADS=1` to read it as CPU time.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use glam::DVec3;
use rigsmith::geometry::bone_pairs::BonePair;
use rigsmith::geometry::bvh::Bvh;
use rigsmith::geometry::hollow_distance::{HOLLOW_RESOLUTION, hollow_distance};
use rigsmith::geometry::medial_offset::medial_offsets;
use rigsmith::geometry::neighbor_table::{GEODESIC_CAP, NeighborTable};
use rigsmith::geometry::orientation::guess_orientation;
use rigsmith::geometry::surface_geodesic::{BALL_RADIUS, SurfaceGeodesic};
use rigsmith::geometry::surface_samples::{SAMPLE_COUNT, SurfaceSamples};
use rigsmith::geometry::symmetry_plane::detect_symmetry_plane;
use rigsmith::geometry::transfer::transfer_map;
use rigsmith::geometry::volumetric_geodesic::{Segment, volumetric_geodesic_distance};
use rigsmith::geometry::voxel_binding::VoxelBinding;
use rigsmith::geometry::voxel_grid::VoxelGrid;
use rigsmith::mesh::Mesh;
use rigsmith::mesh::adjacency::one_ring;
use rigsmith::mesh::weld::weld;
use rigsmith::mesh::working_mesh::WorkingMesh;
use std::f64::consts::{PI, TAU};

/// Ellipsoids of a standing figure: middle, half sides.
const PARTS: [([f64; 3], [f64; 3]); 8] = [
    ([0.0, 0.62, 0.0], [0.14, 0.2, 0.09]),
    ([0.0, 0.9, 0.01], [0.08, 0.1, 0.09]),
    ([0.3, 0.75, 0.0], [0.2, 0.045, 0.045]),
    ([-0.3, 0.75, 0.0], [0.2, 0.045, 0.045]),
    ([0.09, 0.25, 0.0], [0.065, 0.24, 0.07]),
    ([-0.09, 0.25, 0.0], [0.065, 0.24, 0.07]),
    ([0.09, 0.03, 0.05], [0.05, 0.03, 0.1]),
    ([-0.09, 0.03, 0.05], [0.05, 0.03, 0.1]),
];

/// The figure with `around` vertices around each part and half as many along it.
fn figure(around: u32) -> Mesh {
    let mut mesh = Mesh::default();
    let along = around / 2;
    for (middle, half) in PARTS {
        let offset = mesh.positions.len() as u32;
        for (row, column) in (0..=along).flat_map(|row| (0..=around).map(move |column| (row, column))) {
            let (angle, height) = (TAU * f64::from(column) / f64::from(around), PI * f64::from(row) / f64::from(along));
            let on_ball = DVec3::new(height.sin() * angle.cos(), -height.cos(), -height.sin() * angle.sin());
            mesh.positions.push(DVec3::from(middle) + on_ball * DVec3::from(half));
        }
        for (row, column) in (0..along).flat_map(|row| (0..around).map(move |column| (row, column))) {
            let a = offset + row * (around + 1) + column;
            let d = a + around + 1;
            mesh.triangles.extend([[a, a + 1, d + 1], [a, d + 1, d]]);
        }
    }
    weld(&mesh).mesh
}

/// Five bones along the longest axis of each part.
fn bones() -> Vec<Segment> {
    let of_part = |(middle, half): &([f64; 3], [f64; 3])| {
        let (middle, half) = (DVec3::from(*middle), DVec3::from(*half));
        let mut along = DVec3::ZERO;
        along[half.max_position()] = half.max_element() * 0.36;
        (-2..=2)
            .map(|step| (middle + along * (f64::from(step) - 0.5), middle + along * (f64::from(step) + 0.5)))
            .collect::<Vec<Segment>>()
    };
    PARTS.iter().flat_map(of_part).collect::<Vec<Segment>>()
}

/// Keeps a result from being optimised away.
fn sink<T>(result: T) {
    std::hint::black_box(result);
}

fn stages(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("geometry");
    group.sample_size(10);
    for around in [16, 25, 36] {
        let upload = figure(around);
        let working = WorkingMesh::new(&upload).expect("a surface");
        let (mesh, bones) = (&working.mesh, bones());
        let surface = Bvh::new(mesh);
        let samples = SurfaceSamples::new(mesh, SAMPLE_COUNT);
        let geodesic = SurfaceGeodesic::new(&samples, &mesh.positions);
        let balls = geodesic.balls(BALL_RADIUS);
        let solid = VoxelGrid::solid(mesh);
        let vertices = upload.positions.len();
        let mut bench = |name: &str, stage: &dyn Fn()| {
            group.bench_function(BenchmarkId::new(name, vertices), |bencher| bencher.iter(stage));
        };
        bench("orientation", &|| sink(guess_orientation(&upload)));
        bench("working_mesh", &|| sink(WorkingMesh::new(&upload)));
        bench("one_ring", &|| sink(NeighborTable::padded(&one_ring(mesh))));
        bench("bvh", &|| sink(Bvh::new(mesh)));
        bench("surface_samples", &|| sink(SurfaceSamples::new(mesh, SAMPLE_COUNT)));
        bench("surface_geodesic", &|| sink(SurfaceGeodesic::new(&samples, &mesh.positions)));
        bench("geodesic_balls", &|| sink(geodesic.balls(BALL_RADIUS)));
        bench("neighbor_table", &|| {
            sink(NeighborTable::capped(&balls, GEODESIC_CAP, &mesh.positions, 0));
        });
        bench("voxel_grid", &|| sink(VoxelGrid::solid(mesh)));
        bench("symmetry_plane", &|| sink(detect_symmetry_plane(&samples, &surface)));
        bench("bone_pairs", &|| {
            let pairs = bones.iter().flat_map(|&(a, _)| bones.iter().map(move |&(b, _)| (a, b)));
            sink(pairs.map(|(a, b)| BonePair::new(a, b, &solid).outside_count).sum::<usize>());
        });
        bench("volumetric_geodesic", &|| {
            sink(volumetric_geodesic_distance(&mesh.positions, &geodesic, &surface, &bones));
        });
        bench("voxel_binding", &|| sink(VoxelBinding::new(mesh, &solid, &bones).distances(&mesh.positions)));
        bench("hollow_distance", &|| sink(hollow_distance(mesh, &bones, HOLLOW_RESOLUTION)));
        bench("medial_offset", &|| sink(medial_offsets(mesh, &surface)));
        bench("transfer", &|| sink(transfer_map(&upload, &working)));
    }
    group.finish();
}

/// How HollowDist grows with bones, with cells and with faces.
fn hollow_distances(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("hollow_distance");
    group.sample_size(10);
    let some = |count: usize| -> Vec<Segment> {
        let shifted = |(at, (start, end)): (usize, Segment)| {
            let shift = DVec3::splat(1e-3 * (at / bones().len()) as f64);
            (start + shift, end + shift)
        };
        bones().into_iter().cycle().take(count).enumerate().map(shifted).collect()
    };
    let mesh = figure(36);
    for count in [10, 40, 64, 128, 192] {
        let bones = some(count);
        group.bench_function(BenchmarkId::new("bones", count), |bencher| {
            bencher.iter(|| sink(hollow_distance(&mesh, &bones, HOLLOW_RESOLUTION)));
        });
    }
    for resolution in [44, 88, 128, 176, 256] {
        group.bench_function(BenchmarkId::new("resolution", resolution), |bencher| {
            bencher.iter(|| sink(hollow_distance(&mesh, &bones(), resolution)));
        });
    }
    let (million, bones) = (figure(360), some(200));
    group.bench_function(BenchmarkId::new("faces_200_bones_128", million.triangles.len()), |bencher| {
        bencher.iter(|| sink(hollow_distance(&million, &bones, 128)));
    });
    group.finish();
}

criterion_group!(geometry, stages, hollow_distances);
criterion_main!(geometry);
