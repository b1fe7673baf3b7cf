//! [`Reel`]: the scans of a recording by number. The file can be read from its
//! beginning only, so the latest scans are kept: a step back costs nothing, a long
//! way back reads the file again.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use tokio_scip::Scan;
use tokio_scip::recording::{RecordedScans, RecordingError};

use super::recorded::Recorded;
use crate::failure::Failure;

/// The scans behind the current one that are kept: 50 seconds, 700 kB.
const KEPT_SCANS: usize = 500;

/// A recording, and the place to which it was read. All of it blocks.
#[derive(Debug)]
pub(crate) struct Reel {
    recorded: Recorded,
    times: Arc<[Duration]>,
    scans: RecordedScans,
    /// The number of the scan that `scans` returns next.
    next: usize,
    /// The last ones that it has returned.
    kept: VecDeque<Scan>,
}

impl Reel {
    /// Reads the times of all scans. Fails if there is none.
    pub(crate) fn open(recorded: Recorded) -> Result<Self, Failure> {
        let (mut times, mut first) = (Vec::new(), None);
        let mut scans = recorded.open()?.scans();
        while let Some(scan) = next_scan(&mut scans, &recorded)? {
            let first = *first.get_or_insert(scan.received_at());
            times.push(scan.received_at().saturating_duration_since(first));
        }
        if times.is_empty() {
            return Err(recorded.no_scans(&RecordingError::NoReplies));
        }
        let scans = recorded.open()?.scans();
        Ok(Self { recorded, times: times.into(), scans, next: 0, kept: VecDeque::new() })
    }

    /// Returns the time of each scan since the first one.
    pub(crate) fn times(&self) -> Arc<[Duration]> {
        Arc::clone(&self.times)
    }

    /// Returns the scan of this number. Fails if the file cannot be read up to it.
    pub(crate) fn scan(&mut self, number: usize) -> Result<Scan, Failure> {
        if number + self.kept.len() < self.next {
            self.scans = self.recorded.open()?.scans();
            self.next = 0;
            self.kept.clear();
        }
        while self.next <= number {
            let Some(scan) = next_scan(&mut self.scans, &self.recorded)? else {
                let text = format!("{}: the file was changed while it was read", self.recorded);
                return Err(Failure::Failed(text));
            };
            self.next += 1;
            self.kept.push_back(scan);
            if self.kept.len() > KEPT_SCANS {
                self.kept.pop_front();
            }
        }
        let place = (number + self.kept.len()).checked_sub(self.next);
        let scan = place.and_then(|place| self.kept.get(place)).cloned();
        scan.ok_or_else(|| Failure::Failed(format!("{}: no scan {number}", self.recorded)))
    }
}

/// Returns the next scan. A damaged part of the file is left out, as in a replay.
fn next_scan(scans: &mut RecordedScans, recorded: &Recorded) -> Result<Option<Scan>, Failure> {
    for scan in scans {
        match scan {
            Ok(scan) => return Ok(Some(scan)),
            Err(error @ RecordingError::Damaged { .. }) => {
                tracing::warn!(%error, "the playback leaves out a part of the recording");
            }
            Err(error) => return Err(recorded.no_scans(&error)),
        }
    }
    Ok(None)
}
