//! `make bench`: the whole pipeline, stage by stage, in CPU-seconds and peak memory, beside the machine's own
//! matrix-product rate measured in the same run.
//!
//! CPU-seconds are the process's, so they count the work of all threads and not the waiting; on noisy machines only they and
//! ratios within one run can be compared. Each size runs [`REPEATS`] times; the least time of each stage is shown, since
//! noise only adds.

use cpu_time::ProcessTime;
use glam::{DMat3, DVec3};
use rigsmith::cancellation::Cancellation;
use rigsmith::mesh::Mesh;
use rigsmith::nets::network::{Input, Network};
use rigsmith::nets::{LoadOptions, Models, locate, runtime::Runtime};
use rigsmith::pipelines::{RigOptions, Stage, Subject, Watch, rig};
use std::path::Path;
use std::sync::Mutex;
use std::time::{Duration, Instant};
use tracing::span::Id;
use tracing::subscriber::Interest;
use tracing::{Metadata, Subscriber};
use tracing_subscriber::layer::{Context, Layer, SubscriberExt};

const REPEATS: usize = 3;

fn main() {
    // `cargo test --benches` starts every bench with --test; there is nothing to test here.
    if std::env::args().any(|argument| argument == "--test") {
        return;
    }
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let begun = (Instant::now(), ProcessTime::now());
    let options = LoadOptions { onnxruntime: None, models: None, threads };
    let models = Models::load(&options).expect("models load; run `make ort` first");
    println!(
        "start: {:.2} s wall, {:.2} CPU-s, {} MiB resident, {threads} threads",
        begun.0.elapsed().as_secs_f64(),
        begun.1.elapsed().as_secs_f64(),
        peak_rss_mib()
    );
    let rate = matrix_product_rate(threads);
    println!("matrix product (2048 x 1024 x 512, f32): {:.1} GFLOP per CPU-second\n", rate / 1e9);
    tracing::subscriber::set_global_default(tracing_subscriber::registry().with(NetworkTime)).expect("set once");
    println!(
        "| mesh | vertices | {} | total CPU-s | of it networks | peak MiB |",
        Stage::ALL.map(Stage::name).join(" | ")
    );
    println!("|---|---:|{}---:|---:|---:|", "---:|".repeat(Stage::ALL.len()));
    for (name, mesh) in [
        ("1k", character(1_000)),
        ("2.5k", character(2_500)),
        ("5k", character(5_000)),
        ("300k faces", character(150_000)),
    ] {
        let mut runs: Vec<Vec<(Stage, Duration)>> = Vec::new();
        let mut networks = Duration::MAX;
        for _ in 0..REPEATS {
            IN_NETWORKS.lock().expect("no panic while locked").1 = Duration::ZERO;
            runs.push(timed(&mesh, &models));
            networks = networks.min(IN_NETWORKS.lock().expect("no panic while locked").1);
        }
        let least = |stage: Stage| {
            let of_run = |run: &Vec<(Stage, Duration)>| {
                run.iter().filter(|(done, _)| *done == stage).map(|(_, time)| *time).sum::<Duration>()
            };
            runs.iter().map(of_run).min().unwrap_or_default()
        };
        let stages = Stage::ALL.map(|stage| format!("{:.3}", least(stage).as_secs_f64()));
        let total: Duration = Stage::ALL.into_iter().map(least).sum();
        println!(
            "| {name} | {} | {} | {:.2} | {:.2} | {} |",
            mesh.positions.len(),
            stages.join(" | "),
            total.as_secs_f64(),
            networks.as_secs_f64(),
            peak_rss_mib()
        );
    }
}

/// When the running network began, and the CPU time of all networks so far: one job runs here at a time.
static IN_NETWORKS: Mutex<(Option<ProcessTime>, Duration)> = Mutex::new((None, Duration::ZERO));

/// Adds up the CPU time inside the spans that [`Network::run`] opens.
struct NetworkTime;

impl<S: Subscriber> Layer<S> for NetworkTime {
    fn register_callsite(&self, metadata: &'static Metadata<'static>) -> Interest {
        if metadata.is_span() && metadata.name() == "network" { Interest::always() } else { Interest::never() }
    }

    fn on_enter(&self, _: &Id, _: Context<'_, S>) {
        IN_NETWORKS.lock().expect("no panic while locked").0 = Some(ProcessTime::now());
    }

    fn on_exit(&self, _: &Id, _: Context<'_, S>) {
        let mut state = IN_NETWORKS.lock().expect("no panic while locked");
        if let Some(begun) = state.0.take() {
            state.1 += begun.elapsed();
        }
    }
}

