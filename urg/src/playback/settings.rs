//! Options of a playback.

use std::ops::RangeInclusive;

use clap::Args;

use crate::failure::Failure;
use crate::port::name::PortName;
use crate::recording::span::{RangeArgs, TopicArgs};

/// Allowed speeds, as multiples of the recorded speed.
pub(crate) const SPEEDS: RangeInclusive<f64> = 0.1..=100.0;

/// The playback of a recording, for people who look.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Recording")]
pub(crate) struct PlaybackArgs {
    #[command(flatten)]
    pub(crate) range: RangeArgs,
    #[command(flatten)]
    pub(crate) topic: TopicArgs,
    /// Speed of a recording's playback, 0.1 to 100 [default: 1]
    #[arg(long, value_name = "FACTOR", value_parser = speed)]
    pub(crate) speed: Option<f64>,
    /// Begin a recording again at its end
    #[arg(long = "loop")]
    pub(crate) is_looping: bool,
}

impl PlaybackArgs {
    /// Restricts the recordings among `ports` to the requested part.
    ///
    /// Fails if the user set options of a playback without a recording, or a rate without a sensor.
    pub(crate) fn apply<'a>(
        &self,
        ports: impl Iterator<Item = &'a mut PortName>,
        has_rate: bool,
    ) -> Result<(), Failure> {
        let (mut sensors, mut recordings) = (0, 0);
        for port in ports {
            match port.recorded() {
                Some(recorded) => {
                    recorded.require_file()?;
                    recordings += 1;
                    port.choose(self.range, &self.topic)?;
                }
                None => sensors += 1,
            }
        }
        let is_used = self.range.range.is_some()
            || self.topic.topic.is_some()
            || self.speed.is_some()
            || self.is_looping;
        if is_used && recordings == 0 {
            let text = "--range, --topic, --speed and --loop are for a recording, FILE.mcap: a sensor's \
                        scans come when it measures";
            return Err(Failure::Usage(text.to_owned()));
        }
        if has_rate && sensors == 0 {
            let text = "--rate is for a sensor: a recording is played at its own pace, and \
                        `--speed 2` plays it twice as fast";
            return Err(Failure::Usage(text.to_owned()));
        }
        Ok(())
    }
}

fn speed(text: &str) -> Result<f64, &'static str> {
    text.parse()
        .ok()
        .filter(|speed| SPEEDS.contains(speed))
        .ok_or("expected a number from 0.1 to 100, such as 2 for twice as fast")
}
