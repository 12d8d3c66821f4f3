//! Golden vectors of the RigNet reference: where they are and how they are read.
//!
//! The folder is `RIGSMITH_GOLDEN_DIR`, by default the shared one beside the repository; every `*_golden.npz` in it
//! is a case. Its README gives names, shapes and fair tolerances. Without the folder the tests say they were skipped.

use glam::DVec3;
use rigsmith::formats::npz::{Array, Arrays};
use rigsmith::mesh::Mesh;
use std::path::{Path, PathBuf};

/// All arrays of one `*_golden.npz`.
pub struct Case {
    /// File name without `_golden.npz`.
    pub id: String,
    arrays: Arrays,
    folder: PathBuf,
}

/// Where the golden vectors are, or would be.
pub fn folder() -> PathBuf {
    std::env::var_os("RIGSMITH_GOLDEN_DIR")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/golden"), PathBuf::from)
}

/// Every case of the golden folder, sorted by id; empty (and said so on stderr) when the folder is not there.
pub fn cases() -> Vec<Case> {
    let folder = std::env::var_os("RIGSMITH_GOLDEN_DIR")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/golden"), PathBuf::from);
    let Ok(entries) = std::fs::read_dir(&folder) else {
        eprintln!("skipped: no golden vectors at {}", folder.display());
        return Vec::new();
    };
    let mut paths: Vec<PathBuf> = entries
        .map(|entry| entry.expect("golden folder is readable").path())
        .filter(|path| path.to_string_lossy().ends_with("_golden.npz"))
        .collect();
    paths.sort();
    assert!(!paths.is_empty(), "{} holds no *_golden.npz", folder.display());
    paths.iter().map(|path| Case::read(path)).collect()
}

impl Case {
    fn read(path: &Path) -> Self {
        let name = path.file_name().expect("file name").to_string_lossy();
        let arrays = Arrays::read(&std::fs::read(path).expect("golden file reads")).expect("golden file is npz");
        let folder = path.parent().expect("a folder").to_owned();
        Self { id: name.trim_end_matches("_golden.npz").to_owned(), arrays, folder }
    }

    /// The mesh before remeshing, in raw coordinates and double precision, if the case has one.
    pub fn original_mesh(&self) -> Option<Mesh> {
        let text = std::fs::read_to_string(self.folder.join(format!("{}_ori.obj", self.id))).ok()?;
        let mut mesh = Mesh::default();
        for line in text.lines() {
            let words: Vec<&str> = line.split_whitespace().collect();
            let number = |word: &str| word.parse::<f64>().expect("a coordinate");
            let corner = |word: &str| word.split('/').next().and_then(|v| v.parse::<u32>().ok()).expect("a corner") - 1;
            match words[..] {
                ["v", x, y, z, ..] => mesh.positions.push(DVec3::new(number(x), number(y), number(z))),
                ["f", first, ref others @ ..] => {
                    let fan = others.windows(2).map(|pair| [first, pair[0], pair[1]].map(corner));
                    mesh.triangles.extend(fan);
                }
                _ => {}
            }
        }
        Some(mesh)
    }

    fn array(&self, name: &str) -> &Array {
        self.arrays.get(name).unwrap_or_else(|error| panic!("case {}: {error}", self.id))
    }

    pub fn shape(&self, name: &str) -> &[usize] {
        &self.array(name).shape
    }

    /// The array flattened in C order.
    pub fn f64s(&self, name: &str) -> Vec<f64> {
        self.array(name).to_f64()
    }

    pub fn f32s(&self, name: &str) -> Vec<f32> {
        self.f64s(name).into_iter().map(|value| value as f32).collect()
    }

    /// An integer array; negative entries (parents) stay negative.
    pub fn ints(&self, name: &str) -> Vec<i64> {
        self.f64s(name).into_iter().map(|value| value as i64).collect()
    }

    pub fn scalar(&self, name: &str) -> f64 {
        self.f64s(name)[0]
    }

    /// An `[N, 3]` array as points.
    pub fn points(&self, name: &str) -> Vec<DVec3> {
        self.f64s(name).chunks_exact(3).map(DVec3::from_slice).collect()
    }

    /// An `[N, 3]` index array as triangles.
    pub fn triangles(&self, name: &str) -> Vec<[u32; 3]> {
        self.ints(name).chunks_exact(3).map(|corner| [corner[0] as u32, corner[1] as u32, corner[2] as u32]).collect()
    }

    /// A bit array packed most significant bit first, cut to `count` bits.
    pub fn bits(&self, name: &str, count: usize) -> Vec<bool> {
        let packed = self.ints(name);
        (0..count).map(|bit| packed[bit / 8] >> (7 - bit % 8) & 1 == 1).collect()
    }
}
