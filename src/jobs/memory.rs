//! How much memory a job needs: expected before it starts, watched while it runs.

use super::failure::{ErrorCode, JobError, PassedLimit};
use super::job::FileInfo;

const MIB: u64 = 1 << 20;

/// What any job needs, however small its mesh: networks at work, the voxel grid, the working mesh at its largest.
const WORK_BYTES: u64 = 256 * MIB;
/// Memory per byte of a mesh file: the file itself, the scene read from it, and the files written.
const PER_MESH_BYTE: u64 = 8;
/// Memory per byte of a packed file. Its content may be larger, but is bounded by the same limits.
const PER_PACKED_BYTE: u64 = 12;
/// Memory per byte of what is only carried along: read once, written once.
const PER_CARRIED_BYTE: u64 = 3;

/// Memory that rigging `files` (the main one first) is expected to need at most, beside what the idle service has.
pub fn expected_bytes(files: &[FileInfo]) -> u64 {
    let needed = files.iter().enumerate().map(|(index, file)| {
        let name = file.name.to_lowercase();
        let per_byte = match index {
            0 if [".zip", ".fbx"].iter().any(|packed| name.ends_with(packed)) => PER_PACKED_BYTE,
            0 => PER_MESH_BYTE,
            _ => PER_CARRIED_BYTE,
        };
        file.bytes.saturating_mul(per_byte)
    });
    needed.fold(WORK_BYTES, u64::saturating_add)
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
