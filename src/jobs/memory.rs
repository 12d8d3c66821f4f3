//! How much memory a job needs: expected before it starts, watched while it runs.

use super::failure::{ErrorCode, JobError, PassedLimit};
use super::job::FileInfo;

const MIB: u64 = 1 << 20;

/// What any job needs beside the idle service, however small its mesh: networks at work, and the working mesh, whose
/// size is bounded. Measured: 132 MiB.
const WORK_BYTES: u64 = 144 * MIB;
/// Memory per byte of any file: read once, kept in the scene, written once.
const PER_BYTE: u64 = 3;
/// Memory per byte of geometry, beside [`PER_BYTE`]. Measured with both: 8.2 for a GLB, 4.3 to 6.1 for an OBJ, of half a
/// million faces each (`docs/reliability.md`).
const PER_BINARY_BYTE: u64 = 6;
const PER_TEXT_BYTE: u64 = 4;
/// A packed file may hold a text of many times its size.
const PER_PACKED_BYTE: u64 = 40;
/// What the largest mesh that the readers accept needs: two million faces, four times those that were measured.
const GEOMETRY_BYTES_MAX: u64 = 384 * MIB;
/// What the FBX reader may allocate beside that.
const FBX_BYTES_MAX: u64 = 512 * MIB;

/// Memory that rigging `files` (the main one first) is expected to need at most, beside what the idle service has.
pub fn expected_bytes(files: &[FileInfo]) -> u64 {
    let all = files.iter().fold(0, |sum: u64, file| sum.saturating_add(file.bytes)).saturating_mul(PER_BYTE);
    let geometry = files.first().map_or(0, |main| {
        let (_, extension) = main.name.rsplit_once('.').unwrap_or_default();
        let (per_byte, most) = match extension.to_lowercase().as_str() {
            "obj" => (PER_TEXT_BYTE, GEOMETRY_BYTES_MAX),
            "fbx" => (PER_PACKED_BYTE, GEOMETRY_BYTES_MAX + FBX_BYTES_MAX),
            "glb" | "stl" | "ply" => (PER_BINARY_BYTE, GEOMETRY_BYTES_MAX),
            // Archives, glTF with its buffers beside it, and names that do not tell.
            _ => (PER_PACKED_BYTE, GEOMETRY_BYTES_MAX),
        };
        main.bytes.saturating_mul(per_byte).min(most)
    });
    WORK_BYTES.saturating_add(all).saturating_add(geometry)
}

/// The refusal of a job that needs more than there is.
pub fn too_much(needed: u64, max: u64) -> JobError {
    let limit = PassedLimit { name: "memory_bytes".into(), max, actual: Some(needed) };
    let message = format!("the job needs about {} MiB of memory; jobs get {} MiB", needed / MIB, max / MIB);
    let error = JobError::new(ErrorCode::OutOfMemory, message).hint("decimate the mesh, or make its textures smaller");
    JobError { limit: Some(limit), ..error }
}

/// The end of a job that took more than there is.
pub fn took_too_much(taken: u64, max: u64) -> JobError {
    let limit = PassedLimit { name: "memory_bytes".into(), max, actual: Some(taken) };
    let message = format!("the work took {} MiB of memory; jobs get {} MiB", taken / MIB, max / MIB);
    let error = JobError::new(ErrorCode::OutOfMemory, message).hint("decimate the mesh, or make its textures smaller");
    JobError { limit: Some(limit), ..error }
}

/// Memory of this process that is in physical memory now; `None` where the system does not tell.
pub fn resident_bytes() -> Option<u64> {
    // Pages; the size of a page is 4 KiB on every system that has this file and that we build for, but for some ARM
    // kernels, where the value is then taken for too small.
    const PAGE_BYTES: u64 = 4096;
    let status = std::fs::read_to_string("/proc/self/statm").ok()?;
    let pages: u64 = status.split_whitespace().nth(1)?.parse().ok()?;
    Some(pages * PAGE_BYTES)
}

/// Three quarters of the memory of this machine or container; `None` where the system does not tell.
pub fn machine_share() -> Option<u64> {
    let info = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = info.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let machine = line.split_whitespace().next()?.parse::<u64>().ok()?.saturating_mul(1024);
    let group = std::fs::read_to_string("/sys/fs/cgroup/memory.max").ok().and_then(|text| text.trim().parse().ok());
    Some(group.unwrap_or(machine).min(machine) / 4 * 3)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expected(name: &str, bytes: u64) -> u64 {
        expected_bytes(&[FileInfo { name: name.into(), bytes, sha256: [0; 32] }]) / MIB
    }

    #[test]
    fn the_expectation_covers_what_was_measured_and_little_more() {
        // Peak beside the idle service, in MiB, of the files in docs/reliability.md.
        for (name, bytes, measured) in
            [("s0.glb", 144_644, 132), ("s3.glb", 9_209_852, 207), ("s3.obj", 18_759_701, 247)]
        {
            let expected = expected(name, bytes);
            assert!(expected >= measured && expected <= measured * 3 / 2, "{name}: {expected} for {measured}");
        }
    }

    #[test]
    fn the_largest_upload_of_any_format_fits_the_default_bound() {
        for name in ["a.glb", "a.obj", "a.fbx", "a.zip", "a"] {
            let expected = expected(name, 100 << 20);
            assert!((600..2048).contains(&expected), "{name}: {expected}");
        }
    }

    #[test]
    fn the_process_knows_its_memory() {
        if cfg!(target_os = "linux") {
            assert!(resident_bytes().is_some_and(|bytes| bytes > MIB));
            assert!(machine_share().is_some_and(|bytes| bytes > MIB));
        }
    }
}
