//! Output formats for scans, times and other data, for people and for programs.

pub(crate) mod csv;
pub(crate) mod summary;
pub(crate) mod svg;
pub(crate) mod table;
pub(crate) mod time;

use serde::Serialize;

use crate::failure::Failure;

/// Lists the counts above 0, such as `3 malformed, 1 refused`.
pub(crate) fn listed(counts: &[(u64, &str)]) -> String {
    let counts = counts.iter().filter(|(count, _)| *count > 0);
    counts.map(|(count, what)| format!("{count} {what}")).collect::<Vec<_>>().join(", ")
}

/// Formats how much faster than the computer's a clock runs, in parts per million.
pub(crate) fn pace(ppm: f64) -> String {
    let pace = if ppm < 0.0 { "slow" } else { "fast" };
    format!("{:.2} % {pace}", ppm.abs() / 1e4)
}

/// Formats a count with its noun, such as `1 scan` or `2 scans`.
pub(crate) fn counted(count: u64, noun: &str) -> String {
    let ending = if count == 1 { "" } else { "s" };
    format!("{count} {noun}{ending}")
}

/// Serializes `data` as one line of JSON, which ends in LF.
pub(crate) fn json_line(data: &impl Serialize) -> Result<String, Failure> {
    let line = serde_json::to_string(data);
    line.map(|line| line + "\n").map_err(|error| Failure::new("cannot write JSON", &error))
}