/// CPU time of each stage of one rig.
fn timed(mesh: &Mesh, models: &Models) -> Vec<(Stage, Duration)> {
    let marks = Mutex::new(Vec::new());
    let on_stage = |stage| marks.lock().expect("no panic while locked").push((stage, ProcessTime::now()));
    let watch = Watch { cancellation: &Cancellation::default(), on_stage: &on_stage };
    let subject = Subject { mesh, to_upright: DMat3::IDENTITY };
    rig(subject, models, &RigOptions::default(), watch).expect("the bench character is rigged");
    let end = ProcessTime::now();
    let marks = marks.into_inner().expect("no panic while locked");
    let ends = marks.iter().skip(1).map(|(_, at)| *at).chain([end]);
    marks.iter().zip(ends).map(|((stage, from), to)| (*stage, to.duration_since(*from))).collect()
}

/// A humanoid of about `vertices` vertices, made of six overlapping capsules. Made here so that any size can be had.
fn character(vertices: usize) -> Mesh {
    let segments = [
        (DVec3::new(0.0, 0.45, 0.0), DVec3::new(0.0, 0.75, 0.0), 0.1),
        (DVec3::new(0.0, 0.85, 0.0), DVec3::new(0.0, 0.92, 0.0), 0.09),
        (DVec3::new(0.1, 0.72, 0.0), DVec3::new(0.46, 0.72, 0.0), 0.045),
        (DVec3::new(-0.1, 0.72, 0.0), DVec3::new(-0.46, 0.72, 0.0), 0.045),
        (DVec3::new(0.08, 0.42, 0.0), DVec3::new(0.1, 0.05, 0.0), 0.06),
        (DVec3::new(-0.08, 0.42, 0.0), DVec3::new(-0.1, 0.05, 0.0), 0.06),
    ];
    let mut mesh = Mesh::default();
    let per_tube = vertices / segments.len();
    let around = ((per_tube as f64 / 2.0).sqrt().round() as usize).max(6);
    let along = per_tube / around;
    for (start, end, radius) in segments {
        append_capsule(&mut mesh, start, end, radius, around, along);
    }
    mesh
}

/// A closed tube with round ends: `along` rings of `around` vertices.
fn append_capsule(mesh: &mut Mesh, start: DVec3, end: DVec3, radius: f64, around: usize, along: usize) {
    let axis = (end - start).normalize();
    let (side, other) = axis.any_orthonormal_pair();
    let first = mesh.positions.len() as u32;
    for ring in 0..along {
        let t = ring as f64 / (along - 1) as f64;
        // Rings run over the first cap, the tube and the second cap, evenly in arc length.
        let (quarter, tube) = (std::f64::consts::FRAC_PI_2 * radius, (end - start).length());
        let arc = t * (tube + 2.0 * quarter);
        let (centre, lift, wide) = if arc < quarter {
            let angle = arc / radius;
            (start, -radius * angle.cos(), radius * angle.sin())
        } else if arc < quarter + tube {
            (start + axis * (arc - quarter), 0.0, radius)
        } else {
            let angle = (arc - quarter - tube) / radius;
            (end, radius * angle.sin(), radius * angle.cos())
        };
        for step in 0..around {
            let turn = std::f64::consts::TAU * step as f64 / around as f64;
            let out = side * turn.cos() + other * turn.sin();
            mesh.positions.push(centre + axis * lift + out * wide.max(radius * 0.05));
        }
    }
    let at = |ring: usize, step: usize| first + (ring * around + step % around) as u32;
    for ring in 0..along - 1 {
        for step in 0..around {
            mesh.triangles.push([at(ring, step), at(ring, step + 1), at(ring + 1, step + 1)]);
            mesh.triangles.push([at(ring, step), at(ring + 1, step + 1), at(ring + 1, step)]);
        }
    }
}

/// Multiplications and additions per CPU-second of the runtime's own matrix product.
fn matrix_product_rate(threads: usize) -> f64 {
    let runtime = Runtime::load(&locate::runtime_candidates(None), threads).expect("runtime is loaded");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/matrix_product.onnx");
    let graph = std::fs::read(path).expect("graph reads");
    let network = Network::open(&runtime, "matrix_product", graph).expect("graph opens");
    let (m, k, n) = (2048, 1024, 512);
    let left = ndarray::Array2::from_elem((m, k), 0.5f32).into_dyn();
    let right = ndarray::Array2::from_elem((k, n), 0.25f32).into_dyn();
    let run = || {
        let inputs = [("left", Input::F32(left.view())), ("right", Input::F32(right.view()))];
        network.run(&inputs, "product", &Cancellation::default()).expect("product runs");
    };
    run();
    let times = (0..7).map(|_| {
        let begun = ProcessTime::now();
        (0..4).for_each(|_| run());
        begun.elapsed().as_secs_f64() / 4.0
    });
    (2 * m * k * n) as f64 / times.fold(f64::INFINITY, f64::min)
}

/// The most memory that the process has had resident, in MiB; 0 where the system does not say.
fn peak_rss_mib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<u64>().ok()).unwrap_or(0) / 1024
}
