//! One benchmark per geometry stage, on a figure of balls and tubes at about 1,000, 2,500 and 5,000 vertices with 40 bones.
//!
//! `cargo bench --bench geometry`. Wall time; set `RAYON_NUM_THREADS=1` to read it as CPU time.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use figure::{bones, figure};
use rigsmith::geometry::bone_pairs::BonePair;
use rigsmith::geometry::bvh::Bvh;
use rigsmith::geometry::hollow_distance::{HOLLOW_RESOLUTION, HollowDistance, VertexDistances};
use rigsmith::geometry::medial_offset::medial_offsets;
use rigsmith::geometry::neighbor_table::{GEODESIC_CAP, NeighborTable};
use rigsmith::geometry::orientation::guess_orientation;
use rigsmith::geometry::surface_geodesic::{BALL_RADIUS, SurfaceGeodesic};
use rigsmith::geometry::surface_samples::{SAMPLE_COUNT, SurfaceSamples};
use rigsmith::geometry::symmetry_plane::detect_symmetry_plane;
use rigsmith::geometry::transfer::transfer_map;
use rigsmith::geometry::volumetric_geodesic::{bone_euclid, volumetric_geodesic_distance};
use rigsmith::geometry::voxel_binding::VoxelBinding;
use rigsmith::geometry::voxel_grid::VoxelGrid;
use rigsmith::mesh::adjacency::one_ring;
use rigsmith::mesh::working_mesh::WorkingMesh;

mod figure;

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
        bench("bone_euclid", &|| sink(bone_euclid(&mesh.positions, &bones)));
        bench("hollow_distance", &|| {
            let nearest = |vertex: VertexDistances| vertex.hollow.iter().copied().reduce(f32::min);
            sink(HollowDistance::new(mesh, &bones, HOLLOW_RESOLUTION).map(nearest));
        });
        bench("medial_offset", &|| sink(medial_offsets(mesh, &surface)));
        bench("transfer", &|| sink(transfer_map(&upload, &working)));
    }
    group.finish();
}

criterion_group!(geometry, stages);
criterion_main!(geometry);
