//! Random access to the scans of a recording, by number. A cache of the latest scans makes steps
//! back cheap. A jump uses the file's index, so its distance and direction do not matter. A file
//! without an index is read from the start.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use tokio_scip::{Scan, Version};
use urg_recording::{RecordedScans, RecordingError};

use super::recorded::Recorded;
use crate::failure::Failure;

/// Size of the cache, in scans: 50 seconds, 700 kB.
const KEPT_SCANS: usize = 500;
/// Maximum distance, in scans, that is read sequentially instead of by a jump.
const MAX_READ_ON: usize = 100;
/// Scans to read before the target of a jump, for steps back from there.
const READ_BEFORE: usize = 50;

/// Recording with a read position and a cache. All methods block.
#[derive(Debug)]
pub(crate) struct Reel {
    recorded: Recorded,
    /// Position of each scan, counted from the file's first scan, even if `--range` excludes that one.
    positions: Vec<Duration>,
    version: Version,
    scans: RecordedScans,
    /// Number of the next scan from `scans`.
    next: usize,
    /// Cache of the scans before `next`.
    kept: VecDeque<Scan>,
}

impl Reel {
    /// Opens the recording, and reads it once for the positions of all scans. Fails without one.
    pub(crate) fn open(recorded: Recorded) -> Result<Self, Failure> {
        let mut positions = Vec::new();
        let mut scans = recorded.open()?.scans();
        while next_scan(&mut scans).map_err(|error| recorded.no_scans(&error))?.is_some() {
            positions.push(scans.position());
        }
        if positions.is_empty() {
            let left_out = scans.recording().left_out().counts();
            let (topic, topics, others) = (recorded.topic().to_owned(), Vec::new(), Vec::new());
            let error = RecordingError::NoScans { topic, left_out, topics, others };
            return Err(recorded.no_scans(&error));
        }
        let version = scans.version();
        let scans = recorded.open()?.scans();
        Ok(Self { recorded, positions, version, scans, next: 0, kept: VecDeque::new() })
    }

    /// What the recording has of the sensor's version.
    pub(crate) fn version(&self) -> &Version {
        &self.version
    }

    /// Time of each scan since the first one. Never decreases: a scan with an earlier time gets
    /// the time of its predecessor.
    pub(crate) fn times(&self) -> Arc<[Duration]> {
        let first = self.positions.first().copied().unwrap_or_default();
        let latest = |latest: &mut Duration, position: &Duration| {
            *latest = position.saturating_sub(first).max(*latest);
            Some(*latest)
        };
        self.positions.iter().scan(Duration::ZERO, latest).collect()
    }

    /// Reads the scan with this number, from the cache or from the file.
    pub(crate) fn scan(&mut self, number: usize) -> Result<Scan, Failure> {
        let is_before = number + self.kept.len() < self.next;
        if is_before || number > self.next + MAX_READ_ON {
            self.jump(number.saturating_sub(READ_BEFORE))?;
        }
        while self.next <= number {
            let scan = match next_scan(&mut self.scans) {
                // There was one when it was opened.
                Err(RecordingError::NoScans { .. }) => None,
                scan => scan.map_err(|error| self.recorded.failure(&error))?,
            };
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

    /// Moves the read position to the scan with this number, or to an earlier one.
    fn jump(&mut self, number: usize) -> Result<(), Failure> {
        self.kept.clear();
        // Positions identify scans only if they never decrease. Without a recorded window, the
        // file's first poll selects the stream. In both cases, start over.
        if !self.positions.is_sorted() || self.recorded.described().is_none() {
            (self.scans, self.next) = (self.recorded.open()?.scans(), 0);
            return Ok(());
        }
        let place = self.positions.get(number).copied().unwrap_or_default();
        // Several scans may share a position: take the first.
        self.next = self.positions.partition_point(|position| *position < place);
        self.scans = self.recorded.open_at(place)?.scans().numbered_from(self.next as u64);
        Ok(())
    }
}

/// Reads the next scan, and skips damaged parts of the file, as a replay does.
fn next_scan(scans: &mut RecordedScans) -> Result<Option<Scan>, RecordingError> {
    for scan in scans {
        match scan {
            Ok(scan) => return Ok(Some(scan)),
            Err(error @ RecordingError::Damaged { .. }) => {
                tracing::warn!(%error, "the playback leaves out a part of the recording");
            }
            Err(error) => return Err(error),
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use tokio_scip::{Rate, Sensor, Window};
    use urg_emulator::{Emulator, Values, WorldTime};
    use urg_recording::Recorder;

    use super::*;

    /// Records `count` scans. Every value of a scan encodes its number.
    async fn recorded(path: &std::path::Path, count: u64) -> Recorded {
        let world = |time: WorldTime, values: &mut Values| values.fill(20 + time.request as u32);
        let emulator = Emulator::builder().usb().world(world).build();
        let mut recorder = Recorder::builder().create(path).unwrap();
        let builder = Sensor::builder().on_reply(recorder.observer()).depth(1 << 12);
        let sensor = builder.connect(emulator).await.unwrap();
        let window = Window::new(300..=310).unwrap();
        let mut scans = sensor.scans(window, Rate::hz(10.0)).await.unwrap();
        recorder.describe(&sensor, &scans).await.unwrap();
        for _ in 0..count {
            recorder.record(&scans.next().await.unwrap()).unwrap();
        }
        recorder.finish().await.unwrap();
        let mut recorded = Recorded::named(path).unwrap();
        recorded.read_settings().await.unwrap();
        recorded
    }

    #[tokio::test(start_paused = true)]
    async fn a_jump_forward_reads_no_scans_between() {
        let path = std::env::temp_dir().join(format!("urg-reel-{}.mcap", std::process::id()));
        let recorded = recorded(&path, 2000).await;
        let all: Vec<_> = recorded.open().unwrap().scans().map(Result::unwrap).collect();
        let mut reel = Reel::open(recorded).unwrap();
        // Reading the damaged part would shift the numbers of the scans. It covers several
        // chunks, because a slow machine writes smaller ones.
        let mut bytes = std::fs::read(&path).unwrap();
        let quarter = bytes.len() / 4;
        bytes[quarter..quarter + 3000].iter_mut().step_by(50).for_each(|byte| *byte ^= 1);
        std::fs::write(&path, bytes).unwrap();
        for number in [0, 1000, 1001, 999, 1999, 1500, 1200, 1101, 1999] {
            let scan = reel.scan(number).unwrap();
            assert_eq!(scan.sequence(), number as u64);
            assert!(scan.raw_values().eq(all[number].raw_values()), "{number}");
        }
        let error = (400..600).find_map(|number| reel.scan(number).err()).unwrap();
        assert!(error.line().contains("urg repair"), "{error:?}");
        std::fs::remove_file(&path).unwrap();
    }
}
