//! The one place that decides how the cores are shared: workers × threads never exceed them.

/// How many jobs run at the same time, and the threads of each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shares {
    pub workers: usize,
    pub threads: usize,
}

/// Shares `cores` cores as asked for, as far as they go: workers first, then the threads of each.
pub fn share(cores: usize, workers: usize, threads: Option<usize>) -> Shares {
    let cores = cores.max(1);
    let workers = workers.clamp(1, cores);
    let most = cores / workers;
    Shares { workers, threads: threads.unwrap_or(most).clamp(1, most) }
}

/// Cores that this process may use.
pub fn available() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn workers_times_threads_never_exceed_the_cores() {
        for cores in 0..20 {
            for workers in 0..25 {
                for threads in [None, Some(0), Some(1), Some(3), Some(100)] {
                    let Shares { workers, threads } = share(cores, workers, threads);
                    assert!(workers >= 1 && threads >= 1 && workers * threads <= cores.max(1));
                }
            }
        }
        assert_eq!(share(8, 2, None), Shares { workers: 2, threads: 4 });
        assert_eq!(share(8, 2, Some(1)), Shares { workers: 2, threads: 1 });
    }
}
