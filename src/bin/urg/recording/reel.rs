//! [`Reel`]: the scans of a recording by number. The latest scans are kept, so that a
//! step back costs nothing. A place farther away is read from there: in a complete file
//! that takes the same time forward and back, however far it is.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use tokio_scip::Scan;
use tokio_scip::recording::{RecordedScans, RecordingError};

use super::recorded::Recorded;
use crate::failure::Failure;

/// The scans behind the current one that are kept: 50 seconds, 700 kB.
const KEPT_SCANS: usize = 500;
/// Up to so many scans farther on the file is read on.
const MAX_READ_ON: usize = 100;
/// After a jump so many scans before the place are read, for steps back from there.
const READ_BEFORE: usize = 50;

/// A recording, and the place to which it was read. All of it blocks.
#[derive(Debug)]
pub(crate) struct Reel {
    recorded: Recorded,
    /// The time of each scan since the file's first one, which need not be in the part
    /// that is played.
    positions: Vec<Duration>,
    scans: RecordedScans,
    /// The number of the scan that `scans` returns next.
    next: usize,
    /// The last ones that it has returned.
    kept: VecDeque<Scan>,
}

impl Reel {
    /// Reads the times of all scans. Fails if there is none.
    pub(crate) fn open(recorded: Recorded) -> Result<Self, Failure> {
        let mut positions = Vec::new();
        let mut scans = recorded.open()?.scans();
        while next_scan(&mut scans, &recorded)?.is_some() {
            positions.push(scans.position());
        }
        if positions.is_empty() {
            return Err(recorded.no_scans(&RecordingError::NoReplies));
        }
        let scans = recorded.open()?.scans();
        Ok(Self { recorded, positions, scans, next: 0, kept: VecDeque::new() })
    }

    /// Returns the time of each scan since the first one.
    pub(crate) fn times(&self) -> Arc<[Duration]> {
        let first = self.positions.first().copied().unwrap_or_default();
        self.positions.iter().map(|position| position.saturating_sub(first)).collect()
    }

    /// Returns the scan of this number. Fails if the file cannot be read up to it.
    pub(crate) fn scan(&mut self, number: usize) -> Result<Scan, Failure> {
        let is_before = number + self.kept.len() < self.next;
        if is_before || number > self.next + MAX_READ_ON {
            self.jump(number.saturating_sub(READ_BEFORE))?;
        }
        while self.next <= number {
            let scan = next_scan(&mut self.scans, &self.recorded)?;
            let scan =
                scan.filter(|_| Some(&self.scans.position()) == self.positions.get(self.next));
            let scan = scan.ok_or_else(|| {
                Failure::Failed(format!(
                    "{0}: scan {number} is not where it was: the file was changed while it was \
                     read, or its index is wrong, and `urg repair {0}` writes another one",
                    self.recorded
                ))
            })?;
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

    /// Continues to read at the scan of this number, or at an earlier one.
    fn jump(&mut self, number: usize) -> Result<(), Failure> {
        self.kept.clear();
        // Where times do not only rise they are no places, and without a recorded window
        // the stream is that of the file's first poll.
        if !self.positions.is_sorted() || self.recorded.window().is_none() {
            (self.scans, self.next) = (self.recorded.open()?.scans(), 0);
            return Ok(());
        }
        let place = self.positions.get(number).copied().unwrap_or_default();
        // Of scans of the same time the first one.
        self.next = self.positions.partition_point(|position| *position < place);
        self.scans = self.recorded.open_at(place)?.scans().numbered_from(self.next as u64);
        Ok(())
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

#[cfg(test)]
mod tests {
    use tokio_scip::emulator::{Emulator, Values, WorldTime};
    use tokio_scip::recording::Recorder;
    use tokio_scip::{Rate, Sensor, Window};

    use super::*;

    /// Records so many scans, each of which has its number in all of its steps.
    async fn recorded(path: &std::path::Path, count: u64) -> Recorded {
        let world = |look: WorldTime, values: &mut Values| values.fill(20 + look.request as u16);
        let emulator = Emulator::builder().usb().world(world).build();
        let mut recorder = Recorder::builder().create(path).unwrap();
        let builder = Sensor::builder().on_reply(recorder.observer()).ring_depth(1 << 12);
        let sensor = builder.connect(emulator).await.unwrap();
        let window = Window::new(300..=310).unwrap();
        let mut scans = sensor.scans(window, Rate::hz(10.0)).await.unwrap();
        recorder.describe(&sensor, &scans).await.unwrap();
        for _ in 0..count {
            recorder.record(&scans.next().await.unwrap()).unwrap();
        }
        recorder.finish().await.unwrap();
        let mut recorded = Recorded::named(path.to_str().unwrap()).unwrap().unwrap();
        recorded.read_settings().unwrap();
        recorded
    }

    #[tokio::test(start_paused = true)]
    async fn a_jump_forward_finds_its_scan_without_reading_those_before_it() {
        let path = std::env::temp_dir().join(format!("urg-reel-{}.mcap", std::process::id()));
        let recorded = recorded(&path, 2000).await;
        let all: Vec<_> = recorded.open().unwrap().scans().map(Result::unwrap).collect();
        let mut reel = Reel::open(recorded).unwrap();
        // Damage shows that it was read: the number of a scan would be another one. A slow
        // machine writes more and smaller chunks: it is wider than one of them.
        let mut bytes = std::fs::read(&path).unwrap();
        let quarter = bytes.len() / 4;
        bytes[quarter..quarter + 3000].iter_mut().step_by(50).for_each(|byte| *byte ^= 1);
        std::fs::write(&path, bytes).unwrap();
        for number in [0, 1000, 1001, 999, 1999, 1500, 1200, 1101, 1999] {
            let scan = reel.scan(number).unwrap();
            assert_eq!(scan.sequence(), number as u64);
            assert_eq!(scan.values(), all[number].values(), "{number}");
        }
        let error = (400..600).find_map(|number| reel.scan(number).err()).unwrap();
        assert!(error.line().contains("urg repair"), "{error:?}");
        std::fs::remove_file(&path).unwrap();
    }
}
