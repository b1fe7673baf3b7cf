//! `urg view`: a live radar in the terminal.

use tokio_scip::Sensor;

use super::Viewer;
use super::screen::Screen;
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::picture::{PictureArgs, PictureSource};
use crate::playback::Player;
use crate::port::open::{begin, opened};
use crate::stream::follow::StreamEnd;

/// Show a live radar in the terminal
///
/// Continues by itself when an unplugged sensor comes back. Several sensors are shown in
/// one frame, each at its place: X is in metres ahead of the common origin, Y to its
/// left, and YAW in degrees counter-clockwise; write `X,Y,YAW,upside-down` for a sensor
/// mounted so. A sensor that fails does not affect the others. A recording can be paused, stepped and searched, and stays on its last scan.
/// `?` shows the keys, `q` quits. NO_COLOR=1 switches colours off.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct View {
    #[command(flatten)]
    picture: PictureArgs,
}

const EXAMPLES: &str = "\
Examples:
  urg view /dev/ttyACM0
  urg view /dev/ttyUSB0 --baud 115200 --cluster 2
  urg view front=/dev/ttyACM0@0.2,0,0 rear=serial:H0713091@-0.2,0,180
  urg view tcp://192.168.0.10 --intensity       shades for strong and weak reflections
  urg view emulated --from -90deg --to 90deg
  urg view run.mcap --range 1:30..2:00 --loop   a part of a recording";

impl View {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        let sources = interrupt.unless(self.picture.sources()).await?;
        let recording = sources.iter().find(|source| source.port.recorded().is_some());
        if let Some(source) = recording.filter(|_| sources.len() > 1) {
            return Err(Failure::Usage(format!(
                "{}: view plays one recording, and no other source beside it: leave out the other \
                 PORTs, or show them all on a page with `urg serve`",
                source.port
            )));
        }
        Screen::require_terminal()?;
        // Opening comes first: its errors must appear before the radar covers the terminal.
        let mut viewer = interrupt.unless(self.open(sources)).await?;
        let mut screen = Screen::take()?;
        let outcome = tokio::select! {
            outcome = viewer.run(&mut screen) => outcome,
            _ = interrupt.requested() => Ok(StreamEnd::Interrupted),
        };
        screen.restore().await;
        match outcome {
            Ok(StreamEnd::ByItself) => viewer.end(),
            outcome => outcome.map(drop),
        }
    }

    async fn open(&self, sources: Vec<PictureSource>) -> Result<Viewer, Failure> {
        let PictureArgs { playback, link, .. } = &self.picture;
        let mut sensors = Vec::new();
        for source in sources {
            if let Some(recorded) = source.port.recorded() {
                let player = Player::start(recorded, playback.clone()).await?;
                return Ok(Viewer::from_recording(source, player));
            }
            let sensor = begin(&source.port, link, Delivery::Newest)?;
            sensors.push((source, sensor));
        }
        // With `--wait`, several sensors appear as they open.
        if sensors.len() == 1 || !link.wait {
            self.wait_for_any(&sensors).await?;
        }
        Ok(Viewer::from_sensors(sensors))
    }

    /// Waits for every sensor to open or fail. One open sensor is enough to succeed.
    async fn wait_for_any(&self, sensors: &[(PictureSource, Sensor)]) -> Result<(), Failure> {
        let mut failures = Vec::new();
        // All sensors are already opening at the same time.
        for (source, sensor) in sensors {
            if let Err(failure) = opened(&source.port, &self.picture.link, sensor).await {
                failures.push(failure);
            }
        }
        // The screen shows the error of a sensor beside the others.
        if failures.len() < sensors.len() {
            return Ok(());
        }
        let last = failures.pop();
        failures.iter().for_each(|failure| notice(failure.line()));
        last.map_or(Ok(()), Err)
    }
}
