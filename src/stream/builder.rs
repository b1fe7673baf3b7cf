//! [`StreamBuilder`]: a stream with settings of its own.

use super::ScanStream;
use crate::driver::{Client, Request};
use crate::{Error, Rate, Window};

/// Builder of a [`ScanStream`]; made by [`Sensor::stream`](crate::Sensor::stream).
///
/// ```
/// # use urg_emulator::Emulator;
/// use tokio_scip::{Rate, Sensor, Window};
///
/// # #[tokio::main(flavor = "current_thread", start_paused = true)]
/// # async fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let sensor = Sensor::builder().connect(Emulator::default()).await?;
/// let (window, rate) = (Window::DETECTION, Rate::hz(10.0));
/// // A recorder that may be six seconds late, and a control loop that wants the newest
/// // scan: they share the polls.
/// let mut recorder = sensor.stream(window, rate).depth(64).open().await?;
/// let mut control = sensor.scans(window, rate).await?;
/// # tokio::time::sleep(std::time::Duration::from_secs(2)).await;
/// # assert_eq!((recorder.next().await.unwrap()?.sequence(), recorder.missed()), (0, 0));
/// # assert!(control.next().await.unwrap()?.sequence() > 10);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
#[must_use = "a builder does nothing until it opens a stream"]
pub struct StreamBuilder {
    client: Client,
    window: Window,
    rate: Rate,
    depth: usize,
}

impl StreamBuilder {
    pub(crate) fn new(client: Client, window: Window, rate: Rate) -> Self {
        let depth = client.depth();
        Self { client, window, rate, depth }
    }

    /// Sets how many of the newest scans to keep for this stream, at least 1. Default:
    /// the depth of the [sensor](crate::SensorBuilder::depth).
    ///
    /// Streams of the same window and rate share the kept scans: you pay only for the
    /// deepest stream, about 2 bytes per point.
    pub fn depth(mut self, scans: usize) -> Self {
        self.depth = scans.max(1);
        self
    }

    /// Opens the stream; see [`Sensor::scans`](crate::Sensor::scans).
    ///
    /// # Errors
    ///
    /// The cause if the driver has ended.
    pub async fn open(self) -> Result<ScanStream, Error> {
        let Self { client, window, rate, depth } = self;
        let subscribe = |responder| Request::Subscribe { window, rate, depth, responder };
        let cursor = client.ask(subscribe).await?;
        Ok(ScanStream { cursor, window, rate, client })
    }
}
