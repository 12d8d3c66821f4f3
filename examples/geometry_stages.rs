//! CPU time of every geometry stage on one character of a rig archive:
//! `cargo run --release --example geometry_stages -- ARCHIVE.npz INDEX [SUBDIVISIONS]`.
//! Every subdivision makes four faces of one.

use glam::DVec3;
use rigsmith::formats::npz::Arrays;
use rigsmith::geometry::bone_pairs::BonePair;
use rigsmith::geometry::bvh::Bvh;
use rigsmith::geometry::neighbor_table::{GEODESIC_CAP, NeighborTable};
use rigsmith::geometry::surface_geodesic::{BALL_RADIUS, SurfaceGeodesic};
use rigsmith::geometry::surface_samples::{SAMPLE_COUNT, SurfaceSamples};
use rigsmith::geometry::symmetry_plane::detect_symmetry_plane;
use rigsmith::geometry::transfer::transfer_map;
use rigsmith::geometry::volumetric_geodesic::{Segment, volumetric_geodesic_distance};
use rigsmith::geometry::voxel_grid::VoxelGrid;
use rigsmith::mesh::Mesh;
use rigsmith::mesh::adjacency::one_ring;
use rigsmith::mesh::working_mesh::WorkingMesh;

const RUNS: u32 = 5;

/// CPU milliseconds of all threads so far.
fn cpu_ms() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").expect("Linux");
    let of_task = |task: std::fs::DirEntry| {
        let text = std::fs::read_to_string(task.path().join("schedstat")).unwrap_or_default();
        text.split_whitespace().next().and_then(|word| word.parse::<f64>().ok()).unwrap_or(0.0)
    };
    tasks.flatten().map(of_task).sum::<f64>() / 1e6
}

fn timed<T>(name: &str, total: &mut f64, stage: impl Fn() -> T) -> T {
    let result = stage();
    let start = cpu_ms();
    for _ in 0..RUNS {
        stage();
    }
    let spent = (cpu_ms() - start) / f64::from(RUNS);
    *total += spent;
    println!("{name:24} {spent:8.2} ms");
    result
}

fn subdivided(mesh: &Mesh) -> Mesh {
    let mut finer = Mesh { positions: mesh.positions.clone(), triangles: Vec::new() };
    let mut middles = std::collections::HashMap::new();
    for &[a, b, c] in &mesh.triangles {
        let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(from, to)| {
            *middles.entry((from.min(to), from.max(to))).or_insert_with(|| {
                finer.positions.push((mesh.positions[from as usize] + mesh.positions[to as usize]) * 0.5);
                finer.positions.len() as u32 - 1
            })
        });
        finer.triangles.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    finer
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().expect("an archive");
    let index: usize = arguments.next().map_or(0, |word| word.parse().expect("an index"));
    let arrays = Arrays::read(&std::fs::read(path).expect("the archive reads")).expect("an archive");
    let array = |name: &str| arrays.get(&format!("{index:04}/{name}")).expect("a sample").to_f64();
    let points = |name: &str| array(name).chunks_exact(3).map(DVec3::from_slice).collect::<Vec<_>>();
    let subdivisions: usize = arguments.next().map_or(0, |word| word.parse().expect("a count"));
    let mut upload = Mesh {
        positions: points("vertices"),
        triangles: array("faces").chunks_exact(3).map(|face| [0, 1, 2].map(|k| face[k] as u32)).collect(),
    };
    for _ in 0..subdivisions {
        upload = subdivided(&upload);
    }
    println!("upload V {} F {}", upload.positions.len(), upload.triangles.len());
    let (joints, parents) = (points("joints"), array("parents"));
    let mut bones: Vec<Segment> = Vec::new();
    for (joint, &parent) in parents.iter().enumerate().skip(1) {
        bones.push((joints[parent as usize], joints[joint]));
        if !parents.contains(&(joint as f64)) {
            bones.push((joints[joint], joints[joint]));
        }
    }

    let mut total = 0.0;
    let working = timed("working mesh", &mut total, || WorkingMesh::new(&upload).expect("a surface"));
    let mesh = &working.mesh;
    println!("V {} F {} B {} {:?}", mesh.positions.len(), mesh.triangles.len(), bones.len(), working.change);
    timed("one-ring table", &mut total, || NeighborTable::padded(&one_ring(mesh)));
    let surface = timed("bvh", &mut total, || Bvh::new(mesh));
    let samples = timed("surface samples", &mut total, || SurfaceSamples::new(mesh, SAMPLE_COUNT));
    let geodesic = timed("sample graph", &mut total, || SurfaceGeodesic::new(&samples, &mesh.positions));
    let balls = timed("balls", &mut total, || geodesic.balls(BALL_RADIUS));
    timed("ball table", &mut total, || NeighborTable::capped(&balls, GEODESIC_CAP, &mesh.positions, 0));
    let solid = timed("voxels", &mut total, || VoxelGrid::solid(mesh));
    let plane = timed("symmetry plane", &mut total, || detect_symmetry_plane(&samples, &surface));
    timed("bone pairs", &mut total, || {
        let pairs = joints.iter().enumerate().flat_map(|(i, &a)| joints[i + 1..].iter().map(move |&b| (a, b)));
        pairs.map(|(a, b)| BonePair::new(a, b, &solid).outside_count).sum::<usize>()
    });
    timed("volumetric geodesic", &mut total, || {
        volumetric_geodesic_distance(&mesh.positions, &geodesic, &surface, &bones)
    });
    timed("transfer", &mut total, || transfer_map(&upload, &working));
    println!("total                    {total:8.2} ms; {plane:?}");
}
