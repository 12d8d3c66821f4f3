//! What the service costs on top of the rig: an upload with `Prefer: wait` over HTTP, beside the same rig in the same
//! warm process, turn by turn. On a busy machine the rig's own time varies by more than the service costs, so the cost is
//! taken within each request: its whole time less the time of its stages. (They are told in whole milliseconds, which
//! makes the cost look up to 10 ms larger.) CPU-seconds, which other programs change little, are taken of both too: they
//! are all of this process, so those over HTTP include the client's. Prints the figures of `docs/bad-input-and-load.md`.
//!
//!     cargo run --release --example service_latency [ROUNDS]

use rigsmith::formats::Siblings;
use rigsmith::jobs::{Engine, Jobs, RigOptions, Settings, Watch};
use rigsmith::pipelines::LoadOptions;
use rigsmith::server::{App, Limits, run};
use rigsmith::storage::Store;
use std::error::Error;
use std::sync::Arc;
use std::time::Instant;
use tokio::net::TcpListener;

const ROUNDS: usize = 15;
const VERTICES: usize = 2500;
const BUDGET_MS: f64 = 60.0;

/// The character is whole in one file.
struct Alone;

impl Siblings for Alone {
    fn read(&self, _: &str) -> Option<Vec<u8>> {
        None
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let rounds: usize = std::env::args().nth(1).map_or(Ok(ROUNDS), |text| text.parse())?;
    let glb = character(VERTICES);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let engine = Arc::new(Engine::open(&LoadOptions { onnxruntime: None, models: None, threads })?);
    let folder = tempfile::tempdir()?;
    let jobs = Jobs::start(engine.clone(), Store::open(folder.path(), 1 << 30)?, Settings::default())?;
    let runtime = tokio::runtime::Runtime::new()?;
    let listener = runtime.block_on(TcpListener::bind("127.0.0.1:0"))?;
    let url = format!("http://{}/v1/rigs", listener.local_addr()?);
    runtime.spawn(run(listener, std::future::pending(), App::new(jobs, Limits::default())));

    let options = RigOptions::default();
    let direct = || -> Result<f64, Box<dyn Error>> {
        let began = Instant::now();
        engine.rig_file("upload.glb", &glb, &Alone, &options, &Watch::unattended())?;
        Ok(began.elapsed().as_secs_f64() * 1000.0)
    };
    let agent = ureq::Agent::new_with_defaults();
    let served = || -> Result<(f64, f64), Box<dyn Error>> {
        let began = Instant::now();
        let request = agent.post(&url).header("content-type", "model/gltf-binary").header("prefer", "wait=60");
        let mut response = request.header("cache-control", "no-cache").send(&glb[..])?;
        let job: serde_json::Value = response.body_mut().read_json()?;
        let took = began.elapsed().as_secs_f64() * 1000.0;
        let stages = job["timings_ms"].as_object().into_iter().flatten().filter(|(name, _)| *name != "queue");
        let work: f64 = stages.filter_map(|(_, time)| time.as_f64()).sum();
        if job["state"] == "succeeded" { Ok((took, took - work)) } else { Err(format!("{job:#}").into()) }
    };
    direct()?;
    served()?;
    let (mut alone, mut over_http, mut extra) = (Vec::new(), Vec::new(), Vec::new());
    let (mut cpu_alone, mut cpu_over_http) = (0.0, 0.0);
    for _ in 0..rounds {
        let before = cpu_ms()?;
        alone.push(direct()?);
        let between = cpu_ms()?;
        let (took, cost) = served()?;
        over_http.push(took);
        extra.push(cost);
        cpu_alone += between - before;
        cpu_over_http += cpu_ms()? - between;
    }
    let (alone, over_http, extra) = (median(&mut alone), median(&mut over_http), median(&mut extra));
    println!("{} bytes, {VERTICES} vertices, {rounds} rounds, {threads} threads; medians", glb.len());
    println!("rig in the process: {alone:.1} ms; over HTTP with Prefer: wait: {over_http:.1} ms");
    let (cpu_alone, cpu_over_http) = (cpu_alone / rounds as f64, cpu_over_http / rounds as f64);
    let share = 100.0 * cpu_alone / cpu_over_http;
    println!("CPU per rig: {cpu_alone:.1} ms in the process, {cpu_over_http:.1} ms over HTTP ({share:.1} %)");
    println!("beside the stages of the work, a request takes {extra:.1} ms (budget {BUDGET_MS} ms)");
    if extra <= BUDGET_MS { Ok(()) } else { Err("over the budget".into()) }
}

/// CPU time of this process so far. Linux tells it in hundredths of a second.
fn cpu_ms() -> Result<f64, Box<dyn Error>> {
    let text = std::fs::read_to_string("/proc/self/stat")?;
    let (_, fields) = text.rsplit_once(')').ok_or("no process name")?;
    let times = fields.split_whitespace().skip(11).take(2).map(str::parse::<f64>);
    Ok(times.sum::<Result<f64, _>>()? * 10.0)
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// A standing figure of capsules, `vertices` in all but for rounding, as GLB.
fn character(vertices: usize) -> Vec<u8> {
    // From, to, radius: trunk, head, arms, legs.
    let limbs: [([f32; 3], [f32; 3], f32); 6] = [
        ([0.0, 0.85, 0.0], [0.0, 1.4, 0.0], 0.16),
        ([0.0, 1.55, 0.0], [0.0, 1.7, 0.0], 0.11),
        ([0.15, 1.4, 0.0], [0.8, 1.4, 0.0], 0.06),
        ([-0.15, 1.4, 0.0], [-0.8, 1.4, 0.0], 0.06),
        ([0.1, 0.85, 0.0], [0.13, 0.05, 0.0], 0.09),
        ([-0.1, 0.85, 0.0], [-0.13, 0.05, 0.0], 0.09),
    ];
    let around = 16;
    let rings = vertices / (limbs.len() * around);
    let (mut positions, mut indices): (Vec<f32>, Vec<u32>) = (Vec::new(), Vec::new());
    for (from, to, radius) in limbs {
        let first = (positions.len() / 3) as u32;
        let along: [f32; 3] = std::array::from_fn(|axis| to[axis] - from[axis]);
        let length = along.iter().map(|part| part * part).sum::<f32>().sqrt();
        let axis = along.map(|part| part / length);
        // Two directions across the axis; none of the limbs runs along z.
        let side = [axis[1], -axis[0], 0.0];
        for ring in 0..rings {
            // From pole to pole of the capsule: the ends round off over one radius.
            let t = ring as f32 / (rings - 1) as f32 * (length + 2.0 * radius) - radius;
            let overhang = (-t).max(t - length).max(0.0).min(radius * 0.999);
            let width = (radius * radius - overhang * overhang).sqrt();
            for step in 0..around {
                let angle = step as f32 / around as f32 * std::f32::consts::TAU;
                let depth = [0.0, 0.0, 1.0];
                let place: [f32; 3] = std::array::from_fn(|index| {
                    from[index] + t * axis[index] + width * (angle.cos() * side[index] + angle.sin() * depth[index])
                });
                positions.extend(place);
                if ring + 1 < rings {
                    let corner = |ring: usize, step: usize| first + (ring * around + step % around) as u32;
                    let (a, b, c, d) = (
                        corner(ring, step),
                        corner(ring, step + 1),
                        corner(ring + 1, step),
                        corner(ring + 1, step + 1),
                    );
                    indices.extend([a, b, c, b, d, c]);
                }
            }
        }
    }
    gltf(&positions, &indices)
}

/// One primitive as a glTF document with its buffer inside; the decoder tells glTF from GLB by itself.
fn gltf(positions: &[f32], indices: &[u32]) -> Vec<u8> {
    let bound = |pick: fn(f32, f32) -> f32| -> Vec<f32> {
        (0..3).map(|axis| positions.iter().skip(axis).step_by(3).copied().reduce(pick).unwrap_or(0.0)).collect()
    };
    let mut bytes: Vec<u8> = positions.iter().flat_map(|value| value.to_le_bytes()).collect();
    let split = bytes.len();
    bytes.extend(indices.iter().flat_map(|index| index.to_le_bytes()));
    let document = serde_json::json!({
        "asset": {"version": "2.0"},
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": bytes.len()}],
        "bufferViews": [
            {"buffer": 0, "byteLength": split},
            {"buffer": 0, "byteOffset": split, "byteLength": bytes.len() - split},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": positions.len() / 3, "type": "VEC3",
             "min": bound(f32::min), "max": bound(f32::max)},
            {"bufferView": 1, "componentType": 5125, "count": indices.len(), "type": "SCALAR"},
        ],
    });
    glb(&document, &bytes)
}

/// The container: header, JSON chunk, binary chunk, each padded to four bytes.
fn glb(document: &serde_json::Value, buffer: &[u8]) -> Vec<u8> {
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut file = Vec::new();
    let words = |file: &mut Vec<u8>, words: &[u32]| words.iter().for_each(|word| file.extend(word.to_le_bytes()));
    words(&mut file, &[0x4654_6C67, 2, (28 + json.len() + buffer.len()) as u32]);
    words(&mut file, &[json.len() as u32, 0x4E4F_534A]);
    file.extend(json);
    words(&mut file, &[buffer.len() as u32, 0x004E_4942]);
    file.extend(buffer);
    file
}
