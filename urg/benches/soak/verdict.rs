//! The limits, and the verdict for each of them.

use std::collections::HashMap;

use crate::process::Sample;
use crate::viewers::ViewerCounts;

/// A kind of thing that a process holds.
struct Holding {
    name: &'static str,
    of: fn(&Sample) -> u64,
    /// The run fails if the highest sample of the last third of its time exceeds the highest of the
    /// first third by more than this.
    growth_limit: u64,
}

/// Those thirds of two hours are 80 minutes apart, 48,000 scans and 80 replugs: 1 MiB is 22
/// bytes a scan, or 13 KiB a replug.
const HOLDINGS: [Holding; 3] = [
    Holding { name: "KiB of memory", of: |sample| sample.resident_kib, growth_limit: 1024 },
    Holding { name: "file descriptors", of: |sample| sample.descriptors, growth_limit: 2 },
    Holding { name: "threads", of: |sample| sample.threads, growth_limit: 2 },
];
/// The samples of the first minute: buffers are not yet as large as they get.
const WARM_UP: usize = 6;

/// Counts of a run.
#[derive(Default)]
pub(crate) struct Outcome {
    /// Samples of the library's process and of `urg serve`.
    pub(crate) samples: Vec<[Sample; 2]>,
    pub(crate) replugs: u64,
    pub(crate) counts: HashMap<String, u64>,
    pub(crate) scans_in_files: u64,
    pub(crate) served: ViewerCounts,
    pub(crate) served_metrics: String,
}

impl Outcome {
    /// Prints a line for each limit, and returns whether all of them hold.
    pub(crate) fn report(&self) -> bool {
        let mut is_good = true;
        let mut check = |holds: bool, text: String| {
            println!("{} {text}", if holds { "ok      " } else { "EXCEEDED" });
            is_good &= holds;
        };
        let samples = self.samples.get(WARM_UP..).unwrap_or_default();
        let third = samples.len() / 3;
        for (place, process) in ["library", "serve"].into_iter().enumerate() {
            for Holding { name, of, growth_limit } in HOLDINGS {
                let most = |samples: &[[Sample; 2]]| {
                    samples.iter().map(|both| of(&both[place])).max().unwrap_or_default()
                };
                let first = most(&samples[..third]);
                let last = most(&samples[samples.len() - third..]);
                check(
                    third > 0 && last <= first + growth_limit,
                    format!(
                        "{process}: at most {first} {name} in the first third, {last} in the last"
                    ),
                );
            }
        }
        let count = |name: &str| self.counts[name];
        let (recorded, in_files) = (count("recorded"), self.scans_in_files);
        let files = count("files");
        check(
            recorded == in_files,
            format!("{recorded} scans recorded, {in_files} in {files} files"),
        );
        check(count("lost") == 0, format!("{} lost by the recorder", count("lost")));
        let (missed, opened) = (count("missed"), count("opened"));
        check(missed == 0, format!("{missed} missed by the recorder and the streams that keep up"));
        let slow = count("slow_missed");
        check(slow > 0, format!("{slow} missed by the slow stream; {opened} streams opened"));
        let replugs = self.replugs;
        let reconnects = [count("reconnects"), self.metric("urg_reconnects_total")];
        check(
            reconnects == [replugs; 2],
            format!("{replugs} replugs, {} and {} reconnects", reconnects[0], reconnects[1]),
        );
        let ViewerCounts { scans, missed, opened, ended } = self.served;
        check(
            ended == 0,
            format!("{ended} of the clients' {opened} connections ended by the server"),
        );
        println!("{scans} scans read by the clients, {missed} missed");
        let skipped = [count("skipped"), self.metric("urg_polls_skipped_total")];
        println!("{} and {} polls skipped", skipped[0], skipped[1]);
        println!("longest time without a scan: {} ms", count("longest_gap_ms"));
        is_good
    }

    fn metric(&self, name: &str) -> u64 {
        let value = self.served_metrics.lines().find_map(|line| line.strip_prefix(name)).unwrap();
        value.trim().parse().unwrap()
    }
}
