//! The truth about each scan: its data identify the `G` that it answers.

use std::sync::{Arc, Mutex};

use tokio::time::Instant;
use tokio_scip::{Scan, Window};
use urg_emulator::{Values, World, WorldTime};

/// Times at which the sensor measured for each `G`.
#[derive(Clone, Default)]
pub(crate) struct SimulationTruth(Arc<Mutex<Vec<Instant>>>);

/// Returns the value for a `G` and a step; two scans differ nearly everywhere.
///
/// A hash without a division, which the compiler turns into vector instructions: most of
/// the values of a simulation are computed twice.
fn value(request: u64, step: usize) -> u32 {
    let mixed =
        (request as u32).wrapping_mul(0x9e37_79b1) ^ (step as u32).wrapping_mul(0x85eb_ca6b);
    let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0xc2b2_ae35);
    30 + (((mixed >> 16) * 4000) >> 16)
}

/// Returns true if a scan has the values of this request.
fn is_of(scan: &Timed, request: u64) -> bool {
    let Timed { window, values, .. } = scan;
    let (start, end) = (usize::from(window.start()), usize::from(window.end()));
    let cluster = usize::from(window.cluster_count());
    let firsts = (start..=end).step_by(cluster);
    values.len() == window.points()
        && firsts.zip(values).all(|(first, found)| {
            let steps = first..=end.min(first + cluster - 1);
            steps.map(|step| value(request, step)).min() == Some(*found)
        })
}

/// A scan with the time of its request and of its reply.
pub(crate) struct Timed {
    pub(crate) window: Window,
    pub(crate) values: Vec<u32>,
    pub(crate) sent: Instant,
    pub(crate) received: Instant,
}

impl From<&Scan> for Timed {
    fn from(scan: &Scan) -> Self {
        let (sent, received) = (scan.times().requested_at, scan.received_at());
        Self { window: scan.window(), values: scan.raw_values().collect(), sent, received }
    }
}

impl SimulationTruth {
    pub(crate) fn world(&self) -> impl World + 'static {
        let requests = Arc::clone(&self.0);
        move |time: WorldTime, codes: &mut Values| {
            let mut requests = requests.lock().unwrap();
            // A scan that was not sent has the number of the next one.
            requests.truncate(time.request as usize);
            assert_eq!(requests.len() as u64, time.request);
            requests.push(Instant::now());
            for (step, slot) in codes.iter_mut().enumerate() {
                *slot = value(time.request, step);
            }
        }
    }

    /// When the scan with this number was sent.
    pub(crate) fn measured_at(&self, request: u64) -> Instant {
        self.0.lock().unwrap()[request as usize]
    }

    /// Returns the number of the scan that a sensor of SCIP 2 sent. Fails unless that was measured
    /// before it was received, and each value is right.
    pub(crate) fn find(&self, scan: &Timed) -> Result<u64, String> {
        let requests = self.0.lock().unwrap();
        let until = requests.partition_point(|at| *at <= scan.received) as u64;
        let found = (0..until).rev().find(|request| is_of(scan, *request));
        found.ok_or_else(|| format!("{:?} for {} is no scan", scan.values, scan.window))
    }

    /// Returns the `G` that the scan answers, and how many of its values are damaged.
    /// Fails unless that is the `G` of its own request and at most `flips` values are
    /// damaged: no driver can detect a bit that makes another value.
    pub(crate) fn check(&self, scan: &Timed, flips: usize) -> Result<(u64, usize), String> {
        let &Timed { window, ref values, sent, received } = scan;
        let cluster = usize::from(window.cluster_count());
        if values.len() != window.points() {
            return Err(format!("{} values for {window}", values.len()));
        }
        let start = usize::from(window.start());
        let end = usize::from(window.end());
        let expected = |request: u64| {
            (start..=end).step_by(cluster).map(move |first| {
                (first..=end.min(first + cluster - 1)).map(|step| value(request, step)).min()
            })
        };
        let wrong = |request: u64| {
            if cluster == 1 {
                let pairs = values.iter().enumerate();
                return pairs.filter(|(at, found)| value(request, start + at) != **found).count();
            }
            let pairs = expected(request).zip(values);
            pairs.filter(|(expected, value)| *expected != Some(**value)).count()
        };
        let requests = self.0.lock().unwrap();
        // The scans that the sensor served between request and reply.
        let from = requests.partition_point(|at| *at < sent);
        let until = requests.partition_point(|at| *at <= received);
        let found = |range: std::ops::Range<usize>| {
            let wrongs = range.rev().map(|request| (request as u64, wrong(request as u64)));
            wrongs.into_iter().find(|(_, wrong)| *wrong <= flips)
        };
        found(from..until).ok_or_else(|| {
            // For the message: it may be one of the last few hundred.
            let whose = found(from.saturating_sub(500)..from);
            format!("{values:?} for {window} are of {whose:?}: only {from}..{until} were served meanwhile")
        })
    }
}
