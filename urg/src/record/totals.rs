//! [`RecordTotals`]: what `urg record` says of a recording, while it runs and at its end.

use std::fmt::Write as _;
use std::time::Duration;

use bytesize::ByteSize;
use urg_recording::Progress;

use crate::format::counted;
use crate::format::time::clock;
use crate::recording::contents::ScanTimes;
use crate::stream::reporter::Reporter;

/// Counts for the progress line and the final notice.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct RecordTotals {
    progress: Progress,
    /// Scans that are in the file only as replies.
    missed: u64,
    /// Polls without a scan over a working link.
    failed: u64,
    /// Scans of a stream that did not arrive whole, as the sensor's clock tells.
    lost_on_the_way: u64,
    /// Polls that were not sent in time.
    skipped: u64,
    gaps: u64,
    disconnects: u64,
}

impl RecordTotals {
    pub(crate) fn new(progress: Progress, reporter: &Reporter, times: &ScanTimes) -> Self {
        let stats = reporter.sensor.stats();
        let (missed, failed, gaps) = (reporter.missed, reporter.failed, times.gaps.len() as u64);
        let (skipped, disconnects) = (stats.polls_skipped, stats.disconnects);
        // Damage has an error as well.
        let lost_on_the_way = stats.lost.saturating_sub(failed);
        Self { progress, missed, failed, lost_on_the_way, skipped, gaps, disconnects }
    }

    /// Formats the counts of a recording of this length.
    pub(crate) fn after(self, length: Duration) -> String {
        let Self { progress, missed, failed, lost_on_the_way, skipped, gaps, disconnects } = self;
        let Progress { scans, bytes, files, lost, lost_replies, late_syncs, .. } = progress;
        let scans = counted(scans + missed, "scan");
        let mut text = format!("{scans} in {}, ", clock(length.as_secs_f64()));
        // Writing to a `String` is infallible.
        let _ = write!(text, "{:.1}", ByteSize(bytes).display().si());
        if files > 1 {
            let _ = write!(text, " in {files} files");
        }
        if lost + lost_replies + failed + lost_on_the_way + skipped + gaps == 0 {
            text.push_str(", none lost");
        }
        for (count, one, more) in [
            (lost, "lost", "lost"),
            (lost_replies, "reply lost", "replies lost"),
            (failed, "poll without a scan", "polls without a scan"),
            (lost_on_the_way, "lost on the way", "lost on the way"),
            (skipped, "poll skipped", "polls skipped"),
            (gaps, "gap", "gaps"),
            (disconnects, "disconnect", "disconnects"),
            (late_syncs, "late sync", "late syncs"),
        ] {
            if count > 0 {
                let _ = write!(text, ", {count} {}", if count == 1 { one } else { more });
            }
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_time_size_and_losses() {
        let mut totals = RecordTotals::default();
        (totals.progress.scans, totals.progress.bytes) = (598, 2_345_678);
        assert_eq!(totals.after(Duration::from_secs(61)), "598 scans in 1:01, 2.3 MB, none lost");
        assert!(totals.after(Duration::from_secs(3601)).starts_with("598 scans in 1:00:01, "));
        (totals.progress.bytes, totals.failed) = (13_999, 1);
        let failed = "598 scans in 0:09, 14.0 kB, 1 poll without a scan";
        assert_eq!(totals.after(Duration::from_secs(9)), failed);
        let mut progress = Progress::default();
        (progress.scans, progress.bytes, progress.files) = (3, 13_999, 2);
        (progress.lost, progress.lost_replies, progress.late_syncs) = (1, 5, 7);
        let bad = RecordTotals {
            progress,
            missed: 1,
            failed: 4,
            lost_on_the_way: 2,
            skipped: 40,
            gaps: 1,
            disconnects: 1,
        };
        assert_eq!(
            bad.after(Duration::from_millis(999)),
            "4 scans in 0:00, 14.0 kB in 2 files, 1 lost, 5 replies lost, 4 polls without a scan, \
             2 lost on the way, 40 polls skipped, 1 gap, 1 disconnect, 7 late syncs"
        );
    }
}
