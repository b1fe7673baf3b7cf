//! [`RecordTotals`]: what `urg record` says of a recording, while it runs and at its end.

use std::fmt::Write as _;
use std::time::Duration;

use tokio_scip::recording::Recorder;

use crate::format::time::clock;
use crate::stream::reporter::Reporter;

/// Counts for the progress line and the final notice.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct RecordTotals {
    pub(crate) scans: u64,
    pub(crate) bytes: u64,
    pub(crate) files: u64,
    /// Received scans that are missing from the file.
    lost: u64,
    /// Received replies that are missing from the file, and so from a replay.
    lost_replies: u64,
    /// Polls without a scan over a working link.
    failed: u64,
    disconnects: u64,
    /// Syncs that took longer than `--sync`.
    pub(crate) late_syncs: u64,
}

impl RecordTotals {
    pub(crate) fn new(recorder: &Recorder, reporter: &Reporter) -> Self {
        let progress = recorder.progress();
        Self {
            scans: progress.scans,
            bytes: progress.bytes,
            files: progress.files,
            // A missed scan is in the file only as a reply.
            lost: progress.lost + reporter.missed,
            lost_replies: progress.lost_replies,
            failed: reporter.failed,
            disconnects: reporter.sensor.stats().disconnects,
            late_syncs: progress.late_syncs,
        }
    }

    pub(crate) fn after(self, elapsed: Duration) -> String {
        let Self { scans, bytes, files, lost, lost_replies, failed, disconnects, late_syncs } =
            self;
        let noun = if scans == 1 { "scan" } else { "scans" };
        let mut text = format!("{scans} {noun} in {}, ", clock(elapsed.as_secs_f64()));
        text.push_str(&match bytes {
            0..1_000_000 => format!("{} kB", bytes / 1000),
            _ => format!("{:.1} MB", bytes as f64 / 1e6),
        });
        if files > 1 {
            // Writing to a `String` is infallible.
            let _ = write!(text, " in {files} files");
        }
        text.push_str(&match lost {
            0 => ", none lost".to_owned(),
            lost => format!(", {lost} lost"),
        });
        if lost_replies > 0 {
            let _ = write!(text, ", {lost_replies} replies lost");
        }
        if failed > 0 {
            let _ = write!(text, ", {failed} polls without a scan");
        }
        if disconnects > 0 {
            let _ = write!(text, ", link lost {disconnects}x");
        }
        if late_syncs > 0 {
            let _ = write!(text, ", {late_syncs} late syncs");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_the_time_the_size_and_what_is_missing() {
        let good = RecordTotals { scans: 598, bytes: 2_345_678, ..RecordTotals::default() };
        assert_eq!(good.after(Duration::from_secs(61)), "598 scans in 1:01, 2.3 MB, none lost");
        assert!(good.after(Duration::from_secs(3601)).starts_with("598 scans in 1:00:01, "));
        let bad = RecordTotals {
            scans: 3,
            bytes: 13_999,
            files: 2,
            lost: 2,
            lost_replies: 5,
            failed: 4,
            disconnects: 1,
            late_syncs: 7,
        };
        assert_eq!(
            bad.after(Duration::from_millis(999)),
            "3 scans in 0:00, 13 kB in 2 files, 2 lost, 5 replies lost, 4 polls without a scan, link lost 1x, 7 late syncs"
        );
    }
}
