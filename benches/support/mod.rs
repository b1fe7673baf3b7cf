//! Helpers that the benchmarks share: CPU time, percentiles, and medians of several
//! runs.

#![allow(dead_code, reason = "each benchmark uses a part of it")]

use std::time::Duration;

#[path = "server.rs"]
pub(crate) mod server;
#[path = "terminal.rs"]
pub(crate) mod terminal;

/// Returns the CPU time of this process so far, summed over all threads that still run
/// (Linux).
pub(crate) fn cpu_time() -> Duration {
    let tasks = std::fs::read_dir("/proc/self/task").expect("a Linux /proc");
    let nanos = tasks.map(|task| {
        let path = task.expect("a thread").path().join("schedstat");
        // A thread may have ended since the directory was read.
        let text = std::fs::read_to_string(path).unwrap_or_default();
        text.split(' ').next().and_then(|nanos| nanos.parse().ok()).unwrap_or(0)
    });
    Duration::from_nanos(nanos.sum())
}

/// Sorts the values, and returns the smallest that a `share` of them, 0.0..=1.0, does not
/// exceed.
pub(crate) fn percentile<T: Copy + Ord>(values: &mut [T], share: f64) -> T {
    values.sort_unstable();
    let place = (values.len() as f64 * share).ceil() as usize;
    values[place.clamp(1, values.len()) - 1]
}

/// Returns the median.
pub(crate) fn median(figures: impl IntoIterator<Item = f64>) -> f64 {
    let mut figures: Vec<f64> = figures.into_iter().collect();
    figures.sort_unstable_by(f64::total_cmp);
    figures[figures.len() / 2]
}

/// Returns microseconds, for a table.
pub(crate) fn us(time: Duration) -> f64 {
    time.as_secs_f64() * 1e6
}

/// Returns how often the threads of this process that still run have waited, so far
/// (Linux).
pub(crate) fn wake_ups() -> u64 {
    let tasks = std::fs::read_dir("/proc/self/task").expect("a Linux /proc");
    let counts = tasks.map(|task| {
        let path = task.expect("a thread").path().join("status");
        // A thread may have ended since the directory was read.
        let text = std::fs::read_to_string(path).unwrap_or_default();
        let mut lines = text.lines();
        let count = lines.find_map(|line| line.strip_prefix("voluntary_ctxt_switches:"));
        count.and_then(|count| count.trim().parse::<u64>().ok()).unwrap_or(0)
    });
    counts.sum()
}
