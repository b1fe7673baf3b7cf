//! [`StreamBuilder`]: a stream that is about to be opened.

use std::future::{Future, IntoFuture};
use std::pin::Pin;

use super::ScanStream;
use super::scan_stream::StreamClient;
use crate::driver::{Client, Request};
use crate::{Error, Rate, Window};

/// Stream that is about to be opened: await it. Made by [`Sensor::scans`](crate::Sensor::scans).
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
/// let mut recorder = sensor.scans(window, rate).depth(64).await?;
/// let mut control = sensor.scans(window, rate).await?;
/// # tokio::time::sleep(std::time::Duration::from_secs(2)).await;
/// # assert_eq!((recorder.next().await.unwrap()?.sequence(), recorder.missed()), (0, 0));
/// # assert!(control.next().await.unwrap()?.sequence() > 10);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
#[must_use = "a stream is opened when you await its builder"]
pub struct StreamBuilder {
    client: Client,
    window: Window,
    rate: Rate,
    depth: usize,
}

impl StreamBuilder {
    pub(crate) fn new(client: Client, window: Window, rate: Rate) -> Self {
        let depth = client.depth;
        Self { client, window, rate, depth }
    }

    /// Sets how many of the newest scans to keep for this stream, at least 1. Default:
    /// the depth of the [sensor](crate::SensorBuilder::depth).
    ///
    /// Streams of the same window and rate share the kept scans, so you pay only for the deepest
    /// stream: about 2 bytes per point, 4 in SCIP 2, 8 with intensities.
    pub fn depth(mut self, scans: usize) -> Self {
        self.depth = scans.max(1);
        self
    }
}

/// Opens the stream. Dropping the future opens none.
impl IntoFuture for StreamBuilder {
    type Output = Result<ScanStream, Error>;
    type IntoFuture = Pin<Box<dyn Future<Output = Self::Output> + Send>>;

    fn into_future(self) -> Self::IntoFuture {
        let Self { client, window, rate, depth } = self;
        Box::pin(async move {
            let subscribe = |responder| Request::Subscribe { window, rate, depth, responder };
            let cursor = client.ask(subscribe).await?;
            Ok(ScanStream { cursor, window, rate, client: StreamClient(client) })
        })
    }
}
