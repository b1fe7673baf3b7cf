//! [`Source`]: where the distances come from, a world or a [`Script`] of scans that are known in
//! advance, such as a recording.

use std::io;
use std::time::{Duration, SystemTime};

use tokio::time::Instant;

use super::device::Device;
use super::line_buffer::CommandLine;
use super::scip2::Times;
use super::world::{Values, World, WorldTime};

/// Longest time that the sensor holds back a reply until it is due. An earlier request gets
/// no answer. Shorter than a driver's deadline.
const MAX_HOLD: Duration = Duration::from_millis(400);

/// Source of scans in a fixed order, such as a recording:
/// [`EmulatorBuilder::script`](crate::EmulatorBuilder::script). Each request for a scan gets the next
/// one, and a stream (`MD`) sends them all.
pub trait Script: Send {
    /// Reads the next reply, once a command has arrived. May block.
    fn prepare(&mut self);

    /// Time from the first reply to the next one, or `None` after the last one.
    fn due(&self) -> Option<Duration>;

    /// Returns true if a `G` for the single step `step` asks for the next reply, and is
    /// not a fence.
    fn is_single_step(&self, step: u16) -> bool;

    /// Advances to the next reply. Returns its bytes, as an answer to `command`, if they
    /// cannot be encoded from distances. `command` may have started a stream.
    fn advance(&mut self, command: &[u8]) -> Option<Vec<u8>>;

    /// Wall clock of the latest reply's arrival.
    fn wall_clock(&self) -> SystemTime;

    /// Error that ended the script early, if any.
    fn failure(&self) -> Option<io::Error>;

    /// Copies the latest distance and intensity of each step that was ever measured. `intensities` is
    /// empty if none are asked for.
    fn measure(&self, distances: &mut Values, intensities: &mut Values);

    /// Sensor's clock in microseconds at the latest scan. `None` if it is unknown.
    fn clock(&self) -> Option<u64>;
}

/// Speed of a replay.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum ReplayPace {
    /// Recorded speed: no reply arrives before its time. Polls time out in a gap of the
    /// recording.
    #[default]
    Recorded,
    /// As fast as you poll. If your stream must not miss a scan, set a large depth
    /// ([`depth`](tokio_scip::SensorBuilder::depth)).
    Max,
}

/// World, and the script to play in its place.
pub(super) struct Source {
    pub(super) world: Box<dyn World>,
    pub(super) playback: Option<Playback>,
}

impl Source {
    /// Reads the next reply of the script. May block.
    pub(super) fn prepare(&mut self) {
        if let Some(playback) = &mut self.playback {
            playback.script.prepare();
        }
    }

    /// Answer of the script to a command that is served at `at`.
    pub(super) fn next_reply(&self, device: &Device, line: &CommandLine, at: Instant) -> NextReply {
        let Some(playback) = &self.playback else { return NextReply::NotScripted };
        // With the laser off, the sensor refuses `G`, whatever the script has.
        let Some((start, end)) = device.asked_steps(line) else { return NextReply::NotScripted };
        if start >= end && !playback.script.is_single_step(end) {
            return NextReply::NotScripted;
        }
        match playback.due(at) {
            None => NextReply::End,
            Some(due) if due <= at + MAX_HOLD => NextReply::At(due),
            Some(_) => NextReply::TooEarly,
        }
    }

    /// Returns what fills in the distances and intensities of a revolution.
    pub(super) fn measure_at(&mut self, time: WorldTime) -> impl FnMut(&mut [u32], &mut [u32]) {
        move |distances, intensities| match &self.playback {
            Some(playback) => playback.script.measure(distances, intensities),
            None => {
                self.world.measure(time, distances);
                if !intensities.is_empty() {
                    self.world.measure_intensities(time, distances, intensities);
                }
            }
        }
    }
}

/// Script being played.
pub(super) struct Playback {
    pub(super) script: Box<dyn Script>,
    pace: ReplayPace,
    started_at: Option<Instant>,
}

/// Answer of the script to a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NextReply {
    /// The script does not answer the command, so the device does.
    NotScripted,
    /// Next reply of the script, not before this time.
    At(Instant),
    /// No reply, because the next one is due too far in the future.
    TooEarly,
    /// End of the script: the sensor is unplugged.
    End,
}

impl Playback {
    pub(super) fn new(script: Box<dyn Script>, pace: ReplayPace) -> Self {
        Self { script, pace, started_at: None }
    }

    /// When the next reply can be sent, at `at` or later. `None` at the end of the script.
    pub(super) fn due(&self, at: Instant) -> Option<Instant> {
        let due = self.script.due()?;
        let started_at = self.started_at.filter(|_| self.pace == ReplayPace::Recorded);
        Some(started_at.map_or(at, |started_at| at.max(started_at + due)))
    }

    /// Plays the next reply. Returns its bytes if they cannot be encoded from distances.
    pub(super) fn advance(&mut self, command: &[u8], times: &mut Times) -> Option<Vec<u8>> {
        if self.started_at.is_none() {
            self.started_at = times.now.checked_sub(self.script.due().unwrap_or_default());
        }
        let reply = self.script.advance(command);
        times.scan = self.script.clock().unwrap_or(times.scan);
        reply
    }
}
