//! `urg view`: a live radar in the terminal.

use tokio_scip::{Rate, Sensor};

use super::screen::Screen;
use super::{ViewedSensor, Viewer};
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::picture::PictureArgs;
use crate::port::named::PlacedPort;
use crate::port::open::{Delivery, begin, opened};
use crate::stream::follow::StreamEnd;

/// Show a live radar in the terminal
///
/// Continues by itself when an unplugged sensor comes back. Several sensors are shown in
/// one frame, each at its place: X is in metres ahead of the common origin, Y to its
/// left, and YAW in degrees counter-clockwise. A sensor that fails does not affect the
/// others. A recording can be paused, stepped and searched, and stays on its last scan.
/// `?` shows the keys, `q` quits. NO_COLOR=1 switches colours off.
#[derive(Debug, clap::Args)]
#[command(after_help = examples())]
pub(crate) struct View {
    #[command(flatten)]
    picture: PictureArgs,
}

fn examples() -> &'static str {
    "\
Examples:
  urg view /dev/ttyACM0
  urg view /dev/ttyUSB0 --baud 115200 --cluster 2
  urg view front=/dev/ttyACM0@0.2,0,0 rear=serial:H0713091@-0.2,0,180
  urg view emulated --from -90deg --to 90deg
  urg view run.mcap --range 1:30..2:00 --loop   a part of a recording"
}

impl View {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        let polled = interrupt.unless(self.picture.polled()).await?;
        let recording = polled.iter().find(|(placed, _)| placed.named.port.recorded().is_some());
        if let Some((placed, _)) = recording.filter(|_| polled.len() > 1) {
            return Err(Failure::Usage(format!(
                "{}: view plays one recording, and no other source beside it: leave out the other \
                 PORTs, or show them all on a page with `urg serve`",
                placed.named.port
            )));
        }
        Screen::require_terminal()?;
        // Opening comes first: its errors must appear before the radar covers the terminal.
        let mut viewer = interrupt.unless(self.open(polled)).await?;
        let mut screen = Screen::take()?;
        let outcome = tokio::select! {
            outcome = viewer.run(&mut screen) => outcome,
            _ = interrupt.requested() => Ok(StreamEnd::Interrupted),
        };
        screen.restore().await;
        let outcome = match outcome {
            Ok(StreamEnd::ByItself) => viewer.end(),
            outcome => outcome.map(drop),
        };
        viewer.finish().await;
        outcome
    }

    async fn open(&self, polled: Vec<(PlacedPort, Rate)>) -> Result<Viewer, Failure> {
        let PictureArgs { window, playback, link, .. } = &self.picture;
        let has_several = polled.len() > 1;
        let mut sensors = Vec::new();
        for (placed, rate) in polled {
            let port = &placed.named.port;
            let window = window.window(port.default_window())?;
            if let Some(recorded) = port.recorded() {
                return Viewer::of_recording(&placed, recorded, window, *playback).await;
            }
            let sensor = begin(port, link, Delivery::Newest, Sensor::builder())?;
            sensors.push(ViewedSensor { placed, sensor, window, rate });
        }
        // With `--wait`, several sensors appear as they open.
        if !has_several || !link.wait {
            self.wait_for_any(&sensors).await?;
        }
        Ok(Viewer::of_sensors(sensors))
    }

    /// Waits for every sensor to open or fail. One open sensor is enough to succeed.
    async fn wait_for_any(&self, sensors: &[ViewedSensor]) -> Result<(), Failure> {
        let mut failures = Vec::new();
        // All sensors are already opening at the same time.
        for ViewedSensor { placed, sensor, .. } in sensors {
            if let Err(failure) = opened(&placed.named.port, &self.picture.link, sensor).await {
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
