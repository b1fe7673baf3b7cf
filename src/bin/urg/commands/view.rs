//! `urg view`: a live radar in the terminal.

use tokio_scip::Rate;

use crate::args::{LinkArgs, WindowArgs};
use crate::delivery::Delivery;
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::playback::PlaybackArgs;
use crate::port::name::PortArg;
use crate::port::open::open;
use crate::recording;
use crate::stream::follow::Ended;
use crate::view::{Screen, Viewer};

/// Show a live radar in the terminal
///
/// Continues by itself when an unplugged sensor comes back. A recording can be
/// paused, stepped and searched, and stays on its last scan. `?` shows the keys, `q` quits. NO_COLOR=1 switches colours off.
#[derive(Debug, clap::Args)]
#[command(after_help = examples())]
pub(crate) struct View {
    #[command(flatten)]
    port: PortArg,
    /// Scans a second, or `max` for as fast as the sensor answers [default: 10]
    #[arg(long, value_name = "HZ")]
    rate: Option<Rate>,
    #[command(flatten)]
    window: WindowArgs,
    #[command(flatten)]
    playback: PlaybackArgs,
    #[command(flatten)]
    link: LinkArgs,
}

fn examples() -> String {
    let recording = match recording::AVAILABLE {
        true => "\n  urg view run.mcap --range 1:30..2:00 --loop   a part of a recording",
        false => "",
    };
    format!(
        "\
Examples:
  urg view /dev/ttyACM0
  urg view /dev/ttyUSB0 --baud 115200 --cluster 2
  urg view emulated --from -90deg --to 90deg{recording}"
    )
}

impl View {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        let (mut port, rate) = self.port.polled_at(self.rate).await?;
        self.playback.apply([&mut port].into_iter(), self.rate.is_some())?;
        let window = self.window.window(port.default_window())?;
        Screen::require_terminal()?;
        let opening = async {
            if let Some(recorded) = port.recorded() {
                return Viewer::of_recording(&port, recorded, window, self.playback).await;
            }
            let sensor = open(&port, &self.link, Delivery::Newest).await?;
            Viewer::of_sensor(&port, sensor, window, rate).await
        };
        // An error is reported before the terminal is taken over.
        let mut viewer = tokio::select! {
            opened = opening => opened?,
            _ = interrupt.requested() => return Ok(()),
        };
        let mut screen = Screen::take()?;
        let outcome = tokio::select! {
            outcome = viewer.run(&mut screen) => outcome,
            _ = interrupt.requested() => Ok(Ended::Interrupted),
        };
        screen.restore().await;
        let outcome = match outcome {
            Ok(Ended::ByItself) => viewer.end(),
            outcome => outcome.map(drop),
        };
        viewer.finish().await;
        outcome
    }
}
