//! How HollowDist grows with bones, with cells and with faces: CPU-seconds of one thread, least of [`REPEATS`] runs, and for
//! a large mesh the memory. Distances are asked for as HeterSkinNet asks: row by row, of which the nearest bones are kept.
//!
//! `cargo bench --bench hollow_distance`. CPU-seconds are the process's: noise of other programs only adds to them.

use cpu_time::ProcessTime;
use figure::{bones, figure};
use glam::DVec3;
use rigsmith::geometry::hollow_distance::{HOLLOW_RESOLUTION, HollowDistance, VertexDistances};
use rigsmith::geometry::volumetric_geodesic::Segment;
use rigsmith::mesh::Mesh;
use rigsmith::rig::heter_graph::LINKS;
use std::time::Duration;

mod figure;

const REPEATS: usize = 3;

fn main() {
    // `cargo test --benches` starts every bench with --test; there is nothing to test here.
    if std::env::args().any(|argument| argument == "--test") {
        return;
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("one thread starts");
    pool.install(tables);
}

fn tables() {
    // The largest first: what it needs is then not hidden by memory that smaller ones left behind.
    let million = figure(360);
    let (begun, before) = (resident("VmRSS:"), resident("VmHWM:"));
    let time = least_time(&million, &some_bones(200), 128);
    let peak = resident("VmHWM:");
    let mib = |bytes: usize| bytes as f64 / f64::from(1 << 20);
    println!("{} faces, 200 bones, 128³: {:.2} CPU-s", million.triangles.len(), time.as_secs_f64());
    println!(
        "{:.0} MiB at the most, of which mesh and program {:.0}, answer {:.0} ({LINKS} bones of each vertex); \
         {:.0} at the most while the mesh was made",
        mib(peak),
        mib(begun),
        mib(million.positions.len() * size_of::<Nearest>()),
        mib(before),
    );

    let mesh = figure(36);
    for count in [10, 40, 64, 128, 192] {
        let time = least_time(&mesh, &some_bones(count), HOLLOW_RESOLUTION);
        println!(
            "{} vertices, {count} bones, {HOLLOW_RESOLUTION}³: {:.3} CPU-s",
            mesh.positions.len(),
            time.as_secs_f64()
        );
    }
    for resolution in [44, 88, 128, 176, 256] {
        let time = least_time(&mesh, &some_bones(40), resolution);
        println!("{} vertices, 40 bones, {resolution}³: {:.3} CPU-s", mesh.positions.len(), time.as_secs_f64());
    }
}

fn least_time(mesh: &Mesh, bones: &[Segment], resolution: usize) -> Duration {
    let timed = |_| {
        let begun = ProcessTime::now();
        std::hint::black_box(HollowDistance::new(mesh, bones, resolution).map(nearest));
        begun.elapsed()
    };
    (0..REPEATS).map(timed).min().unwrap_or_default()
}

/// Bones and how far they are, nearest first.
type Nearest = [(u32, f32); LINKS];

fn nearest(vertex: VertexDistances) -> Nearest {
    let mut nearest = [(0, f32::INFINITY); LINKS];
    for (bone, &distance) in (0..).zip(vertex.hollow) {
        if distance < nearest[LINKS - 1].1 {
            let place = nearest.partition_point(|known| known.1 <= distance);
            nearest[place..].rotate_right(1);
            nearest[place] = (bone, distance);
        }
    }
    nearest
}

/// The figure's bones again and again, moved a little each time.
fn some_bones(count: usize) -> Vec<Segment> {
    let own = bones();
    let shifted = |at: usize| {
        let ((start, end), shift) = (own[at % own.len()], DVec3::splat(1e-3 * (at / own.len()) as f64));
        (start + shift, end + shift)
    };
    (0..count).map(shifted).collect()
}

/// Resident memory of the process in bytes, now (`VmRSS:`) or at the most so far (`VmHWM:`); zero where the system does not say.
fn resident(field: &str) -> usize {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(field));
    line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<usize>().ok()).unwrap_or(0) * 1024
}
