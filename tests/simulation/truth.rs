//! What the sensor really saw: each scan's data tells which `G` it answers.

use std::sync::{Arc, Mutex};

use tokio::time::Instant;
use tokio_scip::Scan;
use tokio_scip::emulator::{Values, World, WorldTime};

/// When the sensor looked at the world for each `G`.
#[derive(Clone, Default)]
pub(crate) struct Truth(Arc<Mutex<Vec<Instant>>>);

/// A value for each `G` and step, such that two scans differ nearly everywhere.
fn code(request: u64, step: usize) -> u16 {
    let step = step as u64;
    20 + ((request * 1009 + step * 31 + request * step % 97) % 4000) as u16
}

impl Truth {
    pub(crate) fn world(&self) -> impl World + 'static {
        let looks = Arc::clone(&self.0);
        move |look: WorldTime, codes: &mut Values| {
            let mut looks = looks.lock().unwrap();
            assert_eq!(looks.len() as u64, look.request);
            looks.push(Instant::now());
            for (step, slot) in codes.iter_mut().enumerate() {
                *slot = code(look.request, step);
            }
        }
    }

    /// Which `G` the scan answers, if that is the very one that it was asked
    /// for with. `flips` allows for so many wrong values, whose damage nobody can
    /// see.
    pub(crate) fn check(&self, scan: &Scan, flips: usize) -> Result<u64, String> {
        let (window, cluster) = (scan.window(), usize::from(scan.window().cluster_count()));
        if scan.values().len() != window.points() {
            return Err(format!("{} values for {window}", scan.values().len()));
        }
        let start = usize::from(window.start().number());
        let end = usize::from(window.end().number());
        let expected = |request: u64| {
            (start..=end).step_by(cluster).map(move |first| {
                (first..=end.min(first + cluster - 1)).map(|step| code(request, step)).min()
            })
        };
        let wrong = |request: u64| {
            let pairs = expected(request).zip(scan.values());
            pairs.filter(|(expected, value)| *expected != Some(**value)).count()
        };
        let looks = self.0.lock().unwrap();
        let (sent, received) = (scan.requested_at(), scan.received_at());
        // Those that the sensor served while this one was waited for.
        let from = looks.partition_point(|at| *at < sent);
        let until = looks.partition_point(|at| *at <= received);
        (from..until).map(|request| request as u64).find(|&request| wrong(request) <= flips).ok_or_else(
            || {
                let whose = (0..looks.len() as u64).rev().find(|&request| wrong(request) <= flips);
                format!(
                    "the data of {whose:?} for {window}, where only {from}..{until} were served meanwhile: {:?}",
                    scan.values()
                )
            },
        )
    }
}
