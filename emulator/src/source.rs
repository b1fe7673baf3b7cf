//! [`Source`]: where the distances come from, a world or a script.

use tokio::time::Instant;

use super::device::Device;
use super::line_buffer::CommandLine;
use super::playback::{NextReply, Playback};
use super::world::{World, WorldTime};

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
        device
            .asked_steps(line)
            .map_or(NextReply::NotScripted, |steps| playback.next_reply(steps, at))
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
